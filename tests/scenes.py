"""Analytic worlds, photographed, and cameras to see them with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import manifold3d as m3d
import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.datasets.synthetic import Camera, photograph, ring
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene
from recon3d.scene.similarity import Similarity
from recon3d.scene.view import View
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice
from recon3d.volume.sparse import SparseVolume

ORIGIN = np.zeros(3)


def lattice_of(scene: Scene, n: float) -> Lattice:
    """Lattice of a scene with so many voxels along the longest side of its bounds."""
    return Lattice.enclosing(scene.bounds, voxel_size=scene.bounds.longest / n)


def rotation(axis_angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) rotation of a rotation vector (Rodrigues' formula)."""
    angle = np.linalg.norm(axis_angle)
    x, y, z = axis_angle / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def ball_mesh(radius: float = 1.0, resolution: int = 24) -> o3d.geometry.TriangleMesh:
    """Ball around the origin; the facets lie inside the sphere by less than radius * (1 - cos(pi / 2 / resolution))."""
    return o3d.geometry.TriangleMesh.create_sphere(radius, resolution)


def box_mesh(x: float, y: float, z: float) -> o3d.geometry.TriangleMesh:
    """Box centred on the origin."""
    return o3d.geometry.TriangleMesh.create_box(x, y, z).translate((-x / 2, -y / 2, -z / 2))


def two_planes_mesh() -> o3d.geometry.TriangleMesh:
    """A small plate above a large one: the upper hides a part of the lower."""
    return box_mesh(2.0, 1.6, 0.3).translate((0, 0, -0.5)) + box_mesh(0.8, 0.7, 0.3).translate((0.1, 0.1, 0.5))


def box_with_cavity(center: tuple[float, float, float], size: tuple[float, float, float]) -> o3d.geometry.TriangleMesh:
    """Box of 1.6 x 1.6 x 1.2 around the origin, less a smaller one: open where that one ends outside."""
    whole = m3d.Manifold.cube((1.6, 1.6, 1.2), True) - m3d.Manifold.cube(size, True).translate(center)
    surface = whole.to_mesh()
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(surface.vert_properties[:, :3], np.float64)),
        o3d.utility.Vector3iVector(np.array(surface.tri_verts, np.int32)),
    )


def depth_inside(points: NDArray[np.float64], mesh: o3d.geometry.TriangleMesh) -> NDArray[np.float64]:
    """Distance (n,) of points (n, 3) to a closed mesh's surface, positive inside."""
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    found = caster.compute_signed_distance(o3d.core.Tensor.from_numpy(points.astype(np.float32)), nsamples=3)
    return -found.numpy().astype(np.float64)


