"""Choose the defaults of the photo-consistency tests: every setting's F-score on two scenes, as a Markdown table.

Usage: python scripts/tune_tests.py TEMPLE_RING GROUND_TRUTH [--valid PART]

The scenes are Middlebury's templeRing without the views that templeSparseRing holds, on which results are reported, and
the built-in temple. Each setting runs as the paper does: voxel colouring of eight admissible views at a million voxels.
Its F-score is the harmonic mean of the shares of the mesh and of the ground truth that lie within three voxels of each
other. Chosen is the setting whose smaller F-score is the largest: a default has to do for photographs far apart and for
those that the program makes itself. The mean of the two would not choose: between views far apart so much differs that
the means of many tests rise towards that of no test at all.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import open3d as o3d
import typer

import recon3d
from recon3d.consistency import TESTS

SPARSE_RING = {1, 4, 6, 9, 12, 15, 18, 21, 24, 27, 30, 34, 37, 41, 42, 45}
"""Numbers of the templeRing views that templeSparseRing holds."""
RING_FROM_SPARSE_RING = (0.05, -0.06, -0.08)
"""Metres; the ground truth is given in templeSparseRing's frame."""
VOXELS_APART = 3
"""Distance of the F-score."""


def settings_of(parameter: str, *values: float) -> list[dict[str, Any]]:
    """One setting a value."""
    return [{parameter: value} for value in values]


GRIDS: dict[str, list[dict[str, Any]]] = {
    # Fixed by the paper or by its summary of others; here to compare with.
    **{name: [{}] for name in ("fuzzy", "fuzzy-single", "adaptive", "histogram")},
    "variance": settings_of("sigma0", 10, 15, 20, 25, 30, 35, 40, 45, 50, 60),
    "standard-deviation": settings_of("threshold", 10, 15, 20, 25, 30, 35, 40, 45, 50, 60, 80),
    "color-caching": [
        {"threshold": matt, "neighbour_threshold": shiny}
        for matt in (10, 20, 30, 40, 50, 60, 80)
        for shiny in (5, 10, 15, 20, 25, 30, 35, 40, 50)
        if shiny < matt
    ],
    "minkowski": [
        {"norm": norm, "threshold": share * start}
        for norm, start in (("l1", 60), ("l2", 40), ("linf", 30))
        for share in (1, 1.5, 2, 3, 4, 5, 6)
    ],
    "likelihood-ratio": settings_of("sigma0", 20, 30, 40, 50, 60, 70, 80, 90, 100, 130),
    "f-test": settings_of("floor", 1, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 130),
    "outlier-rejection": settings_of("sigma0", 10, 15, 20, 25, 30, 35, 40, 50, 60, 80),
    "specular": settings_of("threshold", 5, 10, 15, 20, 25, 30, 40, 50, 60, 80),
    "ncc": settings_of("threshold", 0.6, 0.5, 0.4, 0.35, 0.3, 0.25, 0.2, 0.1, 0, -0.2),
}


class Measured(NamedTuple):
    """A scene and the surface to measure against."""

    scene: recon3d.Scene
    ground_truth: o3d.geometry.TriangleMesh
    valid: Any = None

    def f_score(self, test: recon3d.ConsistencyTest | None) -> float:
        """F-score in percent of what a test leaves; 0 where it leaves nothing."""
        settings = recon3d.Settings(max_views=8, carving=recon3d.VoxelColoring(test=test))
        try:
            result = recon3d.reconstruct(self.scene, settings)
        except recon3d.errors.EmptyReconstructionError:
            return 0.0
        voxel = result.carved.volume.voxel_size
        evaluation = recon3d.evaluate(result.mesh, self.ground_truth, valid=self.valid, spacing=voxel / 2)
        distance = VOXELS_APART * voxel * self.scene.mm_per_unit
        precision = 100 * float(np.mean(evaluation.accuracy_distances <= distance))
        recall = evaluation.completeness_at(distance)
        return 2 * precision * recall / max(precision + recall, 1e-9)


def temple_ring(folder: Path, ground_truth: Path, valid: Path | None) -> Measured:
    """The ring's views that the sparse ring does not have, and the ground truth moved into its frame."""
    scene = recon3d.open_scene(folder)
    numbers = {view.name: int(re.findall(r"\d+", view.name)[-1]) for view in scene.views}
    scene = scene.subset([name for name, number in numbers.items() if number not in SPARSE_RING])
    surface = recon3d.read_mesh(ground_truth)
    mask = None if valid is None else recon3d.evaluation.triangles_near(surface, recon3d.read_mesh(valid), 1e-4)
    return Measured(scene, surface.translate(RING_FROM_SPARSE_RING), mask)


def no_test(patches: recon3d.Patches) -> recon3d.Verdict:
    """Accept every voxel that the silhouettes leave."""
    ones = np.ones(patches.n_voxels)
    return recon3d.Verdict(ones, ones, ones)


def families(options: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Settings that compete: those of one norm, where a test has norms, else all."""
    norms = dict.fromkeys(option.get("norm") for option in options)
    return [[option for option in options if option.get("norm") == norm] for norm in norms]


def print_family(
    name: str, options: list[dict[str, Any]], make: Callable[..., recon3d.ConsistencyTest], scenes: list[Measured]
) -> None:
    """Print a row for each of a test's settings, and which one is chosen."""
    scores = [[measured.f_score(make(**option)) for measured in scenes] for option in options]
    best = int(np.argmax([min(pair) for pair in scores]))
    for n, (option, pair) in enumerate(zip(options, scores, strict=True)):
        setting = ", ".join(f"{key} {value}" for key, value in option.items())
        mark = "chosen" if n == best and len(options) > 1 else ""
        print(f"| {name} | {setting} | {pair[0]:.1f} | {pair[1]:.1f} | {mark} |", flush=True)


def main(
    temple_ring_folder: Annotated[Path, typer.Argument(metavar="TEMPLE_RING", help="Middlebury's templeRing.")],
    ground_truth: Annotated[Path, typer.Argument(metavar="GROUND_TRUTH", help="Mesh, in templeSparseRing's frame.")],
    valid: Annotated[Path | None, typer.Option(help="Part of GROUND_TRUTH that is real data.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="Tests to run; all when not given.")] = None,
) -> None:
    """Print the table."""
    built_in = recon3d.little_temple()
    scenes = [temple_ring(temple_ring_folder, ground_truth, valid), Measured(built_in.scene, built_in.ground_truth)]
    print(f"| test | setting | {scenes[0].scene.name} | {scenes[1].scene.name} | |")
    print("| --- | --- | --- | --- | --- |")
    print_family("none", [{}], lambda: no_test, scenes)
    for name in only or GRIDS:
        for options in families(GRIDS[name]):
            print_family(name, options, TESTS[name], scenes)


if __name__ == "__main__":
    try:
        typer.run(main)
    except (recon3d.Recon3dError, ValueError, OSError) as error:
        raise SystemExit(f"Error: {error}") from None
