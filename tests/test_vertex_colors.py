"""Colours from the views, against worlds whose colour is known everywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, cameras, photographs, stripes, two_planes_mesh

from recon3d.carving.visual_hull import VisualHull
from recon3d.datasets.synthetic import BuiltInScene, _irradiance, temple_texture
from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.vertex_colors import Samples, Vertices, agreed_colors, facing_views, sample_view, weighted_median
from recon3d.rendering.ray_caster import RayCaster
from recon3d.scene.scene import Scene
from recon3d.surface.extraction import nearest_colors
from recon3d.surface.trust import EDGE_WEIGHT, trusted_pixels
from recon3d.surface.vertex_colors import color
from recon3d.surface.visibility import VertexVisibility
from recon3d.volume.dense import CarvingVolume


def median_slowly(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Where the cumulative weight, each value's own counted half, reaches half of all: by interpolation."""
    order = np.argsort(values, kind="stable")
    middles = np.cumsum(weights[order]) - weights[order] / 2
    return float(np.interp(weights.sum() / 2, middles, values[order]))


def colors_slowly(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    seen: NDArray[np.bool_],
    scene: Scene,
    trust: NDArray[np.float32],
) -> NDArray[np.float64]:
    """Twin of ``agreed_colors``, point by point."""
    colors = np.full((len(points), 3), np.nan)
    for n, point in enumerate(points):
        samples, weights = [], []
        for j, view in enumerate(scene.views):
            (pixel,), (depth,) = view.project(point[None])
            column, row = np.floor(pixel + 0.5).astype(int)
            if not seen[j, n] or trust[j, row, column] == 0:
                continue
            sight = (view.center - point) / np.linalg.norm(view.center - point)
            focal = np.sqrt(view.K[0, 0] * view.K[1, 1])
            weights.append(trust[j, row, column] * (sight @ normals[n]) * (focal / depth) ** 2)
            u, v = np.clip(pixel, 0, [view.width - 1, view.height - 1])
            i, k = min(int(u), view.width - 2), min(int(v), view.height - 2)
            a, b = u - i, v - k
            block = view.image[k : k + 2, i : i + 2].astype(float)
            samples.append(np.einsum("r,c,rcx->x", [1 - b, b], [1 - a, a], block))
        if samples:
            colors[n] = [median_slowly(channel, np.array(weights)) for channel in np.array(samples).T]
    return colors


