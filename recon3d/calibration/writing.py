"""A calibration as a scene on disk: undistorted photographs, a COLMAP model and ``transforms.json``."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.calibration.result import CalibratedCamera, Calibration, Observations
from recon3d.errors import DataError
from recon3d.io.calibration_record import CALIBRATION_FILE
from recon3d.io.files import write_json
from recon3d.scene.image_file import read_image
from recon3d.tasks import StageProgress

_JPEG = (".jpg", ".jpeg")
_QUALITY = 97
_PARTS = ("images", "sparse", "transforms.json", CALIBRATION_FILE)


def check_output(folder: Path, photographs: Iterable[Path], sign: str) -> None:
    """Refuse an output folder whose content would be overwritten though it is not an earlier calibration.

    Parameters
    ----------
    sign : name in the folder that only a calibration leaves.

    Raises
    ------
    DataError : it holds a scene of another origin, or the photographs lie where the undistorted ones go.
    """
    target = (folder / "images").resolve()
    if any(path.resolve().parent == target for path in photographs):
        raise DataError(f"{folder}: the undistorted photographs would replace those in {target}; choose another output")
    there = [part for part in _PARTS if (folder / part).exists()]
    if there and not (folder / sign).exists():
        raise DataError(f"{folder}: holds {', '.join(there)} that no calibration wrote; choose another output")


def write_calibration(calibration: Calibration, folder: Path | str, progress: StageProgress | None = None) -> Path:
    """Write undistorted photographs, COLMAP's text model and nerfstudio's ``transforms.json``; returns the folder.

    The files are complete or not there: they are made beside the folder's and moved into their places, the record
    ``calibration.json`` last. COLMAP and nerfstudio have the top left pixel's centre at (0.5, 0.5); nerfstudio's
    cameras look down their -z axis.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    undone = undistorted(calibration)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".scene-") as name:
        made = Path(name)
        (made / "images").mkdir()
        for n, (taken, camera) in enumerate(zip(calibration.cameras, undone.cameras, strict=True)):
            if progress is not None:
                progress("undistortion", n, len(undone.cameras))
            _write_picture(made / "images" / camera.name, undistort(read_image(taken.path), taken, camera))
        if progress is not None:
            progress("undistortion", len(undone.cameras), len(undone.cameras))
        (made / "sparse" / "0").mkdir(parents=True)
        _write_colmap(undone, made / "sparse" / "0")
        write_json(made / "transforms.json", _transforms(undone))
        write_json(made / CALIBRATION_FILE, _record(calibration))
        for part in reversed(_PARTS):
            _remove(folder / part)
        for part in _PARTS:
            (made / part).rename(folder / part)
    return folder


def undistorted(calibration: Calibration) -> Calibration:
    """The calibration of the photographs with their distortion undone, named as they are written."""
    old, new = calibration.cameras, tuple(map(_without_distortion, calibration.cameras))
    seen = calibration.observations
    pixels = np.empty_like(seen.pixels)
    for n, (camera, changed) in enumerate(zip(old, new, strict=True)):
        mine = seen.views == n
        if mine.any():
            points = cv2.undistortPoints(seen.pixels[mine][:, None], camera.K, camera.distortion, P=changed.K)
            pixels[mine] = points.reshape(-1, 2)
    return replace(calibration, cameras=new, observations=Observations(seen.views, seen.points, pixels))


def undistort(image: NDArray[np.uint8], taken: CalibratedCamera, wanted: CalibratedCamera) -> NDArray[np.uint8]:
    """The photograph (height, width, 3) as a camera without distortion at the same place takes it."""
    if not taken.distortion.any():
        return image
    size = (wanted.width, wanted.height)
    maps = cv2.initUndistortRectifyMap(taken.K, taken.distortion, np.eye(3), wanted.K, size, cv2.CV_32FC1)
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def _without_distortion(camera: CalibratedCamera) -> CalibratedCamera:
    """A camera whose picture the photograph fills to the corners, as little enlarged as that allows."""
    suffix = Path(camera.name).suffix.lower()
    name = camera.name if suffix in _JPEG else f"{Path(camera.name).stem}.png"
    if not camera.distortion.any():
        return replace(camera, name=name)
    w, h = camera.width - 1.0, camera.height - 1.0
    u, v = (np.linspace(0, side, 65) for side in (w, h))
    border = np.concatenate(
        [np.column_stack([u, np.full(65, y)]) for y in (0, h)] + [np.column_stack([np.full(65, x), v]) for x in (0, w)]
    )
    low, high = 0.5, 2.0
    for _ in range(30):
        zoom = (low + high) / 2
        rays = (border - camera.K[:2, 2]) / (zoom * np.diag(camera.K)[:2])
        placed = replace(camera, cam_from_world=np.eye(4)).project(np.column_stack([rays, np.ones(len(rays))]))
        inside = (placed >= 0).all() and (placed <= [w, h]).all()
        low, high = (low, zoom) if inside else (zoom, high)
    K = camera.K.copy()
    K[0, 0], K[1, 1] = high * K[0, 0], high * K[1, 1]
    return replace(camera, name=name, K=K, distortion=np.zeros(5))


