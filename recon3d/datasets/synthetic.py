"""Built-in scenes: real geometry, photographed by the program itself, with exact ground truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import manifold3d as m3d
import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from recon3d.errors import ArgumentError
from recon3d.rendering.orbit import look_at
from recon3d.rendering.renderer import Renderer, pixel_rays
from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import Camera
from recon3d.scene.photograph import Photograph
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

Texture = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Albedo (n, 3) in [0, 1] at world points (n, 3)."""

_LIGHTS = ((np.array([0.5, -0.6, 0.62]), 0.45), (np.array([-0.7, 0.5, 0.5]), 0.3))  # direction to, strength
_AMBIENT = 0.35
_NOTES = {"format": "built in", "source": "little-temple"}


@dataclass(frozen=True)
class BuiltInScene:
    """A scene and the exact surface that it shows, in one frame."""

    scene: Scene
    ground_truth: o3d.geometry.TriangleMesh


def little_temple(
    *,
    n_views: int = 16,
    width: int = 640,
    height: int = 480,
    noise: float = 0.0,
    light_change: float = 0.0,
    supersampling: int = 2,
    seed: int = 0,
) -> BuiltInScene:
    """Photograph a little ruined temple, 13 cm tall, from a ring of cameras that look down on it by 20 degrees.

    It has concavities, thin columns and holes to see through, a background of pure black and exact silhouettes; the
    cameras have unequal focal lengths and a little skew. The world is in metres, z up.

    Parameters
    ----------
    n_views, width, height : of the photographs.
    noise : standard deviation of the sensor's noise, grey levels of 0 to 255.
    light_change : standard deviation of each view's exposure, as a fraction.
    supersampling : rays a pixel, in each direction.
    seed : of noise and exposure.
    """
    if n_views < 1 or width < 8 or height < 8 or supersampling < 1:
        raise ArgumentError("expected n_views >= 1, images of 8x8 pixels or more, supersampling >= 1")
    if not 0 <= noise < 256 or not 0 <= light_change < 10:
        raise ArgumentError(f"expected 0 <= noise < 256 and 0 <= light_change < 10, got {noise} and {light_change}")
    ground_truth = temple_mesh()
    center = ground_truth.get_axis_aligned_bounding_box().get_center()
    cameras = ring(center, n_views=n_views, distance=0.6, width=width, height=height, focal=2.35 * width)
    low, high = ground_truth.get_min_bound(), ground_truth.get_max_bound()
    pad = 0.02 * (high - low).max()
    scene = photograph(ground_truth, temple_texture, cameras, supersampling=supersampling)
    scene = Scene(
        scene.views,
        Bounds(low - pad, high + pad),
        "little-temple",
        notes=_NOTES,
    )
    return BuiltInScene(_with_sensor(scene, noise, light_change, seed), ground_truth)


SCENES: dict[str, Callable[..., BuiltInScene]] = {"little-temple": little_temple}


def ring(
    center: NDArray[np.float64],
    *,
    n_views: int,
    distance: float,
    width: int,
    height: int,
    focal: float,
    elevation: float = 20.0,
    arc: float = 360.0,
) -> list[Camera]:
    """Cameras on an arc (degrees) around the vertical axis through a point (3,), at an elevation (degrees) above it."""
    K = np.array([[focal, 0.4, (width - 1) / 2 + 3.3], [0, 1.004 * focal, (height - 1) / 2 - 2.1], [0, 0, 1]])
    rise = np.radians(elevation)
    step = arc / n_views if arc >= 360 else arc / max(n_views - 1, 1)
    cameras = []
    for angle in np.radians(step * np.arange(n_views)):
        away = np.array([np.cos(rise) * np.cos(angle), np.cos(rise) * np.sin(angle), np.sin(rise)])
        pose = look_at(center + distance * away, center, np.array([0.0, 0.0, 1.0]))
        cameras.append(Camera(K, pose, width, height))
    return cameras