def exact_colors(points: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the striped world under the photographs' lights, 0 to 255."""
    return 255 * stripes(points) * _irradiance(normals)[:, None]


def ball_scene(n_views: int = 8) -> tuple[o3d.geometry.TriangleMesh, Scene]:
    mesh = ball_mesh(1.0, 60)
    mesh.compute_vertex_normals()
    taken_by = cameras(n_views, arc=360, width=160, height=120)
    return mesh, photographs(mesh, taken_by=taken_by, supersampling=2)


def towards(mesh: o3d.geometry.TriangleMesh, center: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cosine at which a camera looks at each vertex of a ball around the origin, whatever is in between."""
    sight = center - np.asarray(mesh.vertices)
    return np.asarray((np.asarray(mesh.vertices) * sight).sum(axis=1) / np.linalg.norm(sight, axis=1))


def error_at(mesh: o3d.geometry.TriangleMesh, where: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Mean difference of the channels from the exact ones at vertices of a ball, grey levels."""
    points = np.asarray(mesh.vertices)[where]
    exact = exact_colors(points, points / np.linalg.norm(points, axis=1, keepdims=True))
    return np.asarray(np.abs(255 * np.asarray(mesh.vertex_colors)[where] - exact).mean(axis=1))


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_the_weighted_median_is_its_slow_twins(n: int) -> None:
    rng = np.random.default_rng(n)
    for _ in range(50):
        values, weights = rng.integers(0, 9, n).astype(float), rng.uniform(0.01, 1, n) ** 3
        assert weighted_median(values.copy(), weights.copy()) == pytest.approx(median_slowly(values, weights), abs=1e-9)


def test_equal_weights_give_the_plain_median() -> None:
    values = np.array([7.0, 200, 3, 9, 8])
    assert weighted_median(values.copy(), np.ones(5)) == 8
    assert weighted_median(values[:2].copy(), np.ones(2)) == pytest.approx(103.5)


def test_kernels_are_their_slow_twins() -> None:
    mesh, scene = ball_scene(5)
    points, normals = (np.asarray(x)[::9].copy() for x in (mesh.vertices, mesh.vertex_normals))
    views = scene.packed
    facing = np.empty((5, len(points)), np.bool_)
    facing_views(Vertices(points, normals), views.cameras, facing)
    for row, view in zip(facing, scene.views, strict=True):
        towards = ((view.center - points) * normals).sum(axis=1) > 0
        np.testing.assert_array_equal(row, view.sees(points) & towards)
    trust = np.random.default_rng(0).choice([0.0, 0.05, 1.0], views.foreground.shape).astype(np.float32)
    colors = np.full((len(points), 3), np.nan)
    shown, weights = np.zeros((*facing.shape, 3)), np.zeros(facing.shape)
    for n, view in enumerate(scene.views):
        chosen = np.flatnonzero(facing[n])
        samples = Samples(np.zeros((len(chosen), 3)), np.zeros(len(chosen)))
        camera, inside = views.cameras.at(n), trust[n, : view.height, : view.width]
        sample_view(Vertices(points, normals), chosen, camera, view.image, inside, samples)
        shown[n, chosen], weights[n, chosen] = samples
    agreed_colors(shown, weights, colors)
    slow = colors_slowly(points, normals, facing, scene, trust)
    assert 0.1 < np.isnan(slow[:, 0]).mean() < 0.9
    np.testing.assert_allclose(colors, slow, atol=1e-6)


def test_a_balls_colours_are_exact_to_a_grey_level_and_better_than_its_voxels() -> None:
    mesh, scene = ball_scene()
    colored, support = color(mesh, scene), VertexVisibility.of(mesh, scene).n_views
    seen = support > 0
    assert seen.mean() > 0.7
    best = np.max([towards(mesh, view.center) for view in scene.views], axis=0)
    facing = seen & (best > 0.4)  # three of the 40 pixels from middle to rim have a smaller cosine
    assert facing.mean() > 0.5
    # Rounding to 8 bits, facets of 3 degrees, and pixels of 0.04 on stripes of 2 and more.
    error = error_at(colored, facing)
    assert error.mean() < 0.5
    assert error.max() < 4
    hull = VisualHull().carve(scene, CarvingVolume.enclosing(scene.bounds, n_voxels=100_000))
    points = np.asarray(mesh.vertices)
    mesh.vertex_colors = o3d.utility.Vector3dVector(nearest_colors(hull.volume, points))
    assert error_at(mesh, facing).mean() > 4 * error.mean()
    assert error_at(mesh, seen).mean() > 2 * error_at(colored, seen).mean()


def test_the_temples_colours_are_nearer_than_its_voxels(temple: BuiltInScene) -> None:
    mesh = o3d.geometry.TriangleMesh(temple.ground_truth)
    triangles = np.asarray(mesh.triangles)
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.asarray(mesh.vertices)[triangles].reshape(-1, 3)),
        o3d.utility.Vector3iVector(np.arange(triangles.size, dtype=np.int32).reshape(-1, 3)),
    ).subdivide_midpoint(3)
    mesh.compute_vertex_normals()
    points, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    exact = 255 * np.clip(temple_texture(points) * _irradiance(normals)[:, None], 0, 1)
    colored, support = color(mesh, temple.scene), VertexVisibility.of(mesh, temple.scene).n_views
    error = np.abs(255 * np.asarray(colored.vertex_colors) - exact).mean(axis=1)[support > 0]
    hull = VisualHull().carve(temple.scene, CarvingVolume.enclosing(temple.scene.bounds, n_voxels=200_000))
    of_voxels = np.abs(255 * nearest_colors(hull.volume, points) - exact).mean(axis=1)[support > 0]
    # Blocks of 7 to 11 mm with sharp borders, and edges of stone, in pixels of 1.6 mm.
    assert np.median(error) < 7
    assert np.median(error) < 0.6 * np.median(of_voxels)
    assert error.mean() < 0.75 * of_voxels.mean()


