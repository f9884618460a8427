"""Pictures of a mesh by ray casting: no display, GL or GPU."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.casting import RayCaster
from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.vertex_colors import facing_views
from recon3d.scene import Scene, View, bounds_corners

_CLEARANCE = 0.1  # pixel footprints before a vertex where its line of sight ends


@dataclass(frozen=True)
class Rendering:
    """What a camera sees of a mesh, pixel by pixel."""

    hit: NDArray[np.bool_]
    """(height, width) pixels that show the mesh."""
    depth: NDArray[np.float64]
    """(height, width) distance along the optical axis, world units; infinite beside the mesh."""
    normals: NDArray[np.float64]
    """(height, width, 3) unit normals in the world, towards the camera; zero beside the mesh."""
    colors: NDArray[np.float64]
    """(height, width, 3) vertex colours in [0, 1], interpolated; zero beside the mesh."""
    shading: NDArray[np.float64]
    """(height, width) cosine between normal and line of sight, in [0, 1]."""

    def picture(self, mode: str = "colored") -> NDArray[np.uint8]:
        """RGB picture (height, width, 3) on white: "colored", "shaded", "normals" or "depth" (near is bright)."""
        if mode == "colored":
            content = self.colors
        elif mode == "shaded":
            content = np.repeat(0.15 + 0.75 * self.shading[..., None], 3, axis=2)
        elif mode == "normals":
            content = 0.5 + 0.5 * self.normals
        elif mode == "depth":
            near, far = (self.depth[self.hit].min(), self.depth[self.hit].max()) if self.hit.any() else (0.0, 1.0)
            with np.errstate(invalid="ignore"):
                nearness = 1 - 0.85 * (self.depth - near) / max(far - near, 1e-12)
            content = np.repeat(nearness[..., None], 3, axis=2)
        else:
            raise ValueError(f"expected mode {', '.join(MODES)}, got {mode!r}")
        content = np.where(self.hit[..., None], content, 1.0)
        return np.rint(255 * np.clip(content, 0, 1)).astype(np.uint8)

    def pictures(self) -> dict[str, NDArray[np.uint8]]:
        """The picture of every mode."""
        return {mode: self.picture(mode) for mode in MODES}


MODES = ("colored", "shaded", "normals", "depth")


class Renderer:
    """Casts rays at one mesh from as many cameras as wanted."""

    def __init__(self, mesh: o3d.geometry.TriangleMesh) -> None:
        if not mesh.has_triangles():
            raise ValueError("the mesh to render has no triangles")
        if not mesh.has_vertex_normals():
            mesh = o3d.geometry.TriangleMesh(mesh)
            mesh.compute_vertex_normals()
        self.mesh = mesh
        self._triangles = np.asarray(mesh.triangles)
        self._normals = np.asarray(mesh.vertex_normals)
        self._colors = np.asarray(mesh.vertex_colors) if mesh.has_vertex_colors() else np.full_like(self._normals, 0.7)
        self._caster = RayCaster(mesh)

    def render(self, K: NDArray[np.float64], cam_from_world: NDArray[np.float64], width: int, height: int) -> Rendering:
        """View of a camera with the full K (skew too), pixel centres at integers."""
        origin, directions = pixel_rays(K, cam_from_world, width, height)
        depth, triangle, uv = self._caster.first_hits(origin, directions)
        hit = np.isfinite(depth)
        corners, uv = self._triangles[triangle[hit]], uv[hit]
        weights = np.column_stack([1 - uv.sum(axis=1), uv])

        def interpolated(values: NDArray[np.float64]) -> NDArray[np.float64]:
            image = np.zeros((height, width, 3))
            image[hit] = np.einsum("nc,ncd->nd", weights, values[corners])
            return image

        normals = interpolated(self._normals)
        normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
        sight = directions / np.linalg.norm(directions, axis=2, keepdims=True)
        cosine = -(normals * sight).sum(axis=2)
        normals *= np.where(cosine < 0, -1.0, 1.0)[..., None]
        return Rendering(hit, depth, normals, np.clip(interpolated(self._colors), 0, 1), np.abs(cosine))

    def render_view(self, view: View) -> Rendering:
        """View from an input camera."""
        return self.render(view.K, view.cam_from_world, view.width, view.height)


def seeing_views(mesh: o3d.geometry.TriangleMesh, scene: Scene, caster: RayCaster | None = None) -> NDArray[np.bool_]:
    """(n_views, n_vertices) whether a view sees a vertex of a mesh: from outside, nothing of the mesh in between.

    Parameters
    ----------
    caster : of the mesh, where there is one already.
    """
    if not mesh.has_vertex_normals():
        mesh = o3d.geometry.TriangleMesh(mesh)
        mesh.compute_vertex_normals()
    caster = caster or RayCaster(mesh)
    vertices, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    # A vertex lies on triangles of its own, so its ray ends a little before it.
    ends = vertices + _CLEARANCE * scene.pixel_footprint * normals
    seen = np.empty((len(scene.views), len(vertices)), np.bool_)
    projections = np.stack([view.projection for view in scene.views])
    sizes = np.array([(view.width, view.height) for view in scene.views])
    facing_views(vertices, normals, projections, scene.centers, sizes, seen)
    for row, view in zip(seen, scene.views, strict=True):
        row[row] = ~caster.hidden(view.center, ends[row])
    return seen


def count_seeing_views(mesh: o3d.geometry.TriangleMesh, scene: Scene) -> NDArray[np.int64]:
    """(n_vertices,) how many views see each vertex of a mesh."""
    return np.asarray(seeing_views(mesh, scene).sum(axis=0))


def keep_vertices(mesh: o3d.geometry.TriangleMesh, kept: NDArray[np.bool_]) -> o3d.geometry.TriangleMesh:
    """The triangles whose vertices (n_vertices,) are all kept."""
    part = o3d.geometry.TriangleMesh(mesh)
    part.remove_triangles_by_mask(~kept[np.asarray(mesh.triangles)].all(axis=1))
    part.remove_unreferenced_vertices()
    return part


def without_unseen(mesh: o3d.geometry.TriangleMesh, scene: Scene) -> o3d.geometry.TriangleMesh:
    """The part of a mesh that some view sees: open where nobody looked, such as underneath.

    Raises
    ------
    EmptyReconstructionError : no view sees any of it.
    """
    seen = count_seeing_views(mesh, scene) > 0
    part = keep_vertices(mesh, seen)
    if not part.has_triangles():
        raise EmptyReconstructionError(f"scene {scene.name}: no view sees any of the surface")
    return part


def pixel_rays(
    K: NDArray[np.float64], cam_from_world: NDArray[np.float64], width: int, height: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Camera centre (3,) and ray directions (height, width, 3) of depth one, in the world, through pixel centres."""
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    world_from_pixel = cam_from_world[:3, :3].T @ np.linalg.inv(K)
    center = -cam_from_world[:3, :3].T @ cam_from_world[:3, 3]
    return center, np.stack([u, v, np.ones_like(u)], axis=-1) @ world_from_pixel.T


