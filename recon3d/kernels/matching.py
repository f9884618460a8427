"""Normalised cross-correlation of windows along the rays of pixels."""

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.cameras import project


@kernel(parallel=True)
def best_depths(
    part: Part,
    image: NDArray[np.float32],
    width: int,
    height: int,
    others: NDArray[np.float32],
    other_sizes: NDArray[np.int64],
    homographies: NDArray[np.float64],
    epipoles: NDArray[np.float64],
    pixels: NDArray[np.int64],
    nearest: NDArray[np.float64],
    farthest: NDArray[np.float64],
    step: float,
    radius: int,
    stride: int,
    min_deviation: float,
    depths: NDArray[np.float64],
    scores: NDArray[np.float64],
) -> None:
    """Depth at which the windows of a view's pixels (n, 2) agree best with other views, and that agreement.

    A pixel p at depth z lies at z * homographies[j] p + epipoles[j] in view j; windows stand parallel to the image.
    The score of a depth is the mean of the two best correlations; scores is -1 where there is none.
    """
    n_others = others.shape[0]
    half = radius // stride
    reach = stride * half
    count = (2 * half + 1) ** 2
    window = np.empty(count, np.float32)
    for n in span(part, pixels.shape[0]):
        scores[n] = -1.0
        u = pixels[n, 0]
        v = pixels[n, 1]
        if u < reach or v < reach or u >= width - reach or v >= height - reach:
            continue
        mean = np.float32(0.0)
        at = 0
        for dv in range(-reach, reach + 1, stride):
            for du in range(-reach, reach + 1, stride):
                window[at] = image[v + dv, u + du]
                mean += window[at]
                at += 1
        mean /= np.float32(count)
        power = 0.0
        for at in range(count):
            window[at] -= mean
            power += window[at] * window[at]
        if power < count * min_deviation * min_deviation:
            continue
        n_steps = int((farthest[n] - nearest[n]) / step) + 1
        previous = -1.0
        best_at = -1
        left = 0.0
        right = 0.0
        for s in range(n_steps):
            z = nearest[n] + s * step
            first = -1.0
            second = -1.0
            for j in range(n_others):
                ncc = _correlation(window, mean, power, u, v, z, half, stride, homographies[j], epipoles[j], others[j],
                                   other_sizes[j, 0], other_sizes[j, 1])  # fmt: skip
                if ncc > first:
                    second = first
                    first = ncc
                elif ncc > second:
                    second = ncc
            score = 0.5 * (first + second) if n_others > 1 else first
            if best_at == s - 1 and best_at >= 0:
                right = score
            if score > scores[n]:
                scores[n] = score
                best_at = s
                left = previous
                right = -1.0
            previous = score
        if best_at >= 0:
            offset = 0.0
            curvature = left - 2 * scores[n] + right
            if left > -1.0 and right > -1.0 and curvature < -1e-9:
                offset = 0.5 * (left - right) / curvature
            depths[n] = nearest[n] + (best_at + offset) * step


@kernel()
def _correlation(
    window: NDArray[np.float32],
    level: np.float32,
    power: float,
    u: int,
    v: int,
    z: float,
    half: int,
    stride: int,
    H: NDArray[np.float64],
    e: NDArray[np.float64],
    other: NDArray[np.float32],
    width: int,
    height: int,
) -> float:
    """Correlation of a centred window with its image in another view; -1 where that leaves the image.

    Within a window the homography is as good as its affine part, which needs no division a sample. The level, grey
    values near the other window's, keeps sums of squares small.
    """
    w = z * (H[2, 0] * u + H[2, 1] * v + H[2, 2]) + e[2]
    if w <= 0.0:
        return -1.0
    x = (z * (H[0, 0] * u + H[0, 1] * v + H[0, 2]) + e[0]) / w
    y = (z * (H[1, 0] * u + H[1, 1] * v + H[1, 2]) + e[1]) / w
    scale = z * stride / w
    xu = (H[0, 0] - x * H[2, 0]) * scale
    xv = (H[0, 1] - x * H[2, 1]) * scale
    yu = (H[1, 0] - y * H[2, 0]) * scale
    yv = (H[1, 1] - y * H[2, 1]) * scale
    wide = half * (abs(xu) + abs(xv)) + 1e-3
    high = half * (abs(yu) + abs(yv)) + 1e-3
    if not (x >= wide and y >= high and x + wide < width - 1.0 and y + high < height - 1.0):
        return -1.0
    total = np.float32(0.0)
    square = np.float32(0.0)
    product = np.float32(0.0)
    at = 0
    for dv in range(-half, half + 1):
        a = x + dv * xv - half * xu
        b = y + dv * yv - half * yu
        for _ in range(2 * half + 1):
            left = int(a)
            above = int(b)
            s = np.float32(a - left)
            t = np.float32(b - above)
            # Of a signed index numba asks whether it counts from the end.
            column, row = np.uint64(left), np.uint64(above)
            right, below = np.uint64(left + 1), np.uint64(above + 1)
            top = other[row, column] + s * (other[row, right] - other[row, column])
            bottom = other[below, column] + s * (other[below, right] - other[below, column])
            value = top + t * (bottom - top) - level
            total += value
            square += value * value
            product += value * window[at]
            at += 1
            a += xu
            b += yu
    variance = square - total * total / at
    if variance < np.float32(0.05) * at:  # rounding in single precision makes a flat window as uneven
        return -1.0
    return product / np.sqrt(power * variance)


