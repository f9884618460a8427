"""Slanted windows: for every pixel the plane whose window agrees best with other views, and the planes' agreement.

A plane is three numbers at a pixel: inverse depth there, and its slopes along u and v; over the image the inverse
depth of a plane is exactly linear.
"""

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.cameras import project

NOTHING = 2.0
"""Cost where no window can be compared; 1 - NCC is at most that."""


@kernel(parallel=True)
def find_visible(
    part: Part,
    depth: NDArray[np.float32],
    normals: NDArray[np.float32],
    center: NDArray[np.float64],
    world_from_pixel: NDArray[np.float64],
    projections: NDArray[np.float64],
    centers: NDArray[np.float64],
    sizes: NDArray[np.int64],
    depths: NDArray[np.float32],
    stride: int,
    tolerance: float,
    min_cosine: float,
    visible: NDArray[np.uint32],
) -> None:
    """Bit j of every strided pixel: other view j sees the surface point there, by that view's own depth map.

    Depths are of all pixels, normals of the strided ones.
    """
    rows, columns = visible.shape
    for row in span(part, rows):
        for column in range(columns):
            u = column * stride
            v = row * stride
            d = depth[v, u]
            visible[row, column] = 0
            if d <= 0.0:
                continue
            n = normals[row, column]
            x = center[0] + d * (world_from_pixel[0, 0] * u + world_from_pixel[0, 1] * v + world_from_pixel[0, 2])
            y = center[1] + d * (world_from_pixel[1, 0] * u + world_from_pixel[1, 1] * v + world_from_pixel[1, 2])
            z = center[2] + d * (world_from_pixel[2, 0] * u + world_from_pixel[2, 1] * v + world_from_pixel[2, 2])
            for j in range(projections.shape[0]):
                a = centers[j, 0] - x
                b = centers[j, 1] - y
                c = centers[j, 2] - z
                facing = n[0] * a + n[1] * b + n[2] * c
                if facing < min_cosine * np.sqrt(a * a + b * b + c * c):
                    continue
                p, q, far = project(projections[j], x, y, z)
                if far <= 0.0:
                    continue
                s = int(np.floor(p + 0.5))
                t = int(np.floor(q + 0.5))
                if s < 1 or t < 1 or s >= sizes[j, 0] - 1 or t >= sizes[j, 1] - 1:
                    continue
                seen = False
                for dt in range(-1, 2):
                    for ds in range(-1, 2):
                        other = depths[j, t + dt, s + ds]
                        seen |= other > 0.0 and abs(other - far) <= tolerance
                if seen:
                    visible[row, column] |= np.uint32(1) << np.uint32(j)


@kernel(parallel=True)
def match_planes(
    part: Part,
    image: NDArray[np.float32],
    width: int,
    height: int,
    others: NDArray[np.float32],
    other_sizes: NDArray[np.int64],
    homographies: NDArray[np.float64],
    epipoles: NDArray[np.float64],
    visible: NDArray[np.uint32],
    nearest: NDArray[np.float32],
    farthest: NDArray[np.float32],
    stride: int,
    radius: int,
    spacing: int,
    contrast: float,
    min_deviation: float,
    most_views: int,
    ranges: NDArray[np.float64],
    parity: int,
    seed: int,
    planes: NDArray[np.float32],
    costs: NDArray[np.float32],
) -> None:
    """Half a red-black sweep of PatchMatch: a pixel tries its neighbours' planes, then random ones around its best.

    A pixel p with inverse depth w lies at homographies[j] p + w epipoles[j] in view j. Ranges hold for each random
    trial the largest change of inverse depth and of slope. Pixels of one parity read only those of the other.
    """
    rows, columns = costs.shape
    half = radius // spacing
    reach = half * spacing
    count = (2 * half + 1) ** 2
    window, weight, chosen = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(most_views, np.int64)
    for row in span(part, rows):
        state = np.uint64(row * 7919 + seed * 104729 + 12345)
        for column in range((row + parity) & 1, columns, 2):
            u = column * stride
            v = row * stride
            if visible[row, column] == 0 or u < reach or v < reach or u >= width - reach or v >= height - reach:
                continue
            power = _take_window(image, u, v, half, spacing, contrast, window, weight)
            if power < min_deviation * min_deviation:
                continue
            n_chosen = 0
            for j in range(others.shape[0]):
                if n_chosen < most_views and (visible[row, column] >> np.uint32(j)) & np.uint32(1):
                    chosen[n_chosen] = j
                    n_chosen += 1
            low = 1.0 / farthest[row, column]
            high = 1.0 / nearest[row, column]
            # As what later trials hold, so that one version of the cost is compiled.
            best_w = np.float64(planes[row, column, 0])
            best_u = np.float64(planes[row, column, 1])
            best_v = np.float64(planes[row, column, 2])
            best = _cost(window, weight, power, u, v, best_w, best_u, best_v, half, spacing, chosen[:n_chosen],
                         homographies, epipoles, others, other_sizes)  # fmt: skip
            # Neighbours at odd distances have the other parity.
            for trial in range(8 + ranges.shape[0]):
                if trial < 8:
                    step = 1 - 2 * (trial & 1) if trial < 4 else 3 - 6 * (trial & 1)
                    dr = step if (trial >> 1) & 1 else 0
                    dc = step - dr
                    r = row + dr
                    c = column + dc
                    if r < 0 or c < 0 or r >= rows or c >= columns or costs[r, c] >= NOTHING:
                        continue
                    wu = np.float64(planes[r, c, 1])
                    wv = np.float64(planes[r, c, 2])
                    w = planes[r, c, 0] - stride * (wu * dc + wv * dr)
                else:
                    state, a = _random(state)
                    state, b = _random(state)
                    state, d = _random(state)
                    change = np.float32(ranges[trial - 8, 0])
                    w = best_w + change * a if change < np.inf else low + np.float32(0.5) * (high - low) * (a + 1)
                    wu = best_u + np.float32(ranges[trial - 8, 1]) * b
                    wv = best_v + np.float32(ranges[trial - 8, 1]) * d
                if w < low or w > high:
                    continue
                cost = _cost(window, weight, power, u, v, w, wu, wv, half, spacing, chosen[:n_chosen],
                             homographies, epipoles, others, other_sizes)  # fmt: skip
                if cost < best:
                    best = cost
                    best_w = w
                    best_u = wu
                    best_v = wv
            planes[row, column, 0] = best_w
            planes[row, column, 1] = best_u
            planes[row, column, 2] = best_v
            costs[row, column] = best


