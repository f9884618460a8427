"""Voxel colouring, literally: one voxel, one view, one pixel at a time, in exact fractions; rays by brute force."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from itertools import product
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from recon3d.rendering.renderer import pixel_rays
from recon3d.scene.scene import Scene
from recon3d.scene.view import View
from recon3d.volume.carved import Label
from recon3d.volume.dense import CarvingVolume

Voxel = tuple[int, int, int]
Pixel = tuple[int, int]


@dataclass
class Result:
    """What became of every voxel that was visited."""

    labels: dict[Voxel, Label] = field(default_factory=dict)
    degree: dict[Voxel, Fraction] = field(default_factory=dict)
    n_views: dict[Voxel, int] = field(default_factory=dict)
    colors: dict[Voxel, tuple[int, ...]] = field(default_factory=dict)
    votes: dict[Voxel, list[list[Pixel]]] = field(default_factory=dict)


def whole_numbers(low: float, high: float) -> range:
    """Whole numbers between two limits; the nearest one where there is none."""
    inside = range(ceil(low), floor(high) + 1)
    if inside:
        return inside
    nearest = floor((low + high) / 2 + 0.5)
    return range(nearest, nearest + 1)


def footprint(view: View, volume: CarvingVolume, voxel: Voxel) -> list[Pixel] | None:
    """Pixels (u, v) of the box around the eight projected corners, inside the image or not; None: behind the camera."""
    P = view.K @ view.cam_from_world[:3]
    us, vs = [], []
    for step in product((0, 1), repeat=3):
        corner = [volume.origin[axis] + volume.voxel_size * (voxel[axis] + step[axis]) for axis in range(3)]
        x, y, depth = (float(P[row] @ [*corner, 1.0]) for row in range(3))
        if depth <= 0:
            return None
        us.append(x / depth)
        vs.append(y / depth)
    # Far outside, the pixels themselves do not matter, only that they are outside.
    u_range = whole_numbers(max(min(us), -9), min(max(us), view.width + 9))
    v_range = whole_numbers(max(min(vs), -9), min(max(vs), view.height + 9))
    return [(u, v) for v in v_range for u in u_range]


def in_image(view: View, pixel: Pixel) -> bool:
    return 0 <= pixel[0] < view.width and 0 <= pixel[1] < view.height


def foreground(view: View, pixel: Pixel) -> bool:
    return view.silhouette is None or bool(view.silhouette[pixel[1], pixel[0]])


def alternating_harmonic(n: int) -> Fraction:
    """S(n), equation 9."""
    return sum((Fraction((-1) ** (k - 1), k) for k in range(1, n + 1)), Fraction(0))


def decile_ratio(intensities: list[int]) -> Fraction:
    """Lowest over highest intensity between the first and the ninth decile, equation 7."""
    ascending = sorted(intensities)
    n = len(ascending)
    d1 = ascending[ceil(Fraction(n, 10)) - 1]
    d9 = ascending[ceil(Fraction(9 * n, 10)) - 1]
    kept = [x for x in ascending if d1 <= x <= d9]
    return Fraction(min(kept), max(kept)) if max(kept) else Fraction(1)


def membership(colors: list[tuple[int, ...]], intensity: str) -> Fraction:
    """The mu of a voxel from its pixels' colours."""
    if intensity == "channels":
        return min(decile_ratio([color[channel] for color in colors]) for channel in range(3))
    return decile_ratio([floor(Fraction(299 * r + 587 * g + 114 * b, 1000) + Fraction(1, 2)) for r, g, b in colors])


def neighbours(voxel: Voxel, connectivity: int) -> Iterable[Voxel]:
    """Voxels that share a face (6), or an edge too (18), or a corner too (26)."""
    allowed = {6: (1,), 18: (1, 2), 26: (1, 2, 3)}[connectivity]
    for a, b, c in product((-1, 0, 1), repeat=3):
        if abs(a) + abs(b) + abs(c) in allowed:
            yield voxel[0] + a, voxel[1] + b, voxel[2] + c