def test_highlights_in_a_minority_of_views_leave_no_trace() -> None:
    mesh, scene = ball_scene(12)
    plainly, support = color(mesh, scene), VertexVisibility.of(mesh, scene).n_views
    views = list(scene.views)
    rng = np.random.default_rng(0)
    for n in range(0, len(views), 3):  # neighbours stay free of highlights
        image = views[n].image.copy()
        for u, v in rng.integers([60, 40], [100, 80], (8, 2)):
            image[v - 4 : v + 5, u - 4 : u + 5] = 255
        views[n] = replace(views[n], photograph=image)
    shining = color(mesh, replace(scene, views=tuple(views)))
    seen = support > 2
    struck = np.zeros(len(seen), np.bool_)
    sees = VertexVisibility.of(mesh, scene).seen
    for n, (before, after) in enumerate(zip(scene.views, views, strict=True)):
        column, row = np.rint(before.project(np.asarray(mesh.vertices))[0]).astype(int).T
        row, column = np.clip(row, 0, before.height - 1), np.clip(column, 0, before.width - 1)
        struck |= sees[n] & (before.image[row, column] != after.image[row, column]).any(axis=1)
    struck &= seen
    assert struck.sum() > 300
    # A highlight raises its view by some 100 grey levels, so the mean of three views or more by tens.
    assert error_at(plainly, struck).mean() < 0.5
    assert error_at(shining, struck).mean() < 1
    assert np.quantile(error_at(shining, struck), 0.9) < 1


