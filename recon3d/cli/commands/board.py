"""``recon3d board``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from recon3d.cli.console import say
from recon3d.cli.options import OUTPUT


class _Paper(StrEnum):
    """Sizes of the sheet."""

    A4 = "A4"
    Letter = "Letter"


def command(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="PDF", help="File to print.", rich_help_panel=OUTPUT)
    ] = Path("board.pdf"),
    board: Annotated[
        str, typer.Option(metavar="charuco-COLUMNSxROWS:MMmm", help="Squares in a row, rows, and a square's side.")
    ] = "charuco-10x7:25mm",
    paper: Annotated[_Paper, typer.Option(help="Size of the sheet.")] = _Paper.A4,
) -> None:
    """Write a board to print, stand the object on, and calibrate by: cameras, scale and up, without any texture."""
    from recon3d.calibration import Board, write_board_pdf

    pattern = Board.parse(board)
    say({"board": write_board_pdf(output, pattern, paper=paper.value)})
    typer.echo(
        f"Print it at 100%, measure the ruler, stand the object on it, and: recon3d calibrate PHOTOS --board {pattern} "
        "--output SCENE"
    )
