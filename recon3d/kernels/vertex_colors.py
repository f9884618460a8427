"""Which views a vertex faces, and the colour that they agree on."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.cameras import bilinear, project
from recon3d.kernels.types import Cameras


class Vertices(NamedTuple):
    """Of a mesh."""

    points: NDArray[np.float64]
    """(n, 3) world."""
    normals: NDArray[np.float64]
    """(n, 3) outwards."""


@kernel(parallel=True)
def facing_views(
    part: Part,
    vertices: Vertices,
    cameras: Cameras,
    facing: NDArray[np.bool_],
) -> None:
    """Whether vertices lie in front of a camera, inside its image, and their normals towards it (n_views, n)."""
    points, normals = vertices
    projections, centers, sizes = cameras.projections, cameras.centers, cameras.sizes
    for n in span(part, len(points)):
        for view in range(len(centers)):
            u, v, depth = project(projections[view], points[n, 0], points[n, 1], points[n, 2])
            along = 0.0
            for axis in range(3):
                along += (centers[view, axis] - points[n, axis]) * normals[n, axis]
            inside = -0.5 <= u < sizes[view, 0] - 0.5 and -0.5 <= v < sizes[view, 1] - 0.5
            facing[view, n] = depth > 0 and inside and along > 0


@kernel(parallel=True)
def agreed_colors(
    part: Part,
    vertices: Vertices,
    seen: NDArray[np.bool_],
    cameras: Cameras,
    images: NDArray[np.uint8],
    trust: NDArray[np.float32],
    colors: NDArray[np.float64],
) -> None:
    """Weighted median of the pixels (n_views, height, width, 3) at vertices that views see (n_views, n).

    A pixel weighs trust (n_views, height, width) times cosine to the normal over footprint squared: how many pixels an
    area gets. Vertices that no pixel with any trust shows keep their colour.
    """
    projections, centers, sizes = cameras.projections, cameras.centers, cameras.sizes
    points, normals = vertices
    n_points, n_views = len(points), len(images)
    values = np.empty((3, n_views), np.float64)
    weights = np.empty(n_views, np.float64)
    sorted_weights = np.empty(n_views, np.float64)
    for n in span(part, n_points):
        count = 0
        for view in range(n_views):
            if not seen[view, n]:
                continue
            u, v, depth = project(projections[view], points[n, 0], points[n, 1], points[n, 2])
            trusted = trust[view, int(v + 0.5), int(u + 0.5)]
            if trusted <= 0:
                continue
            along = square = 0.0
            for axis in range(3):
                sight = centers[view, axis] - points[n, axis]
                along += sight * normals[n, axis]
                square += sight * sight
            weights[count] = trusted * along / np.sqrt(square) * (cameras.focals[view] / depth) ** 2
            for channel in range(3):
                values[channel, count] = bilinear(images[view, :, :, channel], u, v, sizes[view, 0], sizes[view, 1])
            count += 1
        if count > 0:
            for channel in range(3):
                for k in range(count):
                    sorted_weights[k] = weights[k]
                colors[n, channel] = weighted_median(values[channel, :count], sorted_weights[:count])


@kernel()
def weighted_median(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Value at half the weight, linear between values whose own weights are centred on them; sorts both in place."""
    total = weights[0]
    for n in range(1, len(values)):
        value, weight = values[n], weights[n]
        total += weight
        k = n
        while k > 0 and values[k - 1] > value:
            values[k], weights[k] = values[k - 1], weights[k - 1]
            k -= 1
        values[k], weights[k] = value, weight
    below = 0.5 * weights[0]  # weight up to the middle of this value
    for n in range(1, len(values)):
        if below >= 0.5 * total:
            return values[n - 1]
        step = 0.5 * (weights[n - 1] + weights[n])
        if below + step >= 0.5 * total:
            return values[n - 1] + (values[n] - values[n - 1]) * (0.5 * total - below) / step
        below += step
    return values[-1]
