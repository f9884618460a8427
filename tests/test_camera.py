from __future__ import annotations

import pickle
from dataclasses import replace

import cv2
import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from scenes import rotation

from recon3d.errors import ArgumentError
from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import Camera
from recon3d.scene.scene import Scene
from recon3d.scene.segmentation import with_segmented_silhouettes
from recon3d.scene.silhouettes import with_threshold_silhouettes
from recon3d.scene.view import View

K = np.array([[105.0, 2.5, 47.0], [0, 98.0, 36.5], [0, 0, 1]])
BARREL = (-0.25, 0.05, 0.002, -0.003, 0.01)


def camera(distortion: tuple[float, ...] = ()) -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = rotation(np.array([0.3, -0.2, 0.1]))
    pose[:3, 3] = [0.1, -0.2, 5.0]
    return Camera(K, pose, 96, 72, distortion)


def project(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    pixels = (points @ camera.cam_from_world[:3, :3].T + camera.cam_from_world[:3, 3]) @ camera.K.T
    return pixels[:, :2] / pixels[:, 2:]


def test_cameras_are_values() -> None:
    same = [camera(BARREL), camera(BARREL), pickle.loads(pickle.dumps(camera(BARREL)))]  # noqa: S301
    others = [camera(), replace(camera(BARREL), width=97), replace(camera(BARREL), K=K * [[1.01], [1], [1]])]
    assert len({*same, *others}) == 4
    assert same[0] == same[2] != others[0]
    assert not same[2].K.flags.writeable


def test_coefficients_of_zero_are_no_distortion() -> None:
    assert camera((0.0,) * 5) == camera()


@pytest.mark.parametrize("distortion", [(0.1,), (0.1,) * 6, (0.1, 0, 0, np.nan)])
def test_coefficients_that_opencv_does_not_know_are_refused(distortion: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="expected 4, 5, 8, 12 or 14 finite distortion coefficients"):
        camera(distortion)


def test_a_camera_needs_a_size_and_matrices() -> None:
    with pytest.raises(ValueError, match="expected a size of at least 1x1 pixels, got 0x72"):
        Camera(K, np.eye(4), 0, 72)
    with pytest.raises(ValueError, match=r"expected a 3x3 K and a 3x4 or 4x4 cam_from_world, got shapes \(2, 3\)"):
        Camera(K[:2], np.eye(4), 96, 72)


def test_open3ds_camera_makes_the_round_trip() -> None:
    given = camera().to_open3d()
    assert isinstance(given, o3d.camera.PinholeCameraParameters)
    assert Camera.of(given) == camera() == Camera.of(camera())


def test_the_scaled_camera_sees_each_point_where_the_resized_photograph_shows_it() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (40, 3))
    scaled = camera().scaled(32, 36)
    assert (scaled.width, scaled.height) == (32, 36)
    expected = (project(camera(), points) + 0.5) * [32 / 96, 36 / 72] - 0.5
    np.testing.assert_allclose(project(scaled, points), expected, atol=1e-9)
    assert camera().at(0.5) == camera().scaled(48, 36)
    assert camera().at(1) == camera()
    assert (camera().at(1e-3).width, camera().at(1e-3).height) == (1, 1)


@pytest.mark.parametrize("scale", [0, -1, 1.5, float("nan")])
def test_a_scale_that_is_no_reduction_is_refused(scale: float) -> None:
    with pytest.raises(ValueError, match="expected a scale above 0 and at most 1"):
        camera().at(scale)


def test_the_cropped_camera_sees_each_point_where_the_part_shows_it() -> None:
    points = np.random.default_rng(1).uniform(-1, 1, (40, 3))
    cropped = camera().cropped(20, 10, 50, 40)
    assert (cropped.width, cropped.height) == (50, 40)
    np.testing.assert_allclose(project(cropped, points), project(camera(), points) - [20, 10], atol=1e-9)


