"""Dense matching inside the carved volume: for every view a plane at every few pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.carving.depth_votes import MIN_DEVIATION
from recon3d.checks import require_number, require_whole
from recon3d.errors import ArgumentError
from recon3d.kernels.patch_match import NOTHING, HalfSweep, Planes, Search, WeightedWindow, match_planes
from recon3d.kernels.surface_visibility import Surface, find_visible
from recon3d.kernels.types import Camera, Cameras, Compared
from recon3d.rendering.renderer import Renderer, bands
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

_MOST_NEIGHBOURS = 32  # bits of a pixel's visibility


_TOLERANCE = 6.0  # pixel footprints by which the carved surface may miss in depth when visibility is asked


_MIN_COSINE = 0.15  # between a surface's normal and a line of sight along which it can be matched


_EDGE = 2.5  # pixel footprints by which the carved surface leaves a pixel's tangent where another part of it begins


_TRIALS = 2  # random planes a pixel and half sweep


_FIRST_RANGE = 4.0  # pixel footprints that the first random trials change a depth by


_SHRINKING = 0.4  # of the range from round to round


_SLOPE = 0.3  # change of slope, in changes of depth a pixel


@dataclass(frozen=True)
class Matching:
    """How windows are matched; lengths are in pixels, or in pixel footprints at the object."""

    stride: int = 2
    """Pixels between matched pixels."""
    radius: int = 5
    """Of the windows, pixels."""
    spacing: int = 2
    """Between compared pixels of a window."""
    contrast: float = 20.0
    """Grey levels of difference to a window's centre over which a pixel's weight falls to 1/e."""
    rounds: int = 2
    """Sweeps over each view."""
    reach: float = 10.0
    """How far before and behind the hull a depth may lie, pixel footprints."""
    cavities: float = 0.0
    """How far behind the hull it may lie besides, as a fraction of the bounds' shortest side."""
    neighbours: int = 6
    """Views that a view may be compared with."""
    compared: int = 4
    """Of those that see a pixel's surface, the nearest so many are compared; the two best count."""
    max_cost: float = 0.6
    """Largest 1 - NCC of a match."""

    def __post_init__(self) -> None:
        for name in ("stride", "radius", "spacing", "rounds", "compared"):
            require_whole(name, getattr(self, name))
        require_whole("neighbours", self.neighbours, most=_MOST_NEIGHBOURS)
        require_number("contrast", self.contrast, "(0, inf)")
        require_number("reach", self.reach, "(0, inf)")
        require_number("cavities", self.cavities, "[0, inf)")
        require_number("max_cost", self.max_cost, "(0, 1]")
        if self.radius < self.spacing:
            raise ArgumentError(f"expected a radius of at least the spacing, got {self.radius} and {self.spacing}")


@dataclass(frozen=True)
class DepthMap:
    """What a view's pixels were found to show."""

    planes: NDArray[np.float32]
    """(rows, columns, 3) inverse depth along the optical axis and its slopes along u and v; zero beside the hull.

    Row r and column c belong to the pixel (u, v) = (c, r) times the stride.
    """
    costs: NDArray[np.float32]
    """(rows, columns) 1 - NCC in [0, 2], mean of the two best views; ``NOTHING`` where there is no match."""


@dataclass(frozen=True)
class GuidedView:
    """A view as matching reads it, with the carved surface to start from; padded as ``PackedViews``."""

    luminance: NDArray[np.float32]
    """(height, width) in [0, 255]."""
    camera: Camera
    depth: NDArray[np.float32]
    """(height, width) of the carved surface along the optical axis, world units; 0 beside it."""
    normals: NDArray[np.float32]
    """(rows, columns, 3) of the carved surface at the matched pixels, world, towards the camera; zero beside it."""


def guide_views(scene: Scene, surface: o3d.geometry.TriangleMesh, stride: int) -> Iterator[GuidedView]:
    """Each view of a scene with what it sees of a carved surface, whose normals are taken of strided pixels."""
    cameras, renderer = scene.cameras, Renderer(surface)
    height, width = (max(sizes) for sizes in zip(*((view.height, view.width) for view in scene.views), strict=True))
    for n, view in enumerate(scene.views):
        depth, luminance = np.zeros((2, height, width), np.float32)
        normals = np.zeros((*depth[::stride, ::stride].shape, 3), np.float32)
        for rows in bands(view.height, view.width, stride):
            seen = renderer.cast(view.K, view.cam_from_world, view.width, rows)
            depth[rows.start : rows.stop, : view.width] = np.where(seen.hit, seen.depth, 0)
            strided, _ = renderer.normals(seen.strided(stride))
            first = rows.start // stride
            normals[first : first + strided.shape[0], : strided.shape[1]] = strided
        luminance[: view.height, : view.width] = cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY)
        for array in (depth, luminance, normals):
            array.setflags(write=False)
        yield GuidedView(luminance, cameras.at(n), depth, normals)


