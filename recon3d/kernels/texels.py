"""What the texels of an atlas show: which triangle, which views see that, and what these agree on."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.cameras import bilinear, project
from recon3d.kernels.types import Camera
from recon3d.kernels.vertex_colors import pixels_for_area, weighted_median


class Charted(NamedTuple):
    """A mesh whose triangles have a place in an image; texels' centres are at integers."""

    points: NDArray[np.float64]
    """(n_points, 3) world."""
    normals: NDArray[np.float64]
    """(n_points, 3) outwards."""
    triangles: NDArray[np.int32]
    """(m, 3)."""
    places: NDArray[np.float64]
    """(m, 3, 2) column and row of the triangles' corners, texels."""


class Shown(NamedTuple):
    """What a view shows of the surface, pixel by pixel."""

    camera: Camera
    image: NDArray[np.uint8]
    """(height, width, 3) RGB."""
    coarse: NDArray[np.uint8]
    """(height, width, 3) the same without detail."""
    trust: NDArray[np.float32]
    """(height, width); 0: not asked."""
    inverse_depth: NDArray[np.float32]
    """(height, width) of the surface, 1 / world units; 0 beside it."""


class Best(NamedTuple):
    """The views that show each of n texels best, best first."""

    weights: NDArray[np.float32]
    """(n, k); 0: none."""
    colors: NDArray[np.uint8]
    """(n, k, 3) RGB."""
    coarse: NDArray[np.uint8]
    """(n, k, 3) without detail."""


@kernel()
def draw_triangles(places: NDArray[np.float64], owner: NDArray[np.int32]) -> None:
    """Write a triangle's number into the texels (rows, columns) whose centres lie in it, by corners (m, 3, 2)."""
    rows, columns = owner.shape
    for n in range(len(places)):
        (ax, ay), (bx, by), (cx, cy) = places[n, 0], places[n, 1], places[n, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        left, right = max(int(np.ceil(min(ax, bx, cx))), 0), min(int(np.floor(max(ax, bx, cx))), columns - 1)
        top, bottom = max(int(np.ceil(min(ay, by, cy))), 0), min(int(np.floor(max(ay, by, cy))), rows - 1)
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                to_b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
                to_c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                if to_b >= 0.0 and to_c >= 0.0 and to_b + to_c <= 1.0:
                    owner[y, x] = n


@kernel()
def grow_charts(owner: NDArray[np.int32], grown: NDArray[np.int32]) -> None:
    """Give texels without a triangle (rows, columns; -1) that of a neighbour; both begin equal."""
    rows, columns = owner.shape
    for y in range(rows):
        for x in range(columns):
            if owner[y, x] >= 0:
                continue
            for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                v, u = y + down, x + right
                if 0 <= v < rows and 0 <= u < columns and owner[v, u] >= 0:
                    grown[y, x] = owner[v, u]
                    break


@kernel(parallel=True)
def keep_best(
    part: Part,
    charted: Charted,
    texels: NDArray[np.int64],
    owners: NDArray[np.int32],
    columns: int,
    shown: Shown,
    clearance: float,
    best: Best,
) -> None:
    """Add what a view shows of texels (n,), numbered in an image of so many columns, where it is among the best.

    A view sees what faces it, and lies no farther behind the first surface than a share of the distance.
    """
    points, normals, triangles, places = charted
    camera, image, coarse, trust, inverse_depth = shown
    width, height = camera.size[0], camera.size[1]
    point, normal = np.empty(3), np.empty(3)
    weights = np.empty(3)
    n_kept = best.weights.shape[1]
    for n in span(part, len(texels)):
        triangle = owners[n]
        (ax, ay), (bx, by), (cx, cy) = places[triangle, 0], places[triangle, 1], places[triangle, 2]
        x, y = texels[n] % columns, texels[n] // columns
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        weights[1] = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
        weights[2] = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
        weights[0] = 1.0 - weights[1] - weights[2]
        towards = 0.0
        for axis in range(3):
            point[axis] = normal[axis] = 0.0
            for corner in range(3):
                point[axis] += weights[corner] * points[triangles[triangle, corner], axis]
                normal[axis] += weights[corner] * normals[triangles[triangle, corner], axis]
            towards += (camera.center[axis] - point[axis]) * normal[axis]
        if towards <= 0.0:
            continue
        u, v, depth = project(camera.projection, point[0], point[1], point[2])
        if not (depth > 0.0 and -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            continue
        trusted = trust[int(v + 0.5), int(u + 0.5)]
        if trusted <= 0.0 or 1.0 / depth < (1.0 - clearance) * bilinear(inverse_depth, u, v, width, height):
            continue
        weight = np.float32(trusted * pixels_for_area(point, normal, depth, camera))
        if weight <= best.weights[n, n_kept - 1]:
            continue
        place = n_kept - 1
        while place > 0 and best.weights[n, place - 1] < weight:
            best.weights[n, place] = best.weights[n, place - 1]
            for channel in range(3):
                best.colors[n, place, channel] = best.colors[n, place - 1, channel]
                best.coarse[n, place, channel] = best.coarse[n, place - 1, channel]
            place -= 1
        best.weights[n, place] = weight
        for channel in range(3):
            value = bilinear(image[:, :, channel], u, v, width, height)
            best.colors[n, place, channel] = np.uint8(value + 0.5)
            value = bilinear(coarse[:, :, channel], u, v, width, height)
            best.coarse[n, place, channel] = np.uint8(value + 0.5)


@kernel(parallel=True)
def blend(part: Part, best: Best, sharpness: float, colors: NDArray[np.float32]) -> None:
    """Colours (n, 3) that the best views of texels agree on; those without a view keep theirs.

    Without detail the views' weighted median counts, and what is added to it is the detail of the best views: their
    weighted mean, by a power of the weights.
    """
    n_kept = best.weights.shape[1]
    values, weights = np.empty(n_kept), np.empty(n_kept)
    for n in span(part, len(colors)):
        count = 0
        total = 0.0
        while count < n_kept and best.weights[n, count] > 0.0:
            total += (best.weights[n, count] / best.weights[n, 0]) ** sharpness
            count += 1
        if count == 0:
            continue
        for channel in range(3):
            detail = 0.0
            for k in range(count):
                values[k], weights[k] = best.coarse[n, k, channel], best.weights[n, k]
                difference = float(best.colors[n, k, channel]) - best.coarse[n, k, channel]
                detail += (best.weights[n, k] / best.weights[n, 0]) ** sharpness * difference
            colors[n, channel] = weighted_median(values[:count], weights[:count]) + detail / total