def photograph(
    mesh: o3d.geometry.TriangleMesh, texture: Texture, cameras: list[Camera], *, supersampling: int = 2
) -> Scene:
    """Anti-aliased photographs of a textured, matt mesh under fixed lights, on black, with exact silhouettes.

    A silhouette holds every pixel that shows any of the object. The scene's bounds are those of the mesh.
    """
    renderer = Renderer(_faceted(mesh))
    s = supersampling
    views = []
    for n, camera in enumerate(cameras):
        # Sub-pixel k of pixel u lies at u + (k + 0.5) / s - 0.5, pixel centres being integers.
        finer = np.array([[s, 0, (s - 1) / 2], [0, s, (s - 1) / 2], [0, 0, 1]]) @ camera.K
        width, height = s * camera.width, s * camera.height
        rendering = renderer.render(finer, camera.cam_from_world, width, height)
        center, directions = pixel_rays(finer, camera.cam_from_world, width, height)
        points = center + rendering.depth[rendering.hit][:, None] * directions[rendering.hit]
        radiance = np.zeros((height, width, 3))
        radiance[rendering.hit] = texture(points) * _irradiance(rendering.normals[rendering.hit])[:, None]
        size = (camera.width, camera.height)
        image = np.rint(255 * np.clip(cv2.resize(radiance, size, interpolation=cv2.INTER_AREA), 0, 1)).astype(np.uint8)
        coverage = cv2.resize(rendering.hit.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        views.append(View(camera, image, coverage > 0, f"view{n + 1:02d}.png"))
    return Scene(tuple(views), Bounds.of(mesh.get_axis_aligned_bounding_box()), "photographs")


def temple_mesh() -> o3d.geometry.TriangleMesh:
    """Closed, manifold mesh of the little temple, metres, z up, standing on z = 0."""
    mm = 1e-3
    stone = []
    for level in range(3):  # the steps
        stone.append(_box(104 - 8 * level, 76 - 8 * level, 8).translate((0, 0, 8 * level)))
    columns = [(x, y) for x in (-36, -12, 12, 36) for y in (-23, 23)] + [(-36, 0), (36, 0)]
    for x, y in columns:
        stone.append(m3d.Manifold.cylinder(4, 6.5, 6.5, 32).translate((x, y, 23)))
        stone.append(m3d.Manifold.cylinder(58, 5.0, 4.0, 32).translate((x, y, 26)))
        stone.append(m3d.Manifold.cylinder(4, 4.0, 6.5, 32).translate((x, y, 80)))
    cella = _box(46, 24, 62).translate((0, 0, 23))
    door = _box(12, 40, 34).translate((-8, 0, 22))
    window = m3d.Manifold.cylinder(80, 6, 6, 32, True).rotate((90, 0, 0)).translate((13, 0, 62))
    stone.append(cella - door - window)
    stone.append(_box(88, 60, 10).translate((0, 0, 83)))
    gable = m3d.CrossSection([[(-34.0, 0.0), (34.0, 0.0), (0.0, 22.0)]])
    recess = m3d.CrossSection([[(-22.0, 2.5), (22.0, 2.5), (0.0, 16.5)]])
    roof = (
        m3d.Manifold.extrude(gable, 94)
        - m3d.Manifold.extrude(recess, 6)
        - m3d.Manifold.extrude(recess, 6).translate((0, 0, 88))
    )
    stone.append(roof.translate((0, 0, -47)).rotate((90, 0, 90)).translate((0, 0, 92)))
    stone.append(m3d.Manifold.sphere(6, 48).translate((-38, 0, 118)))
    temple = m3d.Manifold.batch_boolean(stone, m3d.OpType.Add)
    # A corner of the roof has fallen.
    temple -= _box(60, 60, 60).rotate((35, 30, 20)).translate((52, 34, 88))
    surface = temple.to_mesh64() if hasattr(temple, "to_mesh64") else temple.to_mesh()
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.asarray(surface.vert_properties, np.float64)[:, :3] * mm),
        o3d.utility.Vector3iVector(np.asarray(surface.tri_verts, np.int32)),
    )


def temple_texture(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Albedo (n, 3) of cream stone in courses of tinted blocks below a terracotta roof; points (n, 3) in metres."""
    cream, terracotta = np.array([0.93, 0.83, 0.66]), np.array([0.80, 0.45, 0.30])
    albedo = np.where(points[:, 2:] > 0.0921, terracotta, cream)
    block = np.floor(points / [0.011, 0.011, 0.007]).astype(np.int64)
    tint = (block @ np.array([73856093, 19349663, 83492791]) % 1009) / 1009.0
    octaves = ((9.0, 0.30), (3.5, 0.25), (1.5, 0.2))  # cell in mm, weight
    grain = np.sum([weight * _value_noise(points * 1000 / cell) for cell, weight in octaves], axis=0)
    brightness = 0.72 + 0.26 * tint + 0.75 * grain
    warmth = np.array([0.06, 0.0, -0.08]) * (tint[:, None] - 0.5)
    return np.asarray(np.clip(albedo * np.clip(brightness, 0.25, 1.1)[:, None] + warmth, 0.03, 1.0))


def _box(x: float, y: float, z: float) -> m3d.Manifold:
    """Box centred on the vertical axis, standing on z = 0."""
    return m3d.Manifold.cube((x, y, z), True).translate((0, 0, z / 2))


_LATTICE = np.random.default_rng(20130526).uniform(-0.5, 0.5, (32, 32, 32))


def _value_noise(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth noise (n,) in [-0.5, 0.5] that varies over about one unit; period 32."""
    return np.asarray(map_coordinates(_LATTICE, points.T, order=1, mode="grid-wrap"))


def _irradiance(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Light (n,) that falls on matt surfaces with world normals (n, 3)."""
    total = np.full(len(normals), _AMBIENT)
    for direction, strength in _LIGHTS:
        total += strength * np.clip(normals @ (direction / np.linalg.norm(direction)), 0, None)
    return total


def _faceted(mesh: o3d.geometry.TriangleMesh) -> o3d.geometry.TriangleMesh:
    """The same surface with unshared vertices, so that edges shade sharply."""
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)].reshape(-1, 3)
    triangles = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    return o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(corners), o3d.utility.Vector3iVector(triangles))


def _with_sensor(scene: Scene, noise: float, light_change: float, seed: int) -> Scene:
    """The scene with each view's exposure changed and noise added."""
    if noise == 0 and light_change == 0:
        return scene
    rng = np.random.default_rng(seed)
    views = []
    for view in scene.views:
        gain = max(1 + light_change * rng.standard_normal(), 0.1)
        signal = gain * view.image + noise * rng.standard_normal(view.image.shape)
        image = np.rint(np.clip(signal, 0, 255)).astype(np.uint8)
        views.append(replace(view, photograph=Photograph(image)))
    return replace(scene, views=tuple(views))