@kernel()
def _take_window(
    image: NDArray[np.float32],
    u: int,
    v: int,
    half: int,
    spacing: int,
    contrast: float,
    window: NDArray[np.float32],
    weight: NDArray[np.float32],
) -> np.float32:
    """Window around a pixel less its mean, weights of sum one that fall with distance and difference; its variance."""
    center = image[v, u]
    total = np.float32(0.0)
    mean = np.float32(0.0)
    at = 0
    for dv in range(-half, half + 1):
        for du in range(-half, half + 1):
            value = image[v + dv * spacing, u + du * spacing]
            far = np.float32((du * du + dv * dv) / (2.0 * half * half))
            window[at] = value
            weight[at] = np.exp(-abs(value - center) / np.float32(contrast) - far)
            total += weight[at]
            mean += weight[at] * value
            at += 1
    mean /= total
    power = np.float32(0.0)
    for n in range(at):
        weight[n] /= total
        window[n] -= mean
        power += weight[n] * window[n] * window[n]
    return power


@kernel()
def _random(state: np.uint64) -> tuple[np.uint64, np.float32]:
    """Next state of a 64-bit linear congruence, and a number in [-1, 1)."""
    state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
    return state, np.float32(np.int64(state >> np.uint64(33)) / 1073741824.0 - 1.0)


@kernel()
def _cost(
    window: NDArray[np.float32],
    weight: NDArray[np.float32],
    power: float,
    u: int,
    v: int,
    w: float,
    wu: float,
    wv: float,
    half: int,
    spacing: int,
    chosen: NDArray[np.int64],
    homographies: NDArray[np.float64],
    epipoles: NDArray[np.float64],
    others: NDArray[np.float32],
    sizes: NDArray[np.int64],
) -> float:
    """Mean of the two smallest 1 - NCC over the chosen views; the only one's where there is one."""
    first = NOTHING
    second = NOTHING
    for j in chosen:
        cost = 1.0 - _correlation(
            window, weight, power, u, v, w, wu, wv, half, spacing, homographies[j], epipoles[j], others[j],
            sizes[j, 0], sizes[j, 1],
        )  # fmt: skip
        if cost < first:
            second = first
            first = cost
        elif cost < second:
            second = cost
    return first if len(chosen) == 1 else 0.5 * (first + second)


@kernel()
def _correlation(
    window: NDArray[np.float32],
    weight: NDArray[np.float32],
    power: float,
    u: int,
    v: int,
    w: float,
    wu: float,
    wv: float,
    half: int,
    spacing: int,
    H: NDArray[np.float64],
    e: NDArray[np.float64],
    other: NDArray[np.float32],
    width: int,
    height: int,
) -> float:
    """Weighted NCC of a centred window with its image in another view; -1 where that leaves the view.

    Within a window the plane's homography is as good as its affine part, which needs no division a sample.
    """
    z = H[2, 0] * u + H[2, 1] * v + H[2, 2] + w * e[2]
    if z <= 0.0:
        return -1.0
    x = (H[0, 0] * u + H[0, 1] * v + H[0, 2] + w * e[0]) / z
    y = (H[1, 0] * u + H[1, 1] * v + H[1, 2] + w * e[1]) / z
    zu = H[2, 0] + wu * e[2]
    zv = H[2, 1] + wv * e[2]
    xu = (H[0, 0] + wu * e[0] - x * zu) / z * spacing
    xv = (H[0, 1] + wv * e[0] - x * zv) / z * spacing
    yu = (H[1, 0] + wu * e[1] - y * zu) / z * spacing
    yv = (H[1, 1] + wv * e[1] - y * zv) / z * spacing
    wide = half * (abs(xu) + abs(xv)) + 1e-3
    high = half * (abs(yu) + abs(yv)) + 1e-3
    if not (x >= wide and y >= high and x + wide < width - 1.0 and y + high < height - 1.0):
        return -1.0
    mean = 0.0
    square = 0.0
    product = 0.0
    at = 0
    for dv in range(-half, half + 1):
        a = x + dv * xv - half * xu
        b = y + dv * yv - half * yu
        for _ in range(2 * half + 1):
            column = int(a)
            row = int(b)
            s = a - column
            t = b - row
            top = other[row, column] + s * (other[row, column + 1] - other[row, column])
            bottom = other[row + 1, column] + s * (other[row + 1, column + 1] - other[row + 1, column])
            value = top + t * (bottom - top)
            weighted = weight[at] * value
            mean += weighted
            square += weighted * value
            product += weighted * window[at]
            at += 1
            a += xu
            b += yu
    variance = square - mean * mean
    if variance < 0.25:
        return -1.0
    return product / np.sqrt(power * variance)


