"""Statistics of a voxel's colours view by view: view j of voxel n owns view_starts[n, j] to view_starts[n, j + 1]."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span


@kernel(parallel=True)
def view_sums(
    part: Part,
    colors: NDArray[np.uint8],
    view_starts: NDArray[np.int64],
    sums: NDArray[np.int64],
    squares: NDArray[np.int64],
) -> None:
    """Sum of the colours (n, n_views, 3), and of their squares, all channels together (n, n_views)."""
    for n in span(part, sums.shape[0]):
        for view in range(sums.shape[1]):
            red = green = blue = square = np.int64(0)
            for pixel in range(view_starts[n, view], view_starts[n, view + 1]):
                r = np.int64(colors[pixel, 0])
                g = np.int64(colors[pixel, 1])
                b = np.int64(colors[pixel, 2])
                red += r
                green += g
                blue += b
                square += r * r + g * g + b * b
            sums[n, view, 0] = red
            sums[n, view, 1] = green
            sums[n, view, 2] = blue
            squares[n, view] = square


@kernel(parallel=True)
def largest_norms(
    part: Part, means: NDArray[np.float64], seen: NDArray[np.bool_], order: int, norms: NDArray[np.float64]
) -> None:
    """Largest norm between two seeing views' mean colours (n, n_views, 3): L1, L2, or of order 0 the maximum norm."""
    for n in span(part, means.shape[0]):
        largest = 0.0
        for j in range(means.shape[1]):
            if not seen[n, j]:
                continue
            for k in range(j):
                if not seen[n, k]:
                    continue
                red = abs(means[n, j, 0] - means[n, k, 0])
                green = abs(means[n, j, 1] - means[n, k, 1])
                blue = abs(means[n, j, 2] - means[n, k, 2])
                if order == 1:
                    norm = red + green + blue
                elif order == 2:
                    norm = np.sqrt(red * red + green * green + blue * blue)
                else:
                    norm = max(red, green, blue)
                largest = max(largest, norm)
        norms[n] = largest


@kernel(parallel=True)
def shared_bins(
    part: Part,
    colors: NDArray[np.uint8],
    view_starts: NDArray[np.int64],
    bins: int,
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    agreements: NDArray[np.float64],
) -> None:
    """Fraction of the pairs of seeing views whose RGB histograms have a filled bin in common; 1 without a pair.

    A channel's value c lies in its bins first[c] to last[c]. The bins of a view are bits of a row of words.
    """
    n_voxels = agreements.shape[0]
    n_views = view_starts.shape[1] - 1
    words = (bins**3 + 63) // 64
    filled = np.empty((n_views, words), np.uint64)
    for n in span(part, n_voxels):
        filled[:] = 0
        pairs = agreeing = 0
        for j in range(n_views):
            for pixel in range(view_starts[n, j], view_starts[n, j + 1]):
                red, green, blue = colors[pixel, 0], colors[pixel, 1], colors[pixel, 2]
                for r in range(first[red], last[red] + 1):
                    for g in range(first[green], last[green] + 1):
                        for b in range(first[blue], last[blue] + 1):
                            bit = (r * bins + g) * bins + b
                            filled[j, bit >> 6] |= np.uint64(1) << np.uint64(bit & 63)
            if view_starts[n, j] == view_starts[n, j + 1]:
                continue
            for k in range(j):
                if view_starts[n, k] == view_starts[n, k + 1]:
                    continue
                pairs += 1
                for word in range(words):
                    if filled[j, word] & filled[k, word]:
                        agreeing += 1
                        break
        agreements[n] = agreeing / pairs if pairs else 1.0


@kernel(parallel=True)
def cached_distances(
    part: Part,
    colors: NDArray[np.uint8],
    view_starts: NDArray[np.int64],
    directions: NDArray[np.float32],
    of_all: NDArray[np.float64],
    of_neighbours: NDArray[np.float64],
) -> None:
    """Largest distance between the most similar colours of two seeing views: of all pairs, and of angular neighbours.

    Neighbours are the edges of the minimum spanning tree of the angles between the directions (n, n_views, 3).
    """
    n_voxels, n_views = directions.shape[:2]
    cosine = np.empty(n_views, np.float64)
    nearest = np.empty(n_views, np.int64)
    outside = np.empty(n_views, np.bool_)
    for n in span(part, n_voxels):
        largest = 0
        first = -1
        left = 0
        for j in range(n_views):
            outside[j] = view_starts[n, j] < view_starts[n, j + 1]
            cosine[j] = -2.0
            if not outside[j]:
                continue
            first = j if first < 0 else first
            left += 1
            for k in range(j):
                if outside[k]:
                    largest = max(largest, _closest(colors, view_starts[n], j, k, largest))
        of_all[n] = np.sqrt(largest)

        # Prim's algorithm: join the view that is nearest to any one joined before.
        largest = 0
        joined = first
        while left > 1:
            outside[joined] = False
            left -= 1
            best = -1
            for j in range(n_views):
                if outside[j]:
                    dot = np.float64(0.0)
                    for axis in range(3):
                        dot += np.float64(directions[n, j, axis]) * np.float64(directions[n, joined, axis])
                    if dot > cosine[j]:
                        cosine[j] = dot
                        nearest[j] = joined
                    if best < 0 or cosine[j] > cosine[best]:
                        best = j
            joined = best
            largest = max(largest, _closest(colors, view_starts[n], joined, nearest[joined], largest))
        of_neighbours[n] = np.sqrt(largest)


@kernel()
def _closest(colors: NDArray[np.uint8], starts: NDArray[np.int64], j: int, k: int, enough: int) -> Any:
    """Smallest squared distance between a colour of view j and one of view k; stops at one that is small enough."""
    closest: Any = 3 * 255 * 255
    for p in range(starts[j], starts[j + 1]):
        for q in range(starts[k], starts[k + 1]):
            red = np.int64(colors[p, 0]) - np.int64(colors[q, 0])
            green = np.int64(colors[p, 1]) - np.int64(colors[q, 1])
            blue = np.int64(colors[p, 2]) - np.int64(colors[q, 2])
            closest = min(closest, red * red + green * green + blue * blue)
            if closest <= enough:
                return closest
    return closest
