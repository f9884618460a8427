"""The command line: which commands there are, and how their errors are told."""

from __future__ import annotations

import os
import sys
import tempfile
import traceback
import warnings
from pathlib import Path
from typing import Annotated

import typer

from recon3d._version import __version__
from recon3d.cli.commands import (
    board,
    calibrate,
    compare,
    convert,
    demo,
    download,
    evaluate,
    explain,
    info,
    reconstruct,
    render,
    texture,
)
from recon3d.errors import ArgumentError, FailedTestError, Recon3dError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Coloured, measured 3D models from calibrated photographs. Start with: recon3d demo",
)
app.command("demo")(demo.command)
app.command("download")(download.command)
app.command("info")(info.command)
app.command("board")(board.command)
app.command("calibrate")(calibrate.command)
app.command("convert")(convert.command)
app.command("reconstruct")(reconstruct.command)
app.command("evaluate")(evaluate.command)
app.command("compare")(compare.command)
app.command("render")(render.command)
app.command("texture")(texture.command)
app.command("explain")(explain.command)


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    show_version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    context.obj = debug
    if show_version:
        typer.echo(f"recon3d {__version__}")
        raise typer.Exit


def main() -> None:
    """Run a command; an error is one line.

    The exit code is 1 for what the user can mend, 2 for what they cannot: a bug, whose traceback is kept in a file.
    """
    debug = "--debug" in sys.argv
    if debug:  # wherever it stands
        sys.argv = [sys.argv[0], *(argument for argument in sys.argv[1:] if argument != "--debug")]
    warnings.showwarning = lambda message, *_args, **_kw: typer.echo(f"Warning: {message}", err=True)
    try:
        app()
    except Exception as error:
        if debug:
            raise
        line, code = _told(error)
        typer.echo(f"Error: {line}", err=True)
        sys.exit(code)


def _told(error: Exception) -> tuple[str, int]:
    """What is said of an error, and the exit code."""
    if isinstance(error, FailedTestError):
        return f"{error}; its traceback is in {_keep_traceback(error)}", 1
    if isinstance(error, Recon3dError | ArgumentError | OSError):
        return str(error), 1
    if isinstance(error, MemoryError):
        return f"not enough memory: {error}" if str(error) else "not enough memory", 1
    said = " ".join(f"{type(error).__name__}: {error}".split())
    return f"this is a bug in recon3d, please report it with {_keep_traceback(error)}: {said}", 2


def _keep_traceback(error: Exception) -> Path:
    """File in the system's folder for such, which holds the traceback of an error, and what was typed."""
    handle, name = tempfile.mkstemp(prefix="recon3d-", suffix=".txt")
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(f"recon3d {__version__}: {' '.join(sys.argv[1:])}\n\n")
        traceback.print_exception(error, file=file)
    return Path(name)
