"""What every carving method promises."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from reference import footprint, foreground, in_image
from scenes import ORIGIN, ball_mesh, cropped, photographs, stripes, transformed

from recon3d.carving import METHODS
from recon3d.datasets.synthetic import ring
from recon3d.errors import ArgumentError, EmptyReconstructionError, SceneError, VisibilityError
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import without_silhouettes
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume

FULL_ONLY = [name for name in METHODS if name.startswith("fine-")]
"""Methods that start from a whole lattice and store the voxels near the surface, without their degrees."""

BY_TURNS = "probabilistic-space-carving"
"""Takes the views one by one where it sums over who sees, which is exact only for visibilities of 0 and 1."""

every_method = pytest.mark.parametrize("name", METHODS)


@cache
def ball(arc: float = 130.0) -> Scene:
    """A ball of radius one from cameras that satisfy every method: on one side, 32 degrees apart, all in the frame."""
    n_views = 5 if arc < 360 else 8
    taken_by = ring(
        ORIGIN, n_views=n_views, distance=6.0, width=84, height=76, focal=90.0, elevation=25.0 if arc < 360 else 0.0,
        arc=arc,
    )  # fmt: skip
    return replace(photographs(ball_mesh(), stripes, taken_by, supersampling=2), name="ball")


def volume_of(scene: Scene) -> CarvingVolume:
    """Voxels that are wider than two pixels."""
    return CarvingVolume.enclosing(scene.bounds, voxel_size=0.15)


def carved(name: str, scene: Scene, volume: CarvingVolume | None = None) -> CarvedVolume:
    return METHODS[name]().carve(scene, volume_of(scene) if volume is None else volume).dense()


@cache
def result(name: str) -> CarvedVolume:
    """What a method leaves of the ball's volume, or of the half of it, where it takes a half."""
    return carved(name, ball(), half_of(name))


