"""``recon3d download``."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from recon3d.cli.console import progress, say
from recon3d.cli.options import OUTPUT
from recon3d.errors import ArgumentError


def command(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Data set, such as templeSparseRing.")] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="New folder for the photographs; in the user's cache otherwise, which RECON3D_CACHE moves.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="List the data sets, as without NAME.")] = False,
) -> None:
    """Download public photographs with known cameras, such as Middlebury's temple."""
    from recon3d.datasets import DATASETS, obtain

    if listed or name is None:
        if name is not None or output is not None:
            raise ArgumentError("the list needs no NAME and no --output; a download needs NAME and no --list")
        say({each: dataset.what for each, dataset in DATASETS.items()})
        for citation in dict.fromkeys(dataset.citation for dataset in DATASETS.values()):
            typer.echo(f"Cite {citation}.")
        typer.echo(f"Next: recon3d download {next(iter(DATASETS))}")
        return
    with progress() as report:
        found = obtain(name, output, progress=report)
    known = "as expected" if found.checked else "not checked: none is known; remembered, so that a change is noticed"
    say({"photographs": found.folder, "SHA-256": f"{found.sha256} ({known})"})
    typer.echo(f"Cite {DATASETS[name].citation}.")
    if not found.new:
        typer.echo("It was there already; nothing was downloaded.")
    typer.echo(f"Next: recon3d reconstruct {shlex.quote(str(found.folder))} --output out")
