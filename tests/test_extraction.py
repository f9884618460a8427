from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest
from scenes import ball_volume, edge_counts, full_volume, signed_volume

from recon3d.errors import EmptyReconstructionError
from recon3d.surface.extraction import mesh_volume, nearest_colors, surface_points
from recon3d.volume.dense import CarvingVolume


def with_voxels(volume: CarvingVolume, *where: tuple[int, int, int]) -> CarvingVolume:
    """The volume with these voxels occupied alone."""
    occupied = np.zeros(volume.shape, np.bool_)
    for index in where:
        occupied[index] = True
    return volume.with_occupancy(occupied)


@pytest.mark.parametrize("smoothing", [0, 5])
@pytest.mark.parametrize("density", [0.03, 0.3, 0.5, 0.8, 1.0])
def test_the_mesh_is_closed_and_edge_manifold_whatever_is_occupied(smoothing: int, density: float) -> None:
    volume = full_volume((14, 15, 16))
    volume = volume.with_occupancy(np.random.default_rng(0).random(volume.shape) < density)
    mesh = mesh_volume(volume, smoothing=smoothing)
    assert (edge_counts(mesh) == 2).all()
    assert mesh.is_edge_manifold(allow_boundary_edges=False)
    assert np.isfinite(np.asarray(mesh.vertices)).all()


@pytest.mark.parametrize("smoothing", [0, 5])
def test_a_balls_mesh_keeps_its_radius_and_its_volume(smoothing: int) -> None:
    volume = ball_volume(1.0, 40)
    mesh = mesh_volume(volume, smoothing=smoothing)
    radii = np.linalg.norm(np.asarray(mesh.vertices), axis=1)
    # The surface runs between the centres of neighbouring voxels, inside and outside the ball.
    assert radii.min() > 1 - volume.voxel_size
    assert radii.max() < 1 + volume.voxel_size
    assert radii.mean() == pytest.approx(1.0, abs=0.3 * volume.voxel_size)
    # The voxels' own volume differs from the ball's by rounding of the lattice; corners cut by the surface are 3%.
    occupied = volume.n_occupied * volume.voxel_size**3
    assert signed_volume(mesh) == pytest.approx(occupied, rel=0.03)


def test_smoothing_does_not_shrink() -> None:
    volume = ball_volume(1.0, 40)
    rough, smooth = mesh_volume(volume, smoothing=0), mesh_volume(volume, smoothing=20)
    # Plain Laplacian smoothing of as many steps loses over 5%.
    assert signed_volume(smooth) == pytest.approx(signed_volume(rough), rel=0.01)


def test_smoothing_smooths() -> None:
    volume = ball_volume(1.0, 40)
    rough, smooth = (np.asarray(mesh_volume(volume, smoothing=s).vertices) for s in (0, 5))
    assert np.linalg.norm(smooth, axis=1).std() < 0.8 * np.linalg.norm(rough, axis=1).std()


def test_normals_point_outwards() -> None:
    mesh = mesh_volume(ball_volume(1.0, 40))
    assert signed_volume(mesh) > 0
    normals, points = np.asarray(mesh.vertex_normals), np.asarray(mesh.vertices)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-9)
    cosine = (normals * points).sum(axis=1) / np.linalg.norm(points, axis=1)
    # Facets of a lattice 20 voxels to the radius lean by less than 45 degrees even before smoothing.
    assert cosine.min() > np.cos(np.radians(45))
    assert cosine.mean() > np.cos(np.radians(12))


def test_a_box_of_voxels_becomes_a_mesh_around_it() -> None:
    volume = full_volume((6, 5, 4), 0.5, (1, 2, 3))
    mesh = mesh_volume(volume, smoothing=0)
    # The surface lies within half a voxel of the outermost voxels' faces, in the world's frame.
    np.testing.assert_allclose(mesh.get_min_bound(), [1, 2, 3], atol=0.25)
    np.testing.assert_allclose(mesh.get_max_bound(), [4, 4.5, 5], atol=0.25)
    np.testing.assert_allclose(mesh.get_center(), [2.5, 3.25, 4], atol=1e-6)


@pytest.mark.parametrize("smoothing", [0, 5])
def test_a_sheet_one_voxel_thin_survives(smoothing: int) -> None:
    volume = full_volume((20, 20, 9))
    occupied = np.zeros(volume.shape, np.bool_)
    occupied[:, :, 4] = True
    mesh = mesh_volume(volume.with_occupancy(occupied), smoothing=smoothing)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    middle = np.argwhere(occupied[2:-2, 2:-2]) + np.array([2.5, 2.5, 0.5])
    assert (scene.compute_occupancy(middle.astype(np.float32)).numpy() == 1).all()
    assert (edge_counts(mesh) == 2).all()


