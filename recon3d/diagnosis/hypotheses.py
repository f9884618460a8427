"""The classical mistakes, each as the change of cameras that undoes it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.diagnosis.epipolar import Cameras
from recon3d.scene.not_seen import FLIP

_SCALES = (2.0, 3.0, 4.0, 8.0, 0.5, 1 / 3, 0.25, 0.125)
_FOCAL_SCALES = tuple(float(2 ** (k / 4)) for k in range(-8, 9) if k)


class Hypothesis(NamedTuple):
    """A mistake, and how cameras are that have it undone."""

    kind: str
    message: str
    advice: str
    undone: Callable[[Cameras], Cameras]


def usual_mistakes(names: Sequence[str]) -> Iterator[Hypothesis]:
    """Mistakes to try, the simplest first."""
    yield from _AXES
    yield from _INTRINSICS
    yield from _orders(names)
    yield _TURNTABLE
    yield from _PIXELS


def focal_lengths() -> Iterator[Hypothesis]:
    """Wrong focal lengths, which are tried where no classical mistake explains the matches."""
    for scale in _FOCAL_SCALES:
        yield Hypothesis(
            "focal length",
            f"the focal lengths are wrong by a factor: with about {scale:.2g} times as many pixels the matches agree.",
            "Check fx and fy: they are in pixels of these very photographs, not millimetres, and not of a crop.",
            partial(_zoomed, scale),
        )


def _zoomed(scale: float, cameras: Cameras) -> Cameras:
    return cameras._replace(K=cameras.K @ np.diag([scale, scale, 1.0]))


def _posed(change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Callable[[Cameras], Cameras]:
    return lambda cameras: cameras._replace(poses=change(cameras.poses))


def _with(poses: NDArray[np.float64], R: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
    changed = poses.copy()
    changed[:, :3, :3], changed[:, :3, 3] = R, t
    return changed


def _R(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    return poses[:, :3, :3]


def _t(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    return poses[:, :3, 3]


def _inverse(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.linalg.inv(poses), np.float64)


_INVERT = "Give world-to-camera matrices: cam_from_world is the inverse of the camera's pose."
_TO_OPENCV = "Negate the camera's y and z axes: numpy.diag([1, -1, -1, 1]) @ cam_from_world."
_AXES = (
    Hypothesis(
        "opengl axes",
        "the cameras' axes are OpenGL's (y up, z backward), not OpenCV's (y down, z forward).",
        _TO_OPENCV,
        _posed(lambda poses: FLIP @ poses),
    ),
    Hypothesis(
        "camera to world",
        "the matrices are camera-to-world, not world-to-camera.",
        _INVERT,
        _posed(_inverse),
    ),
    Hypothesis(
        "camera to world, opengl axes",
        "the matrices are camera-to-world, and their axes are OpenGL's (y up, z backward).",
        f"{_INVERT} {_TO_OPENCV}",
        _posed(lambda poses: FLIP @ _inverse(poses)),
    ),
    Hypothesis(
        "R transposed",
        "R is transposed, t is not.",
        "Give R transposed, and t as it is.",
        _posed(lambda poses: _with(poses, _R(poses).transpose(0, 2, 1), _t(poses))),
    ),
    Hypothesis(
        "t is the centre",
        "t is the camera's centre C, not -R C.",
        "Give t = -R @ C.",
        _posed(lambda poses: _with(poses, _R(poses), -np.einsum("nij,nj->ni", _R(poses), _t(poses)))),
    ),
    Hypothesis(
        "t negated",
        "t has the wrong sign, so that the scene lies behind the cameras.",
        "Negate t.",
        _posed(lambda poses: _with(poses, _R(poses), -_t(poses))),
    ),
)


def _of_pixels(
    change: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
) -> Callable[[Cameras], Cameras]:
    """K changed by a function of one K (3, 3) and the size (2,) of its photograph."""
    return lambda c: c._replace(K=np.array([change(K, size) for K, size in zip(c.K, c.sizes, strict=True)]))


def _scaled(scale: float) -> Callable[[Cameras], Cameras]:
    # Pixel centres are at integers: u + 0.5 is scaled.
    S = np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2], [0, 0, 1]])
    return lambda c: c._replace(K=S @ c.K)


def _denormalised(K: NDArray[np.float64], by: NDArray[np.float64]) -> NDArray[np.float64]:
    # Where K is normalised, the image's corner is the origin, not the first pixel's centre.
    return np.asarray(np.array([[by[0], 0, -0.5], [0, by[1], -0.5], [0, 0, 1.0]]) @ K)


def _turned(quarters: int) -> Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]:
    """K of a photograph that was turned by quarters, clockwise, after the camera was calibrated."""

    def change(K: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.float64]:
        w, h = size - 1
        turns = {
            1: np.array([[0, -1, w], [1, 0, 0], [0, 0, 1.0]]),
            2: np.array([[-1, 0, w], [0, -1, h], [0, 0, 1.0]]),
            3: np.array([[0, 1, 0], [-1, 0, h], [0, 0, 1.0]]),
        }
        return turns[quarters] @ K

    return change


def _centered(K: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.float64]:
    centered = K.copy()
    centered[:2, 2] = (size - 1) / 2
    return centered


def _swapped(K: NDArray[np.float64], _size: NDArray[np.float64]) -> NDArray[np.float64]:
    swapped = K.copy()
    swapped[:2, 2] = K[[1, 0], 2]
    return swapped


_SAME_PHOTOGRAPHS = "Give the photographs as they were calibrated, or change K with them."
_INTRINSICS = (
    Hypothesis(
        "K normalised",
        "K is in units of the image's width and height, not in pixels.",
        "Multiply the first row of K by the width and the second by the height.",
        _of_pixels(lambda K, size: _denormalised(K, size)),
    ),
    Hypothesis(
        "K normalised",
        "K is in units of the image's width, not in pixels.",
        "Multiply the first two rows of K by the width.",
        _of_pixels(lambda K, size: _denormalised(K, size[[0, 0]])),
    ),
    *(
        Hypothesis(
            "K of another size",
            f"K is that of photographs {f'{1 / scale:.3g} times' if scale < 1 else f'1/{scale:.3g}'} as large.",
            f"Give those photographs, or multiply the first two rows of K by {scale:.3g}.",
            _scaled(scale),
        )
        for scale in _SCALES
    ),
    Hypothesis(
        "principal point",
        "the principal point is wrong; with the middle of the image the matches agree.",
        "Check cx and cy: they are in pixels from the upper left pixel's centre, x first.",
        _of_pixels(_centered),
    ),
    Hypothesis(
        "principal point",
        "the principal point's x and y are exchanged.",
        "Give cx in the first row of K, cy in the second.",
        _of_pixels(_swapped),
    ),
)
_PIXELS = (
    Hypothesis(
        "mirrored",
        "the photographs are the mirror image of what the cameras saw, left and right exchanged: either the "
        "photographs or the world are mirrored.",
        "Mirror the photographs back, or negate one axis of the world in all cameras and the bounds.",
        _of_pixels(lambda K, size: np.array([[-1, 0, size[0] - 1], [0, 1, 0], [0, 0, 1.0]]) @ K),
    ),
    Hypothesis(
        "rows from below",
        "the photographs are upside down against the cameras: rows are counted from below, or the world is mirrored.",
        "Count rows from above: cy becomes height - 1 - cy, and y points down.",
        _of_pixels(lambda K, size: np.array([[1, 0, 0], [0, -1, size[1] - 1], [0, 0, 1.0]]) @ K),
    ),
    *(
        Hypothesis("photographs turned", f"the photographs were turned {how} after calibration.",
                   _SAME_PHOTOGRAPHS, _of_pixels(_turned(quarters)))
        for quarters, how in ((2, "by 180 degrees"), (1, "clockwise"), (3, "counter-clockwise"))
    ),
)  # fmt: skip


def reordered(cameras: Cameras, order: NDArray[np.int64]) -> Cameras:
    """Photograph n with the camera of photograph order[n]; order (n_views,)."""
    return cameras._replace(K=cameras.K[order], poses=cameras.poses[order])


def _orders(names: Sequence[str]) -> Iterator[Hypothesis]:
    n = len(names)
    by_text = np.array(sorted(range(n), key=lambda k: str(k + 1)), np.int64)
    ways = [
        ("images reversed", "in reversed order", np.arange(n)[::-1].copy()),
        ("images in another order", "sorted as text (1, 10, 11, 2) against sorted as numbers", np.argsort(by_text)),
        ("images in another order", "sorted as numbers against sorted as text (1, 10, 11, 2)", by_text),
        *(
            ("images shifted", f"shifted by {min(k, n - k)}: the first photograph needs the camera of {names[-k]}",
             np.roll(np.arange(n), k))
            for k in sorted(range(1, n), key=lambda k: min(k, n - k))
        ),
    ]  # fmt: skip
    for kind, how, order in ways:
        yield Hypothesis(
            kind,
            f"photographs and cameras are in different orders, {how}.",
            "Give each camera with the name of its photograph.",
            partial(reordered, order=order),
        )


_TURNTABLE = Hypothesis(
    "turntable reversed",
    "the turntable turned the other way.",
    "Negate the angles that the cameras were made from.",
    _posed(lambda poses: poses[0] @ np.linalg.inv(poses) @ poses[0]),
)
