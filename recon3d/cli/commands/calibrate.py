"""``recon3d calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon3d.cli import options
from recon3d.cli.console import say
from recon3d.cli.options import INPUT, OUTPUT
from recon3d.cli.results import writable
from recon3d.cli.scenes import calibrated


def command(
    photographs: Annotated[Path, typer.Argument(metavar="PHOTOS", help="Folder of JPEG, PNG or TIFF files.")],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="SCENE", help="Folder for the scene.", rich_help_panel=OUTPUT),
    ],
    board: options.Board = None,
    turntable: options.Turntable = None,
    known_distance: options.KnownDistance = None,
    object_alone: options.Object = False,
    masks: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Masks named like the photographs, black where nothing may be matched, as on the still background of "
            "a turntable.",
            rich_help_panel=INPUT,
        ),
    ] = None,
) -> None:
    """Find the cameras of photographs, and write them as a scene: undistorted images, COLMAP and transforms.json."""
    found = calibrated(
        photographs, writable(output), board, turntable, masks, known_distance, object_alone=object_alone
    )
    say(found.summary())
    say({"scene": output})
