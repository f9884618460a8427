"""``recon3d texture``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon3d.cli import options
from recon3d.cli.console import progress, say
from recon3d.cli.results import mesh_of, record_of, recorded_scene, save_texture, writable
from recon3d.cli.scenes import load


def command(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Folder of a result, or a mesh file.")],
    scene: Annotated[
        str | None, typer.Option(metavar="SCENE", help="Whose photographs to use, if not those the result records.")
    ] = None,
    silhouettes: options.Silhouettes = "auto",
    size: Annotated[int, typer.Option(metavar="TEXELS", help="Width and height of the texture.")] = 4096,
    triangles: Annotated[int, typer.Option(metavar="N", help="At most so many triangles in the mesh.")] = 50_000,
    output: options.Output = None,
) -> None:
    """Make a texture for a result from its photographs: GLB, and OBJ with MTL and PNG, in metres, y up."""
    from recon3d.io.reading_geometry import read_mesh
    from recon3d.surface import texture_mesh

    mesh = read_mesh(mesh_of(result))
    folder = writable(output or (result if result.is_dir() else result.parent))
    if scene:
        loaded = load(scene, None, silhouettes)
    else:
        record = record_of(result)
        told = record.scene.silhouettes if record and silhouettes == "auto" else silhouettes
        hint = ", so the photographs are not known; give --scene"
        loaded = recorded_scene(result, record, silhouettes=told, hint=hint, whole_photographs=True)
    with progress() as report:
        report("texture", 0, 1)
        textured = texture_mesh(mesh, loaded, size=size, triangles=triangles)
        report("texture", 1, 1)
    say(textured.summary())
    say(save_texture(textured, folder))
