"""``recon3d compare``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from recon3d.checks import require_number
from recon3d.cli import options
from recon3d.cli.arguments import make_method, names_of, sweep_of, views_of
from recon3d.cli.console import progress, say
from recon3d.cli.options import CARVING, INPUT, MEASURING
from recon3d.cli.results import writable
from recon3d.cli.scenes import load
from recon3d.errors import ArgumentError

TESTS = "Tests"


def command(
    scene: options.Scene,
    tests: Annotated[
        str,
        typer.Option(
            metavar="all|NAME,NAME", help="Photo-consistency tests, built in or module:name.", rich_help_panel=TESTS
        ),
    ] = "all",
    sweep: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=LOW:HIGH:STEP",
            help="Run the tests with this parameter at each of its values.",
            rich_help_panel=TESTS,
        ),
    ] = None,
    views: options.Views = "auto",
    max_views: Annotated[
        int | None, typer.Option(help="At most so many views, after those held out.", rich_help_panel=INPUT)
    ] = None,
    silhouettes: options.Silhouettes = "auto",
    images: options.Images = None,
    bounds: options.Bounds = None,
    mm_per_unit: options.MmPerUnit = None,
    n_voxels: Annotated[
        int, typer.Option("--voxels", help="Approximate number of voxels.", rich_help_panel=CARVING)
    ] = 1_000_000,
    method: options.Method = "voxel-coloring",
    hold_out: Annotated[
        str,
        typer.Option(
            metavar="N|NAME,NAME",
            help="Hold out every N-th view, or those named, to measure re-projection on; 0: measure on all used.",
            rich_help_panel=MEASURING,
        ),
    ] = "4",
    ground_truth: Annotated[
        Path | None, typer.Option(metavar="MESH", help="Measure against this mesh.", rich_help_panel=MEASURING)
    ] = None,
    valid: options.Valid = None,
    valid_within: options.ValidWithin = 0.1,
    accuracy_percent: options.AccuracyPercent = 90.0,
    completeness_threshold: options.CompletenessThreshold = 1.25,
    output: options.Output = None,
    method_option: options.MethodOptions = None,
) -> None:
    """Compare photo-consistency tests on the same voxels and views; what is finished is not run again."""
    from recon3d.evaluation.files import read_ground_truth
    from recon3d.settings import Settings
    from recon3d.study.comparison import compare
    from recon3d.study.variants import expand_variants

    chosen: Any = tests if tests == "all" else names_of(tests)
    swept = sweep_of(sweep) if sweep else None
    expand_variants(chosen, swept)  # a mistake here need not wait for the photographs
    settings = Settings(
        n_voxels=n_voxels,
        carving=make_method(method, method_option or [], None, []),
        views=views_of(views),
        max_views=max_views,
    )
    if valid and not ground_truth:
        raise ArgumentError("--valid: expected --ground-truth, too")
    if mm_per_unit is not None:
        require_number("--mm-per-unit", mm_per_unit, "(0, inf)")
    loaded = load(scene, bounds, silhouettes, mm_per_unit, images)
    measuring: dict[str, Any] = {}
    if ground_truth:
        truth, mask = read_ground_truth(
            ground_truth, valid=valid, valid_within_mm=valid_within, mm_per_unit=loaded.known_scale()
        )
        measuring = {
            "ground_truth": truth,
            "valid": mask,
            "accuracy_percent": accuracy_percent,
            "completeness_threshold_mm": completeness_threshold,
        }
    folder = writable(output or Path("recon3d-output") / f"{loaded.name}-tests")
    with progress() as report:
        result = compare(
            loaded,
            chosen,
            settings=settings,
            sweep=swept,
            hold_out=int(hold_out) if hold_out.isdigit() else names_of(hold_out),
            folder=folder,
            progress=report,
            **measuring,
        )
        written = result.save(folder)
    typer.echo(result.markdown())
    say(written)
