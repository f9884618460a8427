"""SIFT features and their matches, kept in a database that a later run continues.

References
----------
D. Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 60(2), 2004.
J. L. Schönberger, J.-M. Frahm, "Structure-from-motion revisited", CVPR 2016.
C. Wu, "Towards linear-time incremental structure from motion", 3DV 2013 (preemptive matching).
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.calibration.colmap import load_pycolmap
from recon3d.calibration.photographs import PhotoFile
from recon3d.calibration.settings import CalibrationSettings
from recon3d.errors import DataError
from recon3d.scene.image_file import read_image
from recon3d.tasks import StageProgress

MIN_INLIERS = 15
"""Matches that agree with one epipolar geometry, below which two photographs do not overlap."""

_PAIRS_A_STEP = 200
GUESS_FOCAL = 1.2
"""Focal length of a normal lens, of the longer side."""

_COARSEST = 200  # features of the preemptive matching
_PARTNERS = 20  # that it finds for a photograph
_WINDOW = 10  # photographs before and after, matched in any case


@dataclass(frozen=True)
class Pair:
    """What was found between two photographs."""

    first: str
    second: str
    """Names in the database."""
    inliers: int
    """Matches that agree with one geometry."""
    panoramic: bool
    """Whether a rotation about one spot explains them."""


@contextmanager
def open_database(path: Path) -> Iterator[Any]:
    """The database of features and matches at a path, made where there is none."""
    database = load_pycolmap().Database.open(path)
    try:
        yield database
    finally:
        database.close()


def extract_features(
    path: Path, photographs: Sequence[PhotoFile], settings: CalibrationSettings, progress: StageProgress
) -> None:
    """Find the SIFT features of the photographs that the database has none of; it knows them by their digests."""
    pycolmap = load_pycolmap()
    with open_database(path) as database:
        _register(database, photographs)
        missing = [photograph for photograph in photographs if not _has_features(database, photograph.digest)]
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = settings.max_image_size
    options.sift.max_num_features = settings.max_features
    done = len(photographs) - len(missing)
    step = 2 * (os.cpu_count() or 1)
    for start in range(0, len(missing), step):
        progress("features", done, len(photographs))
        batch = missing[start : start + step]
        with tempfile.TemporaryDirectory(dir=path.parent) as name:
            images, masks = Path(name) / "images", Path(name) / "masks"
            reader = pycolmap.ImageReaderOptions()
            for photograph in batch:
                _write_copy(photograph, images, masks)
            if masks.is_dir():
                reader.mask_path = masks
            names = [_file(photograph.digest) for photograph in batch]
            pycolmap.extract_features(path, images, names, reader_options=reader, extraction_options=options)
        done += len(batch)
    progress("features", len(photographs), len(photographs))


def match_features(
    path: Path, photographs: Sequence[PhotoFile], settings: CalibrationSettings, progress: StageProgress
) -> None:
    """Match the photographs, pair by pair, and keep the matches that agree with an epipolar geometry."""
    pycolmap = load_pycolmap()
    matching, verification = pycolmap.FeatureMatchingOptions(), pycolmap.TwoViewGeometryOptions()
    verification.min_num_inliers = MIN_INLIERS
    verification.ransac.random_seed = settings.seed
    with open_database(path) as database:
        pairs = _pairs(database, [photograph.digest for photograph in photographs], settings)
        ids = {photograph.digest: _image(database, photograph.digest).image_id for photograph in photographs}
        missing = [pair for pair in pairs if not database.exists_two_view_geometry(*(ids[name] for name in pair))]
    done = len(pairs) - len(missing)
    for start in range(0, len(missing), _PAIRS_A_STEP):
        progress("matches", done, len(pairs))
        step = missing[start : start + _PAIRS_A_STEP]
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            pairing = pycolmap.ImportedPairingOptions()
            pairing.match_list_path = Path(folder) / "pairs.txt"
            Path(pairing.match_list_path).write_text("".join(f"{_file(a)} {_file(b)}\n" for a, b in step))
            pycolmap.match_image_pairs(path, matching, pairing, verification)
        done += len(step)
    progress("matches", len(pairs), len(pairs))


def matched_pairs(path: Path, digests: Sequence[str]) -> list[Pair]:
    """Pairs of the given photographs that share at least one match that agrees with a geometry."""
    pycolmap = load_pycolmap()
    kinds = pycolmap.TwoViewGeometryConfiguration
    turned = {int(kind) for kind in (kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC)}
    with open_database(path) as database:
        names = {image.image_id: Path(image.name).stem for image in database.read_all_images()}
        pair_ids, geometries = database.read_two_view_geometries()
    wanted, found = set(digests), []
    for pair_id, geometry in zip(pair_ids, geometries, strict=True):
        first, second = (names[image] for image in pycolmap.pair_id_to_image_pair(pair_id))
        inliers = len(geometry.inlier_matches)
        if inliers and first in wanted and second in wanted:
            found.append(Pair(first, second, inliers, int(geometry.config) in turned))
    return found


def feature_scales(path: Path, digests: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Scale in pixels of every feature of each photograph."""
    scales = {}
    with open_database(path) as database:
        for digest in digests:
            keypoints = np.asarray(database.read_keypoints(_image(database, digest).image_id), np.float64)
            scales[digest] = _scales(keypoints)
    return scales


