from __future__ import annotations

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, cameras, photographs, plain_view, rotation

from recon3d.datasets.synthetic import BuiltInScene
from recon3d.rendering.orbit import look_at, up_direction, upright
from recon3d.rendering.renderer import MODES, Renderer, pixel_rays, render
from recon3d.rendering.sheets import comparison_sheet, portrait, turntable
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

K = np.array([[61.0, 4.0, 30.3], [0, 55.0, 22.1], [0, 0, 1]])  # skew, unequal focal lengths, off centre
WIDTH, HEIGHT = 64, 48


def pose() -> NDArray[np.float64]:
    """A turned camera that sees the origin about four units off."""
    cam_from_world = np.eye(4)
    cam_from_world[:3, :3] = rotation(np.array([0.4, -0.7, 0.2]))
    cam_from_world[:3, 3] = [0.1, -0.05, 4.0]
    return cam_from_world


def ball_analytically(radius: float) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
    """Hit, depth and world normals of a ball around the origin, pixel by pixel, from P = K [R | t]."""
    R, t = pose()[:3, :3], pose()[:3, 3]
    center = -R.T @ t
    hit = np.zeros((HEIGHT, WIDTH), np.bool_)
    depth = np.full((HEIGHT, WIDTH), np.inf)
    normals = np.zeros((HEIGHT, WIDTH, 3))
    for v in range(HEIGHT):
        for u in range(WIDTH):
            ray = R.T @ np.linalg.solve(K, [u, v, 1.0])
            a, b, c = ray @ ray, ray @ center, center @ center - radius**2
            if b * b >= a * c:
                hit[v, u] = True
                depth[v, u] = (-b - np.sqrt(b * b - a * c)) / a
                normals[v, u] = (center + depth[v, u] * ray) / radius
    return hit, depth, normals


def test_depth_and_normals_of_a_ball_are_the_analytic_ones() -> None:
    mesh = ball_mesh(1.0, 100)
    rendering = Renderer(mesh).render(K, pose(), WIDTH, HEIGHT)
    hit, depth, normals = ball_analytically(1.0)
    # The facets lie inside by 1 - cos(pi / 200) = 0.00012, so only pixels at the rim may differ.
    assert not (rendering.hit & ~hit).any()
    assert (hit & ~rendering.hit).sum() <= 0.02 * hit.sum()
    assert hit.sum() > 500
    cosine = -(normals * pixel_rays(K, pose(), WIDTH, HEIGHT)[1]).sum(axis=2)
    inner = rendering.hit & (cosine > 0.3)
    assert inner.sum() > 400
    # A sag of 0.00025 at most, seen at an angle of up to acos(0.3 / 1.2).
    np.testing.assert_allclose(rendering.depth[inner], depth[inner], rtol=0, atol=0.002)
    # Interpolated normals of facets of 1.8 degrees.
    np.testing.assert_allclose(rendering.normals[inner], normals[inner], rtol=0, atol=0.01)
    assert np.isinf(rendering.depth[~rendering.hit]).all()
    assert not rendering.normals[~rendering.hit].any()
    assert not rendering.colors[~rendering.hit].any()


def plane(z: float = 0.0) -> o3d.geometry.TriangleMesh:
    """Large square in a plane of constant z, its colour running with x and y."""
    corners = np.array([[-9.0, -9, z], [9, -9, z], [9, 9, z], [-9, 9, z]])
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(corners), o3d.utility.Vector3iVector(np.array([[0, 2, 1], [0, 3, 2]]))
    )
    mesh.vertex_colors = o3d.utility.Vector3dVector(np.column_stack([corners[:, :2] / 18 + 0.5, np.zeros(4)]))
    return mesh


def test_depth_normals_and_colours_of_a_plane_are_the_analytic_ones() -> None:
    cam_from_world = look_at(np.array([0.5, 0.3, -4.0]), np.array([0.0, 0.0, 0.0]), np.array([0.1, 1.0, 0.0]))
    rendering = Renderer(plane()).render(K, cam_from_world, WIDTH, HEIGHT)
    assert rendering.hit.all()
    center, rays = pixel_rays(K, cam_from_world, WIDTH, HEIGHT)
    depth = -center[2] / rays[..., 2]
    # Rays are cast in single precision.
    np.testing.assert_allclose(rendering.depth, depth, rtol=1e-5)
    np.testing.assert_allclose(rendering.normals, np.broadcast_to([0, 0, -1.0], rays.shape), atol=1e-6)
    points = center + depth[..., None] * rays
    np.testing.assert_allclose(rendering.colors[..., :2], points[..., :2] / 18 + 0.5, atol=1e-5)
    expected = -rays[..., 2] / np.linalg.norm(rays, axis=2)
    np.testing.assert_allclose(rendering.shading, np.abs(expected), atol=1e-6)


