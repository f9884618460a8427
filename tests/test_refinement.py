"""Dense matching in analytic worlds: how near its points come, and what it does when there is little to match."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import manifold3d as m3d
import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from scenes import (
    ball_mesh,
    box_mesh,
    cameras,
    cropped,
    edge_counts,
    grain,
    photographs,
    rotation,
    signed_volume,
    transformed,
)
from scipy.spatial import cKDTree

import recon3d
from recon3d import CarvedVolume, CarvingVolume, Scene, SceneError, View
from recon3d.datasets.synthetic import Camera
from recon3d.errors import EmptyReconstructionError
from recon3d.scene.neighbours import matching_neighbours
from recon3d.stereo.fusion import fuse
from recon3d.stereo.patch_match import DepthMap, Matching, guide_views, match_view, plane_normals
from recon3d.stereo.refinement import refine
from recon3d.surface.extraction import mesh_volume
from recon3d.surface.poisson import MeasuredSpace, Surface, mesh_points
from recon3d.volume.carved import Label

QUICK = (Matching(),)  # one pass, near the hull


def cloud_of(points: o3d.t.geometry.PointCloud) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions and normals."""
    return points.point.positions.numpy(), points.point.normals.numpy()


def visual_hull(scene: Scene, n_voxels: int = 12_000) -> CarvedVolume:
    return recon3d.VisualHull().carve(scene, CarvingVolume.enclosing(scene.bounds, n_voxels=n_voxels))


def hull_around(scene: Scene, distance: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> CarvedVolume:
    """What a carving would leave that knew the signed distance (n,) of points (n, 3) to a surface, positive inside."""
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=12_000)
    field = distance(volume.centers()).reshape(volume.shape).astype(np.float32)
    hull = CarvedVolume.untouched(volume, field)
    hull.labels[field > 0] = Label.HIDDEN
    return hull


def near(n_views: int = 6, arc: float = 90.0) -> list[Camera]:
    """Cameras whose pixels measure 0.033 at the origin."""
    return cameras(n_views, arc=arc, width=120, height=90)


def with_views(scene: Scene, views: Sequence[View]) -> Scene:
    return replace(scene, views=tuple(views))


@pytest.fixture(scope="module")
def ball() -> Scene:
    """Six photographs of a unit ball, 18 degrees apart."""
    return photographs(ball_mesh(1, 48), grain, near(), supersampling=2)


@pytest.fixture(scope="module")
def hull(ball: Scene) -> CarvedVolume:
    return visual_hull(ball)


FLAT = 0.0  # thickness of an object without cavities


def surface_of(hull: CarvedVolume) -> o3d.geometry.TriangleMesh:
    return mesh_volume(hull.with_interior, distance=hull.distance)


@pytest.fixture(scope="module")
def depth_maps(ball: Scene, hull: CarvedVolume) -> list[DepthMap]:
    guided = list(guide_views(ball, surface_of(hull), QUICK[0].stride))
    neighbours = matching_neighbours(ball, 6)
    return [
        match_view(view, [guided[other] for other in others], QUICK[0], footprint=ball.pixel_footprint, thickness=FLAT)
        for view, others in zip(guided, neighbours, strict=True)
    ]


@pytest.fixture(scope="module")
def points(ball: Scene, hull: CarvedVolume) -> o3d.t.geometry.PointCloud:
    return refine(ball, hull, passes=QUICK).points


def assert_on_ball(points: o3d.t.geometry.PointCloud, ball: Scene, *, at_least: int) -> None:
    """So many points, half of them within 0.3 pixel footprints of the ball, nearly all within one."""
    error = np.abs(np.linalg.norm(cloud_of(points)[0], axis=1) - 1) / ball.pixel_footprint
    assert len(error) > at_least
    assert np.median(error) < 0.3
    assert np.percentile(error, 95) < 1