def stripes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Albedo (n, 3) that differs from place to place, smoothly, in every channel."""
    phase = points @ np.array([[2.5, 1.5, -1.0], [-0.5, 2.0, 1.5], [1.0, -1.5, 3.0]]).T
    return 0.7 + 0.15 * np.sin(phase)


def grain(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Albedo (n, 3) with detail of a few pixels' size in the cameras below: the sum of 40 plane waves."""
    rng = np.random.default_rng(7)
    direction = rng.standard_normal((40, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    length, phase = rng.uniform(0.15, 0.6, 40), rng.uniform(0, 2 * np.pi, 40)
    grey = 0.55 + 0.05 * np.sin(points @ (2 * np.pi * direction / length[:, None]).T + phase).sum(axis=1)
    return np.clip(grey[:, None] * [1.0, 0.9, 0.8], 0.05, 1)


def plain(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same grey albedo everywhere."""
    return np.full_like(points, 0.8)


def cameras(n_views: int = 4, *, arc: float = 120.0, width: int = 48, height: int = 36) -> list[Camera]:
    """Cameras on an arc about the origin that see a world of radius 1.5, with skew and unequal focal lengths."""
    return ring(
        ORIGIN, n_views=n_views, distance=6.0, width=width, height=height, focal=2.0 * height, elevation=17.0, arc=arc
    )


def photographs(
    mesh: o3d.geometry.TriangleMesh,
    texture: Callable[[NDArray[np.float64]], NDArray[np.float64]] = stripes,
    taken_by: list[Camera] | None = None,
    *,
    supersampling: int = 1,
) -> Scene:
    """Photographs of a mesh, with bounds a little wider than it."""
    scene = photograph(mesh, texture, taken_by or cameras(), supersampling=supersampling)
    # Odd margins, so that no voxel's corner falls on a pixel's centre by symmetry.
    return replace(scene, bounds=Bounds(mesh.get_min_bound() - 0.1137, mesh.get_max_bound() + 0.1259))


def transformed(scene: Scene, scale: float, shift: NDArray[np.float64]) -> Scene:
    """The scene in another unit and place: world points X become scale * X + shift."""
    return moved(scene, Similarity(scale, np.eye(3), shift))


def moved(scene: Scene, to: Similarity) -> Scene:
    """The scene in another world frame, which is turned by right angles alone, so that the bounds stay a box."""

    def in_place(view: View) -> View:
        pose = to.camera(view.cam_from_world)
        return View.from_matrices(view.K, pose, view.image, silhouette=view.silhouette, name=view.name)

    return replace(
        scene,
        views=tuple(map(in_place, scene.views)),
        bounds=Bounds(to(np.array([scene.bounds.low]))[0], to(np.array([scene.bounds.high]))[0]),
        mm_per_unit=scene.mm_per_unit / to.scale,
    )


def with_noise(scene: Scene, sigma: float, seed: int = 0) -> Scene:
    """The scene with normally distributed noise of a standard deviation in grey levels."""
    rng = np.random.default_rng(seed)

    def noisy(view: View) -> View:
        image = np.clip(view.image + sigma * rng.standard_normal(view.image.shape), 0, 255).astype(np.uint8)
        return replace(view, photograph=image)

    return replace(scene, views=tuple(noisy(view) for view in scene.views))


def cropped(view: View, width: int, height: int) -> View:
    """The upper left part of a view."""
    silhouette = None if view.silhouette is None else view.silhouette[:height, :width].copy()
    return View.from_matrices(
        view.K, view.cam_from_world, view.image[:height, :width].copy(), silhouette=silhouette, name=view.name
    )


def plain_view(
    K: NDArray[np.float64] | None = None,
    cam_from_world: NDArray[np.float64] | None = None,
    *,
    width: int = 40,
    height: int = 30,
    name: str = "view",
) -> View:
    """Grey view from a camera; by default one at (0, 0, -5) that looks along +z."""
    if K is None:
        K = np.array([[50.0, 0, (width - 1) / 2], [0, 50.0, (height - 1) / 2], [0, 0, 1]])
    if cam_from_world is None:
        cam_from_world = np.eye(4)
        cam_from_world[2, 3] = 5.0
    return View.from_matrices(K, cam_from_world, np.full((height, width, 3), 128, np.uint8), name=name)


def full_volume(
    shape: tuple[int, int, int], voxel_size: float = 1.0, origin: tuple[float, ...] = (0, 0, 0)
) -> CarvingVolume:
    """Black volume with every voxel occupied."""
    return CarvingVolume(np.array(origin, float), voxel_size, np.ones(shape, np.bool_), np.zeros((*shape, 3), np.uint8))


def ball_volume(radius: float, n: int = 24, *, half_side: float = 1.25) -> CarvingVolume:
    """Volume around the origin that holds the voxels whose centres lie in a ball, red where x > 0."""
    volume = full_volume((n, n, n), 2 * half_side / n, (-half_side,) * 3)
    centers = volume.centers().reshape(n, n, n, 3)
    colors = np.zeros((n, n, n, 3), np.uint8)
    colors[centers[..., 0] > 0] = (200, 0, 0)
    colors[centers[..., 0] <= 0] = (0, 0, 100)
    return CarvingVolume(volume.origin, volume.voxel_size, np.linalg.norm(centers, axis=-1) <= radius, colors)


def mask_of(volume: SparseVolume, voxels: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(nx, ny, nz) mask of voxels (n, 3)."""
    mask = np.zeros(volume.shape, np.bool_)
    mask[tuple(voxels.T)] = True
    return mask


def edge_counts(mesh: o3d.geometry.TriangleMesh) -> NDArray[np.int64]:
    """How many triangles share each edge; all two: closed and edge-manifold."""
    triangles = np.asarray(mesh.triangles)
    edges = np.sort(np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def signed_volume(mesh: o3d.geometry.TriangleMesh) -> float:
    """Volume by the divergence theorem; positive where the triangles face outwards."""
    a, b, c = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)
