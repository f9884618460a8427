"""Cameras of photographs of an object on a turntable, by its angles.

The world stands on the platform: origin where the axis meets it, z up, metres. What turns in the photographs is the
object; in its own frame the camera goes round it, the other way.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from recon3d.calibration.epipolar import essential_matrix, sampson_distances
from recon3d.calibration.features import GUESS_FOCAL
from recon3d.calibration.photographs import PhotoFile, duplicates, find_photographs, unread
from recon3d.calibration.result import CalibratedCamera, Calibration, Observations
from recon3d.calibration.writing import check_output, write_calibration
from recon3d.errors import ArgumentError, CalibrationError
from recon3d.io.calibration_record import CALIBRATION_FILE
from recon3d.scene.camera import Camera
from recon3d.scene.image_file import read_image
from recon3d.tasks import StageProgress

_RATIO = 0.8  # of the nearest to the second nearest descriptor
_FAR = 45.0  # degrees: views farther apart are not matched
_STILL = 1.0  # pixels: what moves less is no part of what turns
_AGREES = 2.0  # pixels from the epipolar line
_MIN_MATCHES = 50
_MIN_SHARE = 0.5  # of the matches that must agree


@dataclass(frozen=True)
class Turntable:
    """How a camera stands before a turntable, and by how much that turns."""

    step: float
    """Degrees from photograph to photograph, counter-clockwise as seen from above."""
    distance: float
    """Of the camera's centre from the axis, millimetres; the scale of what is reconstructed."""
    height: float = 0.0
    """Of the camera's centre above the platform, millimetres."""
    tilt: float = 0.0
    """By which the camera looks down, degrees."""
    focal: float | None = None
    """Focal length, pixels; EXIF's when None."""

    def __post_init__(self) -> None:
        numbers = [getattr(self, field.name) for field in fields(self)]
        if not (np.isfinite([0.0 if n is None else n for n in numbers]).all() and self.step and self.distance > 0):
            raise ArgumentError(f"expected a step other than 0, a distance above 0 and finite numbers, got {self}")
        if self.focal is not None and self.focal <= 0:
            raise ArgumentError(f"expected a focal length above 0 pixels, got {self.focal}")

    @classmethod
    def parse(cls, text: str) -> Turntable:
        """The turntable of a text like ``step=10,distance=600,height=250,tilt=20``.

        Raises
        ------
        ArgumentError : another text.
        """
        found = re.findall(r"(\w+)=(-?\d+(?:\.\d*)?)(?:,|$)", text.replace(" ", ""))
        known = [field.name for field in fields(cls)]
        whole = ",".join(f"{name}={number}" for name, number in found) == text.replace(" ", "")
        if not whole or not {"step", "distance"} <= dict(found).keys() <= set(known):
            raise ArgumentError(
                f"expected a turntable like step=10,distance=600,height=250,tilt=20 of {', '.join(known)}, got {text!r}"
            )
        return cls(**{name: float(number) for name, number in found})


def turntable_cameras(
    K: ArrayLike,
    angles: ArrayLike,
    distance: float,
    height: float,
    tilt: float,
    *,
    pan: float = 0.0,
    roll: float = 0.0,
    size: tuple[int, int] | None = None,
) -> list[Camera]:
    """Cameras of photographs that were taken while a turntable stood at known angles, in the object's frame.

    Parameters
    ----------
    K : (3, 3), pixels.
    angles : (n,) degrees by which the table has turned, counter-clockwise as seen from above.
    distance : of the camera's centre from the axis, world units.
    height : of the camera's centre above the platform, where z is 0, world units.
    tilt : degrees by which the camera looks down.
    pan, roll : degrees by which it looks past the axis to its right, and is turned clockwise about its own axis.
    size : width and height of the photographs; twice the principal point when None.
    """
    intrinsic = np.asarray(K, np.float64)
    width, height_px = size or (round(2 * intrinsic[0, 2] + 1), round(2 * intrinsic[1, 2] + 1))
    poses = _poses(np.atleast_1d(np.asarray(angles, np.float64)), distance, height, tilt, pan, roll)
    return [Camera(intrinsic, pose, width, height_px) for pose in poses]


