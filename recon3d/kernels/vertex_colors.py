"""Which views a vertex faces, and the colour that they agree on."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.cameras import bilinear, project
from recon3d.kernels.types import Camera, Cameras


class Vertices(NamedTuple):
    """Of a mesh."""

    points: NDArray[np.float64]
    """(n, 3) world."""
    normals: NDArray[np.float64]
    """(n, 3) outwards."""


class Samples(NamedTuple):
    """What a view shows of k vertices."""

    colors: NDArray[np.float64]
    """(k, 3) RGB, 0 to 255."""
    weights: NDArray[np.float64]
    """(k,); 0: the pixel is not trusted."""


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
def sample_view(
    part: Part,
    vertices: Vertices,
    chosen: NDArray[np.int64],
    camera: Camera,
    image: NDArray[np.uint8],
    trust: NDArray[np.float32],
    samples: Samples,
) -> None:
    """Pixels of an image (height, width, 3) at chosen vertices (k,), all of which the view sees.

    A pixel weighs trust (height, width) times cosine to the normal over footprint squared: how many pixels an area
    gets.
    """
    points, normals = vertices
    for k in span(part, len(chosen)):
        n = chosen[k]
        u, v, depth = project(camera.projection, points[n, 0], points[n, 1], points[n, 2])
        trusted = trust[int(v + 0.5), int(u + 0.5)]
        samples.weights[k] = 0.0
        if trusted <= 0:
            continue
        samples.weights[k] = trusted * pixels_for_area(points[n], normals[n], depth, camera)
        for channel in range(3):
            samples.colors[k, channel] = bilinear(image[:, :, channel], u, v, camera.size[0], camera.size[1])


@kernel()
def pixels_for_area(point: NDArray[np.float64], normal: NDArray[np.float64], depth: float, camera: Camera) -> float:
    """Pixels of a camera for an area of the surface at a point (3,): cosine to the normal over footprint squared."""
    along = square = 0.0
    for axis in range(3):
        sight = camera.center[axis] - point[axis]
        along += sight * normal[axis]
        square += sight * sight
    return along / np.sqrt(square) * (camera.focal / depth) ** 2


@kernel(parallel=True)
def agreed_colors(
    part: Part, samples: NDArray[np.float64], weights: NDArray[np.float64], colors: NDArray[np.float64]
) -> None:
    """Weighted median of what views show (n_views, n, 3) of vertices; those without any weight keep their colour."""
    n_views, n_points = weights.shape
    values = np.empty((3, n_views), np.float64)
    given = np.empty(n_views, np.float64)
    sorted_weights = np.empty(n_views, np.float64)
    for n in span(part, n_points):
        count = 0
        for view in range(n_views):
            if weights[view, n] <= 0.0:
                continue
            given[count] = weights[view, n]
            for channel in range(3):
                values[channel, count] = samples[view, n, channel]
            count += 1
        if count > 0:
            for channel in range(3):
                for k in range(count):
                    sorted_weights[k] = given[k]
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