def _register(database: Any, photographs: Sequence[PhotoFile]) -> None:
    """Enter photographs that the database does not know, one camera for each size and lens."""
    pycolmap = load_pycolmap()
    cameras = {
        photograph.lens: _image(database, photograph.digest).camera_id
        for photograph in photographs
        if database.exists_image(_file(photograph.digest))
    }
    with pycolmap.DatabaseTransaction(database):
        for photograph in photographs:
            if database.exists_image(_file(photograph.digest)):
                continue
            if photograph.lens not in cameras:
                size = photograph.width, photograph.height
                focal_length = photograph.focal_length or GUESS_FOCAL * max(size)
                camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", focal_length, *size)
                camera.has_prior_focal_length = photograph.focal_length is not None
                cameras[photograph.lens] = database.write_camera(camera)
            database.write_image(pycolmap.Image(name=_file(photograph.digest), camera_id=cameras[photograph.lens]))


def _file(digest: str) -> str:
    """Name of a photograph in the database."""
    return f"{digest}.png"


def _image(database: Any, digest: str) -> Any:
    return database.read_image_with_name(_file(digest))


def _has_features(database: Any, digest: str) -> bool:
    image = _image(database, digest).image_id
    return bool(database.exists_keypoints(image) and database.exists_descriptors(image))


def _write_copy(photograph: PhotoFile, images: Path, masks: Path) -> None:
    """Upright grey copy of a photograph, and of its mask."""
    grey = cv2.cvtColor(read_image(photograph.path), cv2.COLOR_RGB2GRAY)
    images.mkdir(exist_ok=True)
    _write(images / _file(photograph.digest), grey)
    if photograph.mask is None:
        return
    mask = read_image(photograph.mask).max(axis=2)
    if mask.shape != grey.shape:
        raise DataError(f"{photograph.mask}: expected a mask of the photograph's size, got {mask.shape[::-1]}")
    masks.mkdir(exist_ok=True)
    _write(masks / f"{_file(photograph.digest)}.png", np.where(mask > 0, 255, 0).astype(np.uint8))


def _write(path: Path, pixels: NDArray[Any]) -> None:
    if not cv2.imwrite(str(path), pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
        raise OSError(f"{path}: OpenCV could not write the image")


def _pairs(database: Any, digests: Sequence[str], settings: CalibrationSettings) -> list[tuple[str, str]]:
    """Pairs to match: all, or those of near names and those that share coarse features."""
    if len(digests) <= settings.exhaustive_up_to:
        return list(combinations(digests, 2))
    near = {(i, j) for i in range(len(digests)) for j in range(i + 1, min(i + 1 + _WINDOW, len(digests)))}
    descriptors = [_coarsest(database, _image(database, digest).image_id) for digest in digests]
    shared = np.zeros((len(digests), len(digests)))
    for i, j in combinations(range(len(digests)), 2):
        shared[i, j] = shared[j, i] = _mutual_matches(descriptors[i], descriptors[j])
    for i, row in enumerate(shared):
        for j in np.argsort(-row, kind="stable")[:_PARTNERS]:
            if row[j] > 0:
                near.add((min(i, int(j)), max(i, int(j))))
    return [(digests[i], digests[j]) for i, j in sorted(near)]


def _coarsest(database: Any, image: int) -> NDArray[np.float32]:
    """(n, 128) unit descriptors of a photograph's coarsest features, which most views of a place share."""
    scales = _scales(np.asarray(database.read_keypoints(image), np.float64))
    chosen = np.argsort(-scales, kind="stable")[:_COARSEST]
    descriptors = np.asarray(database.read_descriptors(image).data, np.float32).reshape(len(scales), -1)[chosen]
    return np.asarray(descriptors / np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-9))


def _mutual_matches(first: NDArray[np.float32], second: NDArray[np.float32]) -> int:
    """How many features are each other's nearest and much nearer than the second nearest."""
    if len(first) < 2 or len(second) < 2:
        return 0
    angles = np.arccos(np.clip(first @ second.T, -1, 1))
    nearest = angles.argmin(axis=1)
    two = np.partition(angles, 1, axis=1)[:, :2]
    mutual = angles.argmin(axis=0)[nearest] == np.arange(len(first))
    return int(np.count_nonzero(mutual & (two[:, 0] < 0.8 * two[:, 1])))


def _scales(keypoints: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) scales of keypoints (n, 6): u, v and an affine shape."""
    if keypoints.size == 0:
        return np.zeros(0)
    a11, a12, a21, a22 = keypoints[:, 2:6].T
    return np.asarray(np.sqrt(np.abs(a11 * a22 - a12 * a21)))