@kernel(parallel=True)
def average_planes(
    part: Part,
    projections: NDArray[np.float64],
    centers: NDArray[np.float64],
    world_from_pixel: NDArray[np.float64],
    images: NDArray[np.uint8],
    sizes: NDArray[np.int64],
    planes: NDArray[np.float32],
    normals: NDArray[np.float32],
    weights: NDArray[np.float32],
    asked: NDArray[np.int64],
    stride: int,
    tolerance: float,
    min_cosine: float,
    points: NDArray[np.float64],
    mean_normals: NDArray[np.float64],
    colors: NDArray[np.float64],
    support: NDArray[np.float64],
    agreeing: NDArray[np.int64],
    contradicting: NDArray[np.int64],
) -> None:
    """Mean place, normal, colour (0 to 255) and weight of each pixel's plane with those of other views that agree.

    Asked (n_views, k) are each view's others, up to a -1. One agrees whose plane passes within the tolerance of the
    point and faces the same way; it contradicts when it sees a surface farther than three tolerances behind the point.
    The means weigh views; place moves along the normal.
    """
    n_views, rows, columns = weights.shape
    for line in span(part, n_views * rows):
        view = line // rows
        row = line % rows
        M = world_from_pixel[view]
        for column in range(columns):
            own = weights[view, row, column]
            if own <= 0.0:
                continue
            u = column * stride
            v = row * stride
            d = 1.0 / planes[view, row, column, 0]
            x = centers[view, 0] + d * (M[0, 0] * u + M[0, 1] * v + M[0, 2])
            y = centers[view, 1] + d * (M[1, 0] * u + M[1, 1] * v + M[1, 2])
            z = centers[view, 2] + d * (M[2, 0] * u + M[2, 1] * v + M[2, 2])
            n = normals[view, row, column]
            total = np.float64(own)
            offset = 0.0
            for axis in range(3):
                mean_normals[view, row, column, axis] = own * n[axis]
                colors[view, row, column, axis] = own * images[view, v, u, axis]
            for other in asked[view]:
                if other < 0:
                    break
                a, b, depth = project(projections[other], x, y, z)
                if depth <= 0.0:
                    continue
                c = int(np.floor(a / stride + 0.5))
                r = int(np.floor(b / stride + 0.5))
                if r < 0 or c < 0 or r >= rows or c >= columns or weights[other, r, c] <= 0.0:
                    continue
                plane = planes[other, r, c]
                inverse = plane[0] + plane[1] * (a - c * stride) + plane[2] * (b - r * stride)
                behind = 1.0 / inverse - depth if inverse > 0.0 else np.inf
                m = normals[other, r, c]
                along = (
                    m[0] * (x - centers[other, 0]) + m[1] * (y - centers[other, 1]) + m[2] * (z - centers[other, 2])
                ) / depth
                if abs(along * behind) <= tolerance and n[0] * m[0] + n[1] * m[1] + n[2] * m[2] >= min_cosine:
                    q = np.float64(weights[other, r, c])
                    s = min(max(int(np.floor(a + 0.5)), 0), sizes[other, 0] - 1)
                    t = min(max(int(np.floor(b + 0.5)), 0), sizes[other, 1] - 1)
                    total += q
                    offset += q * along * behind
                    for axis in range(3):
                        mean_normals[view, row, column, axis] += q * m[axis]
                        colors[view, row, column, axis] += q * images[other, t, s, axis]
                    agreeing[view, row, column] += 1
                elif behind > 3.0 * tolerance:
                    contradicting[view, row, column] += 1
            length = 0.0
            for axis in range(3):
                length += mean_normals[view, row, column, axis] ** 2
            for axis in range(3):
                mean_normals[view, row, column, axis] /= np.sqrt(length)
                colors[view, row, column, axis] /= total
            points[view, row, column, 0] = x + offset / total * n[0]
            points[view, row, column, 1] = y + offset / total * n[1]
            points[view, row, column, 2] = z + offset / total * n[2]
            support[view, row, column] = total
