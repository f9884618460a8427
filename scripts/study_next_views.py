"""Do the proposed views help? Photographs from them, against photographs from random places around the object.

Usage: python scripts/study_next_views.py [--views N] [--arc DEGREES] [--more N] [--trials N] [--width PIXELS]

The built-in temple is photographed from an arc and reconstructed. Then it is photographed from the proposed places,
too, or from as many random ones among the candidates that the proposals were chosen from, and reconstructed again.
Completeness is that of the measured surface alone, within two pixel footprints of the exact surface.
"""

from typing import Annotated

import numpy as np
import typer

import recon3d
from recon3d.datasets.synthetic import photograph, ring, temple_mesh, temple_texture
from recon3d.evaluation.next_views import candidate_cameras, propose_views

FOOTPRINTS = 2.0
"""Distance that counts as covered."""


def scene_of(cameras: list[recon3d.Camera]) -> recon3d.Scene:
    """The temple as some cameras see it."""
    return photograph(temple_mesh(), temple_texture, cameras)


def reconstructed(scene: recon3d.Scene) -> tuple[recon3d.Reconstruction, float]:
    """A small result, and the percentage of the exact surface that it measured."""
    result = recon3d.reconstruct(scene, recon3d.Settings(n_voxels=30_000))
    within = FOOTPRINTS * scene.pixel_footprint * scene.known_scale()
    measured = result.supported_mesh()
    figures = recon3d.evaluate(measured, temple_mesh(), spacing=3e-4, completeness_threshold_mm=within)
    return result, figures.completeness_percent


def main(
    views: Annotated[int, typer.Option(help="Of the arc.")] = 6,
    arc: Annotated[float, typer.Option(help="Degrees.")] = 150.0,
    more: Annotated[int, typer.Option(help="Views that are added.")] = 3,
    trials: Annotated[int, typer.Option(help="Random choices.")] = 50,
    width: Annotated[int, typer.Option(help="Of the photographs.")] = 160,
    seed: int = 0,
) -> None:
    """Print the completeness before, with the proposals, and with each random choice."""
    center = temple_mesh().get_axis_aligned_bounding_box().get_center()
    given = ring(center, n_views=views, distance=0.6, width=width, height=3 * width // 4, focal=2.35 * width, arc=arc)
    start = scene_of(given)
    result, before = reconstructed(start)
    coverage = propose_views(result.mesh, start, more, support=result.support, uncertainty=result.uncertainty)
    for name, value in coverage.summary().items():
        print(f"{name}: {value}")
    proposed = reconstructed(scene_of([*given, *(view.camera for view in coverage.proposals)]))[1] - before
    print(f"before {before:.1f}%; the proposals add {proposed:.1f}", flush=True)
    candidates, rng, gains = candidate_cameras(start), np.random.default_rng(seed), []
    for trial in range(trials):
        chosen = [candidates[n] for n in rng.choice(len(candidates), more, replace=False)]
        gains.append(reconstructed(scene_of([*given, *chosen]))[1] - before)
        print(f"random choice {trial + 1} adds {gains[-1]:.1f}; the best so far {max(gains):.1f}", flush=True)
    print(
        f"median of random {np.median(gains):.1f}, best {max(gains):.1f}; proposals {proposed / max(gains):.0%} of it"
    )


if __name__ == "__main__":
    typer.run(main)
