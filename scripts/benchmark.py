"""Time and memory of the whole command, over voxels and over views, as a Markdown table.

Usage: python scripts/benchmark.py [SCENE] [--method NAME] [--runs N]

Every row is the median over runs of ``recon3d reconstruct`` as a process of its own; carving is what the run itself
recorded. The first row starts with an empty compile cache.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer

VOXELS = (100_000, 1_000_000, 10_000_000)


def run_once(scene: str, method: str, voxels: int, views: int, cache: Path) -> dict[str, float]:
    """Carving and wall seconds, peak MB of one command."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "recon3d.cli", "reconstruct", scene, "--no-pictures", "--method", method]
        command += ["--voxels", str(voxels), "--max-views", str(views), "--output", folder]
        start = time.perf_counter()
        process = subprocess.Popen(  # noqa: S603
            command, stdout=subprocess.DEVNULL, env={**os.environ, "NUMBA_CACHE_DIR": str(cache)}
        )
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        if status:
            raise SystemExit(f"failed: {' '.join(command)}")
        record = json.loads((Path(folder) / "record.json").read_text())
    return {
        "views": len(record["scene"]["views"]),
        "voxels": sum(record["voxels"].values()),
        "carving": record["timings_s"]["carving"],
        "wall": wall,
        "memory": usage.ru_maxrss / 1024,
    }


def main(
    scene: Annotated[str, typer.Argument(help="A scene; the built-in one by default.")] = "little-temple",
    method: Annotated[str, typer.Option(help="Carving method.")] = "voxel-coloring",
    max_views: Annotated[int, typer.Option(help="Views of the rows over voxels.")] = 8,
    runs: Annotated[int, typer.Option(help="Runs of each row.")] = 3,
) -> None:
    """Print the table."""
    print(f"{Path(scene).name}, {method}, {os.cpu_count()} CPUs, median of {runs} runs\n")
    print("| cache | views | voxels | carving (s) | per voxel and view (ns) | whole command (s) | peak memory (MiB) |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as cache:
        rows = [("cold", 1_000_000, max_views, 1)]
        rows += [("warm", voxels, max_views, runs) for voxels in VOXELS]
        rows += [("warm", 1_000_000, max_views // share, runs) for share in (2, 4)]
        for state, voxels, views, repeats in rows:
            results = [run_once(scene, method, voxels, views, Path(cache)) for _ in range(repeats)]
            row = {name: statistics.median(result[name] for result in results) for name in results[0]}
            each = 1e9 * row["carving"] / (row["voxels"] * row["views"])
            print(
                f"| {state} | {row['views']:.0f} | {row['voxels']:,.0f} | {row['carving']:.2f} | {each:.1f} | "
                f"{row['wall']:.1f} | {row['memory']:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    typer.run(main)