def test_a_single_voxel_has_a_surface() -> None:
    mesh = mesh_volume(with_voxels(full_volume((3, 3, 3)), (1, 1, 1)))
    assert (edge_counts(mesh) == 2).all()
    assert signed_volume(mesh) > 0
    np.testing.assert_allclose(mesh.get_center(), [1.5, 1.5, 1.5], atol=1e-6)


def test_separate_voxels_keep_separate_surfaces() -> None:
    mesh = mesh_volume(with_voxels(full_volume((9, 3, 3)), (1, 1, 1), (6, 1, 1)))
    clusters, _, _ = mesh.cluster_connected_triangles()
    assert len(set(np.asarray(clusters).tolist())) == 2


def test_vertices_take_the_colours_of_the_nearest_voxels() -> None:
    volume = ball_volume(1.0, 40)
    mesh = mesh_volume(volume)
    points, colors = np.asarray(mesh.vertices), np.asarray(mesh.vertex_colors)
    assert colors.min() >= 0
    assert colors.max() <= 1
    # Two voxels from the border between red and blue, all eight neighbours have one colour.
    right, left = points[:, 0] > 2.5 * volume.voxel_size, points[:, 0] < -2.5 * volume.voxel_size
    np.testing.assert_allclose(colors[right], np.tile([200 / 255, 0, 0], (right.sum(), 1)), atol=1e-9)
    np.testing.assert_allclose(colors[left], np.tile([0, 0, 100 / 255], (left.sum(), 1)), atol=1e-9)


def test_another_volume_can_lend_its_colours() -> None:
    solid = ball_volume(1.0, 20)
    green = CarvingVolume(
        solid.origin, solid.voxel_size, solid.surface(), np.full_like(solid.colors, np.array([0, 255, 0], np.uint8))
    )
    colors = np.asarray(mesh_volume(solid, colors_from=green).vertex_colors)
    np.testing.assert_allclose(colors, np.tile([0.0, 1.0, 0.0], (len(colors), 1)), atol=1e-9)


def test_nearest_colours_are_weighted_by_inverse_distance() -> None:
    volume = with_voxels(full_volume((2, 1, 1)), (0, 0, 0), (1, 0, 0))
    volume.colors[1] = 255
    at = np.array([[0.5, 0.5, 0.5], [1.0, 0.5, 0.5], [1.5, 0.5, 0.5]])
    # Weights 1 / (d + 0.1): at the first centre 10 against 1 / 1.1.
    share = (1 / 1.1) / (10 + 1 / 1.1)
    np.testing.assert_allclose(nearest_colors(volume, at)[:, 0], [share, 0.5, 1 - share], atol=1e-12)


def test_a_single_voxel_lends_its_colour_everywhere() -> None:
    volume = with_voxels(full_volume((2, 1, 1)), (0, 0, 0))
    volume.colors[0] = (255, 0, 51)
    np.testing.assert_allclose(nearest_colors(volume, np.zeros((3, 3))), np.tile([1, 0, 0.2], (3, 1)), atol=1e-12)


def test_surface_points_are_the_surface_voxels_with_their_colours() -> None:
    volume = ball_volume(1.0, 20)
    cloud = surface_points(volume)
    np.testing.assert_array_equal(np.asarray(cloud.points), volume.centers(volume.surface()))
    np.testing.assert_array_equal(np.rint(255 * np.asarray(cloud.colors)), volume.colors[volume.surface()])


def test_surface_points_have_unit_normals_outwards() -> None:
    cloud = surface_points(ball_volume(1.0, 40))
    points, normals = np.asarray(cloud.points), np.asarray(cloud.normals)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
    cosine = (normals * points).sum(axis=1) / np.linalg.norm(points, axis=1)
    # A blur of one voxel over a lattice of 16 voxels to the radius.
    assert cosine.min() > np.cos(np.radians(30))
    assert cosine.mean() > np.cos(np.radians(10))


def test_a_shell_takes_its_normals_from_the_solid() -> None:
    solid = ball_volume(1.0, 24)
    shell = solid.with_occupancy(solid.surface())
    points = np.asarray(surface_points(shell, solid=solid).points)
    normals = np.asarray(surface_points(shell, solid=solid).normals)
    assert ((normals * points).sum(axis=1) > 0).all()


def test_a_voxel_without_a_slope_has_a_unit_normal_nevertheless() -> None:
    cloud = surface_points(with_voxels(full_volume((3, 3, 3)), (1, 1, 1)))
    np.testing.assert_allclose(np.linalg.norm(np.asarray(cloud.normals), axis=1), 1.0)


@pytest.mark.parametrize("function", [mesh_volume, surface_points])
def test_an_empty_volume_has_no_surface(function) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(EmptyReconstructionError, match="the volume holds no voxels"):
        function(with_voxels(full_volume((3, 3, 3))))
