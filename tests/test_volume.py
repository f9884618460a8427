from __future__ import annotations

import pickle
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import open3d as o3d
import psutil
import pytest
from numpy.typing import NDArray
from scenes import ball_volume, full_volume, rotation

from recon3d.errors import EmptyReconstructionError, VolumeTooLargeError
from recon3d.io.geometry import write_geometry
from recon3d.io.reading_geometry import read_geometry
from recon3d.scene.bounds import Bounds
from recon3d.volume.carved import CarvedVolume
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import BYTES_PER_VOXEL


def colorful_volume(seed: int = 0) -> CarvingVolume:
    """Random occupancy that reaches the last voxel, every channel value met, an origin and size that are not round."""
    rng = np.random.default_rng(seed)
    shape = (11, 7, 9)
    occupied = rng.random(shape) < 0.5
    occupied[10, 6, 8] = True
    colors = np.where(occupied[..., None], rng.integers(0, 256, (*shape, 3)), 0).astype(np.uint8)
    some = np.argwhere(occupied)[:256]
    colors[tuple(some.T)] = np.arange(len(some))[:, None]
    return CarvingVolume(np.array([-0.0735681, 1.0217283, 17.3]), 0.00037219, occupied, colors)


def assert_same_volume(a: CarvingVolume, b: CarvingVolume) -> None:
    np.testing.assert_array_equal(a.origin, b.origin)
    assert a.voxel_size == b.voxel_size
    np.testing.assert_array_equal(a.occupied, b.occupied)
    np.testing.assert_array_equal(a.colors, b.colors)


@pytest.mark.parametrize("voxel_size", [1e-300, 1e-10])
def test_more_voxels_along_a_side_than_can_be_counted_are_refused(voxel_size: float) -> None:
    with pytest.raises(VolumeTooLargeError, match="along the longest side of bounds of 1 x 2 x 3; expected a larger"):
        CarvingVolume.enclosing(Bounds([0, 0, 0], [1, 2, 3]), voxel_size=voxel_size)


def test_an_enclosing_volume_covers_the_bounds_and_is_centred_on_them() -> None:
    bounds = Bounds([-1, 2, 3], [0.5, 2.4, 3.77])
    volume = CarvingVolume.enclosing(bounds, voxel_size=0.1)
    assert volume.shape == (15, 4, 8)
    top = volume.origin + volume.voxel_size * np.array(volume.shape)
    # Rounding of sums like 0.1 * 15 alone.
    assert (volume.origin <= np.add(bounds.low, 1e-9)).all()
    assert (top >= np.subtract(bounds.high, 1e-9)).all()
    np.testing.assert_allclose((volume.origin + top) / 2, bounds.center, atol=1e-12)
    assert volume.occupied.all()
    assert not volume.colors.any()


@pytest.mark.parametrize("n_voxels", [1, 1000, 50_000])
def test_a_number_of_voxels_is_met_approximately(n_voxels: int) -> None:
    volume = CarvingVolume.enclosing(Bounds([0, 0, 0], [1, 2, 0.7]), n_voxels=n_voxels)
    # Each side is rounded up by less than one voxel.
    sides = np.array([1, 2, 0.7]) / volume.voxel_size
    assert n_voxels - 1e-6 <= volume.occupied.size <= np.prod(sides + 1) + 1e-6


def test_a_voxel_larger_than_the_bounds_makes_one_voxel() -> None:
    assert CarvingVolume.enclosing(Bounds([0, 0, 0], [1, 2, 3]), voxel_size=10).shape == (1, 1, 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "expected either voxel_size or n_voxels"),
        ({"voxel_size": 0.1, "n_voxels": 10}, "expected either voxel_size or n_voxels"),
        ({"n_voxels": 0}, "expected n_voxels to be a whole number of at least 1, got 0"),
        ({"voxel_size": 0.0}, r"expected voxel_size to be a number in \(0, inf\), got 0"),
        ({"voxel_size": float("nan")}, r"expected voxel_size to be a number in \(0, inf\), got nan"),
    ],
)
def test_senseless_sizes_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        CarvingVolume.enclosing(Bounds([0, 0, 0], [1, 1, 1]), **options)  # type: ignore[arg-type]


