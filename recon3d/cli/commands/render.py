"""``recon3d render``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon3d.cli import options
from recon3d.cli.arguments import beside, load, mesh_of, progress, record_of, recorded_scene, say, writable


def command(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Folder of a result, or a mesh file.")],
    scene: Annotated[
        str | None, typer.Option(metavar="SCENE", help="Whose cameras to use, if not those the result records.")
    ] = None,
    output: options.Output = None,
) -> None:
    """Render a result from its input cameras, beside the photographs, and from all around."""
    from recon3d.io.geometry import read_mesh
    from recon3d.reporting.pictures import save_pictures

    mesh = read_mesh(mesh_of(result))
    folder = writable(output or beside(result, "renders"))
    hint = ", so the cameras are not known; give --scene"
    loaded = load(scene, None, "none") if scene else recorded_scene(result, record_of(result), hint=hint)
    with progress() as report:
        report("rendering", 0, 1)
        written = save_pictures(mesh, loaded, folder, every_view=True)
        report("rendering", 1, 1)
    say(written)