def _write_picture(path: Path, image: NDArray[np.uint8]) -> None:
    options = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY] if path.suffix.lower() in _JPEG else []
    if not cv2.imwrite(str(path), image[..., ::-1], options):
        raise OSError(f"{path}: OpenCV could not write the image")


def _write_colmap(calibration: Calibration, folder: Path) -> None:
    """COLMAP's three text files, a PINHOLE camera for each photograph."""
    seen = calibration.observations
    cameras, images = [], []
    features = np.zeros(len(seen.views), np.int64)  # index of each observation in its photograph
    for n, camera in enumerate(calibration.cameras):
        K, pose = camera.K, camera.cam_from_world
        numbers = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5]
        cameras.append(f"{n + 1} PINHOLE {camera.width} {camera.height} {_text(numbers)}")
        mine = np.flatnonzero(seen.views == n)
        features[mine] = np.arange(len(mine))
        images.append(f"{n + 1} {_text([*quaternion(pose[:3, :3]), *pose[:3, 3]])} {n + 1} {camera.name}")
        shown = zip(seen.pixels[mine] + 0.5, seen.points[mine], strict=True)
        images.append(" ".join(f"{pixel[0]:.4f} {pixel[1]:.4f} {point + 1}" for pixel, point in shown))
    residuals = calibration.residuals
    order = np.argsort(seen.points, kind="stable")
    starts = np.searchsorted(seen.points[order], np.arange(len(calibration.points) + 1))
    points = []
    for n, (point, color) in enumerate(zip(calibration.points, calibration.colors, strict=True)):
        mine = order[starts[n] : starts[n + 1]]
        track = " ".join(f"{seen.views[m] + 1} {features[m]}" for m in mine)
        points.append(f"{n + 1} {_text(point)} {color[0]} {color[1]} {color[2]} {residuals[mine].mean():.4f} {track}")
    for name, lines, head in (
        ("cameras.txt", cameras, "CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"),
        (
            "images.txt",
            images,
            "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; POINTS2D[] as (X, Y, POINT3D_ID)",
        ),
        ("points3D.txt", points, "POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"),
    ):
        (folder / name).write_text(f"# {head}\n" + "".join(f"{line}\n" for line in lines), encoding="utf-8")


def _transforms(calibration: Calibration) -> dict[str, object]:
    """Cameras as nerfstudio describes them."""
    frames = []
    for camera in calibration.cameras:
        world_from_cam = np.linalg.inv(camera.cam_from_world) @ np.diag([1.0, -1.0, -1.0, 1.0])
        frames.append(
            {
                "file_path": f"images/{camera.name}",
                "transform_matrix": world_from_cam.tolist(),
                "w": camera.width,
                "h": camera.height,
                "fl_x": float(camera.K[0, 0]),
                "fl_y": float(camera.K[1, 1]),
                "cx": float(camera.K[0, 2] + 0.5),
                "cy": float(camera.K[1, 2] + 0.5),
            }
        )
    return {"camera_model": "OPENCV", "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "frames": frames}


def _record(calibration: Calibration) -> dict[str, object]:
    """What the photographs' own cameras are, and what was not placed."""
    bounds = calibration.bounds
    return {
        "name": calibration.cameras[0].path.absolute().parent.name,
        "summary": {key: str(value) for key, value in calibration.summary().items()},
        "mm_per_unit": calibration.mm_per_unit,
        "bounds": None if bounds is None else [bounds.low, bounds.high],
        "unplaced": dict(calibration.unplaced),
        "cameras": [
            {
                "name": camera.name,
                "width": camera.width,
                "height": camera.height,
                "K": camera.K.tolist(),
                "distortion": camera.distortion.tolist(),
                "cam_from_world": camera.cam_from_world.tolist(),
            }
            for camera in calibration.cameras
        ],
    }


def quaternion(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) unit quaternion w, x, y, z of a rotation (3, 3), by the eigenvector that K. Shepperd's cases select."""
    xx, yy, zz = np.diag(R)
    squares = np.array([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz])
    rows = np.array(
        [
            [squares[0], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], squares[1], R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]],
            [R[0, 2] - R[2, 0], R[1, 0] + R[0, 1], squares[2], R[2, 1] + R[1, 2]],
            [R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], squares[3]],
        ]
    )
    best = rows[squares.argmax()]
    return np.asarray(best / np.linalg.norm(best))


def _text(numbers: NDArray[np.float64] | list[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
