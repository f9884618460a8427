"""``recon3d convert``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from recon3d.cli import options
from recon3d.cli.console import progress, say
from recon3d.cli.options import OUTPUT
from recon3d.cli.scenes import load


class Form(StrEnum):
    """Formats that scenes are written in."""

    colmap = "colmap"
    transforms = "transforms"
    neus = "neus"
    middlebury = "middlebury"
    open3d = "open3d"


def command(
    scene: options.Scene,
    to: Annotated[Form, typer.Option(help="Format of the files that are written.", rich_help_panel=OUTPUT)],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="DIR", help="New folder for the scene.", rich_help_panel=OUTPUT),
    ],
    silhouettes: options.Silhouettes = "auto",
    bounds: options.Bounds = None,
    mm_per_unit: options.MmPerUnit = None,
    images: options.Images = None,
) -> None:
    """Write a scene in another program's format: undistorted photographs, cameras, masks, bounds."""
    from recon3d.io import write_scene

    loaded = load(scene, bounds, silhouettes, mm_per_unit, images=images)
    with progress() as report:
        report("writing", 0, 1)
        written = write_scene(loaded, output, to.value)
        report("writing", 1, 1)
    say(loaded.summary())
    say({"scene": written})
