from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from reference import Result, color_voxels
from scenes import (
    ball_mesh,
    box_mesh,
    cameras,
    cropped,
    full_volume,
    photographs,
    plain_view,
    two_planes_mesh,
    with_noise,
)
from scipy.ndimage import binary_dilation

from recon3d.carving.hysteresis import neighbour_offsets
from recon3d.carving.visibility import sweep_direction
from recon3d.carving.voxel_coloring import VoxelColoring, near_to_far
from recon3d.consistency.base import Patches, Verdict
from recon3d.consistency.deviation import StandardDeviation
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis
from recon3d.datasets.synthetic import BuiltInScene, ring
from recon3d.errors import EmptyReconstructionError, FailedTestError, VisibilityError
from recon3d.evaluation.distances import distance_to_mesh
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import without_silhouettes
from recon3d.scene.view import View
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume


@cache
def world(name: str) -> Scene:
    """Small scenes on which engine and reference must agree."""
    if name == "ball":
        return photographs(ball_mesh())
    if name == "noisy ball":
        return with_noise(photographs(ball_mesh()), 12.0)
    if name == "ball without silhouettes":
        return without_silhouettes(with_noise(photographs(ball_mesh()), 6.0, seed=1))
    if name == "two planes":
        return with_noise(photographs(two_planes_mesh(), taken_by=cameras(5, arc=100)), 4.0, seed=2)
    if name == "box, some silhouettes, one view cropped":
        scene = with_noise(photographs(box_mesh(1.5, 1.2, 1.4), taken_by=cameras(5)), 8.0, seed=3)
        views = list(scene.views)
        views[1] = replace(views[1], mask=None)
        views[3] = cropped(views[3], 26, 20)
        return replace(scene, views=tuple(views))
    if name == "grainy planes":
        return with_noise(photographs(two_planes_mesh(), taken_by=cameras(3, arc=60)), 24.0)
    if name == "one view":
        scene = photographs(ball_mesh())
        return replace(scene, views=(with_noise(scene, 20.0).views[0],))
    raise KeyError(name)


WORLDS = (
    "ball",
    "noisy ball",
    "ball without silhouettes",
    "two planes",
    "box, some silhouettes, one view cropped",
    "grainy planes",
    "one view",
)


ONE_PIXEL = np.ones((3, 3), np.bool_)


def signed_distance(mesh: o3d.geometry.TriangleMesh, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) distances of points to a closed mesh, negative inside."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    return scene.compute_signed_distance(points.astype(np.float32)).numpy().astype(np.float64)


def direction_of(scene: Scene, volume: CarvingVolume) -> NDArray[np.float64]:
    found = sweep_direction(scene.centers, volume.bounds.corners)
    assert found is not None
    return found.direction


def assert_agree(hull: CarvedVolume, expected: Result) -> None:
    """Labels, degrees, numbers of views and colours are the same, bit by bit."""
    shape = hull.volume.shape
    labels = np.full(shape, Label.UNSEEN, np.uint8)
    degree = np.full(shape, np.nan, np.float32)
    n_views = np.zeros(shape, np.uint16)
    colors = np.zeros((*shape, 3), np.uint8)
    for voxel, label in expected.labels.items():
        labels[voxel] = label
    for voxel, mu in expected.degree.items():
        degree[voxel] = float(mu)
        n_views[voxel] = expected.n_views[voxel]
        if expected.labels[voxel] == Label.CONSISTENT:
            colors[voxel] = expected.colors[voxel]
    np.testing.assert_array_equal(hull.labels, labels)
    np.testing.assert_array_equal(hull.degree, degree)
    np.testing.assert_array_equal(hull.n_views, n_views)
    np.testing.assert_array_equal(hull.volume.colors, colors)
    np.testing.assert_array_equal(hull.volume.occupied, labels == Label.CONSISTENT)


@pytest.mark.parametrize("layering", ["slabs", "voxels"])
@pytest.mark.parametrize("name", WORLDS)
def test_the_engine_agrees_with_the_voxel_by_voxel_reference(name: str, layering: str) -> None:
    scene = world(name)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=1500)
    hull = VoxelColoring(layering=layering).carve(scene, volume)
    assert_agree(hull, color_voxels(scene, volume, direction_of(scene, volume), layering=layering))
    counts = hull.counts()
    assert counts["consistent"] > 20
    assert counts["hidden"] > 20