def comparison_sheet(scene: Scene, renderer: Renderer, *, views: int = 4, width: int = 320) -> NDArray[np.uint8]:
    """RGB sheet: a row for each of some evenly chosen views: photograph, coloured, shaded, normals, depth."""
    chosen = np.unique(np.linspace(0, len(scene.views) - 1, min(views, len(scene.views))).round().astype(int))
    rows = []
    for n in chosen:
        view = scene.views[n]
        rendering = renderer.render_view(view)
        pictures = [view.image, *rendering.pictures().values()]
        height = max(1, round(view.height * width / view.width))
        rows.append(np.hstack([cv2.resize(p, (width, height), interpolation=cv2.INTER_AREA) for p in pictures]))
    return np.vstack(rows)


def turntable(
    scene: Scene | None, renderer: Renderer, *, frames: int = 8, size: int = 320, mode: str = "colored"
) -> NDArray[np.uint8]:
    """RGB strip of the mesh seen from all around, about the axis that a scene's cameras stand around.

    Without a scene, about the longest side of the mesh's box.
    """
    extent = renderer.mesh.get_max_bound() - renderer.mesh.get_min_bound()
    up = np.eye(3)[int(extent.argmax())] if scene is None else up_direction(scene)
    center = renderer.mesh.get_axis_aligned_bounding_box().get_center()
    radius = float(np.linalg.norm(extent)) / 2
    pictures = [
        renderer.render(*camera, 2 * size, 2 * size).picture(mode)
        for camera in _orbit(center, radius, up, frames, 2 * size)
    ]
    return np.hstack([cv2.resize(p, (size, size), interpolation=cv2.INTER_AREA) for p in pictures])


def portrait(picture: NDArray[np.uint8], view: View, scene: Scene) -> NDArray[np.uint8]:
    """A picture from a view's camera, cut to what the scene's bounds cover and turned by quarters so that up is up."""
    corners, depths = view.project(bounds_corners(scene.bounds))
    if (depths > 0).all():
        size = np.array([view.width, view.height])
        low = np.clip(np.floor(corners.min(axis=0)), 0, size - 1).astype(int)
        high = np.clip(np.ceil(corners.max(axis=0)), low, size - 1).astype(int)
        picture = picture[low[1] : high[1] + 1, low[0] : high[0] + 1]
    center = np.asarray(scene.bounds.get_center())
    ends, _ = view.project(np.stack([center, center + 0.1 * scene.bounds.get_max_extent() * up_direction(scene)]))
    right, down = ends[1] - ends[0]
    if abs(right) > abs(down):
        return np.rot90(picture, 1 if right > 0 else 3)
    return np.rot90(picture, 2 if down > 0 else 0)


def up_direction(scene: Scene) -> NDArray[np.float64]:
    """(3,) unit axis that the cameras stand around, pointing to the side of the object from which they look down.

    The normal of the plane that fits the camera centres best; the third world axis for fewer than three views.
    """
    centers = scene.centers
    if len(centers) < 3:
        return np.array([0.0, 0.0, 1.0])
    middle = centers.mean(axis=0)
    axis = np.asarray(np.linalg.svd(centers - middle)[2][2])
    above = (middle - np.asarray(scene.bounds.get_center())) @ axis
    return axis if above >= 0 else -axis


def _orbit(
    center: NDArray[np.float64], radius: float, up: NDArray[np.float64], frames: int, size: int
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """K and cam_from_world of square cameras around a point, 15 degrees above it."""
    side = np.eye(3)[np.abs(up).argmin()]
    east = np.cross(up, side)
    east /= np.linalg.norm(east)
    north = np.cross(up, east)
    elevation = np.radians(15)
    distance = 4 * radius
    K = np.array([[1.9 * size, 0, (size - 1) / 2], [0, 1.9 * size, (size - 1) / 2], [0, 0, 1]])
    for angle in np.arange(frames) * 2 * np.pi / frames:
        away = np.cos(elevation) * (np.cos(angle) * east + np.sin(angle) * north) + np.sin(elevation) * up
        yield K, look_at(center + distance * away, center, up)


def look_at(eye: NDArray[np.float64], target: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) cam_from_world of an upright camera at a point that looks at another."""
    forward = target - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    cam_from_world = np.eye(4)
    cam_from_world[:3, :3] = R
    cam_from_world[:3, 3] = -R @ eye
    return cam_from_world
