"""``recon3d render``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from recon3d.cli import options
from recon3d.cli.console import progress, say
from recon3d.cli.results import beside, mesh_of, record_of, recorded_scene, writable
from recon3d.cli.scenes import load
from recon3d.errors import DataError


class _Mode(StrEnum):
    """What pictures show."""

    photographs = "photographs"
    uncertainty = "uncertainty"


def command(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Folder of a result, or a mesh file.")],
    scene: Annotated[
        str | None, typer.Option(metavar="SCENE", help="Whose cameras to use, if not those the result records.")
    ] = None,
    mode: Annotated[
        _Mode,
        typer.Option(
            help="photographs: colours, shading, normals and depth beside the photographs; uncertainty: how far each "
            "place may be from the true surface, with a scale of colours."
        ),
    ] = _Mode.photographs,
    output: options.Output = None,
) -> None:
    """Render a result from its input cameras, beside the photographs, and from all around."""
    from recon3d.io.reading_geometry import read_mesh, read_uncertainty
    from recon3d.reporting.pictures import save_pictures
    from recon3d.reporting.uncertainty_maps import save_uncertainty

    file = mesh_of(result)
    mesh = read_mesh(file)
    uncertainty = read_uncertainty(file) if mode == _Mode.uncertainty and file.suffix.lower() == ".ply" else None
    if mode == _Mode.uncertainty and uncertainty is None:
        raise DataError(
            f"{file}: expected vertices with an uncertainty, as mesh.ply of a dense result has them, got none; a mesh "
            "of voxels has no uncertainty"
        )
    folder = writable(output or beside(result, "renders"))
    hint = ", so the cameras are not known; give --scene"
    loaded = load(scene, None, "none") if scene else recorded_scene(result, record_of(result), hint=hint)
    with progress() as report:
        report("rendering", 0, 1)
        if uncertainty is None:
            written = save_pictures(mesh, loaded, folder, every_view=True)
        else:
            written = save_uncertainty(mesh, uncertainty, loaded, folder)
        report("rendering", 1, 1)
    say(written)
