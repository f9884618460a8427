"""From a place in the world or a pixel in a photograph to the voxel that is meant."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from recon3d.carving.observer import Voxel
from recon3d.errors import ArgumentError
from recon3d.explaining.evidence import Silhouettes
from recon3d.kernels.item_buffer import enter_box, next_voxel
from recon3d.kernels.types import Ray
from recon3d.scene.bounds import place_text
from recon3d.scene.packed import PackedViews
from recon3d.scene.scene import Scene
from recon3d.volume.carved import CarvedVolume
from recon3d.volume.dense import CarvingVolume


def voxel_at(volume: CarvingVolume, at: ArrayLike | None) -> Voxel:
    """The voxel of a volume that holds a place (3,) in the world."""
    place = np.asarray(at, np.float64)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ArgumentError(f"expected a place of three finite numbers, got {at!r}")
    index = np.floor((place - volume.origin) / volume.voxel_size).astype(np.int64)
    if (index < 0).any() or (index >= volume.shape).any():
        size = volume.voxel_size
        low, high = (place_text(corner, size) for corner in (volume.bounds.low, volume.bounds.high))
        raise ArgumentError(f"the place {place_text(place, size)} lies outside the volume, which spans {low} to {high}")
    i, j, k = (int(n) for n in index)
    return i, j, k


def voxels_on_ray(scene: Scene, volume: CarvingVolume, pixel: tuple[str, float, float]) -> list[Voxel]:
    """All voxels of a volume on the ray of a pixel (view, u, v), from the camera on."""
    name, u, v = pixel
    view = scene.subset([name]).views[0]
    if not (-0.5 <= u < view.width - 0.5 and -0.5 <= v < view.height - 0.5):
        raise ArgumentError(f"view {view.name} has {view.width}x{view.height} pixels, got pixel {u:g},{v:g}")
    start = (view.center - volume.origin) / volume.voxel_size
    step = view.cam_from_world[:3, :3].T @ np.linalg.inv(view.K) @ [u, v, 1.0]
    ray, met = Ray(start, step, np.empty(3, np.int64)), list[Voxel]()
    inside = enter_box(volume.shape, ray)
    while inside:
        i, j, k = (int(n) for n in ray.place)
        met.append((i, j, k))
        inside = next_voxel(volume.shape, ray)
    if not met:
        raise ArgumentError(f"the ray of pixel {u:g},{v:g} of view {view.name} misses the volume")
    return met


def most_telling(scene: Scene, views: PackedViews, hull: CarvedVolume, ray: list[Voxel]) -> tuple[Voxel, str]:
    """The voxel on a ray that someone who clicks on its pixel means, and why it."""
    first = next((n for n, voxel in enumerate(ray) if hull.volume.occupied[voxel]), None)
    before = ray[:first]
    judged = [voxel for voxel in before if not np.isnan(hull.degree[voxel])]
    best = max(judged, key=lambda voxel: float(hull.degree[voxel]), default=None)
    if first is not None:
        text = f"first accepted voxel on the pixel's ray; {len(before)} before it are empty"
        if best is not None:
            size = hull.volume.voxel_size
            center = place_text(hull.volume.origin + size * (np.array(best) + 0.5), size)
            text += f", of which {center} with the highest degree, {hull.degree[best]:.3f}"
        return ray[first], text
    if best is not None:
        return best, f"of {len(ray)} voxels on the pixel's ray none is accepted; this one has the highest degree"
    silhouettes = Silhouettes(scene, views, hull)
    best = min(ray, key=lambda voxel: sum(bool(text) for text in silhouettes.excluding(voxel)))
    return best, f"of {len(ray)} voxels on the pixel's ray none is accepted; the fewest silhouettes exclude this one"
