"""``recon3d evaluate``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from recon3d.checks import require_number
from recon3d.cli import options
from recon3d.cli.console import progress, say
from recon3d.cli.results import beside, mesh_of, record_of, recorded_scene, writable
from recon3d.cli.scenes import load
from recon3d.errors import ArgumentError


class _Align(StrEnum):
    """What is undone before measuring."""

    none = "none"
    rigid = "rigid"
    similarity = "similarity"


def command(
    reconstruction: Annotated[Path, typer.Argument(metavar="RECON", help="Result folder, mesh, points or voxels.")],
    ground_truth: Annotated[
        Path, typer.Argument(metavar="GROUND_TRUTH", help="Mesh or points, in the same frame, or see --align.")
    ],
    output: options.Output = None,
    accuracy_percent: options.AccuracyPercent = 90.0,
    completeness_threshold: options.CompletenessThreshold = 1.25,
    mm_per_unit: Annotated[
        float | None,
        typer.Option(
            metavar="MM",
            help="Millimetres in one world unit; after --align similarity one of GROUND_TRUTH.",
            show_default="the result's, or 1000",
        ),
    ] = None,
    valid: options.Valid = None,
    valid_within: options.ValidWithin = 0.1,
    supported: Annotated[
        bool, typer.Option("--supported", help="Leave out what was not measured and is filled from the hull.")
    ] = False,
    align: Annotated[
        _Align,
        typer.Option(
            help="Bring RECON into the frame of GROUND_TRUTH first, by the closest points of both: rigid where their "
            "unit is the same, similarity where it is not, as of photographs without a scale."
        ),
    ] = _Align.none,
    cameras: Annotated[
        str | None,
        typer.Option(
            metavar="SCENE",
            help="With --align: the scene that GROUND_TRUTH is of. Its camera centres and those that RECON was made "
            "from, of the same names, are brought together first.",
        ),
    ] = None,
    error_scale: Annotated[float, typer.Option(metavar="MM", help="Distance that the error maps show red.")] = 5.0,
    seed: Annotated[int, typer.Option(help="Seed of the surface samples.")] = 0,
) -> None:
    """Measure a reconstruction: accuracy and completeness against a ground truth."""
    from open3d.geometry import TriangleMesh

    from recon3d.evaluation.files import evaluate_files
    from recon3d.io.reading_geometry import read_geometry
    from recon3d.reporting.figures import save_evaluation
    from recon3d.reporting.pictures import save_error_maps

    folder = writable(output or beside(reconstruction, "evaluation"))
    if mm_per_unit is None:
        record = record_of(reconstruction)
        mm_per_unit = record.scene.mm_per_unit if record and align is not _Align.similarity else 1000.0
        if mm_per_unit is None:
            raise ArgumentError(
                f"--mm-per-unit: expected it, since {reconstruction} has no scale of its own, or --align similarity"
            )
    require_number("--mm-per-unit", mm_per_unit, "(0, inf)")
    measured_file = mesh_of(reconstruction)
    if align is not _Align.none:
        measured_file = _aligned(reconstruction, ground_truth, folder, cameras, scaling=align is _Align.similarity)
    elif cameras is not None:
        raise ArgumentError("--cameras: expected --align rigid or similarity, too")
    with progress() as report:
        report("measuring", 0, 1)
        measured = evaluate_files(
            measured_file,
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
    files = measured_file, ground_truth
    if all(isinstance(read_geometry(file), TriangleMesh) for file in files):
        with progress() as report:
            report("error maps", 0, 1)
            written |= save_error_maps(*files, folder, mm_per_unit=mm_per_unit, full_scale_mm=error_scale)
            report("error maps", 1, 1)
    say(measured.summary())
    say(written)


def _aligned(reconstruction: Path, ground_truth: Path, folder: Path, cameras: str | None, *, scaling: bool) -> Path:
    """File of a reconstruction in the frame of a ground truth."""
    import numpy as np
    from open3d.geometry import PointCloud, TriangleMesh

    from recon3d.evaluation.alignment import align
    from recon3d.io.geometry import write_geometry
    from recon3d.io.reading_geometry import read_geometry, read_support, read_uncertainty
    from recon3d.scene.similarity import Similarity

    file = mesh_of(reconstruction)
    shape, truth = read_geometry(file), read_geometry(ground_truth)
    if not (isinstance(shape, TriangleMesh | PointCloud) and isinstance(truth, TriangleMesh | PointCloud)):
        raise ArgumentError("--align: expected meshes or points, got a voxel grid, which cannot be turned")
    start = None
    if cameras is not None:
        own = recorded_scene(reconstruction, record_of(reconstruction), hint=", so --cameras cannot be used")
        there = {view.name: view.center for view in load(cameras, None, "none").views}
        shared = [view for view in own.views if view.name in there]
        if len(shared) < 3:
            raise ArgumentError(
                f"--cameras: expected at least 3 views of the same names in {own.name} and {cameras}, got {len(shared)}"
            )
        centers = np.array([view.center for view in shared]), np.array([there[view.name] for view in shared])
        start = Similarity.between(*centers, scaling=scaling)
    with progress() as report:
        report("aligning", 0, 1)
        found = align(shape, truth, scaling=scaling, start=start)
        report("aligning", 1, 1)
    say({"aligned": found})
    support = uncertainty = None
    if file.suffix.lower() == ".ply" and isinstance(shape, TriangleMesh):
        support, uncertainty = read_support(file), read_uncertainty(file)
        uncertainty = None if uncertainty is None else found.scale * uncertainty
    shape.transform(found.matrix())
    return write_geometry(folder / "aligned.ply", shape, support=support, uncertainty=uncertainty)