def test_depths_and_normals_of_a_ball_are_found(ball: Scene, depth_maps: list[DepthMap]) -> None:
    view, depth_map = ball.views[2], depth_maps[2]
    rows, columns = np.nonzero(depth_map.costs < 0.1)
    assert len(rows) > 300
    rays = np.column_stack([2 * columns, 2 * rows, np.ones(len(rows))]) @ np.linalg.inv(view.K).T
    rays = rays @ view.cam_from_world[:3, :3]  # of depth one
    # |C + z ray| = 1
    along, length = rays @ view.center, (rays**2).sum(axis=1)
    inside = np.maximum(along**2 - length * (view.center @ view.center - 1), 0)
    depth = (-along - np.sqrt(inside)) / length
    hit = view.center + depth[:, None] * rays
    facing = -(hit * rays).sum(axis=1) / np.sqrt(length) > 0.5  # elsewhere a small miss is a large depth
    error = np.abs(1 / depth_map.planes[rows, columns, 0] - depth)[facing] / ball.pixel_footprint
    # A window reaches 5 pixels from its middle, where the ball, 30 pixels in radius, has left its plane by 0.4.
    assert np.median(error) < 0.4
    assert np.percentile(error, 90) < 1
    found = plane_normals(view, depth_map.planes, 2)[rows, columns]
    angle = np.degrees(np.arccos(np.clip((found * hit).sum(axis=1)[facing], -1, 1)))
    assert np.median(angle) < 10
    assert np.percentile(angle, 90) < 20


def test_points_of_a_ball_lie_on_it(ball: Scene, points: o3d.t.geometry.PointCloud) -> None:
    assert_on_ball(points, ball, at_least=3500)
    positions, normals = cloud_of(points)
    angle = np.degrees(np.arccos(np.clip((positions * normals).sum(axis=1) / np.linalg.norm(positions, axis=1), -1, 1)))
    assert np.median(angle) < 6
    assert np.percentile(angle, 95) < 20
    confidence = points.point.confidence.numpy()
    assert confidence.shape == (len(positions), 1)
    assert ((confidence > 0) & (confidence < 1)).all()
    colors = points.point.colors.numpy()
    assert ((colors >= 0) & (colors <= 1)).all()


def test_a_tilted_plane_is_flat() -> None:
    plate = box_mesh(0.3, 1.8, 1.6)
    plate.rotate(plate.get_rotation_matrix_from_axis_angle((0, 0, np.radians(45))), (0, 0, 0))  # towards the middle
    normal = np.array([1, 1, 0]) / np.sqrt(2)
    scene = photographs(plate, grain, near(4, 60), supersampling=2)
    thicker = hull_around(scene, lambda places: 0.25 - np.abs(places @ normal))  # by three pixels
    positions, normals = cloud_of(refine(scene, thicker, passes=QUICK).points)
    front = (positions @ normal > 0.05) & (np.abs(positions[:, 2]) < 0.7)
    front &= np.abs(positions @ [-normal[1], normal[0], 0]) < 0.8
    error = np.abs(positions[front] @ normal - 0.15) / scene.pixel_footprint
    angle = np.degrees(np.arccos(np.clip(normals[front] @ normal, -1, 1)))
    assert front.sum() > 1500
    assert np.median(error) < 0.2
    assert np.percentile(error, 95) < 0.6
    assert np.median(angle) < 7
    assert np.percentile(angle, 90) < 15


def test_what_one_view_alone_claims_is_dropped(ball: Scene, depth_maps: list[DepthMap]) -> None:
    rng = np.random.default_rng(1)
    spoiled = []
    for depth_map in depth_maps:
        planes, costs = depth_map.planes.copy(), depth_map.costs.copy()
        wrong = (planes[..., 0] > 0) & (rng.random(costs.shape) < 0.1)
        planes[wrong, 0] *= rng.choice([0.85, 1.15], wrong.sum())  # most of a ball's radius before or behind it
        costs[wrong] = 0.05
        spoiled.append(DepthMap(planes, costs))
    clean, fused = (fuse(ball, maps, QUICK[0]) for maps in (depth_maps, spoiled))
    error = np.abs(np.linalg.norm(fused.points, axis=1) - 1) / ball.pixel_footprint
    assert (error > 3).mean() < 0.01  # of 0.1: two that are wrong alike are still believed
    assert_on_ball(fused.cloud(), ball, at_least=int(0.88 * len(clean.points)))
    kept = [np.count_nonzero(each.read().weights) for each in fused.depths]
    assert min(kept) > 0
    assert sum(kept) == len(fused.points)


