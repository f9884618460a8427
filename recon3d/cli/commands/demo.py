"""``recon3d demo``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from recon3d.cli import options
from recon3d.cli.console import run, say
from recon3d.cli.results import save, writable
from recon3d.cli.scenes import photograph


def command(
    output: options.Output = None,
    n_voxels: Annotated[int, typer.Option("--voxels", help="Approximate number of voxels.")] = 1_000_000,
    noise: Annotated[float, typer.Option(help="Sensor noise, grey levels.")] = 0.0,
    light_change: Annotated[float, typer.Option(help="Change of exposure between views, as a fraction.")] = 0.0,
) -> None:
    """Photograph the built-in little temple, reconstruct, measure and render it."""
    from recon3d.io.geometry import write_geometry
    from recon3d.io.middlebury import write_middlebury
    from recon3d.settings import Settings

    folder = writable(output or Path("recon3d-output/demo"))
    built_in = photograph("little-temple", noise=noise, light_change=light_change)
    photographs = write_middlebury(built_in.scene, folder / "photographs")
    scene = replace(built_in.scene, notes={"format": "Middlebury", "source": str(photographs.resolve())})
    truth = write_geometry(folder / "ground_truth.ply", built_in.ground_truth)
    result = run(scene, Settings(n_voxels=n_voxels), built_in.ground_truth)
    written = save(result, folder, ["ply"])
    say(result.summary())
    say({"photographs": photographs, "ground truth": truth, **written})
