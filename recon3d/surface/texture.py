"""Textures: a picture of a mesh's surface, made from the photographs that show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.checks import require_whole
from recon3d.errors import EmptyReconstructionError
from recon3d.io.textured import write_textured
from recon3d.kernels.texels import Best, Charted, Shown, blend, draw_triangles, grow_charts, keep_best
from recon3d.kernels.types import Camera
from recon3d.rendering.orbit import upright
from recon3d.rendering.ray_caster import RayCaster
from recon3d.rendering.texture import Texture
from recon3d.scene.scene import Scene
from recon3d.scene.view import View
from recon3d.scratch import Scratch, Stored
from recon3d.summary import Summarised
from recon3d.surface.atlas import unwrap
from recon3d.surface.decimation import Decimation, decimate
from recon3d.surface.exposure import view_gains
from recon3d.surface.repair import triangle_areas
from recon3d.surface.trust import TrustedPixels, trusted_pixels
from recon3d.surface.vertex_colors import let_flow

LEAST_SIZE, LARGEST_SIZE = 16, 8192
"""Of a texture, texels a side."""

TRIANGLES = 50_000
"""Of a textured mesh, at most, where nothing else is asked for."""

_KEPT = 6  # best views of a texel

_SHARPNESS = 2.0  # power of the weights of the views' detail

_DETAIL = 3.0  # pixels; the standard deviation of the blur that is taken from a photograph to leave its detail

_FEATHER = 16.0  # pixels over which a view's weight falls towards its border, the background and jumps of depth

_CLEARANCE = 2.0  # pixel footprints behind the first surface that still count as it

_GROWN = 2  # texels around a chart that are coloured like its own

_BATCH = 1 << 22  # texels at a time


@dataclass(frozen=True, eq=False, repr=False)
class TexturedMesh(Summarised):
    """A mesh with a picture of its surface."""

    mesh: o3d.geometry.TriangleMesh
    """In the world's frame, with vertex normals."""
    texture: Texture
    texel: float
    """Size of a texel on the surface, world units."""
    pixel: float
    """Size of a photograph's pixel at the object, world units."""
    seen_share: float
    """Share of the texture's surface, in [0, 1], that a view shows; the rest has the colours of what lies around it."""
    gains: dict[str, NDArray[np.float64]]
    """(3,) factors of red, green and blue by which exposure and white balance of each view were evened, by its name."""
    decimation: Decimation | None
    """What fewer triangles cost; None: all were kept."""
    file_from_world: NDArray[np.float64]
    """(4, 4) to the frame of files: y up, metres where the scene's scale is known; see ``upright``."""
    mm_per_unit: float | None
    """Millimetres in a world unit; None: no scale is known."""

    def summary(self) -> dict[str, object]:
        """Table of what was made."""
        rows, columns, _ = self.texture.image.shape
        scale, unit = (1.0, "units (no scale)") if self.mm_per_unit is None else (self.mm_per_unit, "mm")
        largest = max(float(np.abs(gain - 1).max()) for gain in self.gains.values())
        return {
            "texture": f"{columns}x{rows}, {scale * self.texel:.2g} {unit} a texel; a pixel of the photographs shows "
            f"{scale * self.pixel:.2g} {unit}",
            "seen": f"{self.seen_share:.0%} of the surface; the rest has the colours of what lies around it",
            "exposure": f"evened between the views, by at most {largest:.1%}",
            "triangles": f"{len(self.mesh.triangles):,}"
            + (f", {self.decimation.told(self.mm_per_unit)}" if self.decimation else ""),
            "files": f"{'metres' if self.mm_per_unit else 'world units, since no scale is known'}, y up",
        }

    def picture(self) -> NDArray[np.uint8]:
        """(rows, columns, 3) RGB texture, small."""
        return np.asarray(cv2.resize(self.texture.image, (320, 320), interpolation=cv2.INTER_AREA), np.uint8)

    def write(self, path: Path | str) -> list[Path]:
        """Write as GLB, or as OBJ with MTL and PNG, for other programs: y up, metres; returns the files.

        Raises
        ------
        ArgumentError : the file's name ends otherwise.
        """
        mesh = o3d.geometry.TriangleMesh(self.mesh)
        mesh.transform(self.file_from_world)
        return write_textured(path, mesh, self.texture.places, self.texture.image)