def test_a_surface_that_other_views_see_through_is_dropped(ball: Scene, depth_maps: list[DepthMap]) -> None:
    # Two views agree on a patch that floats before the ball; the four others see the ball behind it.
    patch = np.array([1.3, 1.3, 0]) / np.sqrt(2)
    spoiled = list(depth_maps)
    for n in (2, 3):
        view, planes, costs = ball.views[n], depth_maps[n].planes.copy(), depth_maps[n].costs.copy()
        pixel, depth = view.project(patch[None])
        column, row = np.rint(pixel[0] / 2).astype(int)
        around = slice(row - 3, row + 4), slice(column - 3, column + 4)
        planes[around], costs[around] = [1 / depth[0], 0, 0], 0.05
        spoiled[n] = DepthMap(planes, costs)

    def n_floating(used: Sequence[int]) -> int:
        fused = fuse(with_views(ball, [ball.views[n] for n in used]), [spoiled[n] for n in used], QUICK[0])
        return int((np.linalg.norm(fused.points - patch, axis=1) < 0.25).sum())

    believed = n_floating([2, 3])
    assert believed > 20
    assert n_floating(range(6)) < 0.05 * believed  # where two others found nothing behind it, nobody objects


def test_as_many_depth_maps_as_views_are_wanted(ball: Scene, depth_maps: list[DepthMap]) -> None:
    with pytest.raises(ValueError, match="expected a depth map of each of 6 views, got 5"):
        fuse(ball, depth_maps[1:], QUICK[0])


def test_two_views_are_enough_and_one_is_not(ball: Scene, hull: CarvedVolume) -> None:
    pair = with_views(ball, ball.views[2:4])
    points = refine(pair, hull, passes=QUICK).points
    error = np.abs(np.linalg.norm(cloud_of(points)[0], axis=1) - 1) / ball.pixel_footprint
    assert len(error) > 1000
    assert np.median(error) < 0.5
    assert np.percentile(error, 95) < 1.5
    assert (points.point.confidence.numpy() <= 2 / 3 + 1e-6).all()  # a support of two at most
    alone = with_views(ball, ball.views[:1])
    with pytest.raises(SceneError, match="no two views lie 5 to 60 degrees apart"):
        refine(alone, hull, passes=QUICK)


def test_views_of_different_sizes_match(ball: Scene, hull: CarvedVolume) -> None:
    mixed = with_views(ball, [cropped(view, 120 - 5 * n, 90 - 3 * n) for n, view in enumerate(ball.views)])
    assert_on_ball(refine(mixed, hull, passes=QUICK).points, ball, at_least=3500)


def test_a_view_without_neighbours_and_a_black_one_do_no_harm(ball: Scene, hull: CarvedVolume) -> None:
    behind = photographs(ball_mesh(1, 48), grain, near(2, 225)).views[1]
    lonely = with_views(ball, (*ball.views, replace(behind, name="behind")))
    assert matching_neighbours(lonely)[-1] == []
    *_, view = guide_views(lonely, surface_of(hull), QUICK[0].stride)
    assert (match_view(view, [], QUICK[0], footprint=lonely.pixel_footprint, thickness=FLAT).costs == 2).all()
    dark = replace(ball.views[2], photograph=np.zeros_like(ball.views[2].image))
    black = with_views(ball, [*ball.views[:2], dark, *ball.views[3:]])
    for scene in (lonely, black):
        assert_on_ball(refine(scene, hull, passes=QUICK).points, ball, at_least=3000)