def test_points_project_to_the_pixels_whose_rays_hit_them() -> None:
    view = plain_view(K, pose(), width=WIDTH, height=HEIGHT)
    center, rays = pixel_rays(view.K, view.cam_from_world, WIDTH, HEIGHT)
    np.testing.assert_allclose(center, view.center, atol=1e-12)
    for u, v in ((0, 0), (63, 0), (0, 47), (17, 31)):
        pixels, depth = view.project(center[None] + 2.5 * rays[v, u])
        np.testing.assert_allclose(pixels, [[u, v]], atol=1e-9)
        assert depth[0] == pytest.approx(2.5, abs=1e-12)  # depth along the axis, not along the ray


def test_pixel_centres_are_half_a_pixel_from_open3ds() -> None:
    shifted = K.copy()
    shifted[:2, 2] += 0.5  # Open3D sends pixel (0, 0)'s ray through (0.5, 0.5)
    theirs = o3d.t.geometry.RaycastingScene.create_rays_pinhole(
        o3d.core.Tensor(shifted), o3d.core.Tensor(pose()), WIDTH, HEIGHT
    ).numpy()
    center, directions = pixel_rays(K, pose(), WIDTH, HEIGHT)
    # Single precision.
    np.testing.assert_allclose(theirs[..., :3], np.broadcast_to(center, directions.shape), atol=1e-5)
    ours = directions / np.linalg.norm(directions, axis=2, keepdims=True)
    np.testing.assert_allclose(
        theirs[..., 3:] / np.linalg.norm(theirs[..., 3:], axis=2, keepdims=True), ours, atol=1e-5
    )


def test_a_mesh_without_colours_is_light_grey_and_is_not_changed() -> None:
    mesh = ball_mesh()
    rendering = Renderer(mesh).render(K, pose(), WIDTH, HEIGHT)
    np.testing.assert_allclose(rendering.colors[rendering.hit], 0.7, atol=1e-9)
    assert not mesh.has_vertex_normals()
    assert not mesh.has_vertex_colors()


def test_normals_face_the_camera_from_inside_too() -> None:
    mesh = ball_mesh(50.0, 20)
    rendering = Renderer(mesh).render(K, pose(), WIDTH, HEIGHT)
    assert rendering.hit.all()
    _, rays = pixel_rays(K, pose(), WIDTH, HEIGHT)
    assert ((rendering.normals * rays).sum(axis=2) < 0).all()


def test_a_mesh_without_triangles_is_refused() -> None:
    with pytest.raises(ValueError, match="the mesh to render has no triangles"):
        Renderer(o3d.geometry.TriangleMesh())


@pytest.mark.parametrize("mode", MODES)
def test_pictures_are_white_beside_the_mesh_and_not_on_it(mode: str) -> None:
    mesh = ball_mesh()
    mesh.paint_uniform_color([0.2, 0.4, 0.6])
    rendering = Renderer(mesh).render(K, pose(), WIDTH, HEIGHT)
    picture = rendering.picture(mode)
    assert picture.shape == (HEIGHT, WIDTH, 3)
    assert picture.dtype == np.uint8
    assert (picture[~rendering.hit] == 255).all()
    on = picture[rendering.hit]
    if mode == "colored":
        assert (on == [51, 102, 153]).all()
    elif mode == "shaded":
        assert on.max() == round(255 * (0.15 + 0.75 * rendering.shading.max()))
        assert (np.ptp(on, axis=1) == 0).all()
    elif mode == "normals":
        np.testing.assert_array_equal(on, np.rint(255 * (0.5 + 0.5 * rendering.normals[rendering.hit])))
    else:
        nearest, farthest = rendering.depth[rendering.hit].argmin(), rendering.depth[rendering.hit].argmax()
        assert on[nearest].tolist() == [255] * 3
        assert on[farthest].tolist() == [38] * 3  # 0.15 of white


@pytest.mark.parametrize("mode", MODES)
def test_a_mesh_out_of_sight_makes_a_white_picture(mode: str) -> None:
    rendering = Renderer(ball_mesh().translate((0, 500.0, 0))).render(K, pose(), WIDTH, HEIGHT)
    assert not rendering.hit.any()
    assert (rendering.picture(mode) == 255).all()


def test_an_unknown_mode_is_refused() -> None:
    rendering = Renderer(ball_mesh()).render(K, pose(), 8, 6)
    with pytest.raises(ValueError, match="expected mode colored, shaded, normals, depth, got 'xray'"):
        rendering.picture("xray")


def test_all_pictures_are_named_by_their_modes() -> None:
    rendering = Renderer(ball_mesh()).render(K, pose(), 8, 6)
    pictures = rendering.pictures()
    assert tuple(pictures) == MODES
    for mode, picture in pictures.items():
        np.testing.assert_array_equal(picture, rendering.picture(mode))


