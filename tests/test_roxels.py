"""Roxels: colour, opacity and responsibility."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, box_mesh, cameras, photographs, plain_view

from recon3d.carving.observations import without_background
from recon3d.carving.roxels import Roxels
from recon3d.datasets.synthetic import BuiltInScene, Camera, photograph
from recon3d.errors import EmptyReconstructionError
from recon3d.evaluation.distances import distance_to_mesh
from recon3d.rendering.orbit import look_at
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import without_silhouettes
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume

ALL_ROUND = cameras(8, arc=360)
WALL = box_mesh(3.2, 2.4, 0.4).translate((0, 0, -0.8))
PANE = box_mesh(1.0, 0.8, 0.2).translate((0, 0, 0.7))


def paint(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coloured tiles on the wall, orange on the pane."""
    tiles = np.random.default_rng(5).uniform(0.15, 1, (64, 3))
    wall = tiles[(np.floor(points / 0.4).astype(int) @ np.array([7, 13, 5])) % 64]
    pane = np.array([0.9, 0.55, 0.25]) * (0.85 + 0.15 * np.sin(3 * points.sum(axis=1)))[:, None]
    return np.where(points[:, 2:] < 0, wall, pane)


def wall_behind_a_pane(opacity: float) -> Scene:
    """Views from the front of a wall through a pane that lets a part of its light through."""
    K = np.array([[90, 0.3, 31.2], [0, 91, 22.7], [0, 0, 1]])
    eyes = [np.array([x, y, 6.0]) for x in (-3, -1, 1, 3) for y in (-1.5, 1.5)]
    taken_by = [Camera(K, look_at(eye, np.zeros(3), np.array([0.0, 1, 0])), 64, 48) for eye in eyes]
    bare, covered = (photograph(mesh, paint, taken_by, supersampling=2) for mesh in (WALL, WALL + PANE))
    views = []
    for without, with_pane in zip(bare.views, covered.views, strict=True):
        mixed = (1 - opacity) * without.image.astype(float) + opacity * with_pane.image
        views.append(replace(with_pane, photograph=np.rint(mixed).astype(np.uint8)))
    return replace(covered, views=tuple(views), bounds=Bounds([-1.8, -1.4, -1.1], [1.8, 1.4, 1.1]))


def opacity_across(hull: CarvedVolume, low: float, high: float) -> float:
    """Mean opacity along z of all that lies between two heights, over the middle of the pane."""
    volume = hull.volume
    centers = volume.centers(np.ones(volume.shape, np.bool_)).reshape(*volume.shape, 3)
    between = (centers[0, 0, :, 2] > low) & (centers[0, 0, :, 2] < high)
    middle = (np.abs(centers[:, :, 0, 0]) < 0.35) & (np.abs(centers[:, :, 0, 1]) < 0.25)
    return float((1 - np.prod(1 - np.nan_to_num(hull.degree)[:, :, between], axis=2))[middle].mean())


def test_a_half_transparent_pane_ends_between_an_absent_and_an_opaque_one() -> None:
    scenes = {opacity: wall_behind_a_pane(opacity) for opacity in (0.0, 0.25, 1.0)}
    volume = CarvingVolume.enclosing(scenes[0.0].bounds, voxel_size=0.1)
    hulls = {opacity: Roxels(sigma0=15.0, rounds=20).carve(scene, volume) for opacity, scene in scenes.items()}
    absent, half, opaque = (opacity_across(hull, 0.4, 1.1) for hull in hulls.values())
    assert absent < 0.2
    assert 0.3 < half < 0.7
    assert opaque > 0.9
    assert opacity_across(hulls[0.25], -1.1, -0.5) > 0.95  # the wall seen through it
    seen = np.isfinite(hulls[0.25].degree)
    assert (hulls[0.25].degree[seen] >= 0).all()
    assert (hulls[0.25].degree[seen] <= 1).all()