def pattern(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth grey levels at pixels (..., 2) of the pinhole camera."""
    u, v = pixels[..., 0], pixels[..., 1]
    return 128 + 60 * np.sin(u / 9) + 50 * np.cos(v / 7 + u / 20)


def photograph_through_a_lens(of: Camera) -> NDArray[np.uint8]:
    """What a camera with distortion and skew records where the pinhole camera would record the pattern."""
    u, v = np.meshgrid(np.arange(of.width), np.arange(of.height))
    seen = np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3) @ np.linalg.inv(of.K).T
    criteria = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    rays = cv2.undistortPoints(seen[:, None, :2].copy(), np.eye(3), np.array(of.distortion), criteria=criteria)[:, 0]
    pinhole = np.column_stack([rays, np.ones(len(rays))]) @ of.K.T
    return np.rint(pattern(pinhole[:, :2])).astype(np.uint8).reshape(of.height, of.width)


@pytest.mark.parametrize("distortion", [BARREL, (0.2, -0.03, 0.001, 0.002)])
def test_an_undistorted_view_shows_what_a_pinhole_camera_with_the_same_matrix_would(
    distortion: tuple[float, ...],
) -> None:
    lens = camera(distortion)
    taken = photograph_through_a_lens(lens)
    view = View(lens, np.dstack([taken] * 3))
    u, v = np.meshgrid(np.arange(96), np.arange(72))
    expected = pattern(np.stack([u, v], -1).astype(float))
    # Where the pincushion's photograph ends, its border goes on.
    inside = lens.undistorted(np.full((72, 96), 255, np.uint8), beyond=0) == 255
    assert inside[lens.shown()].mean() > 0.95
    assert inside.mean() > 0.8
    assert np.abs(view.image[..., 0] - expected)[inside].max() < 2.5  # bilinear, of rounded levels
    assert np.abs(taken - expected)[inside].max() > 25
    np.testing.assert_array_equal(view.K, K)
    assert view.camera.intrinsic.width == 96
    half = view.image_at(0.5)[..., 0]
    np.testing.assert_allclose(half, view.image[..., 0].reshape(36, 2, 48, 2).mean((1, 3)), atol=0.5)


def test_what_an_undistorted_photograph_does_not_show_may_be_object() -> None:
    pincushion = camera((0.3, 0.0, 0.0, 0.0))
    nothing = View(pincushion, np.zeros((72, 96, 3), np.uint8), np.zeros((72, 96), np.bool_)).silhouette
    assert nothing is not None
    shown = pincushion.shown()
    assert not shown.all()
    np.testing.assert_array_equal(nothing, ~shown)
    dark = Scene((View(pincushion, np.zeros((72, 96, 3), np.uint8)),), Bounds([-1, -1, -1], [1, 1, 1]))
    for computed in (with_threshold_silhouettes(dark), with_segmented_silhouettes(dark)):
        np.testing.assert_array_equal(computed.views[0].silhouette, ~shown)
    assert camera().shown().all()


@pytest.mark.parametrize("scale", [1.0, 3e-4, 250.0])
def test_a_projection_matrix_of_any_scale_is_taken_apart(scale: float) -> None:
    taken = camera()
    P = scale * taken.K @ taken.cam_from_world[:3]
    found = Camera.from_projection(P, 48, 36)
    np.testing.assert_allclose(found.K, taken.K, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.cam_from_world, taken.cam_from_world, rtol=0, atol=1e-12)
    np.testing.assert_allclose(Camera.from_projection(-P, 48, 36, seen=np.zeros(3)).K, taken.K, rtol=0, atol=1e-9)
    with pytest.raises(ArgumentError, match=r"Give -P, or a point .* world is left-handed: mirror one of its axes"):
        Camera.from_projection(-P, 48, 36)
    with pytest.raises(ArgumentError, match=r"negative\. The world is left-handed"):
        Camera.from_projection(P @ np.diag([1, 1, -1, 1]), 48, 36, seen=np.zeros(3))


def test_a_singular_projection_matrix_is_refused() -> None:
    with pytest.raises(ArgumentError, match="a singular one"):
        Camera.from_projection(np.eye(3, 4) * [1, 1, 0, 1], 48, 36)
    with pytest.raises(ArgumentError, match="3x4 finite numbers"):
        Camera.from_projection(np.full((3, 4), np.nan), 48, 36)
