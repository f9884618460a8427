"""What the commands say while they run and at the end."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:  # Open3D takes seconds to import, --help should not
    import open3d as o3d

    from recon3d.pipeline import Progress
    from recon3d.result import Reconstruction
    from recon3d.scene.scene import Scene
    from recon3d.settings import Settings


def run(
    scene: Scene, settings: Settings, ground_truth: o3d.geometry.TriangleMesh | None, stages: Path | None = None
) -> Reconstruction:
    """Reconstruct under progress bars, keeping finished stages in a folder where one is given."""
    from recon3d.io.checkpoints import Checkpoints
    from recon3d.pipeline import reconstruct

    kept = None if stages is None else Checkpoints(stages)
    with progress() as report:
        return reconstruct(scene, settings, ground_truth=ground_truth, checkpoints=kept, progress=report)


def say(rows: dict[str, Any]) -> None:
    """Print a table to standard output."""
    for name, value in rows.items():
        typer.echo(f"{name + ':':32} {value}")


@contextmanager
def progress() -> Iterator[Progress]:
    """Bars on standard error, one a stage; nothing where that is not a terminal."""
    from rich.console import Console
    from rich.progress import Progress as Bars

    with Bars(console=Console(stderr=True), disable=not sys.stderr.isatty(), transient=True) as bars:
        tasks: dict[str, Any] = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=None if total == 1 else total)
            bars.update(tasks[stage], completed=done, total=None if total == 1 and done == 0 else total)

        yield report
