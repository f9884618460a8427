"""Whether principal points are half a pixel off: pixels counted from the image's corner taken for pixel centres.

All cameras' principal points are moved by the same two numbers until matches agree best. What that is for right cameras
is zero; of cameras that were calibrated only roughly it is anything, and small differences mean nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from recon3d.diagnosis.epipolar import Cameras, sampson_distances
from recon3d.diagnosis.finding import Finding
from recon3d.diagnosis.matches import Matches

_HALF = 0.5
_NEAR = 0.2  # pixels, from half a pixel in both directions
_KNOWN = 0.16  # pixels: standard deviation of the best shift, in both directions
_SIGMAS = 3.0  # of them it is away from zero, in one direction
_WIDTH = 0.3  # pixels; what disagrees by more counts less
_FEWEST = 200  # matches


def half_pixel_findings(matches: Matches, cameras: Cameras) -> list[Finding]:
    """The finding that cx and cy are half a pixel too large or too small, where matches are exact enough to tell."""
    if len(matches.pair) < _FEWEST:
        return []
    scale = 1 / float(np.median(cameras.reduced[:, 0, 0]))  # pixels of the photographs in a reduced one

    def distances(shift: NDArray[np.float64]) -> NDArray[np.float64]:
        return scale * sampson_distances(matches, _moved(cameras, shift))

    found = least_squares(distances, np.zeros(2), loss="cauchy", f_scale=_WIDTH)
    spread = 1.4826 * float(np.median(np.abs(found.fun)))
    try:
        deviations = spread * np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    except np.linalg.LinAlgError:
        return []
    sign = float(np.sign(found.x.sum()))
    known = deviations.max() <= _KNOWN and (np.abs(found.x) / deviations).max() >= _SIGMAS
    if not known or np.abs(found.x - sign * _HALF).max() > _NEAR:
        return []
    before, after = (float(np.median(np.abs(distances(np.full(2, x))))) for x in (0.0, sign * _HALF))
    if after >= before:
        return []
    small, change = ("small", "Add 0.5 to") if sign > 0 else ("large", "Subtract 0.5 from")
    return [
        Finding(
            "half pixel",
            f"The principal points are half a pixel too {small}: with others the matches agree to {after:.2f} instead "
            f"of {before:.2f} pixels. Here the upper left pixel's centre is (0, 0); in COLMAP, OpenGL and Metashape it "
            "is (0.5, 0.5).",
            f"{change} cx and cy.",
        )
    ]


def _moved(cameras: Cameras, shift: NDArray[np.float64]) -> Cameras:
    """Cameras with principal points moved by (2,) pixels."""
    K = cameras.K.copy()
    K[:, :2, 2] += shift
    return cameras._replace(K=K)
