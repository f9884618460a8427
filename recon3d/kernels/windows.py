"""Small windows of the views, resampled on a plane through each voxel."""

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.cameras import luminance, project
from recon3d.kernels.types import Cameras


@kernel(parallel=True)
def sample_windows(
    part: Part,
    centers: NDArray[np.float64],
    voxel_size: float,
    counts: NDArray[np.int64],
    cameras: Cameras,
    images: NDArray[np.uint8],
    windows: NDArray[np.float32],
) -> None:
    """Luminance (n, n_views, side, side) of points of a plane through each centre (n, 3); NaN: the view sees it not.

    The plane faces the mean direction of the views with counts (n, n_views) above 0. Its points lie one mean pixel
    footprint apart, or farther, so that they span the voxel.
    """
    n_views, side = counts.shape[1], windows.shape[2]
    projections, sizes = cameras.projections, cameras.sizes
    half = 0.5 * (side - 1)
    for n in span(part, centers.shape[0]):
        windows[n] = np.nan
        normal = np.zeros(3)
        spacing = 0.0
        seeing = 0
        for view in range(n_views):
            if counts[n, view] > 0:
                toward = cameras.centers[view] - centers[n]
                distance = np.sqrt(np.sum(toward * toward))
                normal += toward / distance
                spacing += distance / cameras.focals[view]
                seeing += 1
        if seeing == 0:
            continue
        spacing = max(spacing / seeing, voxel_size / side)
        length = np.sqrt(np.sum(normal * normal))
        if length < 1e-6:  # cameras opposite each other face no common plane
            normal[2] = length = 1.0
        normal /= length
        across = np.zeros(3)
        if abs(normal[2]) < 0.9:  # along the horizon
            across[0], across[1] = -normal[1], normal[0]
        else:
            across[0], across[2] = normal[2], -normal[0]
        across *= spacing / np.sqrt(np.sum(across * across))
        down = np.array(
            [
                normal[1] * across[2] - normal[2] * across[1],
                normal[2] * across[0] - normal[0] * across[2],
                normal[0] * across[1] - normal[1] * across[0],
            ]
        )
        for view in range(n_views):
            if counts[n, view] == 0:
                continue
            for sample in range(side * side):
                point = centers[n] + (sample // side - half) * down + (sample % side - half) * across
                u, v, depth = project(projections[view], point[0], point[1], point[2])
                if not (depth > 0.0 and 0.0 <= u <= sizes[view, 0] - 1 and 0.0 <= v <= sizes[view, 1] - 1):
                    windows[n, view] = np.nan
                    break
                u0 = min(int(u), sizes[view, 0] - 2)
                v0 = min(int(v), sizes[view, 1] - 2)
                value = 0.0
                for corner in range(4):
                    du, dv = corner & 1, corner >> 1
                    grey = luminance(images[view, v0 + dv, u0 + du])
                    value += (abs(1 - du - (u - u0))) * (abs(1 - dv - (v - v0))) * grey
                windows[n, view, sample // side, sample % side] = value
