"""``recon3d info``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon3d.cli import options
from recon3d.cli.arguments import load, say


def command(
    scene: options.Scene,
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
    silhouettes: options.Silhouettes = "auto",
    images: options.Images = None,
) -> None:
    """Check a scene: what it holds, what is wrong with it, its views in a table; --output and --figure draw it."""
    from recon3d.carving.visibility import largest_admissible_views
    from recon3d.diagnosis import diagnose
    from recon3d.io.files import write_image
    from recon3d.io.middlebury import read_angles
    from recon3d.scene.silhouettes import overlay
    from recon3d.summary import thumbnails

    loaded = load(scene, bounds, silhouettes, images=images)
    admissible = largest_admissible_views(loaded)
    angles = read_angles(scene) if Path(scene).is_dir() else {}
    diagnosis = diagnose(loaded)
    say(loaded.summary())
    say({"views for voxel colouring": f"{len(admissible)} of {len(loaded.views)} (ordinal visibility constraint)"})
    typer.echo()
    heading, *rows = diagnosis.table()
    typer.echo("  " + heading)
    for view, row in zip(loaded.views, rows, strict=True):
        angle = "lat {:.1f} lon {:.1f}".format(*angles[view.name]) if view.name in angles else ""
        use = "used" if view.name in admissible else "-"
        known = "silhouette" if view.has_silhouette else "no silhouette"
        typer.echo(f"  {row}  {use:6} {known:14} {angle}".rstrip())
    typer.echo()
    for finding in diagnosis.findings:
        typer.echo(f"  Check: {finding}")
    if not diagnosis.findings:
        typer.echo(f"  Check: nothing wrong was found ({diagnosis.seen()})")
    if figure:
        from recon3d.diagnosis.figure import save_figure

        say({"cameras and bounds": save_figure(diagnosis, figure)})
    if output:
        sheet = thumbnails((overlay(loaded, view) for view in loaded.views), width=320, columns=4)
        say({"silhouettes and bounds": write_image(output / "views.png", sheet)})