@pytest.mark.parametrize("layering", ["slabs", "voxels"])
@pytest.mark.parametrize("connectivity", [6, 18])
def test_every_connectivity_agrees_with_the_reference(connectivity: int, layering: str) -> None:
    scene = world("grainy planes")
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=1500)
    hull = VoxelColoring(connectivity=connectivity, layering=layering).carve(scene, volume)
    expected = color_voxels(scene, volume, direction_of(scene, volume), connectivity=connectivity, layering=layering)
    assert_agree(hull, expected)


def test_connectivity_matters_on_the_scene_that_it_is_tested_on() -> None:
    scene = world("grainy planes")
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=1500)
    accepted = {VoxelColoring(connectivity=c).carve(scene, volume).volume.n_occupied for c in (6, 18, 26)}
    assert len(accepted) == 3


@pytest.mark.parametrize("name", ["noisy ball", "box, some silhouettes, one view cropped"])
def test_intensity_by_channels_agrees_with_the_reference(name: str) -> None:
    scene = world(name)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=1500)
    hull = VoxelColoring(FuzzyAdaptiveHysteresis(intensity="channels")).carve(scene, volume)
    assert_agree(hull, color_voxels(scene, volume, direction_of(scene, volume), intensity="channels"))


def test_voxels_smaller_than_a_pixel_agree_with_the_reference() -> None:
    scene = world("noisy ball")
    # A pixel covers 6 / 72 = 0.083 world units at the origin, so most boxes hold one pixel's centre or none.
    bounds = Bounds([0.31, -0.42, 0.1], [1.03, 0.33, 0.61])
    volume = CarvingVolume.enclosing(bounds, voxel_size=0.059)
    scene = replace(scene, bounds=bounds)
    assert_agree(VoxelColoring().carve(scene, volume), color_voxels(scene, volume, direction_of(scene, volume)))


def test_only_the_occupied_voxels_of_the_volume_are_visited() -> None:
    scene = world("noisy ball")
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=1000)
    kept = np.random.default_rng(0).random(volume.shape) < 0.6
    volume = volume.with_occupancy(kept)
    hull = VoxelColoring().carve(scene, volume)
    assert_agree(hull, color_voxels(scene, volume, direction_of(scene, volume)))
    assert (hull.labels[~kept] == Label.UNSEEN).all()


def test_the_volume_that_was_given_is_not_changed() -> None:
    scene = world("ball")
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=1000)
    VoxelColoring().carve(scene, volume)
    assert volume.occupied.all()
    assert not volume.colors.any()


@pytest.mark.parametrize("layering", ["slabs", "voxels"])
def test_the_order_of_the_views_does_not_matter(layering: str) -> None:
    scene = world("two planes")
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=4000)
    hull = VoxelColoring(layering=layering).carve(scene, volume)
    shuffled = replace(scene, views=tuple(scene.views[n] for n in (3, 0, 4, 2, 1)))
    other = VoxelColoring(layering=layering).carve(shuffled, volume)
    np.testing.assert_array_equal(hull.labels, other.labels)
    np.testing.assert_array_equal(hull.volume.colors, other.volume.colors)


def test_the_order_of_the_views_does_not_matter_when_the_sweep_runs_along_an_axis() -> None:
    # A full ring above a box symmetric about it: the direction is (0, 0, -1) but for rounding.
    mesh = two_planes_mesh()
    eyes = ring(np.zeros(3), n_views=8, distance=6.0, width=48, height=36, focal=72.0, elevation=50.0)
    scene = with_noise(photographs(mesh, taken_by=eyes), 4.0, seed=5)
    scene = replace(scene, bounds=Bounds([-1.2, -1.2, -0.8], [1.2, 1.2, 0.8]))
    volume = CarvingVolume.enclosing(scene.bounds, voxel_size=0.1)
    hull = VoxelColoring().carve(scene, volume)
    rng = np.random.default_rng(0)
    for _ in range(4):
        shuffled = replace(scene, views=tuple(scene.views[n] for n in rng.permutation(8)))
        np.testing.assert_array_equal(VoxelColoring().carve(shuffled, volume).labels, hull.labels)


def test_layers_along_an_axis_are_the_lattice_planes_in_spite_of_rounding() -> None:
    occupied = np.ones((7, 7, 40), np.bool_)
    rng = np.random.default_rng(0)
    for _ in range(5):
        direction = np.array([0.0, 0.0, -1.0]) + 1e-15 * rng.standard_normal(3)
        direction /= np.linalg.norm(direction)
        layers = list(near_to_far(occupied, direction))
        assert [sorted(set(layer[:, 2].tolist())) for layer in layers] == [[k] for k in range(39, -1, -1)]