def half_of(name: str) -> CarvingVolume:
    volume = volume_of(ball())
    if name in FULL_ONLY:
        return volume
    occupied = volume.occupied.copy()
    occupied[:, : occupied.shape[1] // 2] = False
    return volume.with_occupancy(occupied)


def assert_same(one: CarvedVolume, other: CarvedVolume) -> None:
    """To the last bit, but for where the lattice lies."""
    assert one.arrays().keys() == other.arrays().keys()
    for name, array in one.arrays().items():
        np.testing.assert_array_equal(array, other.arrays()[name], err_msg=name)


@every_method
def test_the_result_lies_inside_the_volume_and_its_labels_partition_the_lattice(name: str) -> None:
    before, after = half_of(name), result(name)
    assert after.volume.shape == before.shape
    np.testing.assert_array_equal(after.volume.origin, before.origin)
    assert after.volume.voxel_size == before.voxel_size
    assert np.isin(after.labels, list(Label)).all()
    assert (after.labels[~before.occupied] == Label.UNSEEN).all()
    assert (after.with_interior.occupied <= before.occupied).all()
    np.testing.assert_array_equal(after.volume.occupied, after.labels == Label.CONSISTENT)
    assert sum(after.counts().values()) == before.occupied.size
    assert after.volume.n_occupied == after.n_accepted == after.counts()["consistent"] > 0


@every_method
def test_what_is_known_of_voxels_is_in_range(name: str) -> None:
    after = result(name)
    known = ~np.isnan(after.degree)
    assert ((after.degree[known] >= 0) & (after.degree[known] <= 1)).all()
    assert (after.n_views <= len(ball().views)).all()
    assert after.volume.colors[after.volume.occupied].any()
    assert not after.volume.colors[~after.volume.occupied].any()
    if METHODS[name].uses_test and name not in FULL_ONLY:
        assert known[after.volume.occupied].all()
    if after.distance is not None:
        assert (after.with_interior.occupied <= (after.distance > 0)).all()


@every_method
@pytest.mark.parametrize("threads", [1, 2])
def test_the_result_is_always_the_same(name: str, threads: int, thread_count: Callable[[int], None]) -> None:
    thread_count(threads)
    assert_same(carved(name, ball(), half_of(name)), result(name))


@pytest.fixture
def thread_count() -> Iterator[Callable[[int], None]]:
    """Sets the number of numba's threads, and sets it back."""
    before = numba.get_num_threads()
    yield lambda count: numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    numba.set_num_threads(before)


@every_method
def test_scene_and_volume_are_left_as_they_were(name: str) -> None:
    scene, volume = ball(), half_of(name)
    before = pickle.dumps((scene, volume.occupied, volume.colors))
    volume.occupied.setflags(write=False)
    volume.colors.setflags(write=False)
    after = carved(name, scene, volume)
    assert pickle.dumps((scene, volume.occupied, volume.colors)) == before
    assert not np.shares_memory(after.volume.occupied, volume.occupied)
    assert not np.shares_memory(after.volume.colors, volume.colors)


@every_method
def test_unit_and_place_of_the_world_do_not_matter(name: str) -> None:
    shift = np.array([64.0, -32.0, 16.0])
    moved, volume = transformed(ball(), 4.0, shift), half_of(name)
    there = CarvingVolume(4 * volume.origin + shift, 4 * volume.voxel_size, volume.occupied, volume.colors)
    after = carved(name, moved, there)
    np.testing.assert_array_equal(after.labels, result(name).labels)
    np.testing.assert_array_equal(after.volume.colors, result(name).volume.colors)


@every_method
def test_the_order_of_the_views_does_not_matter(name: str) -> None:
    scene = ball()
    shuffled = replace(scene, views=tuple(scene.views[n] for n in (3, 0, 4, 2, 1)))
    changed = (carved(name, shuffled, half_of(name)).labels != result(name).labels).mean()
    assert changed == 0 or (name == BY_TURNS and changed < 0.005)


@every_method
def test_what_a_silhouette_leaves_out_is_carved(name: str) -> None:
    assert not (carved(name, ball()).with_interior.occupied & outside()).any()


@cache
def outside() -> NDArray[np.bool_]:
    """(nx, ny, nz) voxels whose box of pixels in some image is background alone."""
    volume = volume_of(ball())
    excluded = np.zeros(volume.shape, np.bool_)
    for voxel in np.ndindex(volume.shape):
        boxes = [(view, footprint(view, volume, voxel)) for view in ball().views]
        excluded[voxel] = any(
            not any(not in_image(view, pixel) or foreground(view, pixel) for pixel in box) for view, box in boxes if box
        )
    assert 0.3 < excluded.mean() < 0.9
    return excluded


@every_method
def test_views_may_differ_in_size(name: str) -> None:
    scene = ball()
    sizes = [(84, 76), (80, 76), (84, 68), (76, 70), (75, 69)]
    views = tuple(cropped(view, *size) for view, size in zip(scene.views, sizes, strict=True))
    assert all(view.sees(volume_of(scene).bounds.corners).all() for view in views)  # what is cut off shows no voxel
    assert_same(carved(name, replace(scene, views=views), half_of(name)), result(name))


@every_method
def test_scenes_without_silhouettes_are_carved_or_refused_as_the_method_says(name: str) -> None:
    scene = without_silhouettes(ball())
    if METHODS[name].needs_silhouettes:
        with pytest.raises(SceneError, match=r"scene ball: .*silhouettes"):
            carved(name, scene)
    else:
        assert carved(name, scene).n_accepted > 0


@every_method
def test_cameras_all_around_are_welcome_or_refused_as_the_method_says(name: str) -> None:
    scene = ball(360.0)
    if METHODS[name].one_sided:
        with pytest.raises(VisibilityError, match="scene ball: the cameras do not lie on one side"):
            carved(name, scene)
    else:
        assert carved(name, scene).n_accepted > 0


@every_method
def test_nothing_left_is_an_error_that_names_the_scene(name: str) -> None:
    scene = ball()
    blind = replace(scene.views[2], mask=np.zeros((76, 84), np.bool_))
    with pytest.raises(EmptyReconstructionError, match="scene nothing there: "):
        carved(name, replace(scene, name="nothing there", views=(*scene.views[:2], blind, *scene.views[3:])))


@pytest.mark.parametrize("name", FULL_ONLY)
def test_methods_that_start_from_a_whole_lattice_refuse_less(name: str) -> None:
    volume = volume_of(ball())
    volume.occupied[0, 0, 0] = False
    with pytest.raises(ArgumentError, match="expected a lattice or a full volume, got one with 1 empty voxels"):
        carved(name, ball(), volume)


@every_method
def test_a_lattice_stands_for_its_full_volume(name: str) -> None:
    volume = volume_of(ball())
    method = METHODS[name]()
    assert_same(method.carve(ball(), volume.lattice).dense(), method.carve(ball(), volume).dense())


@every_method
def test_progress_is_told_up_to_the_end(name: str) -> None:
    told: list[tuple[int, int]] = []
    METHODS[name]().carve(ball(), half_of(name), progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (told[-1][1], told[-1][1])
    assert len({total for _, total in told}) == 1
    assert all(before <= after for (before, _), (after, _) in pairwise(told))
    assert told[0][0] >= 0


@every_method
def test_an_observer_is_told_of_verdicts_where_a_test_is_asked(name: str) -> None:
    class Listener:
        judgements = 0

        def judged(self, voxels: NDArray[np.int64], *_: object) -> None:
            self.judgements += len(voxels)

        def resolving(self, labels: NDArray[np.uint8]) -> None:
            assert labels.ndim == 3

    listener = Listener()
    METHODS[name]().dense().carve(ball(), half_of(name), observer=listener)
    assert (listener.judgements > 0) == METHODS[name].uses_test
