"""What kernels do with cameras and images: projection, values between pixels, luminance."""

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import kernel


@kernel()
def project(P: NDArray[np.float64], x: float, y: float, z: float) -> tuple[float, float, float]:
    """Pixel (u, v) of a point, and its depth; where that is not positive the pixel means nothing."""
    depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
    u = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / depth
    v = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / depth
    return u, v, depth


@kernel()
def unproject(
    center: NDArray[np.float64], world_from_pixel: NDArray[np.float64], u: int, v: int, depth: float
) -> tuple[float, float, float]:
    """Point (x, y, z) that a pixel shows at a depth."""
    M = world_from_pixel
    x = center[0] + depth * (M[0, 0] * u + M[0, 1] * v + M[0, 2])
    y = center[1] + depth * (M[1, 0] * u + M[1, 1] * v + M[1, 2])
    z = center[2] + depth * (M[2, 0] * u + M[2, 1] * v + M[2, 2])
    return x, y, z


@kernel()
def bilinear(image: NDArray[np.float32], u: float, v: float, width: int, height: int) -> float:
    """Value of an image at a sub-pixel place, the border's value beyond the outermost pixel centres."""
    u = min(max(u, 0.0), width - 1.0)
    v = min(max(v, 0.0), height - 1.0)
    u0 = min(int(u), width - 2)
    v0 = min(int(v), height - 2)
    a = u - u0
    b = v - v0
    return (1 - b) * ((1 - a) * image[v0, u0] + a * image[v0, u0 + 1]) + b * (
        (1 - a) * image[v0 + 1, u0] + a * image[v0 + 1, u0 + 1]
    )


@kernel()
def luminance(pixel: NDArray[np.uint8]) -> float:
    """Of an RGB pixel, by ITU-R BT.601."""
    return 0.299 * pixel[0] + 0.587 * pixel[1] + 0.114 * pixel[2]
