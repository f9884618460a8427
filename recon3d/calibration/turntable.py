"""Cameras of photographs of an object on a turntable, by its angles.

The world stands on the platform: origin where the axis meets it, z up, metres. What turns in the photographs is the
object; in its own frame the camera goes round it, the other way.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon3d.calibration import turning_matches, turning_silhouettes
from recon3d.calibration.features import GUESS_FOCAL
from recon3d.calibration.photographs import PhotoFile, duplicates, find_photographs, unread
from recon3d.calibration.result import CalibratedCamera, Calibration
from recon3d.calibration.writing import check_output, write_calibration
from recon3d.errors import ArgumentError, CalibrationError
from recon3d.io.calibration_record import CALIBRATION_FILE
from recon3d.scene.camera import Camera
from recon3d.tasks import StageProgress

_AGREES = 2.0  # pixels from the epipolar line
_MIN_MATCHES = 50
_MIN_SHARE = 0.5  # of the matches that must agree
_MIN_EXPLAINED = 0.9  # of the silhouettes


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

    Tilt, pan and roll are adjusted to matches between neighbouring photographs. Where an object has too little texture
    for them, tilt and pan are adjusted to its silhouettes before a background of one color. Angles, distance and focal
    length are taken as they are, and so is the height, which only says where on the axis z is 0. Where matches or
    silhouettes say that the table turns the other way, it does, and the calibration's notes say so.

    Parameters
    ----------
    photographs : a folder of JPEG, PNG or TIFF files, or files, of one size.
    output : folder for the scene that ``calibrate`` writes too; None: nothing is written.

    Raises
    ------
    DataError : a photograph is missing or unreadable, or the output holds a scene of another origin.
    CalibrationError : matches or silhouettes do not agree with the angles, or there are neither.
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
    matches = turning_matches.matches_between(found, angles, progress)
    n_matches = sum(len(pair.pixels[0]) for pair in matches)
    if n_matches >= _MIN_MATCHES:
        poses, kept, sign = _by_matches(matches, K, angles, turntable, progress)
        how = f"{n_matches} matches"
    else:
        poses, sign = _by_silhouettes(found, K, angles, turntable, n_matches, progress)
        kept, how = np.zeros(n_matches, np.bool_), "silhouettes: there are too few matches"
    cameras = tuple(
        CalibratedCamera(photograph.name, photograph.path, photograph.width, photograph.height, K, np.zeros(5), pose)
        for photograph, pose in zip(found, poses, strict=True)
    )
    places, seen = turning_matches.triangulated(matches, cameras, kept)
    notes = {"turntable": "turns clockwise as seen from above" if sign * turntable.step < 0 else "counter-clockwise"}
    if sign < 0:
        notes["turntable"] = f"turns the other way than told: {notes['turntable']}"
    notes["pose of the camera"] = f"adjusted to {how}"
    grey = np.full((len(places), 3), 128, np.uint8)
    calibration = Calibration(cameras, places, grey, seen, unread(photographs), mm_per_unit=1000.0, notes=notes)
    if output is not None:
        write_calibration(calibration, output, progress)
    return calibration


def _by_matches(
    matches: Sequence[turning_matches.Pair],
    K: NDArray[np.float64],
    angles: NDArray[np.float64],
    turntable: Turntable,
    progress: StageProgress | None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], float]:
    """Poses (n, 4, 4), which matches (m,) agree with them, and -1 where the table turns the other way, else 1."""
    tried = []
    for n, sign in enumerate((1.0, -1.0)):
        if progress is not None:
            progress("turntable", n, 2)
        posed, start = partial(_posed, sign * angles, turntable), np.array([np.radians(turntable.tilt), 0.0, 0.0])
        tried.append((*turning_matches.fitted(matches, K, posed, start), sign))
    poses, distances, sign = max(tried, key=lambda each: float(np.mean(each[1] < _AGREES)))
    share = float(np.mean(distances < _AGREES))
    if share < _MIN_SHARE:
        raise CalibrationError(
            f"only {100 * share:.0f}% of {len(distances)} matches agree with the angles to {_AGREES:g} pixels. Does "
            f"the table turn by {turntable.step:g} degrees a photograph, in the order of the names, before a still "
            "camera?"
        )
    return poses, distances < _AGREES, sign


def _by_silhouettes(
    photographs: Sequence[PhotoFile],
    K: NDArray[np.float64],
    angles: NDArray[np.float64],
    turntable: Turntable,
    n_matches: int,
    progress: StageProgress | None,
) -> tuple[NDArray[np.float64], float]:
    """Poses (n, 4, 4) with which silhouettes explain each other, and -1 where the table turns the other way, else 1."""
    views = turning_silhouettes.reduced_views(photographs, K)
    if views is None:
        raise CalibrationError(
            f"only {n_matches} matches were found between neighbouring photographs, {_MIN_MATCHES} are needed, and the "
            "background is not of one color, which would show the silhouettes: take smaller steps, give the object "
            "texture, or let the turntable carry a printed board (recon3d board)"
        )
    tilt = np.radians(turntable.tilt)
    ways = {sign: partial(_posed, sign * angles, turntable) for sign in (1.0, -1.0)}
    tried = {sign: turning_silhouettes.fitted(views, way, tilt, adjust=False) for sign, way in ways.items()}
    if progress is not None:
        progress("turntable", 0, 1)
    sign = max(tried, key=lambda each: tried[each].explained)
    tilt, pan, share = turning_silhouettes.fitted(views, ways[sign], tilt, adjust=True)
    if progress is not None:
        progress("turntable", 1, 1)
    if share < _MIN_EXPLAINED:
        raise CalibrationError(
            f"only {n_matches} matches were found, and what lies in all silhouettes fills only {share:.0%} of the "
            f"average one. Does the table turn by {turntable.step:g} degrees a photograph, in the order of the names, "
            "before a still camera, and is nothing else to be seen before the background?"
        )
    return ways[sign](np.array([tilt, pan, 0.0])), sign


def _posed(angles: NDArray[np.float64], turntable: Turntable, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 4, 4) cam_from_world of tilt, pan and roll (3,), radians."""
    return _poses(angles, turntable.distance / 1000, turntable.height / 1000, *np.degrees(x))


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
