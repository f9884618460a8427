"""Photographs to cameras, by structure from motion."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon3d.calibration.colmap import load_pycolmap
from recon3d.calibration.features import extract_features, feature_scales, match_features, matched_pairs
from recon3d.calibration.known_distance import KnownDistance, with_known_distance
from recon3d.calibration.mapping import map_photographs, refine_intrinsics
from recon3d.calibration.object_alone import with_object_alone
from recon3d.calibration.photographs import PhotoFile, duplicates, find_photographs, unread
from recon3d.calibration.reasons import advice, reasons_of
from recon3d.calibration.result import CalibratedCamera, Calibration, Observations, upright_world
from recon3d.calibration.settings import CalibrationSettings
from recon3d.calibration.writing import check_output, write_calibration
from recon3d.errors import CalibrationError
from recon3d.io.files import write_json
from recon3d.scene.image_file import read_image
from recon3d.tasks import StageProgress

WORK_FOLDER = ".calibration"
"""Folder in the output that keeps features, matches and the model, for a later run to continue from."""

_UNPLACED = "unplaced.json"


def calibrate(
    photographs: Path | str | Iterable[Path | str],
    output: Path | str,
    *,
    masks: Path | str | None = None,
    known_distance: KnownDistance | str | None = None,
    object_alone: bool = False,
    settings: CalibrationSettings | None = None,
    progress: StageProgress | None = None,
) -> Calibration:
    """Find the cameras of photographs of an object or a place, and write them as a scene.

    The focal lengths start from EXIF and are estimated with the distortion, one camera for each size and lens; the
    principal point is the middle of the picture where a camera has few views. The world is arbitrary: z up, origin
    among the points, cameras at a median distance of one. An interrupted run resumes, and photographs can be added.

    Parameters
    ----------
    photographs : a folder of JPEG, PNG or TIFF files, or files. Orientation is taken from EXIF.
    output : folder that gets ``images`` (undistorted), ``sparse/0`` (COLMAP), ``transforms.json`` (nerfstudio) and
        ``calibration.json`` (the photographs' own cameras, and which were not placed).
    masks : folder of masks, 0 where nothing must be matched, as on the background of a turntable.
    known_distance : between two points that can be found in the photographs, or its text
        ``a.jpg:812,400+b.jpg:790,405 a.jpg:210,410+b.jpg:190,420 = 120mm``. The world is then in metres.
    object_alone : find the bounds of what stands on a table or the ground, where one is recognised among the points;
        it is then the plane z = 0.
    progress : called with the stage's name, its steps that are done and how many it has. Whatever it raises ends the
        run, which can be resumed.

    Raises
    ------
    DataError : a photograph is missing or unreadable, or the output holds a scene of another origin.
    CalibrationError : pycolmap is missing, or too few photographs could be placed; says what to change.
    """
    settings = settings or CalibrationSettings()
    known = KnownDistance.parse(known_distance) if isinstance(known_distance, str) else known_distance
    report = _silent if progress is None else progress
    output = Path(output)
    found = find_photographs(photographs, masks=masks)
    repeated, others = duplicates(found), unread(photographs)
    distinct = [photograph for photograph in found if photograph.name not in repeated]
    if len(distinct) < 3:
        raise CalibrationError(f"expected at least 3 different photographs, got {len(distinct)}: add more")
    check_output(output, (photograph.path for photograph in found), WORK_FOLDER)
    load_pycolmap()
    work = output / WORK_FOLDER
    work.mkdir(parents=True, exist_ok=True)
    database = work / f"features-{_key(settings.max_image_size, settings.max_features, settings.seed)}.db"
    extract_features(database, distinct, settings, report)
    match_features(database, distinct, settings, report)
    kept = work / f"model-{_key(database.name, settings, *(photograph.digest for photograph in distinct))}"
    if not kept.is_dir():
        _make_model(database, distinct, settings, report, kept)
    unplaced = json.loads((kept / _UNPLACED).read_text(encoding="utf-8"))
    unplaced |= others | {name: f"the same file as {first}" for name, first in repeated.items()}
    model = load_pycolmap().Reconstruction(kept)
    calibration = upright_world(_calibration(model, distinct, dict(sorted(unplaced.items()))))
    if known is not None:
        calibration = with_known_distance(calibration, known)
    if object_alone:
        calibration = with_object_alone(calibration)
    write_calibration(calibration, output, report)
    return calibration


def _make_model(
    database: Path,
    photographs: Sequence[PhotoFile],
    settings: CalibrationSettings,
    progress: StageProgress,
    kept: Path,
) -> None:
    """Place the photographs and keep the model, and the reasons why others have no place in it."""
    digests = [photograph.digest for photograph in photographs]
    models = map_photographs(database, digests, settings, progress)
    pairs, scales = matched_pairs(database, digests), feature_scales(database, digests)
    groups = [_placed(model) for model in models]
    unplaced = reasons_of(photographs, groups, pairs, scales)
    n_placed = len(digests) - len(unplaced)
    if n_placed < max(3, settings.min_registered * len(digests)):
        listed = "".join(f"\n  {name}: {reason}" for name, reason in unplaced.items())
        raise CalibrationError(
            f"only {n_placed} of {len(digests)} photographs could be placed. "
            f"{advice(len(digests), pairs, scales)}{listed}"
        )
    model = refine_intrinsics(models[0], settings, progress)
    with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
        made = Path(folder) / "model"
        made.mkdir()
        model.write(made)
        write_json(made / _UNPLACED, unplaced)
        made.rename(kept)


def _placed(model: Any) -> set[str]:
    return {Path(image.name).stem for image in model.images.values() if image.has_pose}


def _calibration(model: Any, photographs: Sequence[PhotoFile], unplaced: Mapping[str, str]) -> Calibration:
    """A pycolmap model in recon3d's conventions: pixel centres at integers."""
    images = {Path(image.name).stem: image for image in model.images.values() if image.has_pose}
    placed = [photograph for photograph in photographs if photograph.digest in images]
    index = {point: n for n, point in enumerate(sorted(model.points3D))}
    cameras, views, points, pixels = [], [], [], []
    for n, photograph in enumerate(placed):
        image = images[photograph.digest]
        cameras.append(_camera(photograph, image, model.cameras[image.camera_id]))
        features = image.get_observation_points2D()
        views.append(np.full(len(features), n))
        points.append(np.array([index[feature.point3D_id] for feature in features], np.int64))
        pixels.append(np.array([feature.xy for feature in features]).reshape(-1, 2) - 0.5)
    seen = Observations(np.concatenate(views), np.concatenate(points), np.concatenate(pixels))
    places = np.array([model.points3D[point].xyz for point in sorted(model.points3D)])
    return Calibration(tuple(cameras), places, _colors(placed, seen, len(places)), seen, unplaced)


def _camera(photograph: PhotoFile, image: Any, camera: Any) -> CalibratedCamera:
    K = np.array(camera.calibration_matrix())
    K[:2, 2] -= 0.5
    distortion = np.zeros(5)
    distortion[: len(camera.params) - 3] = camera.params[3:]
    pose = np.eye(4)
    pose[:3] = image.cam_from_world().matrix()
    return CalibratedCamera(photograph.name, photograph.path, photograph.width, photograph.height, K, distortion, pose)


def _colors(photographs: Sequence[PhotoFile], seen: Observations, n_points: int) -> NDArray[np.uint8]:
    """(n, 3) mean RGB of the pixels that show each point."""
    total = np.zeros((n_points, 3))
    for n, photograph in enumerate(photographs):
        mine = seen.views == n
        image = read_image(photograph.path)
        u, v = np.rint(seen.pixels[mine]).astype(np.int64).T
        v, u = np.clip(v, 0, image.shape[0] - 1), np.clip(u, 0, image.shape[1] - 1)
        np.add.at(total, seen.points[mine], image[v, u])
    counts = np.bincount(seen.points, minlength=n_points)
    return np.rint(total / np.maximum(counts, 1)[:, None]).astype(np.uint8)


def _key(*parts: object) -> str:
    """Text that changes with pycolmap and with what is given."""
    text = repr((load_pycolmap().__version__, *parts))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _silent(_stage: str, _done: int, _total: int) -> None:
    pass
