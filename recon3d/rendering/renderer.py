"""Pictures of a mesh by ray casting: no display, GL or GPU."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import ArgumentError
from recon3d.rendering.ray_caster import RayCaster
from recon3d.rendering.texture import Texture
from recon3d.scene.view import View

_BAND = 1 << 20  # rays at a time, of some hundred bytes each


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
            raise ArgumentError(f"expected mode {', '.join(MODES)}, got {mode!r}")
        content = np.where(self.hit[..., None], content, 1.0)
        return np.rint(255 * np.clip(content, 0, 1)).astype(np.uint8)

    def pictures(self) -> dict[str, NDArray[np.uint8]]:
        """The picture of every mode."""
        return {mode: self.picture(mode) for mode in MODES}


MODES = ("colored", "shaded", "normals", "depth")


class Renderer:
    """Casts rays at one mesh from as many cameras as wanted.

    Parameters
    ----------
    caster : of the mesh, where there is one already.
    texture : colours of the mesh, instead of those of its vertices.
    """

    def __init__(
        self, mesh: o3d.geometry.TriangleMesh, caster: RayCaster | None = None, *, texture: Texture | None = None
    ) -> None:
        if not mesh.has_triangles():
            raise ArgumentError("the mesh to render has no triangles")
        if not mesh.has_vertex_normals():
            mesh = o3d.geometry.TriangleMesh(mesh)
            mesh.compute_vertex_normals()
        self.mesh = mesh
        self._triangles = np.asarray(mesh.triangles)
        self._normals = np.asarray(mesh.vertex_normals)
        self._colors = np.asarray(mesh.vertex_colors) if mesh.has_vertex_colors() else np.full_like(self._normals, 0.7)
        self._texture = texture
        self._caster = caster or RayCaster(mesh)

    def render(self, K: NDArray[np.float64], cam_from_world: NDArray[np.float64], width: int, height: int) -> Rendering:
        """View of a camera with the full K (3, 3), skew too, and cam_from_world (4, 4); pixel centres at integers."""
        seen = self.cast(K, cam_from_world, width, height)
        normals, cosine = self.normals(seen)
        return Rendering(seen.hit, seen.depth.astype(np.float64), normals, self.colors(seen), cosine)

    def render_view(self, view: View) -> Rendering:
        """View from an input camera."""
        return self.render(view.K, view.cam_from_world, view.width, view.height)

    def cast(
        self, K: NDArray[np.float64], cam_from_world: NDArray[np.float64], width: int, rows: int | range
    ) -> SeenPixels:
        """Where the rays of the pixels of a camera, K (3, 3) and cam_from_world (4, 4), meet the mesh.

        Parameters
        ----------
        rows : of the image: how many there are, or those that are wanted.
        """
        center, directions = pixel_rays(K, cam_from_world, width, rows)
        return SeenPixels(*self._caster.first_hits(center, directions), directions)

    def normals(self, seen: SeenPixels) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(rows, columns, 3) unit normals towards the camera, zero beside the mesh; their cosine to the line of sight.

        The cosine (rows, columns) is in [0, 1].
        """
        normals = self._interpolated(self._normals, seen)
        normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
        sight = seen.directions / np.linalg.norm(seen.directions, axis=2, keepdims=True)
        cosine = -(normals * sight).sum(axis=2)
        normals *= np.where(cosine < 0, -1.0, 1.0)[..., None]
        return normals, np.abs(cosine)

    def colors(self, seen: SeenPixels) -> NDArray[np.float64]:
        """(rows, columns, 3) colours in [0, 1], of the vertices or the texture; zero beside the mesh."""
        if self._texture is None:
            return np.clip(self._interpolated(self._colors, seen), 0, 1)
        image = np.zeros((*seen.hit.shape, 3))
        image[seen.hit] = self._texture.colors(seen.triangle[seen.hit], seen.corner_weights)
        return image

    def _interpolated(self, values: NDArray[np.float64], seen: SeenPixels) -> NDArray[np.float64]:
        """(rows, columns, 3) of values (n_vertices, 3); zero beside the mesh."""
        hit = seen.hit
        image = np.zeros((*hit.shape, 3))
        image[hit] = np.einsum("nc,ncd->nd", seen.corner_weights, values[self._triangles[seen.triangle[hit]]])
        return image


def render(mesh: o3d.geometry.TriangleMesh, views: Iterable[View]) -> list[Rendering]:
    """A mesh as each of some views' cameras sees it."""
    renderer = Renderer(mesh)
    return [renderer.render_view(view) for view in views]


@dataclass(frozen=True)
class SeenPixels:
    """Where the rays of a camera's pixels first meet a mesh."""

    depth: NDArray[np.float32]
    """(rows, columns) distance along the optical axis, world units; infinite beside the mesh."""
    triangle: NDArray[np.uint32]
    """(rows, columns) of no meaning beside the mesh, as are the weights."""
    uv: NDArray[np.float32]
    """(rows, columns, 2) weights of the triangle's second and third corner."""
    directions: NDArray[np.float64]
    """(rows, columns, 3) of the rays, of depth one, world."""

    @property
    def hit(self) -> NDArray[np.bool_]:
        """(rows, columns) pixels that show the mesh."""
        return np.isfinite(self.depth)

    @property
    def corner_weights(self) -> NDArray[np.float64]:
        """(n, 3) weights of the corners of the triangles that the pixels with a hit show."""
        uv = self.uv[self.hit].astype(np.float64)
        return np.column_stack([1 - uv.sum(axis=1), uv])

    def strided(self, stride: int) -> SeenPixels:
        """Every stride-th row and column, the first included."""
        return SeenPixels(*(array[::stride, ::stride] for array in vars(self).values()))


def pixel_rays(
    K: NDArray[np.float64], cam_from_world: NDArray[np.float64], width: int, rows: int | range
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Camera centre (3,) and ray directions (n_rows, width, 3) of depth one, in the world, through pixel centres.

    Parameters
    ----------
    rows : of the image: how many there are, or those that are wanted.
    """
    wanted = range(rows) if isinstance(rows, int) else rows
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(wanted.start, wanted.stop, dtype=np.float64))
    world_from_pixel = cam_from_world[:3, :3].T @ np.linalg.inv(K)
    center = -cam_from_world[:3, :3].T @ cam_from_world[:3, 3]
    return center, np.stack([u, v, np.ones_like(u)], axis=-1) @ world_from_pixel.T


def bands(height: int, width: int, stride: int = 1) -> list[range]:
    """Rows of an image in parts whose rays take little memory; each begins at a multiple of the stride."""
    n = max(_BAND // width // stride, 1) * stride
    return [range(top, min(top + n, height)) for top in range(0, height, n)]