@pytest.mark.parametrize("direction", [(0.3, -0.8, 0.52), (0.0, 0.0, -1.0), (-0.57735, 0.57735, 0.57735)])
def test_layers_run_from_near_to_far_and_hold_every_voxel_once(direction: tuple[float, float, float]) -> None:
    occupied = np.random.default_rng(0).random((6, 7, 8)) < 0.7
    d = np.array(direction) / np.linalg.norm(direction)
    layers = list(near_to_far(occupied, d))
    np.testing.assert_array_equal(np.unique(np.vstack(layers), axis=0), np.argwhere(occupied))
    assert sum(map(len, layers)) == occupied.sum()
    depths = [layer @ d for layer in layers]
    # One voxel thick, but for rounding.
    assert max(np.ptp(depth) for depth in depths) <= 1 + 1e-6
    assert all(a.max() <= b.min() + 1e-6 for a, b in pairwise(depths))


def test_layers_voxel_by_voxel_hold_one_voxel_each_in_order_of_depth() -> None:
    occupied = np.ones((3, 4, 5), np.bool_)
    d = np.array([0.3, -0.8, 0.52])
    layers = list(near_to_far(occupied, d, "voxels"))
    assert all(len(layer) == 1 for layer in layers)
    assert len(layers) == 60
    assert (np.diff([float((layer @ d)[0]) for layer in layers]) >= 0).all()


def test_no_occupied_voxels_make_no_layers() -> None:
    assert list(near_to_far(np.zeros((2, 2, 2), np.bool_), np.array([0, 0, 1.0]))) == []


def test_an_unknown_layering_is_refused() -> None:
    scene = world("ball")
    with pytest.raises(ValueError, match="expected layering slabs, voxels, got 'rings'"):
        VoxelColoring(layering="rings").carve(scene, full_volume((2, 2, 2), 0.1))  # type: ignore[arg-type]


@pytest.mark.parametrize("connectivity", [6, 18, 26])
def test_neighbour_offsets_are_all_different_and_symmetric(connectivity: int) -> None:
    offsets = neighbour_offsets(connectivity)  # type: ignore[arg-type]
    steps = {tuple(step) for step in offsets.tolist()}
    assert len(steps) == len(offsets) == connectivity
    assert steps == {tuple(-x for x in step) for step in steps}
    assert (0, 0, 0) not in steps


def test_an_unknown_connectivity_is_refused() -> None:
    with pytest.raises(ValueError, match="expected connectivity 6, 18, 26, got 8"):
        neighbour_offsets(8)  # type: ignore[arg-type]


MESHES = {"ball": ball_mesh(), "box": box_mesh(1.5, 1.2, 1.4), "two planes": two_planes_mesh()}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("n_voxels", [600, 5000])
def test_the_background_never_carves_a_voxel_that_holds_a_part_of_the_object(name: str, n_voxels: int) -> None:
    scene = photographs(MESHES[name], taken_by=cameras(6), supersampling=4)
    # A footprint is made of whole pixels, so what a voxel shows may lie in a pixel next to it: one pixel of margin.
    views = tuple(replace(view, mask=binary_dilation(view.silhouette, ONE_PIXEL)) for view in scene.views)
    scene = replace(scene, views=views, bounds=Bounds([-1.6] * 3, [1.6] * 3))
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=n_voxels)
    hull = VoxelColoring().carve(scene, volume)
    points = np.asarray(MESHES[name].sample_points_uniformly(20000).points)
    touched = np.unique(np.floor((points - volume.origin) / volume.voxel_size).astype(int), axis=0)
    assert len(touched) > 50
    assert (hull.labels[tuple(touched.T)] != Label.BACKGROUND).all()
    assert (hull.labels == Label.BACKGROUND).any()


@pytest.mark.parametrize("name", ["ball", "box"])
def test_exact_silhouettes_never_carve_a_voxel_that_the_object_fills(name: str) -> None:
    scene = photographs(MESHES[name], taken_by=cameras(6))
    # Voxels of 0.18 units cover two pixels of 0.083, so a full voxel holds a pixel's centre.
    volume = CarvingVolume.enclosing(scene.bounds, voxel_size=0.18)
    hull = VoxelColoring().carve(scene, volume)
    centers = volume.centers()
    inside = signed_distance(MESHES[name], centers) < -volume.voxel_size * np.sqrt(3) / 2
    filled = np.zeros(volume.shape, np.bool_)
    filled[tuple(np.argwhere(volume.occupied)[inside].T)] = True
    assert filled.sum() > 20
    assert (hull.labels[filled] != Label.BACKGROUND).all()