def texture_mesh(
    mesh: o3d.geometry.TriangleMesh, scene: Scene, *, size: int = 4096, triangles: int = TRIANGLES
) -> TexturedMesh:
    """A mesh of at most so many triangles, with a texture from the photographs that show it.

    Exposure and white balance of the views are evened first. Each texel is a place on the surface, which the views that
    see it are asked for: those that it faces, and where nothing of the mesh lies before it. As for vertices, a view
    weighs by the pixels that it has for an area of the surface; and the less, the nearer its border, the background or
    a jump of depth, so that views begin and end softly. Of the photographs without their detail the weighted median
    counts, so no highlight and no mistaken view is followed; the detail itself is of the best views, so nothing is
    blurred by views that are a little off. Surface that no view shows has colours from where one does, along the
    surface.

    Parameters
    ----------
    mesh : manifold, closed or open; its normals say which side is looked at.
    size : of the square image, texels.
    triangles : the mesh is decimated to at most so many.

    Raises
    ------
    ArgumentError : size or triangles are out of range.
    EmptyReconstructionError : no view shows any of the surface, or the mesh cannot be laid flat.

    References
    ----------
    Callieri, Cignoni, Corsini, Scopigno, "Masked photo blending: mapping dense photographic data set on
    high-resolution sampled 3D models", Computers & Graphics 2008 (weights).
    Baumberg, "Blending images for texturing 3D models", BMVC 2002 (two bands of frequencies).
    """
    require_whole("size", size, LEAST_SIZE, LARGEST_SIZE)
    fewer, decimation = decimate(mesh, triangles)
    if not fewer.has_vertex_normals():
        fewer = o3d.geometry.TriangleMesh(fewer)
        fewer.compute_vertex_normals()
    places = unwrap(fewer, size)
    texel = _texel_size(fewer, places, size)
    views = scene.shrunk(min(1.0, scene.pixel_footprint / texel))
    caster = RayCaster(fewer)
    scratch = Scratch()
    trusted = [scratch.keep(trusted_pixels(caster, view)) for view in views.views]
    gains = view_gains(fewer, views, caster, trusted)
    charted = Charted(
        np.asarray(fewer.vertices), np.asarray(fewer.vertex_normals), np.asarray(fewer.triangles), places * size - 0.5
    )
    owner = _owners(charted, size)
    colors = np.full((size * size, 3), np.nan, np.float32)
    texels = np.flatnonzero(owner >= 0)
    cameras = views.cameras
    prepared = [
        scratch.keep(_prepared(view, cameras.at(n), gains[n], trusted[n].read())) for n, view in enumerate(views.views)
    ]
    colors[texels] = _baked(charted, texels, owner, prepared)
    seen = np.isfinite(colors[texels, 0])
    if not seen.any():
        raise EmptyReconstructionError(f"scene {scene.name}: no view shows any of the surface, so it has no texture")
    _fill_unseen(charted, texels[~seen], owner, colors)
    image = _padded(colors.reshape(size, size, 3))
    return TexturedMesh(
        fewer,
        Texture(places, image),
        texel,
        scene.pixel_footprint,
        float(seen.mean()),
        {view.name: gain for view, gain in zip(scene.views, gains, strict=True)},
        decimation,
        upright(scene, up="y", unit_mm=1000.0),
        scene.mm_per_unit,
    )


def _texel_size(mesh: o3d.geometry.TriangleMesh, places: NDArray[np.float64], size: int) -> float:
    """Root of the surface's area for a texel, world units."""
    area = triangle_areas(np.asarray(mesh.vertices), np.asarray(mesh.triangles)).sum()
    a, b = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
    flat = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    return float(np.sqrt(area / flat)) / size


def _owners(charted: Charted, size: int) -> NDArray[np.int32]:
    """(size, size) triangle that each texel shows, those around a chart too; -1: none."""
    owner = np.full((size, size), -1, np.int32)
    draw_triangles(charted.places, owner)
    for _ in range(_GROWN):
        grown = owner.copy()
        grow_charts(owner, grown)
        owner = grown
    return owner


@dataclass(frozen=True)
class _Prepared:
    """What a view shows, as ``Shown``."""

    camera: Camera
    image: NDArray[np.uint8]
    coarse: NDArray[np.uint8]
    trust: NDArray[np.float32]
    inverse_depth: NDArray[np.float32]


def _baked(
    charted: Charted, texels: NDArray[np.int64], owner: NDArray[np.int32], prepared: Sequence[Stored[_Prepared]]
) -> NDArray[np.float32]:
    """(n, 3) colours of texels (n,), 0 to 255; NaN where no view sees them."""
    colors = np.full((len(texels), 3), np.nan, np.float32)
    kept = min(_KEPT, len(prepared))
    for first in range(0, len(texels), _BATCH):
        batch = texels[first : first + _BATCH]
        best = Best(
            np.zeros((len(batch), kept), np.float32),
            np.zeros((len(batch), kept, 3), np.uint8),
            np.zeros((len(batch), kept, 3), np.uint8),
        )
        owners = owner.ravel()[batch]
        for each in prepared:
            view = each.read()
            shown = Shown(view.camera, view.image, view.coarse, view.trust, view.inverse_depth)
            keep_best(charted, batch, owners, owner.shape[1], shown, _CLEARANCE / view.camera.focal, best)
        blend(best, _SHARPNESS, colors[first : first + _BATCH])
    return colors