def color_voxels(
    scene: Scene,
    volume: CarvingVolume,
    direction: NDArray[np.float64],
    *,
    connectivity: int = 26,
    layering: str = "slabs",
    intensity: str = "luminance",
) -> Result:
    """The whole sweep along a direction."""
    result = Result()
    marked: list[set[Pixel]] = [set() for _ in scene.views]
    boxes: dict[Voxel, list[list[Pixel] | None]] = {}
    remaining: list[Voxel] = []
    for voxel in product(*(range(n) for n in volume.shape)):
        if not volume.occupied[voxel]:
            continue
        boxes[voxel] = [footprint(view, volume, voxel) for view in scene.views]
        if any(
            box is not None and all(in_image(view, pixel) and not foreground(view, pixel) for pixel in box)
            for view, box in zip(scene.views, boxes[voxel], strict=True)
        ):
            result.labels[voxel] = Label.BACKGROUND
        else:
            remaining.append(voxel)

    for layer in layers(remaining, direction, layering):
        candidates: set[Voxel] = set()
        accepted: set[Voxel] = set()
        for voxel in layer:
            votes = [
                [pixel for pixel in box or [] if in_image(view, pixel) and foreground(view, pixel)]
                for view, box in zip(scene.views, boxes[voxel], strict=True)
            ]
            free = [[pixel for pixel in vote if pixel not in gone] for vote, gone in zip(votes, marked, strict=True)]
            if not any(free):
                result.labels[voxel] = Label.HIDDEN if any(votes) else Label.UNSEEN
                continue
            colors = [
                tuple(int(x) for x in view.image[v, u])
                for view, pixels in zip(scene.views, free, strict=True)
                for u, v in pixels
            ]
            n_views = sum(bool(pixels) for pixels in free)
            mu = membership(colors, intensity)
            result.degree[voxel], result.n_views[voxel], result.votes[voxel] = mu, n_views, free
            result.colors[voxel] = tuple(
                floor(Fraction(sum(color[channel] for color in colors), len(colors)) + Fraction(1, 2))
                for channel in range(3)
            )
            if mu >= alternating_harmonic(2 * n_views + 1):
                accepted.add(voxel)
            elif mu <= alternating_harmonic(2 * n_views):
                result.labels[voxel] = Label.INCONSISTENT
            else:
                candidates.add(voxel)

        for voxel in accepted:
            result.labels[voxel] = Label.CONSISTENT
        changed = True
        while changed:
            changed = False
            for voxel in sorted(candidates):
                if any(result.labels.get(other) == Label.CONSISTENT for other in neighbours(voxel, connectivity)):
                    result.labels[voxel] = Label.CONSISTENT
                    accepted.add(voxel)
                    candidates.remove(voxel)
                    changed = True
        for voxel in candidates:
            result.labels[voxel] = Label.INCONSISTENT
        for voxel in accepted:
            for gone, box in zip(marked, boxes[voxel], strict=True):
                gone.update(box or [])
    return result


def layers(voxels: list[Voxel], direction: NDArray[np.float64], layering: str) -> list[list[Voxel]]:
    """Voxels near to far, equally far ones by index: in slabs one voxel thick from the nearest one, or one by one."""
    # Up to the last bits of the direction, which must not part a lattice plane.
    depth = {voxel: round(sum(float(direction[axis]) * voxel[axis] for axis in range(3)), 6) for voxel in voxels}
    near_to_far = sorted(voxels, key=depth.__getitem__)
    if layering == "voxels":
        return [[voxel] for voxel in near_to_far]
    slabs: dict[int, list[Voxel]] = {}
    for voxel in near_to_far:
        slabs.setdefault(floor(depth[voxel] - depth[near_to_far[0]]), []).append(voxel)
    return [slabs[n] for n in sorted(slabs)]


def brute_force_items(scene: Scene, volume: CarvingVolume, occupied: NDArray[np.bool_]) -> NDArray[np.int64]:
    """First occupied voxel of each foreground pixel's ray by slab tests against every occupied voxel."""
    voxels = np.argwhere(occupied)
    low = volume.origin + voxels * volume.voxel_size
    flat = np.ravel_multi_index(tuple(voxels.T), volume.shape)
    answer = []
    for view in scene.views:
        center, rays = pixel_rays(view.K, view.cam_from_world, view.width, view.height)
        items = np.full((view.height, view.width), -1)
        for row, column in np.argwhere(view.silhouette):
            with np.errstate(divide="ignore"):
                a = (low - center) / rays[row, column]
                b = (low + volume.voxel_size - center) / rays[row, column]
            near, far = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
            hit = np.flatnonzero(near < far)
            if len(hit):
                items[row, column] = flat[hit[near[hit].argmin()]]
        answer.append(items)
    return np.stack(answer)