def match_view(
    view: GuidedView, others: Sequence[GuidedView], matching: Matching, *, footprint: float, thickness: float
) -> DepthMap:
    """Match a view with others, the nearest first.

    The carved surface starts each pixel off with a depth and a normal, bounds the search, and says which views see it.
    Of a window only what lies on the pixel's own side of its edges is compared.

    Parameters
    ----------
    footprint : of a pixel at the object, world units.
    thickness : of the object, which limits the depth of cavities; world units.

    References
    ----------
    Bleyer, Rhemann, Rother, "PatchMatch stereo: stereo matching with slanted support windows", BMVC 2011.
    Galliani, Lasinger, Schindler, "Massively parallel multiview stereopsis by surface normal diffusion", ICCV 2015
    (red-black propagation).
    Furukawa, Ponce, "Accurate, dense, and robust multiview stereopsis", TPAMI 2010 (planes refined by optimisation).
    """
    stride = matching.stride
    start = view.depth[::stride, ::stride]
    planes = _first_planes(view, start, stride)
    costs = np.full(start.shape, NOTHING, np.float32)
    if not others or not start.any():
        return DepthMap(planes, costs)
    cameras, depths = Cameras.of([other.camera for other in others]), np.stack([other.depth for other in others])
    visible = np.zeros(start.shape, np.uint32)
    surface = Surface(view.camera, view.depth, view.normals, stride)
    find_visible(surface, cameras, depths, _TOLERANCE * footprint, _MIN_COSINE, visible)
    luminances = np.stack([other.luminance for other in others])
    compared = Compared.between(view.luminance, view.camera, luminances, cameras)
    window = WeightedWindow(matching.radius, matching.spacing, matching.contrast, MIN_DEVIATION)
    reach = np.float32(matching.reach * footprint)
    behind = reach + np.float32(matching.cavities * thickness)
    nearest, farthest = np.maximum(start - reach, reach), start + behind
    unit = footprint / float(np.median(start[start > 0])) ** 2
    guide = np.divide(1, view.depth, out=np.zeros_like(view.depth), where=view.depth > 0)
    edge = _EDGE / float(view.camera.focal)
    search = Search(visible, guide, planes.copy(), edge, nearest, farthest, stride, matching.compared)
    for sweep in range(2 * matching.rounds):
        half_sweep = HalfSweep(sweep, _ranges(matching, unit, sweep // 2))
        match_planes(compared, window, search, half_sweep, Planes(planes, costs))
    return DepthMap(planes, costs)


def _ranges(matching: Matching, unit: float, sweep: int) -> NDArray[np.float64]:
    """(n_trials, 2) largest changes of inverse depth and slope in a sweep's random trials; infinite: any depth.

    A unit of inverse depth is a pixel's footprint over depth squared.
    """
    change = _FIRST_RANGE * _SHRINKING**sweep * 0.5 ** np.arange(_TRIALS) * unit
    anywhere = [[np.inf, change[0]]] if matching.cavities and not sweep else np.empty((0, 2))
    return np.concatenate([anywhere, np.column_stack([change, _SLOPE * change])])


def _first_planes(view: GuidedView, start: NDArray[np.float32], stride: int) -> NDArray[np.float32]:
    """(rows, columns, 3) planes of the carved surface at every strided pixel, where it has a depth (rows, columns)."""
    depth = start.astype(np.float64)
    # On the plane m . X = m . X0 of the camera's frame, 1 / z = m . K^-1 (u, v, 1) / (m . X0).
    m = view.normals @ view.camera.world_from_pixel
    rows, columns = np.mgrid[: depth.shape[0], : depth.shape[1]] * stride
    facing = m[..., 0] * columns + m[..., 1] * rows + m[..., 2]
    facing = np.minimum(facing, -_MIN_COSINE)  # normals face the camera; a grazing plane is turned towards it
    hit = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=hit)
    slopes = m[..., :2] * (inverse / facing)[..., None]
    return np.concatenate([inverse[..., None], np.where(hit[..., None], slopes, 0)], axis=-1).astype(np.float32)


def plane_normals(view: View, planes: NDArray[np.float32], stride: int) -> NDArray[np.float32]:
    """(rows, columns, 3) unit world normals, towards the camera, of a view's planes; zero where there is none."""
    w, along_u, along_v = np.moveaxis(planes, -1, 0).astype(np.float64)
    rows, columns = np.mgrid[: w.shape[0], : w.shape[1]] * stride
    # 1 / z = (a, b, c) . (u, v, 1) is the plane (K^T (a, b, c)) . X = 1.
    plane = np.stack([along_u, along_v, w - along_u * columns - along_v * rows], axis=-1)
    toward = -(plane @ view.K @ view.cam_from_world[:3, :3])
    length = np.linalg.norm(toward, axis=-1, keepdims=True)
    return np.asarray(np.divide(toward, length, out=np.zeros_like(toward), where=length > 0), np.float32)
