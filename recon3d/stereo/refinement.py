"""Sharpen a carved hull: dense matching inside it, fused into one cloud of oriented points."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping, Sequence
from typing import NamedTuple

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from recon3d.carving.depth_votes import carve_by_depths, hull_of_field
from recon3d.carving.item_buffer import ItemBuffer
from recon3d.carving.visible import color_visible
from recon3d.scene.scene import Scene
from recon3d.stereo.fusion import Fusion, fuse
from recon3d.stereo.patch_match import DepthMap, Matcher, Matching
from recon3d.surface.extraction import mesh_shape
from recon3d.volume.carved import CarvedVolume, Label

Stages = MutableMapping[str, dict[str, NDArray[np.generic]]]
"""Arrays by name of every finished stage, kept for a later run."""


PASSES = (
    Matching(cavities=0.3, stride=4, rounds=3),  # into the cavities that carving left filled
    Matching(cavities=0.3, stride=4, rounds=3),  # and into what is seen only through these
    Matching(cavities=0.3, radius=4, spacing=1),  # as finely as the photographs allow
)
"""How the views are matched, one pass after the other."""


_PRIOR = 0.05  # weight of the vote for solid; a clear match weighs up to one


_BLUR = 1.0  # of the votes, voxels


_TRUNCATION = 4.0  # voxels before and behind a depth where it is evidence


class Refinement(NamedTuple):
    """What dense matching found."""

    points: o3d.t.geometry.PointCloud
    """Tensors ``positions`` (n, 3) world units, ``normals`` (n, 3) outwards, ``colors`` (n, 3) in [0, 1], means over
    the views that agree, and ``confidence`` (n, 1) in (0, 1): s / (1 + s), s the sum of their NCC^2."""
    carved: CarvedVolume
    """The volume carved once more, to the depths found: what is left where there are no points."""


def refine(
    scene: Scene,
    hull: CarvedVolume,
    *,
    passes: Sequence[Matching] = PASSES,
    stages: Stages | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Refinement:
    """Points of the surface to a fraction of a pixel's footprint, where two views or more show it.

    The carved surface gives every pixel of a view a first depth and a normal, and says which other views see it. Each
    pixel then looks for the plane on which the window around it agrees best with those views, helped by its
    neighbours' planes; planes that other views confirm become points. Each further pass does so from the surface that
    the depths of the pass before carve.

    Parameters
    ----------
    hull : of the scene, by any carving method; vote carving comes nearest to the surface.
    passes : how windows are matched, each time from what was found before.
    stages : finished views are taken from here and put here, so that an interrupted run can go on; of the same scene,
        hull and passes.
    progress : called with the views that are done and how many there are, over all passes.

    Raises
    ------
    SceneError : no two views can be matched.
    EmptyReconstructionError : the hull is empty, or no two views agree on any point.
    """
    if not passes:
        raise ValueError("expected at least one pass of matching")
    stages = {} if stages is None else stages
    n_steps = len(passes) * len(scene.views)
    for n_pass, matching in enumerate(passes):
        matcher = Matcher(scene, mesh_shape(hull.with_interior, distance=hull.distance), matching)
        depth_maps = []
        for n in range(len(scene.views)):
            name = f"pass {n_pass + 1} view {n + 1}"
            if name not in stages:
                depth_map = matcher.depth_map(n)
                stages[name] = {"planes": depth_map.planes, "costs": depth_map.costs}
            kept = stages[name]
            depth_maps.append(DepthMap(kept["planes"].astype(np.float32), kept["costs"].astype(np.float32)))
            if progress:
                progress(n_pass * len(scene.views) + n + 1, n_steps)
        fusion = fuse(scene, depth_maps, matching)
        hull = _carve(scene, hull, depth_maps, fusion, matching)
    color_visible(hull, ItemBuffer(scene.packed, hull.volume), hull.with_interior.occupied)
    return Refinement(fusion.cloud(), hull)


def _carve(
    scene: Scene, hull: CarvedVolume, depth_maps: Sequence[DepthMap], fusion: Fusion, matching: Matching
) -> CarvedVolume:
    """The hull without what lies in front of the fused depths."""
    volume, solid, views = hull.volume, hull.with_interior.occupied, scene.packed
    distance = hull.distance if hull.distance is not None else _distance_inside(solid, volume.voxel_size)
    inverse = np.stack([depth_map.planes[..., 0] for depth_map in depth_maps])
    depths = np.divide(1, inverse, out=np.zeros_like(inverse), where=fusion.weights > 0)
    field = carve_by_depths(
        np.where(solid, distance, np.minimum(distance, 0)), volume, views, depths, fusion.weights,
        stride=matching.stride, resolution=_BLUR * volume.voxel_size, truncation=_TRUNCATION * volume.voxel_size,
        prior=_PRIOR,
    )  # fmt: skip
    return hull_of_field(field, np.where(solid, Label.INCONSISTENT, hull.labels), volume)


def _distance_inside(solid: NDArray[np.bool_], voxel_size: float) -> NDArray[np.float32]:
    """Signed distance (nx, ny, nz) of voxel centres to the surface between voxels, positive inside, world units."""
    padded = np.pad(solid, 1)
    inside, outside = distance_transform_edt(padded) - 0.5, distance_transform_edt(~padded) - 0.5
    signed = np.where(padded, inside, -outside) * voxel_size
    return np.asarray(signed[1:-1, 1:-1, 1:-1], np.float32)