def test_views_that_agree_on_nothing_are_an_error(ball: Scene, hull: CarvedVolume) -> None:
    dark = with_views(ball, [replace(view, photograph=np.zeros_like(view.image)) for view in ball.views])
    with pytest.raises(EmptyReconstructionError, match="no two views agree on any point; 0 pixels found a match"):
        refine(dark, hull, passes=QUICK)


def test_runs_are_the_same_to_the_last_bit(ball: Scene, hull: CarvedVolume, points: o3d.t.geometry.PointCloud) -> None:
    again = refine(ball, hull, passes=QUICK).points
    for name in ("positions", "normals", "colors", "confidence"):
        np.testing.assert_array_equal(again.point[name].numpy(), points.point[name].numpy())


@pytest.mark.parametrize("change", ["unit and place", "order of views"])
def test_neither_the_world_nor_the_order_of_views_matters_much(
    ball: Scene, hull: CarvedVolume, points: o3d.t.geometry.PointCloud, change: str
) -> None:
    scale, shift = (1000.0, np.array([3e5, -5e6, 1e3])) if change == "unit and place" else (1.0, np.zeros(3))
    scene = transformed(ball, scale, shift)
    if change == "order of views":
        scene = with_views(scene, scene.views[::-1])
    moved = CarvedVolume(
        CarvingVolume(
            scale * hull.volume.origin + shift, scale * hull.volume.voxel_size, hull.volume.occupied, hull.volume.colors
        ),
        hull.labels, hull.degree, hull.n_views, scale * hull.distance,
    )  # fmt: skip
    positions = (cloud_of(refine(scene, moved, passes=QUICK).points)[0] - shift) / scale
    expected = cloud_of(points)[0]
    # Rounding may decide between two planes as good, for hardly any point.
    gap = cKDTree(expected).query(positions)[0] / ball.pixel_footprint
    assert len(positions) == pytest.approx(len(expected), rel=0.01)
    assert (gap < 1e-3).mean() > 0.98


def test_a_pit_that_carving_left_filled_is_found() -> None:
    block = m3d.Manifold.cube((1.8, 1.8, 1.8), True)
    pit = m3d.Manifold.cube((1.2, 1.0, 1.0), True).translate((0.9, 0, 0))  # 1.0 wide and 0.6 deep, in the side x = 0.9
    surface = (block - pit).to_mesh64()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(surface.vert_properties[:, :3])),
        o3d.utility.Vector3iVector(np.array(surface.tri_verts, np.int32)),
    )
    towards = rotation(np.radians([0, 0, 30]))
    scene = photographs(mesh.rotate(towards, (0, 0, 0)), grain, near(6, 60), supersampling=2)
    filled = hull_around(scene, lambda places: 0.9 - np.abs(places @ towards).max(axis=1))
    points, carved = refine(scene, filled)
    floor = np.array([(0.3, a, b) for a in np.linspace(-0.3, 0.3, 7) for b in np.linspace(-0.4, 0.1, 7)]) @ towards.T
    distance = cKDTree(cloud_of(points)[0]).query(floor)[0] / scene.pixel_footprint
    assert distance.max() < 1.5  # of points two pixels apart
    middle = np.array([(0.6, a, b) for a in (-0.2, 0.0, 0.2) for b in (-0.2, 0.0, 0.2)]) @ towards.T
    voxels = tuple(np.floor((middle - filled.volume.origin) / filled.volume.voxel_size).astype(int).T)
    assert filled.with_interior.occupied[voxels].all()
    assert not carved.with_interior.occupied[voxels].any()


@pytest.fixture(scope="module")
def ring() -> tuple[Scene, CarvedVolume, o3d.t.geometry.PointCloud]:
    """A ball from all around, its hull and its points: none where every view looks at a grazing angle, nor below."""
    scene = photographs(ball_mesh(1, 48), grain, near(16, 360), supersampling=2)
    hull = visual_hull(scene)
    return scene, hull, refine(scene, hull, passes=QUICK).points