def test_every_accepted_voxel_is_inside_the_visual_hull() -> None:
    scene = world("noisy ball")
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=4000)
    hull = VoxelColoring().carve(scene, volume)
    corners = np.stack(np.meshgrid(*[[0, 1]] * 3), -1).reshape(-1, 3)
    for voxel in np.argwhere(hull.volume.occupied):
        world_corners = volume.origin + volume.voxel_size * (voxel + corners)
        for view in scene.views:
            pixels, _ = view.project(world_corners)
            u0, v0 = np.floor(pixels.min(axis=0)).astype(int)
            u1, v1 = np.ceil(pixels.max(axis=0)).astype(int)
            assert view.silhouette is not None
            assert view.silhouette[max(v0, 0) : v1 + 1, max(u0, 0) : u1 + 1].any()


def test_more_views_leave_fewer_voxels_to_the_background_rule() -> None:
    scene = photographs(ball_mesh(), taken_by=cameras(6))
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=4000)
    outside = np.zeros(volume.shape, np.bool_)
    for n in range(1, 7):
        hull = VoxelColoring().carve(replace(scene, views=scene.views[:n]), volume)
        carved = hull.labels == Label.BACKGROUND
        assert not (outside & ~carved).any()
        outside = carved
    assert outside.sum() > 1000


def test_accepted_voxels_of_a_plain_box_lie_on_its_surface() -> None:
    # One albedo and shading by facet: every true surface voxel is consistent, and the voxels before it show background.
    scene = photographs(box_mesh(1.5, 1.2, 1.4), taken_by=cameras(6))
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=8000)
    hull = VoxelColoring().carve(scene, volume)
    distance = distance_to_mesh(hull.volume.centers(), box_mesh(1.5, 1.2, 1.4))
    # Silhouettes are exact to a pixel (0.083 units here) and a voxel's half diagonal.
    assert np.median(distance) < 0.083 + volume.voxel_size * np.sqrt(3) / 2


def test_labels_degree_and_views_are_consistent_with_each_other(temple: BuiltInScene) -> None:
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=8000)
    hull = VoxelColoring().carve(temple.scene, volume)
    judged = (hull.labels == Label.CONSISTENT) | (hull.labels == Label.INCONSISTENT)
    np.testing.assert_array_equal(np.isfinite(hull.degree), judged)
    np.testing.assert_array_equal(hull.n_views > 0, judged)
    np.testing.assert_array_equal(hull.volume.occupied, hull.labels == Label.CONSISTENT)
    np.testing.assert_array_equal(
        hull.with_interior.occupied, (hull.labels == Label.CONSISTENT) | (hull.labels == Label.HIDDEN)
    )
    assert hull.n_views.max() <= len(temple.scene.views)
    assert not hull.volume.colors[~hull.volume.occupied].any()
    assert sum(hull.counts().values()) == volume.occupied.size
    for name, number in hull.counts().items():
        assert f"{number:,} {name}" in hull.count_text()
        assert hull.summary()[name] == f"{number:,}"
    assert "CarvedVolume" in hull._repr_html_()


def test_progress_counts_the_layers_to_the_last() -> None:
    scene = world("ball")
    calls: list[tuple[int, int]] = []
    VoxelColoring().carve(
        scene, CarvingVolume.enclosing(scene.bounds, n_voxels=500), progress=lambda n, of: calls.append((n, of))
    )
    total = calls[0][1]
    assert calls == [(n, total) for n in range(1, total + 1)]


class AcceptNothing:
    def __call__(self, patches: Patches) -> Verdict:
        return Verdict(np.zeros(patches.n_voxels), np.ones(patches.n_voxels), np.ones(patches.n_voxels))


class AcceptEverything:
    """Records what it was shown."""

    def __init__(self) -> None:
        self.batches: list[Patches] = []

    def __call__(self, patches: Patches) -> Verdict:
        self.batches.append(patches)
        return Verdict(np.ones(patches.n_voxels), np.zeros(patches.n_voxels), np.ones(patches.n_voxels))


def test_a_sweep_that_accepts_nothing_is_an_error_with_the_counts() -> None:
    scene = world("ball")
    with pytest.raises(EmptyReconstructionError, match=r"all voxels were carved .*inconsistent.*0 consistent"):
        VoxelColoring(AcceptNothing()).carve(scene, CarvingVolume.enclosing(scene.bounds, n_voxels=500))