def _prepared(view: View, camera: Camera, gains: NDArray[np.float64], trusted: TrustedPixels) -> _Prepared:
    """A view's photograph with its exposure evened, without detail, and how far its pixels are trusted."""
    trust, inverse_depth = trusted.trust, trusted.inverse_depth
    inner = np.zeros((view.height + 2, view.width + 2), np.uint8)
    inner[1:-1, 1:-1] = (trust == 1) & (inverse_depth > 0)
    from_border = cv2.distanceTransform(inner, cv2.DIST_L2, 3)[1:-1, 1:-1]
    levels = np.clip(view.image * gains.astype(np.float32), 0, 255)
    shows = (trust > 0).astype(np.float32)
    share = np.asarray(cv2.GaussianBlur(shows, (0, 0), _DETAIL))
    blurred = cv2.GaussianBlur(levels * shows[..., None], (0, 0), _DETAIL) / np.maximum(share, 1e-6)[..., None]
    return _Prepared(
        camera,
        np.rint(levels).astype(np.uint8),
        np.rint(np.clip(blurred, 0, 255)).astype(np.uint8),
        np.where(trust == 1, np.maximum(np.minimum(from_border / _FEATHER, 1), 0.01), 0.01 * trust).astype(np.float32),
        inverse_depth,
    )


def _fill_unseen(
    charted: Charted, unseen: NDArray[np.int64], owner: NDArray[np.int32], colors: NDArray[np.float32]
) -> None:
    """Give unseen texels (n,) colours, of all (n_texels, 3), that flow along the surface from those that are seen."""
    if not len(unseen):
        return
    size = len(owner)
    corners = np.clip(np.rint(charted.places), 0, size - 1).astype(np.int64)
    shown = colors[corners[..., 1] * size + corners[..., 0]].reshape(-1, 3)
    index, known = charted.triangles.ravel(), np.isfinite(shown[:, 0])
    count = np.bincount(index[known], minlength=len(charted.points))
    of_points = (
        np.column_stack([np.bincount(index[known], shown[known, channel], len(charted.points)) for channel in range(3)])
        / np.maximum(count, 1)[:, None]
    )
    let_flow(of_points, count > 0, charted.points, charted.triangles)
    for first in range(0, len(unseen), _BATCH):
        batch = unseen[first : first + _BATCH]
        triangle = owner.ravel()[batch]
        a, b, c = charted.places[triangle].transpose(1, 0, 2)
        ab, ac, ap = b - a, c - a, np.column_stack([batch % size, batch // size]) - a
        area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
        to_b = (ap[:, 0] * ac[:, 1] - ap[:, 1] * ac[:, 0]) / area
        to_c = (ab[:, 0] * ap[:, 1] - ab[:, 1] * ap[:, 0]) / area
        weights = np.clip(np.column_stack([1 - to_b - to_c, to_b, to_c]), 0, 1)
        weights /= weights.sum(axis=1, keepdims=True)
        colors[batch] = np.einsum("nc,ncd->nd", weights, of_points[charted.triangles[triangle]])


def _padded(colors: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(rows, columns, 3) image of colours, where what is NaN continues what is around it: pull and push.

    References
    ----------
    Gortler, Grzeszczuk, Szeliski, Cohen, "The lumigraph", SIGGRAPH 1996, section 3.4 (pull-push).
    """
    known = np.isfinite(colors[..., :1])
    weight = known.astype(np.float32)
    levels = [(np.where(known, colors, 0), weight)]
    while max(levels[-1][0].shape[:2]) > 1:
        sums, weight = (_halved(each) for each in levels[-1])
        levels.append((sums, weight))
    filled = levels[-1][0] / np.maximum(levels[-1][1], 1e-6)
    for sums, weight in levels[-2::-1]:
        rows, columns = sums.shape[:2]
        doubled = (2 * filled.shape[1], 2 * filled.shape[0])
        wider = np.asarray(cv2.resize(filled, doubled, interpolation=cv2.INTER_LINEAR))[:rows, :columns]
        filled = np.where(weight > 0, sums / np.maximum(weight, 1e-6), wider)
    return np.rint(np.clip(filled, 0, 255)).astype(np.uint8)


def _halved(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(rows / 2, columns / 2, n) sums of fours, of fewer at the end of an odd number of rows or columns."""
    part = np.pad(values, [(0, side % 2) for side in values.shape[:2]] + [(0, 0)])
    return np.asarray(part[::2, ::2] + part[1::2, ::2] + part[::2, 1::2] + part[1::2, 1::2])
