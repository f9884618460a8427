"""``recon3d evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon3d.checks import require_number
from recon3d.cli import options
from recon3d.cli.arguments import beside, mesh_of, progress, record_of, say, writable
from recon3d.errors import ArgumentError


def command(
    reconstruction: Annotated[Path, typer.Argument(metavar="RECON", help="Result folder, mesh, points or voxels.")],
    ground_truth: Annotated[Path, typer.Argument(metavar="GROUND_TRUTH", help="Mesh or points, in the same frame.")],
    output: options.Output = None,
    accuracy_percent: options.AccuracyPercent = 90.0,
    completeness_threshold: options.CompletenessThreshold = 1.25,
    mm_per_unit: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Millimetres in one world unit.", show_default="the result's, or 1000"),
    ] = None,
    valid: options.Valid = None,
    valid_within: options.ValidWithin = 0.1,
    supported: Annotated[
        bool, typer.Option("--supported", help="Leave out what was not measured and is filled from the hull.")
    ] = False,
    error_scale: Annotated[float, typer.Option(metavar="MM", help="Distance that the error maps show red.")] = 5.0,
    seed: Annotated[int, typer.Option(help="Seed of the surface samples.")] = 0,
) -> None:
    """Measure a reconstruction: accuracy and completeness against a ground truth."""
    from open3d.geometry import TriangleMesh

    from recon3d.evaluation.files import evaluate_files
    from recon3d.io.geometry import read_geometry
    from recon3d.reporting.figures import save_evaluation
    from recon3d.reporting.pictures import save_error_maps

    folder = writable(output or beside(reconstruction, "evaluation"))
    if mm_per_unit is None:
        record = record_of(reconstruction)
        mm_per_unit = record["mm_per_unit"] if record else 1000.0
        if mm_per_unit is None:
            raise ArgumentError(f"--mm-per-unit: expected it, since {reconstruction} has no scale of its own")
    require_number("--mm-per-unit", mm_per_unit, "(0, inf)")
    with progress() as report:
        report("measuring", 0, 1)
        measured = evaluate_files(
            mesh_of(reconstruction),
            ground_truth,
            valid=valid,
            valid_within_mm=valid_within,
            supported=supported,
            mm_per_unit=mm_per_unit,
            accuracy_percent=accuracy_percent,
            completeness_threshold_mm=completeness_threshold,
            seed=seed,
        )
        report("measuring", 1, 1)
    written = save_evaluation(measured, folder)
    files = mesh_of(reconstruction), ground_truth
    if all(isinstance(read_geometry(file), TriangleMesh) for file in files):
        with progress() as report:
            report("error maps", 0, 1)
            written |= save_error_maps(*files, folder, mm_per_unit=mm_per_unit, full_scale_mm=error_scale)
            report("error maps", 1, 1)
    say(measured.summary())
    say(written)