@pytest.mark.parametrize("surface", ["poisson", "graph-cut"])
def test_the_hull_closes_the_mesh_where_there_are_no_points(
    ring: tuple[Scene, CarvedVolume, o3d.t.geometry.PointCloud], surface: Surface
) -> None:
    scene, hull, points = ring
    spacing = 1.5 * scene.pixel_footprint
    mesh = mesh_points(points, hull, surface=surface, spacing=spacing)
    vertices = np.asarray(mesh.vertices)
    measured = MeasuredSpace(points, spacing).holds(vertices)
    assert (edge_counts(mesh) == 2).all()
    assert signed_volume(mesh) == pytest.approx(4 / 3 * np.pi, rel=0.1)
    error = np.abs(np.linalg.norm(vertices, axis=1) - 1) / scene.pixel_footprint
    assert np.median(error[measured]) < 0.3
    assert error[measured].max() < 3  # the reach of a point, two spacings
    # Only the underside is out of sight of two views: its middle, and all of what was not measured.
    assert not measured[vertices[:, 2] < -0.95].any()
    assert measured[vertices[:, 2] > -0.7].all()
    assert 0 < (~measured).mean() < 0.1


def test_the_surface_is_measured_within_two_spacings_of_a_point() -> None:
    cloud = o3d.t.geometry.PointCloud(np.array([[0.0, 0, 0], [5, 0, 0]]))
    places = np.array([[1.99, 0, 0], [2.01, 0, 0], [4, 1, 1], [9, 9, 9]])
    np.testing.assert_array_equal(MeasuredSpace(cloud, 1.0).holds(places), [True, False, True, False])


def test_a_mesh_does_not_depend_on_the_run_nor_on_the_place(
    ring: tuple[Scene, CarvedVolume, o3d.t.geometry.PointCloud],
) -> None:
    _, hull, points = ring
    one, two = (np.asarray(mesh_points(points, hull, spacing=0.1).vertices) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    shift = np.array([3e5, -5e6, 1e3])
    volume = CarvingVolume(hull.volume.origin + shift, hull.volume.voxel_size, hull.volume.occupied, hull.volume.colors)
    there = mesh_points(points.clone().translate(shift), replace(hull, volume=volume), spacing=0.1)
    vertices = np.asarray(there.vertices) - shift
    assert np.abs(np.linalg.norm(vertices[vertices[:, 2] > -0.7], axis=1) - 1).max() < 0.1


def test_what_turns_away_from_the_nearest_point_was_not_measured() -> None:
    plate = box_mesh(1.0, 1.0, 0.02)
    plate.compute_vertex_normals()
    cloud = o3d.t.geometry.PointCloud(np.array([[x, y, 0.01] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]))
    cloud.point.normals = o3d.core.Tensor(np.tile([0.0, 0, 1], (4, 1)))
    space = MeasuredSpace(cloud, 1.0)
    assert space.holds(np.asarray(plate.vertices)).all()
    np.testing.assert_array_equal(space.holds_surface(plate), np.asarray(plate.vertices)[:, 2] > 0)


@pytest.mark.parametrize("wrong", [{"surface": "ball-pivoting"}, {"spacing": 0}, {"spacing": np.nan}])
def test_a_mesh_of_points_wants_a_known_surface_and_a_length(
    hull: CarvedVolume, points: o3d.t.geometry.PointCloud, wrong: dict[str, Any]
) -> None:
    with pytest.raises(ValueError, match=r"expected (surface poisson, graph-cut|a positive spacing), got"):
        mesh_points(points, hull, **wrong)


@pytest.mark.parametrize(
    "wrong",
    [
        {"stride": 0}, {"stride": 1.5}, {"radius": 1, "spacing": 2}, {"neighbours": 33}, {"compared": 0},
        {"contrast": 0}, {"reach": np.nan}, {"reach": np.inf}, {"cavities": -1}, {"max_cost": 1.5},
    ],
)  # fmt: skip
def test_matching_says_what_it_expects(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"^expected "):
        Matching(**wrong)


def test_at_least_one_pass_is_wanted(ball: Scene, hull: CarvedVolume) -> None:
    with pytest.raises(ValueError, match="expected at least one pass of matching"):
        refine(ball, hull, passes=())
