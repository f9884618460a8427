"""Which views see the surface that a view's pixels show."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.cameras import project, unproject
from recon3d.kernels.types import Camera, Cameras


class Surface(NamedTuple):
    """What a view sees of the carved surface."""

    camera: Camera
    """The view's."""
    depth: NDArray[np.float32]
    """(height, width) of all pixels along the optical axis, world units; 0 beside the surface."""
    normals: NDArray[np.float32]
    """(rows, columns, 3) at the matched pixels, unit, world, towards the camera; zero beside the surface."""
    stride: int
    """Pixels between matched pixels."""


@kernel(parallel=True)
def find_visible(
    part: Part,
    surface: Surface,
    others: Cameras,
    depths: NDArray[np.float32],
    tolerance: float,
    min_cosine: float,
    visible: NDArray[np.uint32],
) -> None:
    """Bit j of every matched pixel: other view j sees the surface point there, by its own depth map.

    Depths (n_others, height, width) are of all pixels of the others; 0 beside the surface.
    """
    camera, depth, normals, stride = surface
    projections, centers, sizes = others.projections, others.centers, others.sizes
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
            x, y, z = unproject(camera.center, camera.world_from_pixel, u, v, d)
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
