"""Carving by depth maps: one camera of parallel rays, near enough, before walls at known depths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from reference import fused_depths_twin
from scenes import cameras, cropped, full_volume, plain_view

from recon3d import Bounds, CarvingVolume, Scene, View
from recon3d.carving.depth_votes import carve_by_depths, hull_of_field
from recon3d.carving.item_buffer import ItemBuffer
from recon3d.carving.visible import color_visible
from recon3d.kernels.depth_maps import add_depths
from recon3d.kernels.types import DepthMaps, Lattice, Votes
from recon3d.volume.carved import Label

SIDE = 16  # voxels of length one
FAR = 1000.0  # of the camera from the volume's near face, so that rays run along +z


@pytest.fixture(scope="module")
def view() -> View:
    """A pixel measures half a voxel in the volume's middle."""
    K = np.array([[2 * (FAR + 8), 0, 19.5], [0, 2 * (FAR + 8), 19.5], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, 3] = [-8, -8, FAR]
    return plain_view(K, pose, width=40, height=40)


@pytest.fixture(scope="module")
def volume() -> CarvingVolume:
    return full_volume((SIDE, SIDE, SIDE))


def carved(
    view: View,
    volume: CarvingVolume,
    *maps: tuple[NDArray[np.floating] | float, NDArray[np.floating] | float],
    field: NDArray[np.float32] | None = None,
    resolution: float = 0.5,
    margin: float = 0.0,
) -> NDArray[np.float32]:
    """The field, 20 deep everywhere, after the votes of depths and weights (40, 40), or one for all pixels."""
    before = np.full(volume.shape, 20, np.float32) if field is None else field
    scene = Scene(tuple(replace(view, name=f"{n}") for n in range(len(maps))), Bounds([0, 0, 0], [SIDE] * 3))
    depths, weights = (
        np.stack([np.broadcast_to(np.asarray(part, np.float32), (40, 40)) for part in parts])
        for parts in zip(*maps, strict=True)
    )
    return carve_by_depths(
        before, volume, scene.cameras, [DepthMaps(depths, weights, 1)], resolution=resolution, truncation=4.0,
        prior=0.02, margin=margin,
    )  # fmt: skip


@pytest.mark.parametrize(("wall", "margin"), [(6.0, 0.0), (6.3, 0.0), (6.0, 2.0)])
def test_the_field_is_the_signed_distance_to_the_depths(
    view: View, volume: CarvingVolume, wall: float, margin: float
) -> None:
    field = carved(view, volume, (FAR + wall, 1), margin=margin)
    z = np.arange(SIDE) + 0.5
    near = np.abs(z - wall) < 3  # truncated farther off; the prior is a fiftieth of a vote, of four voxels
    expected = np.broadcast_to(z - wall + 0.5 * margin, field.shape)
    np.testing.assert_allclose(field[..., near], expected[..., near], atol=0.15)
    assert (field[..., z < wall - margin] < 0).all()
    # What nobody speaks of is as deep as the truncation.
    np.testing.assert_allclose(field[..., z > wall + 4.5], 4 + 0.5 * margin, atol=0.02)


DRAWN_OUT = pytest.mark.xfail(strict=True, reason="the blur of the votes draws the surface out")


@pytest.mark.parametrize("before", [4.3, pytest.param(5.3, marks=DRAWN_OUT), pytest.param(5.7, marks=DRAWN_OUT)])
def test_a_surface_close_to_the_present_one_lies_where_the_depths_are(
    view: View, volume: CarvingVolume, before: float
) -> None:
    # A blur over what is occupied alone would draw every surface out to the present one.
    wall, z = 6.3, np.arange(SIDE) + 0.5
    present = np.broadcast_to((z - before).astype(np.float32), volume.shape)
    field = carved(view, volume, (FAR + wall, 1), field=present, resolution=1.0)[3:-3, 3:-3]
    crossing = np.argmax(field > 0, axis=-1)
    inner, outer = (np.take_along_axis(field, crossing[..., None] - n, -1)[..., 0] for n in (0, 1))
    np.testing.assert_allclose(z[crossing] - inner / (inner - outer), wall, atol=0.15)


def test_depths_count_by_their_weights(view: View, volume: CarvingVolume) -> None:
    field = carved(view, volume, (FAR + 6, 0.2), (FAR + 7, 0.6))
    z = np.arange(SIDE) + 0.5
    near = np.abs(z - 6.75) < 2.5
    expected = np.broadcast_to(z - 6.75, field.shape)
    np.testing.assert_allclose(field[..., near], expected[..., near], atol=0.2)


def test_where_no_pixel_votes_the_field_stays(view: View, volume: CarvingVolume) -> None:
    half = np.zeros((40, 40))
    half[:, :20] = 1
    rng = np.random.default_rng(2)
    present = rng.uniform(-3, 3, volume.shape).astype(np.float32)
    field = carved(view, volume, (FAR + 12, half), field=present, resolution=0.5)
    silent = slice(8 + 3, None)  # the blur ends after four halves of a voxel
    np.testing.assert_array_equal(field[silent], present[silent])
    assert (field[:6, ..., :11] <= 0).mean() > 0.99


@pytest.mark.parametrize("stride", [1, 2, 3])
def test_fused_distances_are_the_weighted_mean_of_those_of_every_view(stride: int) -> None:
    views = [plain_view(camera.K, camera.cam_from_world, width=48, height=36, name=f"{n}")
             for n, camera in enumerate(cameras(4, arc=120))]  # fmt: skip
    scene = Scene((*views[:3], cropped(views[3], 30, 20)), Bounds([-1] * 3, [1] * 3))
    rng = np.random.default_rng(stride)
    shape = (4, *scene.packed.images[0, ::stride, ::stride].shape[:2])
    depths = rng.uniform(5, 7, shape).astype(np.float32)
    weights = (rng.uniform(0, 1, shape) * (rng.random(shape) < 0.7)).astype(np.float32)
    # The second half lies outside some images, and behind some cameras.
    voxels = np.vstack([rng.integers(0, 12, (200, 3)), rng.integers(-30, 40, (200, 3))])
    origin, size, truncation = np.array([-1.8, -1.7, -1.9]), 0.3, 0.8
    distance, support = np.zeros(len(voxels)), np.zeros(len(voxels))
    lattice, sums = Lattice(tuple(origin.tolist()), size, (12, 12, 12)), Votes(distance, support)
    for part in ([0], [1, 2, 3]):
        maps = DepthMaps(depths[part], weights[part], stride)
        add_depths(voxels, lattice, scene.cameras.part(part), maps, truncation, sums)
    np.divide(distance, support, out=distance, where=support > 0)
    expected = fused_depths_twin(scene, origin + (voxels + 0.5) * size, depths, weights, stride, truncation)
    np.testing.assert_allclose(distance, expected[0], atol=1e-6)
    np.testing.assert_allclose(support, expected[1], atol=1e-6)
    assert 120 < np.count_nonzero(support) < 300
    assert np.abs(distance).max() <= truncation + 1e-9


def test_one_stray_ray_bores_no_hole_and_many_do(view: View, volume: CarvingVolume) -> None:
    columns, rows = np.meshgrid(np.arange(40), np.arange(40))

    def hole(radius: float) -> NDArray[np.float32]:
        depths = np.where(np.hypot(columns - 19.5, rows - 19.5) <= radius, FAR + 12, FAR + 2)
        return carved(view, volume, (depths, 1), resolution=1.0)[8, 8]

    assert (hole(0.8)[3:] > 0).all()
    assert (hole(8.0)[:11] < 0).all()


def test_votes_carve_and_never_add(view: View, volume: CarvingVolume) -> None:
    half = np.full(volume.shape, 20, np.float32)
    half[:8] = -1
    again = carved(view, volume, (FAR + 6, 1), field=half)
    assert (again <= half).all()
    assert (again[8:, ..., 7:] > 0).all()
    np.testing.assert_array_equal(carved(view, volume, (0, 0)) > 0, True)  # nobody votes


def test_a_cavity_without_an_opening_is_filled(view: View, volume: CarvingVolume) -> None:
    # One view sees a wall at 2; another, weaker, sees past it to 9, which leaves a slab of 3 to 6 before a cavity.
    columns, rows = np.meshgrid(np.arange(40), np.arange(40))
    middle = np.hypot(columns - 19.5, rows - 19.5) <= 8
    wall = (FAR + 2, 1)
    assert (carved(view, volume, wall, (FAR + 9, np.where(middle, 0.3, 0)))[..., 4:] > 0).all()
    tunnel = middle | (np.abs(rows - 19.5) < 8)  # the cavity of these rays is open at both ends
    cavity = carved(view, volume, wall, (FAR + 9, np.where(tunnel, 0.3, 0)))[:, 8]
    assert (cavity[:, 4] > 0).all()
    assert (cavity[:, 7] < 0).all()


def test_the_hull_of_a_field_is_what_is_positive_coloured_where_it_is_seen(view: View, volume: CarvingVolume) -> None:
    image = np.zeros_like(view.image)
    image[:, :20], image[:, 20:] = [200, 0, 0], [0, 100, 0]
    scene = Scene((replace(view, photograph=image),), Bounds([0, 0, 0], [SIDE] * 3))
    field = np.broadcast_to((np.arange(SIDE) - 5.5).astype(np.float64), volume.shape)
    hull = hull_of_field(field, np.full(volume.shape, Label.BACKGROUND), volume)
    assert (hull.labels[..., 6:] == Label.HIDDEN).all()
    assert not hull.volume.n_occupied
    color_visible(hull, ItemBuffer(scene.packed, volume), field > 0)
    assert (hull.labels[..., :6] == Label.BACKGROUND).all()
    assert (hull.labels[2:-2, 2:-2, 6] == Label.CONSISTENT).all()
    assert (hull.labels[2:-2, 2:-2, 7:] == Label.HIDDEN).all()
    assert hull.with_interior.n_occupied == SIDE * SIDE * 10
    np.testing.assert_array_equal(hull.volume.colors[3, 8, 6], [200, 0, 0])
    np.testing.assert_array_equal(hull.volume.colors[12, 8, 6], [0, 100, 0])
    assert hull.distance is not None
    np.testing.assert_array_equal(hull.distance, field)
    assert hull.distance.dtype == np.float32
    nothing = hull_of_field(-np.ones(volume.shape), np.zeros(volume.shape, np.uint8), volume)
    assert nothing.with_interior.n_occupied == 0


@pytest.mark.parametrize("cleared", [True, False])
def test_a_cavity_stays_where_a_camera_is_inside_and_is_filled_where_none_is(
    volume: CarvingVolume, cleared: bool
) -> None:
    K = np.array([[20.0, 0, 19.5], [0, 20.0, 19.5], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, 3] = [-8, -8, -8]  # in the middle, looks along +z
    field = np.full(volume.shape, 20, np.float32)
    if cleared:
        field[7:9, 7:9, 7:9] = -1
    after = carved(plain_view(K, pose, width=40, height=40), volume, (5.0, 1.0), (5.0, 1.0), field=field)
    assert (after[7:9, 7:9, 10] < 0).all() == cleared
    assert (after[7:9, 7:9, 14] > 0).all()
