"""Fit the constants of the predicted uncertainty on scenes whose surface is known exactly, as a Markdown table.

Usage: python scripts/fit_uncertainty.py RENDERED KEEP

RENDERED holds cow_black, cow_room, cow_white and figure_white with their masks, and cow_truth.ply and figure_truth.ply;
the built-in temple is photographed as it is, with noise, and with fewer views. What was found of each scene is kept in
KEEP, so that a second run only fits.

The uncertainty is to be what 68% of errors lie within, and twice the uncertainty what 95% lie within. The constants
minimise the mean of both quantiles' losses, of logarithms, so that small errors count as much as large ones. The cow,
the figure and the temple count alike, however many scenes show them, and each is also predicted with constants that
were fitted without it.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import open3d as o3d
import typer
from numpy.typing import NDArray
from scipy.optimize import minimize

import recon3d
from recon3d.evaluation.distances import distance_to_mesh
from recon3d.io import Checkpoints
from recon3d.pipeline import SPACING, kept_carving
from recon3d.surface.uncertainty import Constants, Evidence, evidence, predicted_distance, standard_deviation

SHARES = ((0.68, 1.0), (0.95, 2.0))
"""Share of errors, and the multiple of the uncertainty that they are to lie within."""
MOST = 15_000
"""Vertices of each scene that the fit looks at."""


class Known(NamedTuple):
    """A scene and its surface."""

    scene: recon3d.Scene
    truth: o3d.geometry.TriangleMesh


class Found(NamedTuple):
    """What is known of the measured vertices of a scene's mesh, and how far they lie from the surface, footprints."""

    evidence: Evidence
    error: NDArray[np.float64]


def rendered(folder: Path, name: str, truth: str) -> Known:
    """A scene with its exact masks."""
    scene = recon3d.open_scene(folder / name, silhouettes=folder / name / "masks")
    return Known(scene, recon3d.read_mesh(folder / truth))


def built_in(**options: float) -> Known:
    """The little temple."""
    made = recon3d.little_temple(**options)
    return Known(made.scene, made.ground_truth)


def scenes(folder: Path) -> dict[str, dict[str, Callable[[], Known]]]:
    """Ways to the scenes, by kind and name."""
    cows = {
        name: lambda name=name: rendered(folder, name, "cow_truth.ply")
        for name in ("cow_black", "cow_room", "cow_white")
    }
    return {
        "cow": cows,
        "figure": {"figure_white": lambda: rendered(folder, "figure_white", "figure_truth.ply")},
        "temple": {
            "temple": built_in,
            "temple, noise of 4 levels, light 8%": lambda: built_in(noise=4.0, light_change=0.08),
            "temple, 8 views, noise of 2 levels": lambda: built_in(n_views=8, noise=2.0),
        },
    }


def find(known: Known, stages: Path) -> Found:
    """Reconstruct a scene up to its mesh, and measure it."""
    scene, kept = known.scene, Checkpoints(stages)
    settings = recon3d.Settings().resolved(scene)
    carved = kept_carving(scene, settings.lattice(scene), settings, kept)
    points, carved = recon3d.refine(scene, carved.dense(), passes=settings.passes_for(scene), checkpoints=kept)
    spacing = SPACING * scene.pixel_footprint
    meshed = recon3d.mesh(carved, points, settings.meshing, spacing=spacing)
    visibility = recon3d.surface.VertexVisibility.of(meshed.mesh, scene)
    measured = meshed.measured & (visibility.n_views > 0)
    error = distance_to_mesh(np.asarray(meshed.mesh.vertices)[measured], known.truth)
    return Found(evidence(meshed.mesh, points, scene, visibility, measured), error / scene.pixel_footprint)


def kept(name: str, make: Callable[[], Known], folder: Path) -> Found:
    """What was found of a scene, in this run or an earlier one."""
    file = folder / f"{name}.npz"
    if not file.is_file():
        found = find(make(), folder / "stages" / name)
        np.savez(file, error=found.error, **found.evidence._asdict())
    with np.load(file) as stored:
        return Found(Evidence(**{each: stored[each] for each in Evidence._fields}), stored["error"])


def some(found: Found) -> Found:
    """A part of the vertices, the same in every run."""
    chosen = np.random.default_rng(0).permutation(len(found.error))[:MOST]
    return Found(Evidence(*(values[chosen] for values in found.evidence)), found.error[chosen])


def loss(constants: Constants, found: Found) -> float:
    """Both quantile losses of the logarithm of error over uncertainty."""
    ratio, total = np.log(np.maximum(found.error, 1e-9) / standard_deviation(found.evidence, constants)), 0.0
    for share, multiple in SHARES:
        beyond = ratio - np.log(multiple)
        total += float(np.where(beyond > 0, share * beyond, (share - 1) * beyond).mean())
    return total


def fit(kinds: Iterable[Iterable[Found]]) -> Constants:
    """The constants that describe some kinds of scenes best; positive."""
    samples = [[some(each) for each in kind] for kind in kinds]

    def of(logarithms: NDArray[np.float64]) -> float:
        constants = Constants(*np.exp(logarithms))
        return float(np.mean([np.mean([loss(constants, each) for each in kind]) for kind in samples]))

    starts = [np.log([2.0, 0.1, 1.0, 0.03]), np.log([1.0, 0.3, 0.5, 0.03])]
    best = min((minimize(of, start, method="Nelder-Mead", options={"maxiter": 400}) for start in starts),
               key=lambda each: each.fun)  # fmt: skip
    return Constants(*(float(x) for x in np.exp(best.x)))


def coverage(found: Found, constants: Constants) -> list[str]:
    """Percentages of the errors within the uncertainty and within twice the uncertainty."""
    uncertainty = standard_deviation(found.evidence, constants)
    return [f"{np.mean(found.error <= multiple * uncertainty):.1%}" for _, multiple in SHARES]


def main(
    folder: Annotated[Path, typer.Argument(metavar="RENDERED", help="Folder of the rendered scenes.")],
    keep: Annotated[Path, typer.Argument(metavar="KEEP", help="Folder for what was found of each scene.")],
) -> None:
    """Print the constants and how well they predict each scene."""
    keep.mkdir(parents=True, exist_ok=True)
    found = {
        kind: {name: kept(name, make, keep) for name, make in ways.items()} for kind, ways in scenes(folder).items()
    }
    constants = fit(kind.values() for kind in found.values())
    print(", ".join(f"{name}={value:.3g}" for name, value in constants._asdict().items()))
    print("| scene | vertices | error, 90% | predicted | within u | within 2 u | left out: u | 2 u |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for kind, scenes_of_kind in found.items():
        without = fit(those.values() for other, those in found.items() if other != kind)
        for name, each in scenes_of_kind.items():
            predicted = predicted_distance(standard_deviation(each.evidence, constants))
            cells = [name, f"{len(each.error):,}", f"{np.quantile(each.error, 0.9):.2f}", f"{predicted:.2f}"]
            print(
                " | ".join(["", *cells, *coverage(each, constants), *coverage(each, without), ""]).strip(), flush=True
            )


if __name__ == "__main__":
    typer.run(main)