def cameras_from_turntable(
    photographs: Path | str | Iterable[Path | str],
    turntable: Turntable,
    *,
    output: Path | str | None = None,
    progress: StageProgress | None = None,
) -> Calibration:
    """Cameras of a turntable's photographs, in the order of their names, one step from each to the next.

    Tilt, pan and roll are adjusted to matches between neighbouring photographs. Angles, distance and focal length are
    taken as they are, and so is the height, which only says where on the axis z is 0. Where the matches say that the
    table turns the other way, it does, and the calibration's notes say so.

    Parameters
    ----------
    photographs : a folder of JPEG, PNG or TIFF files, or files, of one size.
    output : folder for the scene that ``calibrate`` writes too; None: nothing is written.

    Raises
    ------
    DataError : a photograph is missing or unreadable, or the output holds a scene of another origin.
    CalibrationError : the matches do not agree with the angles, or there are too few.
    """
    found = find_photographs(photographs)
    sizes = {(photograph.width, photograph.height) for photograph in found}
    if len(found) < 3 or len(sizes) > 1 or duplicates(found):
        raise CalibrationError(
            f"expected at least 3 different photographs of one size on a turntable, got {len(found)} of "
            f"{', '.join(f'{width}x{height}' for width, height in sorted(sizes))}, {len(duplicates(found))} repeated"
        )
    if output is not None:
        check_output(Path(output), (photograph.path for photograph in found), CALIBRATION_FILE)
    K = _intrinsic(found[0], turntable)
    angles = turntable.step * np.arange(len(found), dtype=np.float64)
    matches = _matches(found, angles, progress)
    n_matches = sum(len(pair.pixels[0]) for pair in matches)
    if n_matches < _MIN_MATCHES:
        raise CalibrationError(
            f"only {n_matches} matches were found between neighbouring photographs, {_MIN_MATCHES} are needed: take "
            "smaller steps, give the object texture, or let the turntable carry a printed board (recon3d board)"
        )
    if progress is not None:
        progress("turntable", 0, 2)
    tried = []
    for n, sign in enumerate((1.0, -1.0), start=1):
        tried.append((*_fitted(matches, K, sign * angles, turntable), sign))
        if progress is not None:
            progress("turntable", n, 2)
    poses, distances, sign = max(tried, key=lambda each: float(np.mean(each[1] < _AGREES)))
    share = float(np.mean(distances < _AGREES))
    if share < _MIN_SHARE:
        raise CalibrationError(
            f"only {100 * share:.0f}% of {n_matches} matches agree with the angles to {_AGREES:g} pixels. Does the "
            f"table turn by {turntable.step:g} degrees a photograph, in the order of the names, before a still camera?"
        )
    cameras = tuple(
        CalibratedCamera(photograph.name, photograph.path, photograph.width, photograph.height, K, np.zeros(5), pose)
        for photograph, pose in zip(found, poses, strict=True)
    )
    places, seen = _triangulated(matches, cameras, distances < _AGREES)
    notes = {"turntable": "turns clockwise as seen from above" if sign * turntable.step < 0 else "counter-clockwise"}
    if sign < 0:
        notes["turntable"] = f"turns the other way than told: {notes['turntable']}"
    grey = np.full((len(places), 3), 128, np.uint8)
    calibration = Calibration(cameras, places, grey, seen, unread(photographs), mm_per_unit=1000.0, notes=notes)
    if output is not None:
        write_calibration(calibration, output, progress)
    return calibration


class _Pair(NamedTuple):
    """Two photographs and what was matched between them."""

    views: tuple[int, int]
    pixels: tuple[NDArray[np.float64], NDArray[np.float64]]
    """(n, 2) each."""


def _intrinsic(photograph: PhotoFile, turntable: Turntable) -> NDArray[np.float64]:
    size = photograph.width, photograph.height
    f = turntable.focal or photograph.focal_length or GUESS_FOCAL * max(size)
    return np.array([[f, 0, (size[0] - 1) / 2], [0, f, (size[1] - 1) / 2], [0, 0, 1]])


def _poses(
    angles: NDArray[np.float64], distance: float, height: float, tilt: float, pan: float, roll: float
) -> NDArray[np.float64]:
    """(n, 4, 4) cam_from_world."""
    turns = [cv2.Rodrigues(np.radians(v) * np.eye(3)[k])[0] for v, k in ((-roll, 2), (tilt, 0), (-pan, 1))]
    own = turns[0] @ turns[1] @ turns[2]
    poses = np.tile(np.eye(4), (len(angles), 1, 1))
    for pose, angle in zip(poses, np.radians(-angles), strict=True):
        away = np.array([np.cos(angle), np.sin(angle), 0.0])
        level = np.array([[-away[1], away[0], 0], [0, 0, -1], -away])
        pose[:3, :3] = own @ level
        pose[:3, 3] = -pose[:3, :3] @ (distance * away + [0, 0, height])
    return poses


def _matches(
    photographs: Sequence[PhotoFile], angles: NDArray[np.float64], progress: StageProgress | None
) -> list[_Pair]:
    """Mutual matches of SIFT features between photographs of near angles, but for what stands still."""
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
        pairs.append(_Pair((a, b), (first[moved], second[moved])))
    return pairs


def _fitted(
    matches: Sequence[_Pair], K: NDArray[np.float64], angles: NDArray[np.float64], turntable: Turntable
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Poses (n, 4, 4) that agree best with the matches, and pixels (m,) of each match from its epipolar line."""
    distance, focal = turntable.distance / 1000, K[0, 0]
    inverse = np.linalg.inv(K)
    rays = [[np.column_stack([p, np.ones(len(p))]) @ inverse.T for p in pair.pixels] for pair in matches]

    def poses(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return _poses(angles, distance, turntable.height / 1000, *np.degrees(x))

    def residuals(x: NDArray[np.float64]) -> NDArray[np.float64]:
        found = poses(x)
        parts = []
        for pair, (first, second) in zip(matches, rays, strict=True):
            a, b = pair.views
            parts.append(focal * sampson_distances(essential_matrix(found[b] @ np.linalg.inv(found[a])), first, second))
        return np.concatenate(parts)

    x = np.array([np.radians(turntable.tilt), 0.0, 0.0])
    for width in (20.0, 1.0):  # pixels: first whatever is far off, too
        x = least_squares(residuals, x, loss="cauchy", f_scale=width).x
    return poses(x), residuals(x)


def _triangulated(
    matches: Sequence[_Pair], cameras: Sequence[CalibratedCamera], kept: NDArray[np.bool_]
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
    counts = [len(part) for part in places[1:]]
    starts = np.concatenate([[0], np.cumsum(counts)])
    index = [np.tile(np.arange(first, first + n), 2) for first, n in zip(starts[:-1], counts, strict=True)]
    seen = Observations(np.concatenate(views), np.concatenate(index).astype(np.int64), np.concatenate(pixels))
    return np.vstack(places), seen
