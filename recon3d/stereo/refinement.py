"""Refine a carved volume: dense matching inside it, fused into one cloud of oriented points."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from typing import NamedTuple

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from recon3d import tasks
from recon3d.carving.depth_votes import carve_by_depths, hull_of_field
from recon3d.carving.item_buffer import ItemBuffer
from recon3d.carving.start import any_silhouette
from recon3d.carving.visible import color_visible
from recon3d.carving.vote_carving import reading_scale
from recon3d.errors import ArgumentError
from recon3d.kernels.types import DepthMaps
from recon3d.scene.scene import Scene
from recon3d.scratch import Scratch, Stored, load
from recon3d.stereo.fusion import Fusion, fuse
from recon3d.stereo.patch_match import DepthMap, GuidedView, Matching, guide_views, match_view
from recon3d.stereo.sharing import surface_neighbours
from recon3d.surface.extraction import mesh_shape
from recon3d.tasks import Arrays, Kept, Progress, Store, content_key, once
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.lattice import Lattice

PASSES = (
    Matching(cavities=0.3, stride=4, rounds=3),  # into the cavities that carving left filled
    Matching(cavities=0.3, stride=4, rounds=3),  # and into what is seen only through these
    Matching(cavities=0.3, radius=4, spacing=1),  # as finely as the photographs allow
)
"""How the views are matched, one pass after the other."""


_PRIOR = 0.05  # weight of the vote for solid; a clear match weighs up to one


_BLUR = 1.0  # of the votes, voxels


_TRUNCATION = 4.0  # voxels before and behind a depth where it is evidence

_MARGIN = 0.02  # of the bounds' longest side: what lies so near to a face may be on it

_FACING = 0.5  # cosine of the angle to a face's normal below which a surface does not face it


class Refinement(NamedTuple):
    """What dense matching found."""

    points: o3d.t.geometry.PointCloud
    """Tensors ``positions`` (n, 3) world units, ``normals`` (n, 3) outwards, ``colors`` (n, 3) in [0, 1], means over
    the views that agree, ``confidence`` (n, 1) in (0, 1): s / (1 + s), s the sum of their NCC^2, ``correlation`` (n, 1)
    in (0, 1], the mean of these, and ``shift`` (n, 1), how far along the normal the mean lies from the plane of a
    point's own view, world units."""
    carved: CarvedVolume
    """The volume carved once more, to the depths found: what is left where there are no points."""