def matching_neighbours_twin(scene: Scene, places: NDArray[np.float64], most: int) -> list[list[int]]:
    """For each view the nearest others, by the places (m, 3) in the bounds that two views see."""
    n = len(scene.views)
    seen = [view.sees(places) for view in scene.views]

    @cache
    def angle(a: int, b: int) -> float:
        rays = [(scene.views[a].center - place, scene.views[b].center - place) for place in places[seen[a] & seen[b]]]
        between = [np.arctan2(np.linalg.norm(np.cross(one, two)), one @ two) for one, two in rays]
        return float(np.degrees(np.mean(between))) if between else np.inf

    def share(a: int, b: int) -> float:
        return float((seen[a] & seen[b]).sum() / seen[a].sum())

    @cache
    def nearness(a: int, b: int) -> float:
        ratios = []
        for place in places[seen[a] & seen[b]]:
            sizes = [np.linalg.norm(scene.views[k].center - place) / scene.cameras.focals[k] for k in (a, b)]
            ratios.append(max(sizes) / min(sizes))
        return round(angle(a, b) * max(np.mean(ratios) / 1.5, 1), 6)

    chosen = []
    for view in range(n):
        possible = [other for other in range(n) if other != view and 5 <= angle(view, other) <= 60]
        best = max((share(view, other) for other in possible), default=0)
        possible = [other for other in possible if share(view, other) >= 0.25 * best]
        others: list[int] = []
        for other in sorted(possible, key=lambda other, view=view: nearness(view, other)):  # type: ignore[misc]
            if not any(angle(other, known) < 5 and share(other, known) >= 0.5 for known in others):
                others.append(other)
        chosen.append(others[:most])
    return chosen


def point_at(view: View, pixel: Pixel, depth: float) -> NDArray[np.float64]:
    """World point (3,) that a pixel shows at a depth along the optical axis."""
    in_camera = depth * np.linalg.inv(view.K) @ [*pixel, 1]
    return np.asarray(np.linalg.inv(view.cam_from_world) @ [*in_camera, 1])[:3]


def nearest_sample(view: View, point: NDArray[np.float64], stride: int, shape: tuple[int, ...]) -> Pixel | None:
    """Row and column of the sample, of every stride-th pixel, that is nearest to a world point's image."""
    (pixel,), (depth,) = view.project(point[None])
    column, row = (floor(place / stride + 0.5) for place in pixel)
    return (row, column) if depth > 0 and 0 <= row < shape[0] and 0 <= column < shape[1] else None


def agreements_twin(scene: Scene, depths: NDArray[np.float32], stride: int, tolerance: float) -> NDArray[np.int64]:
    """(n_views, rows, columns) in how many other depth maps a pixel's point has its own depth."""
    counts = np.zeros(depths.shape, np.int64)
    for (n, row, column), depth in np.ndenumerate(depths):
        if depth > 0:
            point = point_at(scene.views[n], (stride * column, stride * row), float(depth))
            for j, other in enumerate(scene.views):
                at = nearest_sample(other, point, stride, depths.shape[1:])
                if j != n and at and depths[j][at] > 0:
                    counts[n, row, column] += abs(depths[j][at] - other.project(point[None])[1][0]) <= tolerance
    return counts


def fused_depths_twin(
    scene: Scene,
    points: NDArray[np.float64],
    depths: NDArray[np.float32],
    weights: NDArray[np.float32],
    stride: int,
    truncation: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weighted mean (n,) of how far world points (n, 3) lie behind the depth maps, and the sum (n,) of the weights."""
    distance, support = np.zeros(len(points)), np.zeros(len(points))
    for n, point in enumerate(points):
        votes = []
        for view, depth_map, weight_map in zip(scene.views, depths, weights, strict=True):
            at = nearest_sample(view, point, stride, depths.shape[1:])
            if at and weight_map[at] > 0:
                behind = float(view.project(point[None])[1][0]) - float(depth_map[at])
                if behind <= truncation:
                    votes.append((max(behind, -truncation), float(weight_map[at])))
        if votes:
            behind_all, weights_all = np.transpose(votes)
            distance[n], support[n] = np.average(behind_all, weights=weights_all), weights_all.sum()
    return distance, support
