"""Matches between photographs of what turns, and the pose of the camera that agrees with them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from recon3d.calibration.epipolar import essential_matrix, sampson_distances
from recon3d.calibration.photographs import PhotoFile
from recon3d.calibration.result import CalibratedCamera, Observations
from recon3d.calibration.turning_silhouettes import Poses
from recon3d.scene.image_file import read_image
from recon3d.tasks import StageProgress

_RATIO = 0.8  # of the nearest to the second nearest descriptor
_FAR = 45.0  # degrees: views farther apart are not matched
_STILL = 1.0  # pixels: what moves less is no part of what turns


class Pair(NamedTuple):
    """Two photographs and what was matched between them."""

    views: tuple[int, int]
    pixels: tuple[NDArray[np.float64], NDArray[np.float64]]
    """(n, 2) each."""


def matches_between(
    photographs: Sequence[PhotoFile], angles: NDArray[np.float64], progress: StageProgress | None
) -> list[Pair]:
    """Mutual matches of SIFT features between photographs of near angles, but for what stands still.

    Parameters
    ----------
    angles : (n,) degrees by which the table has turned.
    """
    sift, matcher, features = (
        cv2.SIFT.create(4000, enable_precise_upscale=True),
        cv2.BFMatcher(cv2.NORM_L2, crossCheck=False),
        [],
    )
    for n, photograph in enumerate(photographs):
        if progress is not None:
            progress("features", n, len(photographs))
        keypoints, found = sift.detectAndCompute(cv2.cvtColor(read_image(photograph.path), cv2.COLOR_RGB2GRAY), None)
        pixels = np.array([point.pt for point in keypoints], np.float64).reshape(-1, 2)
        features.append((pixels, found if found is not None else np.zeros((0, 128), np.float32)))
    pairs = []
    for a, b in combinations(range(len(photographs)), 2):
        apart = abs((angles[b] - angles[a] + 180) % 360 - 180)
        if not 0 < apart <= max(_FAR, abs(angles[1])) or min(len(features[n][1]) for n in (a, b)) < 2:
            continue
        forth, back = (matcher.knnMatch(features[i][1], features[j][1], k=2) for i, j in ((a, b), (b, a)))
        nearest = {match[0].queryIdx: match[0].trainIdx for match in back}
        good = [
            (one.queryIdx, one.trainIdx)
            for one, two in forth
            if one.distance < _RATIO * two.distance and nearest.get(one.trainIdx) == one.queryIdx
        ]
        if not good:
            continue
        first, second = (features[n][0][list(index)] for n, index in zip((a, b), zip(*good, strict=True), strict=True))
        moved = np.linalg.norm(first - second, axis=1) > _STILL
        pairs.append(Pair((a, b), (first[moved], second[moved])))
    return pairs


def fitted(
    matches: Sequence[Pair], K: NDArray[np.float64], poses: Poses, start: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Poses (n, 4, 4) that agree best with the matches, and pixels (m,) of each match from its epipolar line."""
    focal = K[0, 0]
    inverse = np.linalg.inv(K)
    rays = [[np.column_stack([p, np.ones(len(p))]) @ inverse.T for p in pair.pixels] for pair in matches]

    def residuals(x: NDArray[np.float64]) -> NDArray[np.float64]:
        found = poses(x)
        parts = []
        for pair, (first, second) in zip(matches, rays, strict=True):
            a, b = pair.views
            parts.append(focal * sampson_distances(essential_matrix(found[b] @ np.linalg.inv(found[a])), first, second))
        return np.concatenate(parts)

    x = start
    for width in (20.0, 1.0):  # pixels: first whatever is far off, too
        x = least_squares(residuals, x, loss="cauchy", f_scale=width).x
    return poses(x), residuals(x)


def triangulated(
    matches: Sequence[Pair], cameras: Sequence[CalibratedCamera], kept: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], Observations]:
    """Points (n, 3) of the matches that are kept, each seen by two photographs."""
    P = [camera.K @ camera.cam_from_world[:3] for camera in cameras]
    places, views, pixels = [np.zeros((0, 3))], [], []
    start = 0
    for pair in matches:
        n = len(pair.pixels[0])
        mine, start = kept[start : start + n], start + n
        a, b = (p[mine] for p in pair.pixels)
        if not len(a):
            continue
        points = cv2.triangulatePoints(P[pair.views[0]], P[pair.views[1]], a.T, b.T)
        places.append((points[:3] / points[3]).T)
        views.append(np.repeat(np.array(pair.views), len(a)))
        pixels.append(np.vstack([a, b]))
    if not views:
        nothing = np.zeros(0, np.int64)
        return places[0], Observations(nothing, nothing, np.zeros((0, 2)))
    counts = [len(part) for part in places[1:]]
    starts = np.concatenate([[0], np.cumsum(counts)])
    index = [np.tile(np.arange(first, first + n), 2) for first, n in zip(starts[:-1], counts, strict=True)]
    seen = Observations(np.concatenate(views), np.concatenate(index).astype(np.int64), np.concatenate(pixels))
    return np.vstack(places), seen