def test_the_ball_is_found_near_its_surface_in_its_colours() -> None:
    mesh = ball_mesh()
    scene = photographs(mesh, taken_by=ALL_ROUND)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=8000)
    hull = Roxels().carve(scene, volume)
    surface = hull.with_interior.surface()
    # A pixel is 0.083 units.
    assert np.median(distance_to_mesh(volume.centers(surface), mesh)) < 0.083 + volume.voxel_size * np.sqrt(3) / 2
    seen = np.concatenate([view.image[view.silhouette] for view in scene.views])
    shown = hull.volume.colors[hull.volume.occupied]
    np.testing.assert_allclose(shown.mean(axis=0), seen.mean(axis=0), atol=20)


def test_the_result_lies_inside_the_visual_hull_with_opacities_as_degrees(temple: BuiltInScene) -> None:
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=20_000)
    hull = Roxels(threshold=0.6, rounds=6).carve(temple.scene, volume)
    _, occupied = without_background(temple.scene.packed, volume)
    assert not (hull.with_interior.occupied & ~occupied).any()
    judged = (hull.labels == Label.CONSISTENT) | (hull.labels == Label.INCONSISTENT)
    np.testing.assert_array_equal(np.isfinite(hull.degree), judged)
    assert (hull.degree[hull.volume.occupied] >= 0.6).all()
    assert (hull.degree[hull.labels == Label.INCONSISTENT] < 0.6).all()
    assert not hull.volume.colors[~hull.volume.occupied].any()


def test_fewer_voxels_pass_a_higher_threshold() -> None:
    scene = photographs(ball_mesh(), taken_by=ALL_ROUND)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=4000)
    low, high = (Roxels(threshold=threshold).carve(scene, volume) for threshold in (0.3, 0.8))
    assert low.volume.n_occupied > high.volume.n_occupied
    assert not (high.volume.occupied & ~low.volume.occupied).any()


def test_what_no_voxel_is_opaque_enough_for_is_an_error() -> None:
    scene = photographs(ball_mesh(), taken_by=ALL_ROUND)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=2000)
    with pytest.raises(EmptyReconstructionError, match=r"all voxels were carved .*0 consistent"):
        Roxels(threshold=1.0, rounds=1).carve(scene, volume)
    with pytest.raises(EmptyReconstructionError, match="all voxels were carved"):
        Roxels().carve(scene, volume.with_occupancy(np.zeros(volume.shape, np.bool_)))


def test_a_single_view_no_silhouettes_and_a_camera_inside_still_run() -> None:
    scene = photographs(ball_mesh(), taken_by=ALL_ROUND)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=4000)
    assert Roxels().carve(without_silhouettes(scene), volume).volume.n_occupied
    assert Roxels().carve(replace(scene, views=scene.views[:1]), volume).n_views.max() == 1
    inside = Scene((plain_view(),), Bounds([-2, -2, -6], [2, 2, 2]))
    hull = Roxels(threshold=0.05).carve(inside, CarvingVolume.enclosing(inside.bounds, voxel_size=0.25))
    assert (hull.volume.centers()[:, 2] > -5).all()


def test_one_thread_gives_what_two_give(temple: BuiltInScene) -> None:
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=8000)
    hulls: list[CarvedVolume] = []
    before = numba.get_num_threads()
    for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(threads)
        hulls.append(Roxels(rounds=4, threshold=0.3).carve(temple.scene, volume))
    numba.set_num_threads(before)
    np.testing.assert_array_equal(hulls[0].labels, hulls[1].labels)
    np.testing.assert_array_equal(hulls[0].degree, hulls[1].degree)
    np.testing.assert_array_equal(hulls[0].volume.colors, hulls[1].volume.colors)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sigma0": 0.0}, "expected sigma0"),
        ({"initial": 1.0}, "expected initial"),
        ({"threshold": 1.5}, "expected threshold"),
        ({"rounds": 0}, "expected rounds to be a whole number of at least 1"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Roxels(**options)  # type: ignore[arg-type]


def test_progress_counts_the_rounds() -> None:
    scene = photographs(ball_mesh())
    calls: list[tuple[int, int]] = []
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=1000)
    Roxels(rounds=5, threshold=0.1).carve(scene, volume, progress=lambda n, of: calls.append((n, of)))
    assert calls == [(n, 5) for n in range(1, 6)]
