"""What runs need, against what ``recon3d info`` expects of them: memory and CPU seconds, as a Markdown table.

python scripts/measure_needs.py SCENE[:DETAIL[:VIEWS]] ...
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile

import recon3d
from recon3d.budget import SCALES, Needs, needs


def measure(scene: str, detail: str, views: int | None) -> tuple[float, float]:
    """Peak MiB and CPU seconds of one command."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "recon3d", "reconstruct", scene, "--detail", detail, "--output", folder,
                   "--no-pictures", *(["--max-views", str(views)] if views else [])]  # fmt: skip
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)  # noqa: S603 # the arguments are our own
        _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(command)}: failed")
    return usage.ru_maxrss / 1024, usage.ru_utime + usage.ru_stime


def expected(scene: str, detail: str, views: int | None) -> Needs:
    """What ``recon3d info`` says."""
    return needs(recon3d.open_scene(scene).shrunk(SCALES[detail]), recon3d.Settings(max_views=views))


def main(arguments: list[str]) -> None:
    """Print a row for each scene."""
    print("| scene | memory (MiB) | expected | ratio | CPU (s) | expected | ratio |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for argument in arguments:
        given = argument.split(":")
        scene, detail, views = given + ["full", "0"][len(given) - 1 :]
        told = expected(scene, detail, int(views) or None)
        memory, seconds = measure(scene, detail, int(views) or None)
        told_memory = told.memory / 2**20
        print(
            f"| {argument} | {memory:.0f} | {told_memory:.0f} | {told_memory / memory:.2f} | {seconds:.0f} | "
            f"{told.seconds:.0f} | {told.seconds / seconds:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
