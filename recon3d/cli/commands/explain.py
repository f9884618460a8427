"""``recon3d explain``."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated

import typer

from recon3d.cli import options
from recon3d.cli.arguments import numbers_of, pixel_of
from recon3d.cli.console import progress, say
from recon3d.cli.results import beside, record_of, recorded_scene, recorded_settings, writable
from recon3d.errors import ArgumentError


def command(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Folder of a result.")],
    at: Annotated[str | None, typer.Option(metavar="X,Y,Z", help="A place in the voxel, world units.")] = None,
    pixel: Annotated[
        str | None,
        typer.Option(
            metavar="VIEW,U,V",
            help="The surface that the pixel shows; where there is none, what came nearest to it on the ray.",
        ),
    ] = None,
    test: Annotated[
        str | None,
        typer.Option(metavar="MODULE:NAME", help="Your own test, if the result was made with it: run its code again."),
    ] = None,
    output: options.Output = None,
) -> None:
    """Say why a voxel was carved or kept: carve once more as recorded, and draw what decided."""
    from recon3d.explaining.explanation import explain as explain_voxel
    from recon3d.io.checkpoints import Checkpoints
    from recon3d.io.files import write_image

    place, clicked = numbers_of("--at", at, "three numbers X,Y,Z"), pixel_of(pixel)
    if (place is None) == (clicked is None):
        raise ArgumentError("expected --at X,Y,Z or --pixel VIEW,U,V, one of them")
    record = record_of(result)
    settings = recorded_settings(result, record, test)
    scene = recorded_scene(result, record, silhouettes=record.scene.silhouettes if record else "auto")
    folder = writable(output or beside(result, "explanations"))
    stages = beside(result, "stages")
    kept = Checkpoints(stages) if stages.is_dir() else None
    with progress() as report:
        report("carving", 0, 1)
        found = explain_voxel(scene, settings, at=place, pixel=clicked, checkpoints=kept)
        report("carving", 1, 1)
    kept_voxels = ("consistent", "hidden")
    if record and any(record.voxels.get(name) != found.carved.counts()[name] for name in kept_voxels):
        warnings.warn(f"{result}: carved once more, other voxels are left than recorded; data or program have changed",
                      stacklevel=1)  # fmt: skip
    name = "voxel_" + "_".join(map(str, found.voxel)) + ".png"
    say(found.summary())
    say({"picture": write_image(folder / name, found.picture())})
