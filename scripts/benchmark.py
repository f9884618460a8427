"""Time and memory of the whole command, over voxels and over views, as a Markdown table.

Usage: python scripts/benchmark.py [SCENE] [--method NAME] [--runs N] [--tests]

Every row is the median over runs of ``recon3d reconstruct`` as a process of its own; carving is what the run itself
recorded. The first row starts with an empty compile cache. With --tests instead a row for every photo-consistency test,
at a million voxels, after one run that fills the cache.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from recon3d.consistency import TESTS

VOXELS = (100_000, 1_000_000, 10_000_000)


def run_once(scene: str, options: list[str], voxels: int, views: int, cache: Path) -> dict[str, float]:
    """Carving and wall seconds, peak MB of one command."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "recon3d", "reconstruct", scene, "--no-pictures", *options]
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


def medians(runs: int, *arguments: Any) -> dict[str, float]:
    """Median of each figure over runs."""
    results = [run_once(*arguments) for _ in range(runs)]
    return {name: statistics.median(result[name] for result in results) for name in results[0]}


def compare_tests(scene: str, method: str, views: int, runs: int, cache: Path) -> None:
    """Print the table over tests."""
    print("| test | views | voxels | carving (s) | whole command (s) | peak memory (MiB) |")
    print("| --- | --- | --- | --- | --- | --- |")
    for test in TESTS:
        arguments = (scene, ["--method", method, "--test", test], 1_000_000, views, cache)
        run_once(*arguments)
        row = medians(runs, *arguments)
        print(
            f"| {test} | {row['views']:.0f} | {row['voxels']:,.0f} | {row['carving']:.2f} | {row['wall']:.1f} | "
            f"{row['memory']:.0f} |",
            flush=True,
        )


def compare_sizes(scene: str, method: str, max_views: int, runs: int, cache: Path) -> None:
    """Print the table over voxels and views."""
    print("| cache | views | voxels | carving (s) | per voxel and view (ns) | whole command (s) | peak memory (MiB) |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    rows = [("cold", 1_000_000, max_views, 1)]
    rows += [("warm", voxels, max_views, runs) for voxels in VOXELS]
    rows += [("warm", 1_000_000, max_views // share, runs) for share in (2, 4)]
    for state, voxels, views, repeats in rows:
        row = medians(repeats, scene, ["--method", method], voxels, views, cache)
        each = 1e9 * row["carving"] / (row["voxels"] * row["views"])
        print(
            f"| {state} | {row['views']:.0f} | {row['voxels']:,.0f} | {row['carving']:.2f} | {each:.1f} | "
            f"{row['wall']:.1f} | {row['memory']:.0f} |",
            flush=True,
        )


def main(
    scene: Annotated[str, typer.Argument(help="A scene; the built-in one by default.")] = "little-temple",
    method: Annotated[str, typer.Option(help="Carving method.")] = "voxel-coloring",
    max_views: Annotated[int, typer.Option(help="Views of the rows over voxels.")] = 8,
    runs: Annotated[int, typer.Option(help="Runs of each row.")] = 3,
    tests: Annotated[bool, typer.Option("--tests", help="A row for every photo-consistency test instead.")] = False,
) -> None:
    """Print the table."""
    print(f"{Path(scene).name}, {method}, {os.cpu_count()} CPUs, median of {runs} runs\n")
    with tempfile.TemporaryDirectory() as cache:
        (compare_tests if tests else compare_sizes)(scene, method, max_views, runs, Path(cache))


if __name__ == "__main__":
    typer.run(main)