def refine(
    scene: Scene,
    carved: CarvedVolume,
    *,
    passes: Sequence[Matching] = PASSES,
    checkpoints: Store | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Refinement:
    """Points of the surface to a fraction of a pixel's footprint, where two views or more show it.

    The carved surface gives every pixel of a view a first depth and a normal, and says which other views see it. Each
    pixel then looks for the plane on which the window around it agrees best with those views, helped by its
    neighbours' planes; planes that other views confirm become points. Each further pass does so from the surface that
    the depths of the pass before carve.

    Parameters
    ----------
    carved : of the scene, by any carving method; vote carving comes nearest to the surface.
    passes : how windows are matched, each time from what was found before.
    checkpoints : finished depth maps and passes are kept here, and taken from here where the scene, the carved volume
        and the passes up to them are the same.
    executor : matches several views at a time, see ``recon3d.tasks.map``; the result is the same.
    progress : called with the views that are done and how many there are, over all passes.

    Raises
    ------
    SceneError : no two views can be matched.
    EmptyReconstructionError : the carved volume is empty, or no two views agree on any point.
    """
    if not passes:
        raise ArgumentError("expected at least one pass of matching")
    report = progress or (lambda _done, _total: None)
    key = content_key(scene, carved.lattice, carved.arrays()) if checkpoints is not None else ""  # nothing is kept
    found = Refinement(o3d.t.geometry.PointCloud(), carved)
    for n, matching in enumerate(passes):
        key, last = content_key(key, matching), n + 1 == len(passes)
        one_pass = partial(
            _pass, scene, found.carved, matching, name=f"pass {n + 1}", colored=last,
            kept=Kept(checkpoints, key, vars, lambda arrays: DepthMap(**arrays)), executor=executor,
            progress=partial(_in_all, report, n, len(passes)),
        )  # fmt: skip
        kept = Kept(checkpoints, content_key(key, last), _arrays, partial(_restored, carved.lattice))
        found = once(one_pass, f"pass {n + 1}", kept=kept)
        _in_all(report, n, len(passes), len(scene.views), len(scene.views))
    return found


def _in_all(report: Progress, n_before: int, n_passes: int, done: int, total: int) -> None:
    """Report the views done in a pass as those done in all passes."""
    report(n_before * total + done, n_passes * total)


def _pass(
    scene: Scene,
    hull: CarvedVolume,
    matching: Matching,
    *,
    name: str,
    colored: bool,
    kept: Kept[DepthMap],
    executor: Executor | None,
    progress: Progress,
) -> Refinement:
    """Match every view, fuse the depth maps, and carve the hull to them, whose voxels are coloured if wanted."""
    scratch = Scratch()
    surface = mesh_shape(hull.with_interior, distance=hull.distance)
    neighbours = surface_neighbours(scene, surface, matching.neighbours, clearance=hull.lattice.voxel_size)
    guided = [scratch.keep(view) for view in guide_views(scene, surface, matching.stride)]
    match = partial(_matched, footprint=scene.pixel_footprint, thickness=float(min(scene.bounds.extent)))
    inputs = {
        f"{name} view {n + 1}": (view, [guided[other] for other in neighbours[n]], matching)
        for n, view in enumerate(guided)
    }
    depth_maps = tasks.map(match, inputs, kept=kept, held=scratch.keep, executor=executor, progress=progress)
    fusion = fuse(scene, depth_maps, matching)
    carved = _carve(scene, hull, fusion, matching)
    if colored:
        views = scene.packed_at(reading_scale(scene, hull.lattice.voxel_size))
        color_visible(carved, ItemBuffer(views, carved.volume), carved.with_interior.occupied)
    points = fusion.cloud()
    return Refinement(points if any_silhouette(scene) else _within(points, scene), carved)


def _matched(
    view: GuidedView | Stored[GuidedView],
    others: Sequence[GuidedView | Stored[GuidedView]],
    matching: Matching,
    *,
    footprint: float,
    thickness: float,
) -> DepthMap:
    """Match a view with others that are read for it alone."""
    return match_view(load(view), [load(other) for other in others], matching, footprint=footprint, thickness=thickness)


def _within(points: o3d.t.geometry.PointCloud, scene: Scene) -> o3d.t.geometry.PointCloud:
    """The points without the background: what lies beyond the bounds, or on one of their faces, as a floor does.

    Next to a face of the bounds an object turns its outside towards the face; what turns it inwards is background. Not
    so around cameras inside the bounds, which look at the walls of a room.
    """
    places, normals = points.point.positions.numpy(), points.point.normals.numpy()
    inner = scene.bounds.padded(-_MARGIN * scene.bounds.longest)
    low, high = places < inner.low, places > inner.high
    background = ((places < scene.bounds.low) | (places > scene.bounds.high)).any(axis=1)
    if not scene.camera_inside:
        background |= ((low & (normals > _FACING)) | (high & (normals < -_FACING))).any(axis=1)
    return points.select_by_mask(o3d.core.Tensor.from_numpy(~background))


_OF_POINTS = ("positions", "normals", "colors", "confidence", "correlation", "shift")


def _arrays(found: Refinement) -> Arrays:
    """A refinement for a file."""
    points = {f"point {name}": found.points.point[name].numpy() for name in _OF_POINTS}
    return points | found.carved.arrays()


def _restored(lattice: Lattice, arrays: Arrays) -> Refinement:
    """The refinement of arrays that were kept, on their lattice."""
    rest, points = dict(arrays), o3d.t.geometry.PointCloud()
    for name in _OF_POINTS:
        points.point[name] = o3d.core.Tensor.from_numpy(rest.pop(f"point {name}"))
    return Refinement(points, CarvedVolume.from_arrays(lattice, rest))


def _carve(scene: Scene, hull: CarvedVolume, fusion: Fusion, matching: Matching) -> CarvedVolume:
    """The hull without what lies in front of the fused depths."""
    volume, solid = hull.volume, hull.with_interior.occupied
    distance = hull.distance if hull.distance is not None else _distance_inside(solid, volume.voxel_size)
    kept = (each.read() for each in fusion.depths)
    maps = (DepthMaps(each.depths[None], each.weights[None], matching.stride) for each in kept)
    field = carve_by_depths(
        np.where(solid, distance, np.minimum(distance, 0)), volume, scene.cameras, maps,
        resolution=_BLUR * volume.voxel_size, truncation=_TRUNCATION * volume.voxel_size, prior=_PRIOR,
    )  # fmt: skip
    return hull_of_field(field, np.where(solid, Label.INCONSISTENT, hull.labels), volume)


def _distance_inside(solid: NDArray[np.bool_], voxel_size: float) -> NDArray[np.float32]:
    """Signed distance (nx, ny, nz) of voxel centres to the surface between voxels, positive inside, world units."""
    padded = np.pad(solid, 1)
    inside, outside = distance_transform_edt(padded) - 0.5, distance_transform_edt(~padded) - 0.5
    signed = np.where(padded, inside, -outside) * voxel_size
    return np.asarray(signed[1:-1, 1:-1, 1:-1], np.float32)
