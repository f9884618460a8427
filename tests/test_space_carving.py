"""Space carving by plane sweeps along the axes."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ORIGIN, ball_mesh, box_mesh, cameras, full_volume, photographs, plain_view, two_planes_mesh

from recon3d.carving.observations import without_background
from recon3d.carving.space_carving import SpaceCarving
from recon3d.carving.voxel_coloring import VoxelColoring
from recon3d.consistency.base import Patches, Verdict
from recon3d.consistency.deviation import StandardDeviation
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis
from recon3d.datasets.synthetic import BuiltInScene, ring
from recon3d.errors import EmptyReconstructionError, FailedTestError, VisibilityError
from recon3d.evaluation.distances import distance_to_mesh
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import without_silhouettes
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume

ALL_ROUND = cameras(8, arc=360)
AT_EYE_LEVEL = ring(ORIGIN, n_views=8, distance=6.0, width=48, height=36, focal=72.0, elevation=0.0)


def visual_hull(scene: Scene, volume: CarvingVolume) -> NDArray[np.bool_]:
    return without_background(scene.packed, volume)[1]


class AcceptNothing:
    def __call__(self, patches: Patches) -> Verdict:
        return Verdict(np.zeros(patches.n_voxels), np.ones(patches.n_voxels), np.ones(patches.n_voxels))


class AcceptEverything:
    def __call__(self, patches: Patches) -> Verdict:
        return Verdict(np.ones(patches.n_voxels), np.zeros(patches.n_voxels), np.ones(patches.n_voxels))


class SmallRange:
    """A monotone test: the largest difference between two pixels, in any channel, at most a limit."""

    def __init__(self, limit: float) -> None:
        self.limit = limit

    def __call__(self, patches: Patches) -> Verdict:
        starts = patches.starts[:-1]
        spread = np.zeros(patches.n_voxels)
        if patches.n_voxels:
            high, low = (reduce.reduceat(patches.colors, starts).astype(float) for reduce in (np.maximum, np.minimum))
            spread = (high - low).max(axis=1)
        limit = np.full(patches.n_voxels, 1 - self.limit / 255)
        return Verdict(1 - spread / 255, limit, limit)


class CandidatesOnly:
    """Never sure of anything."""

    def __call__(self, patches: Patches) -> Verdict:
        n = patches.n_voxels
        return Verdict(np.full(n, 0.5), np.zeros(n), np.ones(n))


def test_cameras_all_around_that_voxel_colouring_refuses_are_welcome() -> None:
    mesh = ball_mesh()
    scene = photographs(mesh, taken_by=AT_EYE_LEVEL)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=8000)
    with pytest.raises(VisibilityError):
        VoxelColoring().carve(scene, volume)
    hull = SpaceCarving().carve(scene, volume)
    distance = distance_to_mesh(hull.volume.centers(), mesh)
    # A pixel is 0.083 units; the poles are seen by nobody from above.
    assert np.median(distance) < 0.083 + volume.voxel_size * np.sqrt(3) / 2


def test_the_temple_is_found_closer_than_its_visual_hull(temple: BuiltInScene) -> None:
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=100_000)
    hull = SpaceCarving().carve(temple.scene, volume)
    outline = volume.with_occupancy(visual_hull(temple.scene, volume))
    carved, silhouettes = (
        distance_to_mesh(shape.centers(shape.surface()), temple.ground_truth).mean() for shape in (hull.volume, outline)
    )
    assert carved < 0.95 * silhouettes


@pytest.mark.parametrize("test", [FuzzyAdaptiveHysteresis(), StandardDeviation(15.0)])
def test_the_result_lies_inside_the_visual_hull(temple: BuiltInScene, test: StandardDeviation) -> None:
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=20_000)
    hull = SpaceCarving(test).carve(temple.scene, volume)
    assert not (hull.with_interior.occupied & ~visual_hull(temple.scene, volume)).any()


@pytest.mark.parametrize("mesh", [ball_mesh(), box_mesh(1.5, 1.2, 1.4), two_planes_mesh()])
def test_the_photo_hull_holds_the_object_when_the_test_is_monotone(mesh: object) -> None:
    scene = photographs(mesh, taken_by=ALL_ROUND, supersampling=1)  # type: ignore[arg-type]
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=8000)
    hull = SpaceCarving(SmallRange(120.0)).carve(scene, volume)
    points = np.asarray(mesh.sample_points_uniformly(20000).points)  # type: ignore[attr-defined]
    inside = np.unique(np.floor((points - volume.origin) / volume.voxel_size).astype(int), axis=0)
    seen = inside[visual_hull(scene, volume)[tuple(inside.T)]]
    assert len(seen) > 0.7 * len(inside)
    assert hull.with_interior.occupied[tuple(seen.T)].all()


def test_a_test_that_accepts_everything_leaves_the_visual_hull() -> None:
    scene = photographs(ball_mesh(), taken_by=ALL_ROUND)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=4000)
    hull = SpaceCarving(AcceptEverything()).carve(scene, volume)
    np.testing.assert_array_equal(hull.with_interior.occupied, visual_hull(scene, volume))
    assert not (hull.volume.occupied & ~hull.with_interior.surface()).any()


def test_what_is_left_is_consistent_on_all_that_shows_it() -> None:
    scene = photographs(two_planes_mesh(), taken_by=ALL_ROUND)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=8000)
    hull = SpaceCarving(StandardDeviation(12.0)).carve(scene, volume)
    assert (hull.degree[hull.volume.occupied] >= 1 - 12 / 127.5 - 1e-6).all()
    assert (hull.degree[hull.labels == Label.INCONSISTENT] < 1 - 12 / 127.5 + 1e-6).all()


def test_voxels_are_judged_on_views_from_opposite_sweeps_together() -> None:
    # Cameras on either side of a thin plate meet its rim in opposite sweeps.
    scene = photographs(box_mesh(1.5, 0.2, 1.4), taken_by=AT_EYE_LEVEL)
    volume = CarvingVolume.enclosing(scene.bounds, voxel_size=0.2)
    hull = SpaceCarving(AcceptEverything()).carve(scene, volume)
    assert hull.n_views.max() > len(scene.views) / 2


def test_a_second_carving_of_the_result_changes_nothing() -> None:
    scene = photographs(two_planes_mesh(), taken_by=ALL_ROUND)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=4000)
    once = SpaceCarving(SmallRange(40.0)).carve(scene, volume)
    twice = SpaceCarving(SmallRange(40.0)).carve(scene, volume.with_occupancy(once.with_interior.occupied))
    np.testing.assert_array_equal(twice.volume.occupied, once.volume.occupied)


def test_fewer_rounds_leave_more_voxels() -> None:
    scene = photographs(two_planes_mesh(), taken_by=ALL_ROUND)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=8000)
    one, all_of_them = (SpaceCarving(SmallRange(30.0), max_rounds=n).carve(scene, volume) for n in (1, 50))
    assert one.with_interior.n_occupied >= all_of_them.with_interior.n_occupied
    assert not (all_of_them.with_interior.occupied & ~one.with_interior.occupied).any()


def test_candidates_that_touch_nothing_certain_are_carved() -> None:
    scene = photographs(ball_mesh(), taken_by=ALL_ROUND)
    with pytest.raises(EmptyReconstructionError, match=r"all voxels were carved .*inconsistent.*0 consistent"):
        SpaceCarving(CandidatesOnly()).carve(scene, CarvingVolume.enclosing(scene.bounds, n_voxels=1000))


def test_a_test_that_accepts_nothing_is_an_error_with_the_counts() -> None:
    scene = photographs(ball_mesh(), taken_by=ALL_ROUND)
    with pytest.raises(EmptyReconstructionError, match=r"all voxels were carved .*0 hidden, 0 consistent"):
        SpaceCarving(AcceptNothing()).carve(scene, CarvingVolume.enclosing(scene.bounds, n_voxels=1000))


def test_an_empty_volume_is_an_error() -> None:
    scene = photographs(ball_mesh(), taken_by=ALL_ROUND)
    volume = full_volume((3, 3, 3), 0.1)
    with pytest.raises(EmptyReconstructionError, match="all voxels were carved"):
        SpaceCarving().carve(scene, volume.with_occupancy(np.zeros((3, 3, 3), np.bool_)))


def test_no_silhouettes_and_a_single_view_still_run() -> None:
    scene = photographs(ball_mesh(), taken_by=ALL_ROUND)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=4000)
    assert SpaceCarving().carve(without_silhouettes(scene), volume).volume.n_occupied
    single = replace(scene, views=scene.views[:1])
    hull = SpaceCarving().carve(single, volume)
    assert hull.volume.n_occupied
    assert hull.n_views.max() == 1


def test_a_camera_inside_the_volume_sees_the_box_before_it() -> None:
    # The camera at (0, 0, -5) looks along +z; the volume begins behind it.
    scene = Scene((plain_view(),), Bounds([-2, -2, -6], [2, 2, 2]))
    volume = CarvingVolume.enclosing(scene.bounds, voxel_size=0.25)
    hull = SpaceCarving().carve(scene, volume)
    assert hull.volume.n_occupied
    centers = hull.volume.centers()
    assert (centers[:, 2] > -5).all()
    # Grey agrees with itself, so the first voxels that are not too near are taken.
    assert np.linalg.norm(centers - [0, 0, -5], axis=1).min() < 5 * volume.voxel_size


def test_one_thread_gives_what_two_give(temple: BuiltInScene) -> None:
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=8000)
    hulls: list[CarvedVolume] = []
    before = numba.get_num_threads()
    for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(threads)
        hulls.append(SpaceCarving().carve(temple.scene, volume))
    numba.set_num_threads(before)
    np.testing.assert_array_equal(hulls[0].labels, hulls[1].labels)
    np.testing.assert_array_equal(hulls[0].degree, hulls[1].degree)
    np.testing.assert_array_equal(hulls[0].volume.colors, hulls[1].volume.colors)


def test_labels_degree_and_views_are_consistent_with_each_other(temple: BuiltInScene) -> None:
    hull = SpaceCarving().carve(temple.scene, CarvingVolume.enclosing(temple.scene.bounds, n_voxels=8000))
    judged = (hull.labels == Label.CONSISTENT) | (hull.labels == Label.INCONSISTENT)
    np.testing.assert_array_equal(np.isfinite(hull.degree), judged)
    np.testing.assert_array_equal(hull.n_views > 0, judged)
    np.testing.assert_array_equal(hull.volume.occupied, hull.labels == Label.CONSISTENT)
    assert not hull.volume.colors[~hull.volume.occupied].any()
    assert sum(hull.counts().values()) == hull.labels.size


def test_progress_ends_at_the_total_and_never_goes_back(temple: BuiltInScene) -> None:
    calls: list[tuple[int, int]] = []
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=2000)
    SpaceCarving(max_rounds=9).carve(temple.scene, volume, progress=lambda n, of: calls.append((n, of)))
    assert {total for _, total in calls} == {54}
    assert [n for n, _ in calls] == sorted(n for n, _ in calls)
    assert calls[-1] == (54, 54)


def test_no_rounds_are_refused() -> None:
    scene = photographs(ball_mesh())
    with pytest.raises(ValueError, match="expected max_rounds to be a whole number of at least 1, got 0"):
        SpaceCarving(max_rounds=0).carve(scene, full_volume((2, 2, 2)))


def test_a_test_that_judges_another_number_of_voxels_is_refused() -> None:
    def too_few(_: Patches) -> Verdict:
        return Verdict(np.ones(1), np.ones(1), np.ones(1))

    scene = photographs(ball_mesh())
    with pytest.raises(FailedTestError, match="judged 1 voxels of"):
        SpaceCarving(too_few).carve(scene, CarvingVolume.enclosing(scene.bounds, n_voxels=500))
