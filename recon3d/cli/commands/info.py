"""``recon3d info``."""

from __future__ import annotations

from pathlib import Path

import typer

from recon3d.cli import options
from recon3d.cli.arguments import load, say


def command(
    scene: options.Scene,
    output: options.Output = None,
    bounds: options.Bounds = None,
    silhouettes: options.Silhouettes = "auto",
    images: options.Images = None,
) -> None:
    """Say what a scene holds and which views can be used together; with --output, draw it."""
    from recon3d.carving.visibility import largest_admissible_views
    from recon3d.io.files import write_image
    from recon3d.io.middlebury import read_angles
    from recon3d.scene.silhouettes import overlay
    from recon3d.summary import thumbnails

    loaded = load(scene, bounds, silhouettes, images=images)
    admissible = largest_admissible_views(loaded)
    angles = read_angles(scene) if Path(scene).is_dir() else {}
    say(loaded.summary())
    say({"views for voxel colouring": f"{len(admissible)} of {len(loaded.views)} (ordinal visibility constraint)"})
    typer.echo()
    for view in loaded.views:
        angle = "lat {:.1f} lon {:.1f}".format(*angles[view.name]) if view.name in angles else ""
        use = "used" if view.name in admissible else "-"
        known = "silhouette" if view.has_silhouette else "no silhouette"
        typer.echo(f"  {view.name:24} {use:6} {known:14} {angle}".rstrip())
    if output:
        sheet = thumbnails((overlay(loaded, view) for view in loaded.views), width=320, columns=4)
        say({"silhouettes and bounds": write_image(output / "views.png", sheet)})
