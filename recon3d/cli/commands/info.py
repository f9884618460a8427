"""``recon3d info``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from recon3d.cli import options
from recon3d.cli.console import say
from recon3d.cli.results import mesh_of, record_of, recorded_scene
from recon3d.cli.scenes import at_detail, doubts, load, warn_of_doubts
from recon3d.errors import ArgumentError, Recon3dError

if TYPE_CHECKING:
    from recon3d.diagnosis import Diagnosis
    from recon3d.scene.scene import Scene


def command(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|RESULT",
            help="Folder of calibrated photographs, or 'little-temple' (built in); with --next-views that of a result.",
        ),
    ],
    output: options.Output = None,
    figure: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Draw cameras, bounds and matched points in 3D: .png, .pdf or .svg.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    bounds: options.Bounds = None,
    object_alone: options.Object = False,
    silhouettes: options.Silhouettes = "auto",
    images: options.Images = None,
    mm_per_unit: options.MmPerUnit = None,
    detail: options.Detail = "auto",
    memory: options.Memory = None,
    next_views: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Of a result: which of its surface is missing, and from where N more photographs would help most.",
        ),
    ] = None,
) -> None:
    """Check a scene: what it holds, what is wrong with it, its views in a table; --output and --figure draw it.

    Of a scene that cannot be used, what could be read is told, and why not.
    """
    from recon3d.budget import advised_voxel_size, needs
    from recon3d.diagnosis import diagnose
    from recon3d.settings import Settings

    if next_views is not None:
        given = output, bounds, object_alone or None, images, mm_per_unit, memory
        if any(option is not None for option in given) or (silhouettes, detail) != ("auto", "auto"):
            raise ArgumentError("--next-views: expected a result and --figure alone; its record tells the scene")
        _tell_of_next_views(Path(scene), next_views, figure)
        return
    with doubts() as doubted:
        try:
            loaded = load(scene, bounds, silhouettes, mm_per_unit, images, object_alone=object_alone)
        except Recon3dError:
            _tell_of_refused(scene, images, figure)
            raise
        chosen = at_detail(loaded, detail, memory)
    diagnosis = diagnose(loaded)  # at full detail, or half a pixel would be less
    advised = advised_voxel_size(chosen.scene)
    told = f"{loaded.length(advised)} (--voxel-size {advised:.3g}): {needs(chosen.scene, Settings(voxel_size=advised))}"
    say({**chosen.scene.summary(), "detail": chosen.told, "advised voxel size": told})
    _tell_of_views(loaded, diagnosis, Path(scene))
    warn_of_doubts(doubted, diagnosis.findings)
    _tell_of_findings(diagnosis, figure, wrong=bool(doubted))
    if output:
        _draw_silhouettes(loaded, output)


def _tell_of_next_views(result: Path, n: int, figure: Path | None) -> None:
    """Print which part of a result's surface is missing and where to photograph from, and draw it."""
    from recon3d.diagnosis import diagnose
    from recon3d.diagnosis.figure import save_figure
    from recon3d.evaluation import propose_views
    from recon3d.io.reading_geometry import read_mesh, read_support, read_uncertainty

    file = mesh_of(result)
    mesh, of_vertices = read_mesh(file), file.suffix.lower() == ".ply"
    scene = recorded_scene(result, record_of(result))
    coverage = propose_views(
        mesh, scene, n,
        support=read_support(file) if of_vertices else None,
        uncertainty=read_uncertainty(file) if of_vertices else None,
    )  # fmt: skip
    say(coverage.summary())
    if figure:
        cameras = [view.camera for view in coverage.proposals]
        drawn = save_figure(diagnose(scene), figure, proposed=cameras, missing=coverage.samples)
        say({"cameras and missing surface": drawn})


def _tell_of_views(scene: Scene, diagnosis: Diagnosis, path: Path) -> None:
    """Print the table of the views, with what can be done with them."""
    from recon3d.carving.visibility import largest_admissible_views
    from recon3d.io.middlebury import read_angles

    admissible = largest_admissible_views(scene)
    angles = read_angles(path) if path.is_dir() else {}
    say({"views for voxel colouring": f"{len(admissible)} of {len(scene.views)} (ordinal visibility constraint)"})
    rows = []
    for view in scene.views:
        angle = "lat {:.1f} lon {:.1f}".format(*angles[view.name]) if view.name in angles else ""
        use = "used" if view.name in admissible else "-"
        rows.append(f"{use:6} {'silhouette' if view.has_silhouette else 'no silhouette':14} {angle}")
    _print_table(diagnosis, rows)


def _tell_of_refused(scene: str, images: Path | None, figure: Path | None) -> None:
    """Print what the files of a scene say that cannot be used; nothing where not even they can be read."""
    from recon3d.diagnosis import diagnose_cameras
    from recon3d.io.opening import read_calibrated, views_of

    try:
        found = read_calibrated(scene, images)
        views = views_of(found)
        diagnosis = diagnose_cameras(views, name=found.name)
    except (Recon3dError, ValueError):
        return
    sizes = sorted({f"{view.width}x{view.height}" for view in views})
    say({"name": found.name, "views": len(views), "image size": ", ".join(sizes), **found.notes})
    if found.bounds is not None:
        say({"bounds": found.bounds.text})
    _print_table(diagnosis, [""] * len(views))
    _tell_of_findings(diagnosis, figure, wrong=True)


def _print_table(diagnosis: Diagnosis, ends: list[str]) -> None:
    heading, *rows = diagnosis.table()
    typer.echo()
    typer.echo("  " + heading)
    for row, end in zip(rows, ends, strict=True):
        typer.echo(f"  {row}  {end}".rstrip())
    typer.echo()


def _tell_of_findings(diagnosis: Diagnosis, figure: Path | None, *, wrong: bool) -> None:
    """Print what the checks have found, and draw it.

    Parameters
    ----------
    wrong : whether something else is known to be wrong, or may be.
    """
    for finding in diagnosis.findings:
        typer.echo(f"  Check: {finding}")
    if not diagnosis.findings:
        more = " else" if wrong else ""
        typer.echo(f"  Check: nothing{more} wrong was found ({diagnosis.seen()})")
    if figure:
        from recon3d.diagnosis.figure import save_figure

        say({"cameras and bounds": save_figure(diagnosis, figure)})


def _draw_silhouettes(scene: Scene, output: Path) -> None:
    """Write a sheet of all views with silhouettes and bounds drawn in."""
    from recon3d.io.files import write_image
    from recon3d.scene.silhouettes import overlay
    from recon3d.summary import thumbnails

    sheet = thumbnails((overlay(scene, view) for view in scene.views), width=320, columns=4)
    say({"silhouettes and bounds": write_image(output / "views.png", sheet)})