def test_an_input_view_is_rendered_where_its_photograph_shows_the_object(temple: BuiltInScene) -> None:
    renderer = Renderer(temple.ground_truth)
    for view in temple.scene.views[:2]:
        rendering = renderer.render_view(view)
        assert rendering.hit.shape == (view.height, view.width)
        assert view.silhouette is not None
        # A silhouette holds every pixel that shows any of the object, a rendering those whose centre does.
        assert (rendering.hit & ~view.silhouette).sum() <= 0.01 * rendering.hit.sum()
        assert rendering.hit.sum() > 0.8 * view.silhouette.sum()


def test_the_comparison_sheet_has_a_row_for_each_chosen_view(temple: BuiltInScene) -> None:
    renderer = Renderer(temple.ground_truth)
    sheet = comparison_sheet(temple.scene, renderer, views=3, width=80)
    assert sheet.shape == (3 * 60, 5 * 80, 3)
    assert sheet.dtype == np.uint8
    # The first column holds photographs on black, the others pictures on white.
    assert sheet[0, 0].tolist() == [0, 0, 0]
    assert sheet[0, 80].tolist() == [255, 255, 255]
    assert comparison_sheet(temple.scene, renderer, views=99, width=40).shape == (8 * 30, 5 * 40, 3)


def test_the_turntable_shows_the_whole_mesh_in_every_frame(temple: BuiltInScene) -> None:
    strip = turntable(temple.scene, Renderer(temple.ground_truth), frames=5, size=64, mode="shaded")
    assert strip.shape == (64, 5 * 64, 3)
    for frame in np.split(strip, 5, axis=1):
        ink = (frame < 250).any(axis=2)
        assert ink.sum() > 300
        border = np.concatenate([ink[0], ink[-1], ink[:, 0], ink[:, -1]])
        assert not border.any()


def test_the_turntable_shows_the_top_at_the_top() -> None:
    # A ball above a small one, seen by cameras that look down from above.
    mesh = ball_mesh(0.2).translate((0, 0, -0.8)) + ball_mesh(0.7).translate((0, 0, 0.4))
    scene = photographs(mesh, taken_by=cameras(6, arc=360))
    ink = (turntable(scene, Renderer(mesh), frames=1, size=64, mode="shaded") < 250).any(axis=2)
    rows = np.flatnonzero(ink.any(axis=1))
    middle = (rows[0] + rows[-1]) // 2
    assert ink[:middle].sum() > 1.5 * ink[middle:].sum()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_up_is_the_axis_that_the_cameras_stand_around(seed: int) -> None:
    R = rotation(np.random.default_rng(seed).standard_normal(3))
    views = []
    for n, view in enumerate(photographs(ball_mesh(), taken_by=cameras(6, arc=360)).views):
        turned = np.eye(4)
        turned[:3, :3] = view.cam_from_world[:3, :3] @ R.T
        turned[:3, 3] = view.cam_from_world[:3, 3]
        views.append(replace(plain_view(view.K, turned, width=48, height=36), name=str(n)))
    scene = Scene(tuple(views), Bounds([-1, -1, -1], [1, 1, 1]))
    np.testing.assert_allclose(up_direction(scene), R @ [0, 0, 1], atol=1e-9)


@pytest.mark.parametrize("arc", [60.0, 4.0])
def test_up_is_that_of_the_photographs_where_all_are_taken_from_one_side(arc: float) -> None:
    # From 17 degrees above; within four degrees, up and forward cannot be told but by how the cameras were held.
    scene = photographs(ball_mesh(), taken_by=cameras(6, arc=arc))
    R = rotation(np.array([2.0, 0.5, -1.0]))
    turned = np.eye(4)
    turned[:3, :3] = R
    views = tuple(
        View.from_matrices(view.K, view.cam_from_world @ turned.T, view.image, name=view.name) for view in scene.views
    )
    off = np.degrees(np.arccos(up_direction(replace(scene, views=views)) @ R @ [0, 0, 1]))
    assert off < (0.1 if arc > 10 else 18)


def test_up_is_the_third_axis_for_fewer_than_three_views() -> None:
    scene = photographs(ball_mesh(), taken_by=cameras(2))
    assert up_direction(scene).tolist() == [0, 0, 1]