def test_an_empty_volume_is_an_error() -> None:
    scene = world("ball")
    volume = full_volume((3, 3, 3), 0.1)
    with pytest.raises(EmptyReconstructionError, match="all voxels were carved"):
        VoxelColoring().carve(scene, volume.with_occupancy(np.zeros((3, 3, 3), np.bool_)))


def test_a_test_in_plain_numpy_is_handed_well_formed_patches() -> None:
    scene = world("box, some silhouettes, one view cropped")
    test = AcceptEverything()
    hull = VoxelColoring(test).carve(scene, CarvingVolume.enclosing(scene.bounds, n_voxels=1500))
    assert sum(batch.n_voxels for batch in test.batches) == hull.volume.n_occupied > 0
    for batch in test.batches:
        assert batch.view_starts.shape[1] == len(scene.views) + 1
        assert (batch.counts >= 0).all()
        assert (batch.n_views >= 1).all()
        np.testing.assert_array_equal(batch.view_starts[:-1, -1], batch.view_starts[1:, 0])
        if batch.n_voxels:
            assert batch.view_starts[0, 0] == 0
            assert batch.view_starts[-1, -1] == len(batch.colors)


def test_a_test_that_judges_another_number_of_voxels_is_refused() -> None:
    def too_few(_: Patches) -> Verdict:
        return Verdict(np.ones(1), np.ones(1), np.ones(1))

    scene = world("ball")
    with pytest.raises(FailedTestError, match="judged 1 voxels of"):
        VoxelColoring(too_few).carve(scene, CarvingVolume.enclosing(scene.bounds, n_voxels=500))


def test_another_test_gives_another_hull() -> None:
    scene = world("ball")
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=1500)
    strict, loose = (VoxelColoring(StandardDeviation(threshold=t)).carve(scene, volume) for t in (8.0, 60.0))
    assert (strict.labels != loose.labels).any()
    # The degree is kept in single precision.
    assert np.nanmin(strict.degree[strict.volume.occupied]) >= 1 - 8 / 127.5 - 1e-6
    assert np.nanmax(strict.degree[strict.labels == Label.INCONSISTENT]) < 1 - 8 / 127.5 + 1e-6


def test_cameras_all_around_are_refused_by_name() -> None:
    eyes = ring(np.zeros(3), n_views=6, distance=6.0, width=48, height=36, focal=72.0, elevation=0.0)
    scene = photographs(ball_mesh(), taken_by=eyes)
    with pytest.raises(VisibilityError, match=r"ordinal visibility constraint.*leave out view\d\d\.png"):
        VoxelColoring().carve(scene, CarvingVolume.enclosing(scene.bounds, n_voxels=500))


def test_a_volume_that_reaches_past_a_camera_is_refused_even_when_the_bounds_do_not() -> None:
    view = plain_view()
    scene = Scene((view,), Bounds([-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]))
    # The camera stands at (0, 0, -5), inside this volume.
    volume = full_volume((20, 20, 20), 0.7, (-7.0, -7.0, -7.0))
    with pytest.raises(VisibilityError):
        VoxelColoring().carve(scene, volume)


def test_voxels_outside_every_image_stay_unseen() -> None:
    view = plain_view()  # sees 40 / 50 * 5 = 4 units across at the origin
    scene = Scene((view,), Bounds([-4, -0.5, -0.5], [4, 0.5, 0.5]))
    volume = CarvingVolume.enclosing(scene.bounds, voxel_size=0.25)
    hull = VoxelColoring().carve(scene, volume)
    pixels, _ = view.project(volume.centers())
    far_off = (np.abs(pixels[:, 0] - 19.5) > 26).reshape(volume.shape)
    assert far_off.any()
    assert (hull.labels[far_off] == Label.UNSEEN).all()
    assert (hull.labels[len(hull.labels) // 2] != Label.UNSEEN).all()


def test_a_silhouette_does_not_carve_what_lies_partly_outside_the_image() -> None:
    # The first view sees no object at all, yet a voxel across its border may hold one that begins outside.
    empty = np.zeros((30, 40), np.bool_)
    blind = View.from_matrices(
        plain_view().K, plain_view().cam_from_world, plain_view().image, silhouette=empty, name="blind"
    )
    scene = Scene((blind,), Bounds([1.75, -0.25, -0.25], [2.25, 0.25, 0.25]))
    volume = full_volume((1, 1, 1), 0.5, (1.75, -0.25, -0.25))
    pixels, _ = blind.project(scene.bounds.corners)
    assert pixels[:, 0].min() < 39 < 40 < pixels[:, 0].max()
    with pytest.raises(EmptyReconstructionError, match="1 unseen, 0 background"):
        VoxelColoring().carve(scene, volume)