def test_what_lies_in_front_or_behind_does_not_bleed_over_the_edge() -> None:
    mesh = two_planes_mesh().subdivide_midpoint(5)
    mesh.compute_vertex_normals()

    def red_above_blue(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(points[:, 2:] > 0, [[0.9, 0.0, 0.0]], [[0.0, 0.0, 0.9]])

    scene = photographs(mesh, red_above_blue, cameras(8, arc=360, width=96, height=72), supersampling=3)
    colored, support = color(mesh, scene), VertexVisibility.of(mesh, scene).n_views
    colors, above = np.asarray(colored.vertex_colors), np.asarray(mesh.vertices)[:, 2] > 0
    foreign = np.where(above, colors[:, 2], colors[:, 0])
    assert (support > 0).mean() > 0.3
    assert foreign.max() < 0.02


def test_a_steep_plane_has_no_edges_and_a_step_has() -> None:
    mesh, scene = ball_scene(1)
    view = scene.views[0]
    toward = view.center / np.linalg.norm(view.center)
    side = np.cross(toward, [0, 0, 1.0])
    side /= np.linalg.norm(side)
    slope = side + 2 * toward  # 63 degrees from facing the camera
    up = np.cross(side, toward)
    corners = np.array([a * 30 * slope + b * 30 * up for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    plane = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(corners), o3d.utility.Vector3iVector(np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    )
    unmasked = replace(view, mask=None)
    trust = trusted_pixels(RayCaster(plane), unmasked).trust
    assert (trust == 1).mean() > 0.99
    ball = trusted_pixels(RayCaster(mesh), unmasked).trust
    assert 100 < (ball == np.float32(EDGE_WEIGHT)).sum() < 2000  # the rim of a disc of 80 pixels, 3 or 4 wide
    masked = trusted_pixels(RayCaster(mesh), view).trust
    assert view.silhouette is not None
    assert (masked[~view.silhouette] == 0).all()
    assert 0 < (masked[view.silhouette] == 0).mean() < 0.1


def test_colours_flow_to_where_no_view_looks() -> None:
    mesh = ball_mesh(1.0, 30)
    inner = ball_mesh(0.5, 10).translate((0.1, 0, 0))  # no view sees it, no edge leads to it
    both = mesh + inner
    both.compute_vertex_normals()
    scene = photographs(both, taken_by=cameras(6, arc=360, width=96, height=72))
    scene = replace(scene, views=tuple(replace(view, photograph=np.full_like(view.image, 120)) for view in scene.views))
    colored, support = color(both, scene), VertexVisibility.of(both, scene).n_views
    assert 0 < (support == 0).sum() < len(support)
    assert (support[len(mesh.vertices) :] == 0).all()
    np.testing.assert_allclose(np.asarray(colored.vertex_colors), 120 / 255, atol=1e-9)


def test_flowed_colours_are_those_of_the_nearest_seen() -> None:
    mesh = ball_mesh(1.0, 100)
    mesh.compute_vertex_normals()

    def left_and_right(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(points[:, :1] > 0, [[0.8, 0.0, 0.0]], [[0.0, 0.0, 0.8]])

    scene = photographs(mesh, left_and_right, cameras(6, arc=360, width=96, height=72))  # looking down
    colored, support = color(mesh, scene), VertexVisibility.of(mesh, scene).n_views
    colors, points = np.asarray(colored.vertex_colors), np.asarray(mesh.vertices)
    below = (support == 0) & (points[:, 2] < -0.7)
    right, left = below & (points[:, 0] > 0.3), below & (points[:, 0] < -0.3)
    assert right.sum() > 10
    assert left.sum() > 10
    assert (colors[right, 0] > 3 * colors[right, 2]).all()
    assert (colors[left, 2] > 3 * colors[left, 0]).all()


def test_support_counts_the_views_that_see_a_vertex_and_the_mesh_is_not_changed() -> None:
    mesh, scene = ball_scene(4)
    mesh.vertex_normals = o3d.utility.Vector3dVector()
    support, colored = VertexVisibility.of(mesh, scene).n_views, color(mesh, scene)
    assert not mesh.has_vertex_colors()
    assert not mesh.has_vertex_normals()
    assert colored.has_vertex_normals()
    # On a ball of radius 1 a camera at distance 6 sees the cap of height 1 - 1/6 around its direction.
    points = np.asarray(mesh.vertices)
    cosines = points @ (scene.centers / np.linalg.norm(scene.centers, axis=1, keepdims=True)).T
    clear = (np.abs(cosines - 1 / 6) > 0.05).all(axis=1)
    assert clear.mean() > 0.7
    np.testing.assert_array_equal(support[clear], (cosines > 1 / 6).sum(axis=1)[clear])


def test_a_surface_that_no_view_shows_has_no_colours() -> None:
    mesh, scene = ball_scene(2)
    with pytest.raises(EmptyReconstructionError, match="no view shows any of the surface"):
        color(mesh.translate((0, 0, 50.0)), scene)


def test_without_silhouettes_colours_come_out_nearly_the_same() -> None:
    mesh, scene = ball_scene()
    unmasked = replace(scene, views=tuple(replace(view, mask=None) for view in scene.views))
    one, other, support = color(mesh, scene), color(mesh, unmasked), VertexVisibility.of(mesh, scene).n_views
    difference = np.abs(np.asarray(one.vertex_colors) - np.asarray(other.vertex_colors)).max(axis=1)
    facing = np.max([towards(mesh, view.center) for view in scene.views], axis=0) > 0.4
    assert difference[facing & (support > 0)].max() < 0.01


def test_what_sees_the_mesh_can_be_handed_over_and_must_fit() -> None:
    mesh, scene = ball_scene(4)
    visibility, caster = VertexVisibility.of(mesh, scene), RayCaster(mesh)
    given, found = color(mesh, scene, visibility=visibility, caster=caster), color(mesh, scene)
    np.testing.assert_array_equal(np.asarray(given.vertex_colors), np.asarray(found.vertex_colors))
    nothing = VertexVisibility(np.zeros_like(visibility.seen))
    with pytest.raises(EmptyReconstructionError, match="no view shows any"):
        color(mesh, scene, visibility=nothing)
    with pytest.raises(ValueError, match=r"expected the visibility of 7,082 vertices in 4 views, got 3 in 4"):
        color(mesh, scene, visibility=visibility.of_vertices(np.arange(3)))