@kernel(parallel=True)
def fuse_depths(
    part: Part,
    voxels: NDArray[np.int64],
    origin: NDArray[np.float64],
    size: float,
    projections: NDArray[np.float64],
    depth_maps: NDArray[np.float32],
    weights: NDArray[np.float32],
    stride: int,
    truncation: float,
    distance: NDArray[np.float64],
    support: NDArray[np.float64],
) -> None:
    """Weighted mean of truncated signed distances (positive behind the depth maps) at voxel centres (n, 3).

    Depth maps hold every stride-th pixel of every stride-th row. A voxel farther than the truncation behind a view's
    surface learns nothing from that view.
    """
    n_views, rows, columns = depth_maps.shape
    for n in span(part, voxels.shape[0]):
        x = origin[0] + (voxels[n, 0] + 0.5) * size
        y = origin[1] + (voxels[n, 1] + 0.5) * size
        z = origin[2] + (voxels[n, 2] + 0.5) * size
        total = 0.0
        weight = 0.0
        for view in range(n_views):
            u, v, depth = project(projections[view], x, y, z)
            if depth <= 0.0:
                continue
            column = int(np.floor(u / stride + 0.5))
            row = int(np.floor(v / stride + 0.5))
            if row < 0 or column < 0 or row >= rows or column >= columns or weights[view, row, column] <= 0.0:
                continue
            behind = depth - depth_maps[view, row, column]
            if behind > truncation:
                continue
            total += weights[view, row, column] * max(behind, -truncation)
            weight += weights[view, row, column]
        support[n] = weight
        if weight > 0.0:
            distance[n] = total / weight


@kernel(parallel=True)
def count_agreements(
    part: Part,
    projections: NDArray[np.float64],
    centers: NDArray[np.float64],
    world_from_pixel: NDArray[np.float64],
    depth_maps: NDArray[np.float32],
    stride: int,
    tolerance: float,
    counts: NDArray[np.int64],
) -> None:
    """In how many other views the depth map, where a pixel's point falls, has the point's own depth.

    Depth maps hold every stride-th pixel of every stride-th row, 0 where there is no depth; tolerance is far below
    any depth.
    """
    n_views, rows, columns = depth_maps.shape
    for line in span(part, n_views * rows):
        view = line // rows
        row = line % rows
        M = world_from_pixel[view]
        for column in range(columns):
            z = depth_maps[view, row, column]
            if z <= 0.0:
                continue
            u = column * stride
            v = row * stride
            x = centers[view, 0] + z * (M[0, 0] * u + M[0, 1] * v + M[0, 2])
            y = centers[view, 1] + z * (M[1, 0] * u + M[1, 1] * v + M[1, 2])
            w = centers[view, 2] + z * (M[2, 0] * u + M[2, 1] * v + M[2, 2])
            for other in range(n_views):
                a, b, depth = project(projections[other], x, y, w)
                if other == view or depth <= 0.0:
                    continue
                c = int(np.floor(a / stride + 0.5))
                r = int(np.floor(b / stride + 0.5))
                if 0 <= r < rows and 0 <= c < columns and abs(depth_maps[other, r, c] - depth) <= tolerance:
                    counts[view, row, column] += 1