@pytest.mark.parametrize(("mm_per_unit", "scale"), [(10.0, 0.01), (None, 1.0)])
def test_an_upright_frame_has_metres_and_the_worlds_axes_where_these_are_meant(
    mm_per_unit: float | None, scale: float
) -> None:
    scene = replace(photographs(ball_mesh(), taken_by=cameras(6, arc=360)), mm_per_unit=mm_per_unit)
    upwards, x = scale * np.eye(3)[2], scale * np.eye(3)[0]
    assert np.allclose(upright(scene, up="z", unit_mm=1000.0)[:3, :3], scale * np.eye(3), atol=1e-9)
    y_up = upright(scene, up="y", unit_mm=1000.0)
    assert np.linalg.det(y_up[:3, :3]) == pytest.approx(scale**3)
    np.testing.assert_allclose(y_up[:3, :3] @ [0, 0, 1], upwards[[0, 2, 1]], atol=1e-9)
    np.testing.assert_allclose(y_up[:3, :3] @ [1, 0, 0], x, atol=1e-9)
    np.testing.assert_array_equal(y_up[:3, 3], 0)


def test_an_upright_frame_follows_the_cameras_where_the_world_is_turned() -> None:
    scene = photographs(ball_mesh(), taken_by=cameras(6, arc=360))
    for degrees, followed in ((8.0, False), (35.0, True)):
        R = rotation(np.radians([degrees, 0, 0]))
        turned = np.eye(4)
        turned[:3, :3] = R
        views = [
            View.from_matrices(view.K, view.cam_from_world @ turned.T, view.image, name=view.name)
            for view in scene.views
        ]
        frame = upright(replace(scene, views=tuple(views)), up="y", unit_mm=1000.0)[:3, :3]
        np.testing.assert_allclose(frame @ (R @ [0, 0, 1] if followed else [0, 0, 1]), [0, 1, 0], atol=1e-9)
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-9)


def test_looking_at_a_point_puts_it_on_the_axis_and_up_up() -> None:
    eye, target, up = np.array([3.0, -2, 1]), np.array([0.5, 0.2, -0.3]), np.array([0, 0, 1.0])
    cam_from_world = look_at(eye, target, up)
    R, t = cam_from_world[:3, :3], cam_from_world[:3, 3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R @ eye + t, 0, atol=1e-12)
    np.testing.assert_allclose(R @ target + t, [0, 0, np.linalg.norm(target - eye)], atol=1e-12)
    assert (R @ up)[1] < 0  # y points down
    assert (R @ up)[0] == pytest.approx(0, abs=1e-12)
    assert eye.tolist() == [3, -2, 1]


def test_a_world_far_from_its_origin_renders_alike(temple: BuiltInScene) -> None:
    far = np.array([5e5, 5e6, 100.0])
    view = temple.scene.views[0]
    moved_mesh = o3d.geometry.TriangleMesh(temple.ground_truth).translate(far)
    moved_pose = view.cam_from_world.copy()
    moved_pose[:3, 3] -= moved_pose[:3, :3] @ far
    near = Renderer(temple.ground_truth).render_view(view)
    there = Renderer(moved_mesh).render(view.K, moved_pose, view.width, view.height)
    # Doubles keep 1e-9 m there; a ray at an edge may still fall to the other side.
    assert (near.hit == there.hit).mean() > 0.999
    both = near.hit & there.hit
    assert np.quantile(np.abs(near.depth[both] - there.depth[both]), 0.99) < 1e-5


def test_a_portrait_is_cut_to_the_bounds_and_upright_whichever_way_the_camera_was_held(temple: BuiltInScene) -> None:
    scene = temple.scene
    level = scene.views[3]
    K = np.diag(level.K.diagonal())  # without skew, so that a turned camera is one, too
    K[:2, 2] = level.K[:2, 2]
    view = View.from_matrices(K, level.cam_from_world, level.image)
    upright = portrait(view.image, view, scene)
    corners, _ = view.project(scene.bounds.corners)
    np.testing.assert_allclose(upright.shape[1::-1], np.ptp(corners, axis=0) + 1, rtol=0, atol=2)
    u, v = corners.min(axis=0).astype(int)
    np.testing.assert_array_equal(upright, view.image[v : v + upright.shape[0], u : u + upright.shape[1]])
    turn = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    for _ in range(3):
        K = view.K[[1, 0, 2]][:, [1, 0, 2]]  # (u, v) becomes (v, width - 1 - u)
        K[1, 2] = view.width - 1 - K[1, 2]
        view = View.from_matrices(K, turn @ view.cam_from_world, np.rot90(view.image).copy())
        np.testing.assert_array_equal(portrait(view.image, view, scene), upright)


def test_one_call_renders_a_mesh_from_many_views(temple: BuiltInScene) -> None:
    views = temple.scene.views[1:3]
    renderer = Renderer(temple.ground_truth)
    for view, rendering in zip(views, render(temple.ground_truth, views), strict=True):
        np.testing.assert_array_equal(rendering.depth, renderer.render_view(view).depth)
        np.testing.assert_array_equal(rendering.colors, renderer.render_view(view).colors)
