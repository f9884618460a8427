"""Probabilistic space carving."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, box_mesh, cameras, full_volume, photographs, plain_view, with_noise

from recon3d.carving.observations import without_background
from recon3d.carving.probabilistic import ProbabilisticSpaceCarving
from recon3d.carving.space_carving import SpaceCarving
from recon3d.consistency.deviation import StandardDeviation
from recon3d.datasets.synthetic import BuiltInScene
from recon3d.errors import EmptyReconstructionError
from recon3d.evaluation.distances import distance_to_mesh
from recon3d.kernels.existence import likelihood_ratio, visibility
from recon3d.kernels.rays import walk
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import without_silhouettes
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume

ALL_ROUND = cameras(8, arc=360)
SIGMA = 10.0
UNIFORM = 1 / 256**3


def ratio(colors: list[list[int]], weights: list[float]) -> float:
    return likelihood_ratio(
        np.array(colors, np.uint8), np.array(weights), np.full(len(weights), UNIFORM), SIGMA
    )  # fmt: skip


def gaussian_evidence(colors: NDArray[np.float64]) -> float:
    """Ratio of the integral of the product of normals over c, by numerical integration along each channel."""
    grid = np.linspace(-200, 456, 20001)
    evidence = 1.0
    for channel in colors.T:
        normals = np.exp(-0.5 * ((channel[:, None] - grid) / SIGMA) ** 2) / (np.sqrt(2 * np.pi) * SIGMA)
        evidence *= np.trapezoid(normals.prod(axis=0), grid) * 256 ** (len(channel) - 1)
    return evidence


def test_one_view_says_nothing_about_existence() -> None:
    assert ratio([[10, 20, 30]], [0.7]) == pytest.approx(1)
    assert ratio([[10, 20, 30], [200, 20, 30]], [0.7, 0.0]) == pytest.approx(1)


def test_views_that_see_agree_with_the_integral_over_the_surface_colour() -> None:
    colors = [[100, 90, 80], [110, 95, 70], [95, 99, 91], [102, 80, 84]]
    assert ratio(colors, [1.0] * 4) == pytest.approx(gaussian_evidence(np.array(colors, float)), rel=1e-6)


def test_likely_views_are_a_sum_over_who_sees() -> None:
    colors = np.array([[100, 90, 80], [110, 95, 70], [240, 20, 200]])
    weights = np.array([0.8, 0.6, 0.9])
    expected = 0.0
    for number in range(8):
        sees = np.array([number >> view & 1 for view in range(3)], np.bool_)
        chance = np.where(sees, weights, 1 - weights).prod()
        expected += chance * (gaussian_evidence(colors[sees].astype(float)) if sees.any() else 1.0)
    assert ratio(colors.tolist(), weights.tolist()) == pytest.approx(expected, rel=0.02)


def test_agreement_speaks_for_existence_and_contradiction_against_it() -> None:
    assert ratio([[100, 90, 80]] * 3, [0.9] * 3) > 100
    assert ratio([[100, 90, 80], [200, 40, 30], [20, 190, 90]], [0.9] * 3) < 0.05


@pytest.mark.parametrize("target", [(0, 0, 0), (6, 3, 2), (2, 4, 1), (6, 0, 4)])
@pytest.mark.parametrize("center", [(-5.2, 1.7, 2.3), (3.5, 2.5, -9.0), (20.0, -7.0, 11.0), (2.23, 1.11, 3.37)])
def test_a_walk_meets_the_voxels_that_small_steps_meet(target: tuple[int, int, int], center: tuple[float, ...]) -> None:
    shape = (7, 5, 5)
    path = np.empty(sum(shape), np.int64)
    n = walk(np.array(center), np.array(target), shape, True, path)
    steps = np.linspace(0, 1, 200_001)[1:, None] * 20
    points = np.array(center) + steps * (np.array(target) + 0.5 - center)
    inside = points[((points >= 0) & (points < shape)).all(axis=1)]
    voxels = np.ravel_multi_index(tuple(np.floor(inside).astype(int).T), shape)
    # Steps miss what the ray only grazes.
    expected = voxels[np.flatnonzero(np.diff(voxels, prepend=-1))]
    walked = path[:n].tolist()
    assert [voxel for voxel in walked if voxel in set(expected.tolist())] == expected.tolist()
    assert len(walked) <= len(expected) + 2
    until = walk(np.array(center), np.array(target), shape, False, path)
    assert path[until - 1] == np.ravel_multi_index(target, shape)


def test_visibility_is_the_product_along_the_ray() -> None:
    probability = np.random.default_rng(3).uniform(0, 0.4, (4, 1, 1)).astype(np.float32)
    path = np.empty(6, np.int64)
    seen = visibility(probability, np.array([-3.0, 0.5, 0.5]), np.array([3, 0, 0]), path)
    assert seen == pytest.approx(np.prod(1 - probability[:3, 0, 0]), rel=1e-6)


def test_the_ball_is_found_near_its_surface() -> None:
    mesh = ball_mesh()
    scene = photographs(mesh, taken_by=ALL_ROUND)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=8000)
    hull = ProbabilisticSpaceCarving().carve(scene, volume)
    # A pixel is 0.083 units.
    assert np.median(distance_to_mesh(hull.volume.centers(), mesh)) < 0.083 + volume.voxel_size * np.sqrt(3) / 2


def test_noise_that_makes_space_carving_tear_through_the_object_does_not_here() -> None:
    scene = with_noise(photographs(box_mesh(1.5, 1.2, 1.4), taken_by=ALL_ROUND), 10.0)
    volume = CarvingVolume.enclosing(scene.bounds, voxel_size=0.1)
    centers = np.abs(volume.centers().reshape(*volume.shape, 3))
    core = (centers < np.array([0.75, 0.6, 0.7]) - 0.1).all(axis=-1)

    def lines_carved_through(hull: CarvedVolume) -> int:
        left = core & (hull.labels != Label.INCONSISTENT)
        return sum(int((core.any(axis) & ~left.any(axis)).sum()) for axis in range(3))

    # The test allows for the noise and a little more, yet some sets of pixels exceed it, and bare what is behind.
    hard = SpaceCarving(StandardDeviation(12.5)).carve(scene, volume)
    soft = ProbabilisticSpaceCarving(sigma0=10.0).carve(scene, volume)
    assert hard.volume.n_occupied > 500
    assert lines_carved_through(hard) > 10
    assert lines_carved_through(soft) == 0
    assert (soft.labels[core] == Label.INCONSISTENT).mean() < 0.1


def test_the_result_lies_inside_the_visual_hull_with_probabilities_as_degrees(temple: BuiltInScene) -> None:
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=20_000)
    hull = ProbabilisticSpaceCarving(threshold=0.6).carve(temple.scene, volume)
    _, occupied = without_background(temple.scene.packed, volume)
    assert not (hull.with_interior.occupied & ~occupied).any()
    judged = (hull.labels == Label.CONSISTENT) | (hull.labels == Label.INCONSISTENT)
    np.testing.assert_array_equal(np.isfinite(hull.degree), judged)
    np.testing.assert_array_equal(hull.n_views > 0, judged)
    assert (hull.degree[hull.volume.occupied] >= 0.6).all()
    assert (hull.degree[hull.labels == Label.INCONSISTENT] < 0.6).all()
    assert not hull.volume.colors[~hull.volume.occupied].any()


def test_a_single_view_leaves_every_voxel_at_the_prior() -> None:
    scene = photographs(ball_mesh(), taken_by=ALL_ROUND)
    single = replace(scene, views=scene.views[:1])
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=4000)
    with pytest.raises(EmptyReconstructionError, match=r"all voxels were carved .*0 consistent"):
        ProbabilisticSpaceCarving().carve(single, volume)
    hull = ProbabilisticSpaceCarving(threshold=0.29).carve(single, volume)
    np.testing.assert_allclose(hull.degree[hull.volume.occupied], 0.3, atol=1e-5)


def test_no_silhouettes_and_a_camera_inside_the_volume_still_run() -> None:
    scene = photographs(ball_mesh(), taken_by=ALL_ROUND)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=4000)
    assert ProbabilisticSpaceCarving().carve(without_silhouettes(scene), volume).volume.n_occupied
    inside = Scene((plain_view(), plain_view(name="other")), Bounds([-2, -2, -6], [2, 2, 2]))
    hull = ProbabilisticSpaceCarving().carve(inside, CarvingVolume.enclosing(inside.bounds, voxel_size=0.25))
    assert (hull.volume.centers()[:, 2] > -5).all()


def test_an_empty_volume_is_an_error() -> None:
    volume = full_volume((3, 3, 3), 0.1)
    with pytest.raises(EmptyReconstructionError, match="all voxels were carved"):
        ProbabilisticSpaceCarving().carve(
            photographs(ball_mesh()), volume.with_occupancy(np.zeros((3, 3, 3), np.bool_))
        )


def test_one_thread_gives_what_two_give(temple: BuiltInScene) -> None:
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=8000)
    hulls: list[CarvedVolume] = []
    before = numba.get_num_threads()
    for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(threads)
        hulls.append(ProbabilisticSpaceCarving().carve(temple.scene, volume))
    numba.set_num_threads(before)
    np.testing.assert_array_equal(hulls[0].labels, hulls[1].labels)
    np.testing.assert_array_equal(hulls[0].degree, hulls[1].degree)
    np.testing.assert_array_equal(hulls[0].volume.colors, hulls[1].volume.colors)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sigma0": 0.0}, "expected sigma0"),
        ({"prior": 1.0}, "expected prior"),
        ({"threshold": 0.0}, "expected threshold"),
        ({"rounds": 0}, "expected rounds to be a whole number of at least 1"),
        ({"outliers": 1.0}, "expected outliers"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ProbabilisticSpaceCarving(**options)  # type: ignore[arg-type]


def test_progress_counts_the_rounds(temple: BuiltInScene) -> None:
    calls: list[tuple[int, int]] = []
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=2000)
    ProbabilisticSpaceCarving(rounds=3).carve(temple.scene, volume, progress=lambda n, of: calls.append((n, of)))
    assert calls == [(1, 3), (2, 3), (3, 3)]