def test_a_volume_that_does_not_fit_into_memory_is_refused_with_a_size_that_would(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bounds = Bounds([0, 0, 0], [1, 1, 1])
    free = 1000 * BYTES_PER_VOXEL
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=free))
    with pytest.raises(VolumeTooLargeError, match=r"20 x 20 x 20 voxels of 0\.05 would need .* GiB") as caught:
        CarvingVolume.enclosing(bounds, voxel_size=0.05)
    found = re.search(r"a voxel size of (\S+) would fit", str(caught.value))
    assert found
    fitting = float(found[1])
    # 1000 voxels are free, so at most ten a side; and no more than twice as coarse as needed.
    assert 0.1 <= fitting < 0.2
    assert CarvingVolume.enclosing(bounds, voxel_size=fitting).occupied.all()


def test_an_absurd_volume_is_refused_before_it_is_allocated() -> None:
    with pytest.raises(VolumeTooLargeError, match="would fit"):
        CarvingVolume.enclosing(Bounds([0, 0, 0], [1, 1, 1]), voxel_size=1e-7)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"origin": np.zeros(2)}, "expected an origin of three finite numbers"),
        ({"origin": np.array([0, np.nan, 0])}, "expected an origin of three finite numbers"),
        ({"voxel_size": -1.0}, r"expected voxel_size to be a number in \(0, inf\), got -1"),
        ({"voxel_size": float("inf")}, r"expected voxel_size to be a number in \(0, inf\), got inf"),
        ({"occupied": np.ones((2, 2, 2), np.uint8)}, "expected a bool occupancy"),
        ({"occupied": np.ones((2, 2), np.bool_)}, "expected a bool occupancy"),
        ({"colors": np.zeros((2, 2, 1, 3), np.uint8)}, r"expected uint8 colours \(2, 2, 2, 3\), got \(2, 2, 1, 3\)"),
        ({"colors": np.zeros((2, 2, 2, 3))}, "float64"),
    ],
)
def test_a_malformed_volume_is_refused(change: dict[str, NDArray[np.float64]], message: str) -> None:
    good = {
        "origin": np.zeros(3),
        "voxel_size": 1.0,
        "occupied": np.ones((2, 2, 2), np.bool_),
        "colors": np.zeros((2, 2, 2, 3), np.uint8),
    }
    with pytest.raises(ValueError, match=message):
        CarvingVolume(**{**good, **change})  # type: ignore[arg-type]


def test_another_occupancy_must_have_the_same_shape() -> None:
    with pytest.raises(ValueError, match="expected uint8 colours"):
        full_volume((2, 2, 2)).with_occupancy(np.ones((3, 2, 2), np.bool_))


def test_a_volume_makes_the_round_trip_through_open3d_exactly() -> None:
    volume = colorful_volume()
    grid = volume.to_voxel_grid()
    np.testing.assert_array_equal(grid.origin, volume.origin)
    assert grid.voxel_size == volume.voxel_size
    assert_same_volume(CarvingVolume.from_voxel_grid(grid, shape=volume.shape), volume)


def test_open3d_has_every_voxel_where_the_volume_has_it() -> None:
    volume = colorful_volume(1)
    grid = volume.to_voxel_grid()
    got = {tuple(int(x) for x in voxel.grid_index): np.rint(voxel.color * 255) for voxel in grid.get_voxels()}
    expected = {tuple(int(x) for x in index) for index in np.argwhere(volume.occupied)}
    assert set(got) == expected
    for index, color in got.items():
        np.testing.assert_array_equal(color, volume.colors[index])
    index = next(iter(expected))
    center = volume.origin + (np.array(index) + 0.5) * volume.voxel_size
    np.testing.assert_allclose(grid.get_voxel_center_coordinate(np.array(index)), center, rtol=0, atol=1e-12)


def test_a_volume_makes_the_round_trip_through_a_ply_file_exactly(tmp_path: Path) -> None:
    volume = colorful_volume(2)
    grid = read_geometry(write_geometry(tmp_path / "grid.ply", volume.to_voxel_grid()))
    assert isinstance(grid, o3d.geometry.VoxelGrid)
    assert_same_volume(CarvingVolume.from_voxel_grid(grid, shape=volume.shape), volume)


def test_without_a_shape_the_volume_is_just_large_enough() -> None:
    volume = full_volume((5, 6, 7))
    occupied = np.zeros((5, 6, 7), np.bool_)
    occupied[1, 2, 3] = occupied[3, 0, 2] = True
    back = CarvingVolume.from_voxel_grid(volume.with_occupancy(occupied).to_voxel_grid())
    assert back.shape == (4, 3, 4)
    np.testing.assert_array_equal(back.occupied, occupied[:4, :3, :4])
    np.testing.assert_array_equal(back.origin, volume.origin)


def test_voxels_of_negative_index_move_the_origin() -> None:
    grid = o3d.geometry.VoxelGrid()
    grid.origin, grid.voxel_size = np.array([1.0, 2.0, 3.0]), 0.5
    for index in ((-2, 0, 1), (1, 3, 2)):
        grid.add_voxel(o3d.geometry.Voxel(np.array(index), np.array([1.0, 0.5, 0.0])))
    volume = CarvingVolume.from_voxel_grid(grid)
    assert volume.origin.tolist() == [0.0, 2.0, 3.0]
    assert {tuple(i) for i in np.argwhere(volume.occupied).tolist()} == {(0, 0, 1), (3, 3, 2)}
    assert volume.colors[0, 0, 1].tolist() == [255, 128, 0]


def test_a_shape_too_small_for_the_grid_is_refused() -> None:
    with pytest.raises(ValueError, match="expected a shape of at least"):
        CarvingVolume.from_voxel_grid(full_volume((2, 3, 4)).to_voxel_grid(), shape=(2, 2, 4))


def test_an_empty_grid_is_refused() -> None:
    with pytest.raises(EmptyReconstructionError, match="the voxel grid holds no voxels"):
        CarvingVolume.from_voxel_grid(o3d.geometry.VoxelGrid())


def test_a_rotated_grid_is_refused() -> None:
    grid = full_volume((2, 2, 2)).to_voxel_grid()
    grid.rotate(rotation(np.array([0.0, 0.0, 0.3])), np.zeros(3))
    with pytest.raises(ValueError, match="expected an axis-aligned voxel grid, got a rotated one"):
        CarvingVolume.from_voxel_grid(grid)


def test_a_grid_with_a_stray_voxel_far_away_is_refused_before_it_is_allocated() -> None:
    grid = full_volume((2, 2, 2)).to_voxel_grid()
    grid.add_voxel(o3d.geometry.Voxel(np.array([2_000_000, 2_000_000, 2_000_000]), np.zeros(3)))
    with pytest.raises(VolumeTooLargeError):
        CarvingVolume.from_voxel_grid(grid)


def test_centers_are_half_a_voxel_above_the_lowest_corner() -> None:
    volume = full_volume((2, 1, 1), 0.5, (1, 2, 3))
    np.testing.assert_allclose(volume.centers(), [[1.25, 2.25, 3.25], [1.75, 2.25, 3.25]])
    mask = np.array([[[False]], [[True]]])
    np.testing.assert_allclose(volume.centers(mask), [[1.75, 2.25, 3.25]])


def test_surface_voxels_are_those_with_an_empty_face_neighbour() -> None:
    occupied = np.random.default_rng(0).random((6, 7, 8)) < 0.85
    surface = full_volume((6, 7, 8)).with_occupancy(occupied).surface()
    expected = np.zeros_like(occupied)
    for i, j, k in np.argwhere(occupied):
        for a, b, c in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)):
            x, y, z = i + a, j + b, k + c
            within = 0 <= x < 6 and 0 <= y < 7 and 0 <= z < 8
            expected[i, j, k] |= not (within and occupied[x, y, z])
    np.testing.assert_array_equal(surface, expected)
    assert 0 < surface.sum() < occupied.sum()


def test_the_summary_and_the_picture_show_the_volume() -> None:
    volume = ball_volume(0.9, 20)
    assert volume.summary()["voxels"] == "20 x 20 x 20 = 8,000"
    assert f"{volume.n_occupied:,}" in str(volume.summary()["occupied"])
    assert "data:image/png;base64," in volume._repr_html_()
    along_x = volume._seen_along(0)
    assert along_x.shape == (20, 20, 3)
    # The first voxels along x have x < 0 and are blue; the corners of the picture show nothing.
    assert along_x[10, 10].tolist() == [0, 0, 100]
    assert along_x[0, 0].tolist() == [255, 255, 255]


def test_volumes_are_values() -> None:
    first, copy = ball_volume(0.9, 12), pickle.loads(pickle.dumps(ball_volume(0.9, 12)))  # noqa: S301
    other = first.with_occupancy(~first.occupied)
    assert first == copy != other
    assert len({first, copy, other}) == 2
    carved = CarvedVolume.untouched(first)
    same = pickle.loads(pickle.dumps(carved))  # noqa: S301
    assert carved == same  # though degrees are NaN
    before = hash(same)
    same.accept(np.array([[0, 0, 0]]), np.array([[1, 2, 3]], np.uint8))
    assert carved != same
    assert hash(same) == before
