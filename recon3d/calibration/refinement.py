"""Bundle adjustment of cameras that are given.

References
----------
B. Triggs, P. McLauchlan, R. Hartley, A. Fitzgibbon, "Bundle adjustment: a modern synthesis", Vision Algorithms 1999.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.calibration.colmap import load_pycolmap
from recon3d.calibration.epipolar import MAX_DISTANCE, essential_matrix, sampson_distances
from recon3d.calibration.features import open_database
from recon3d.calibration.mapping import adjust, squared_residuals
from recon3d.calibration.settings import CalibrationSettings
from recon3d.errors import ArgumentError, CalibrationError
from recon3d.scene.camera import Camera
from recon3d.scene.similarity import Similarity
from recon3d.scene.view import View
from recon3d.summary import Summarised
from recon3d.tasks import StageProgress

_MAX_ERROR = 4.0  # pixels
_MIN_ANGLE = 1.5  # degrees between two rays to a point
_MAX_TURN = 75.0  # degrees between the axes of two views that are matched
_MIN_OBSERVATIONS = 20  # of a view, below which it keeps its camera


@dataclass(frozen=True, repr=False)
class RefinedCameras(Summarised):
    """Views with adjusted cameras, in the frame and scale of the given ones."""

    views: tuple[View, ...]
    residual_before: float
    """Root mean squared pixels between matches and the points triangulated from them by the given cameras."""
    residual_after: float
    """The same by the adjusted cameras."""
    n_points: int
    """Points that the cameras were adjusted by."""
    n_observations: NDArray[np.int64]
    """(n_views,) of those points in each view."""
    moved: NDArray[np.float64]
    """(n_views,) pixels that a view's content shifts by: root mean squared over its points, given against adjusted."""

    def summary(self) -> dict[str, object]:
        """Table of what changed."""
        return {
            "views": len(self.views),
            "points": self.n_points,
            "residual before (pixels)": f"{self.residual_before:.3f}",
            "residual after (pixels)": f"{self.residual_after:.3f}",
            "cameras moved by (pixels, median)": f"{np.median(self.moved):.3f}",
            "cameras moved by (pixels, most)": f"{self.moved.max():.3f}",
        }


def refine_cameras(
    views: Sequence[View],
    *,
    focal_lengths: bool = False,
    settings: CalibrationSettings | None = None,
    progress: StageProgress | None = None,
) -> RefinedCameras:
    """Adjust the poses of given cameras, and optionally their focal lengths, to the matches between their views.

    The adjusted cameras are moved as a whole by the similarity that brings the matched points closest to where the
    given ones have them, so that bounds and lengths stay what they are.

    Parameters
    ----------
    views : cameras that are right to a few pixels; matched inside their silhouettes where they have them.
    focal_lengths : adjust those too, by one factor for views of equal K.

    Raises
    ------
    ArgumentError : fewer than three views.
    CalibrationError : pycolmap is missing, or fewer than three views share matches.
    """
    if len(views) < 3:
        raise ArgumentError(f"expected at least 3 views, got {len(views)}")
    settings = settings or CalibrationSettings()
    with tempfile.TemporaryDirectory() as folder:
        model = _triangulated(views, Path(folder), settings, progress)
    counts = np.array([model.images[n + 1].num_points3D for n in range(len(views))])
    if np.count_nonzero(counts >= _MIN_OBSERVATIONS) < 3:
        raise CalibrationError(
            f"expected at least 3 views of {_MIN_OBSERVATIONS} matched points each, got {counts.tolist()} points: the "
            "object has too little texture, or the cameras are wrong by more than a few pixels"
        )
    before = float(np.sqrt(np.mean(squared_residuals(model))))
    places = {point: np.array(model.points3D[point].xyz) for point in model.points3D}
    held = [n + 1 for n, count in enumerate(counts) if count < _MIN_OBSERVATIONS]
    for _ in range(2):
        adjust(model, held=held, intrinsics=focal_lengths)
        load_pycolmap().ObservationManager(model).filter_all_points3D(_MAX_ERROR, _MIN_ANGLE)
    after = float(np.sqrt(np.mean(squared_residuals(model))))
    refined, moved = _moved_back(views, model, places)
    return RefinedCameras(refined, before, after, model.num_points3D(), counts, moved)


def _triangulated(
    views: Sequence[View], folder: Path, settings: CalibrationSettings, progress: StageProgress | None
) -> Any:
    """The model of the given cameras and of the points that their matches triangulate to; image n is views[n - 1]."""
    pycolmap = load_pycolmap()
    path, pair_file = folder / "matches.db", folder / "pairs.txt"
    given = _given(views)
    keypoints = {}
    with open_database(path) as database:
        for camera in given.cameras.values():
            database.write_camera(camera, use_camera_id=True)
        for n, view in enumerate(views, start=1):
            if progress is not None:
                progress("features", n - 1, len(views))
            camera_id = given.images[n].camera_id
            database.write_image(pycolmap.Image(name=str(n), camera_id=camera_id, image_id=n), use_image_id=True)
            keypoints[n], descriptors = _features(view, settings)
            database.write_keypoints(n, keypoints[n])
            database.write_descriptors(n, descriptors)
    pairs = [
        (a, b) for a, b in combinations(range(1, len(views) + 1), 2) if _turn(views[a - 1], views[b - 1]) < _MAX_TURN
    ]
    pair_file.write_text("".join(f"{a} {b}\n" for a, b in pairs))
    matching, pairing = pycolmap.FeatureMatchingOptions(), pycolmap.ImportedPairingOptions()
    matching.skip_geometric_verification = True
    pairing.match_list_path = pair_file
    if progress is not None:
        progress("matches", 0, 1)
    pycolmap.match_image_pairs(path, matching, pairing)
    if progress is not None:
        progress("matches", 1, 1)
    with open_database(path) as database:
        for a, b in pairs:
            _keep_epipolar(database, a, b, given, keypoints)
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = settings.seed
    options.extract_colors = False
    return pycolmap.triangulate_points(given, path, folder, folder, options=options)


def _given(views: Sequence[View]) -> Any:
    """The model of the cameras alone; views of equal K and size share a camera, which has square pixels."""
    pycolmap = load_pycolmap()
    model = pycolmap.Reconstruction()
    lenses: dict[tuple[object, ...], int] = {}
    for n, view in enumerate(views, start=1):
        lens = (view.width, view.height, *view.K.ravel())
        if lens not in lenses:
            lenses[lens] = len(lenses) + 1
            params = [_square(view.K)[0, 0], view.K[0, 2] + 0.5, view.K[1, 2] + 0.5]
            model.add_camera_with_trivial_rig(
                pycolmap.Camera(
                    camera_id=lenses[lens], model="SIMPLE_PINHOLE", width=view.width, height=view.height, params=params
                )
            )
        image = pycolmap.Image(name=str(n), camera_id=lenses[lens], image_id=n)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(view.cam_from_world[:3]))
    return model


def _features(view: View, settings: CalibrationSettings) -> tuple[NDArray[np.float32], Any]:
    """Keypoints (n, 6) as a camera with square pixels sees them, and descriptors, inside the silhouette."""
    pycolmap = load_pycolmap()
    options = pycolmap.FeatureExtractionOptions()
    options.sift.max_num_features = settings.max_features
    grey = np.ascontiguousarray(cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY))
    found, descriptors = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu).extract_from_uint8_array(grey)
    keypoints = np.array([(k.x, k.y, k.a11, k.a12, k.a21, k.a22) for k in found], np.float64).reshape(-1, 6)
    if view.silhouette is not None:
        u, v = np.clip(keypoints[:, :2].astype(np.int64), 0, [view.width - 1, view.height - 1]).T
        keep = view.silhouette[v, u]
        keypoints = keypoints[keep]
        descriptors = pycolmap.FeatureDescriptors(descriptors.type, np.asarray(descriptors.data)[keep])
    pixels = np.column_stack([keypoints[:, :2] - 0.5, np.ones(len(keypoints))])
    keypoints[:, :2] = (pixels @ (_square(view.K) @ np.linalg.inv(view.K)).T)[:, :2] + 0.5
    return keypoints.astype(np.float32), descriptors


def _keep_epipolar(database: Any, a: int, b: int, model: Any, keypoints: dict[int, NDArray[np.float32]]) -> None:
    """Enter the matches of two images that lie near their epipolar lines by the given cameras (Sampson's distance)."""
    pycolmap = load_pycolmap()
    matches = np.asarray(database.read_matches(a, b), np.int64).reshape(-1, 2)
    if len(matches) == 0:
        return
    E = essential_matrix(_pose(model, b) @ np.linalg.inv(_pose(model, a)))
    cameras = [model.cameras[model.images[n].camera_id] for n in (a, b)]
    rays = [
        np.column_stack(
            [camera.cam_from_img(keypoints[n][matches[:, side], :2].astype(np.float64)), np.ones(len(matches))]
        )
        for side, (n, camera) in enumerate(zip((a, b), cameras, strict=True))
    ]
    distances = sampson_distances(E, *rays) * cameras[0].focal_length
    geometry = pycolmap.TwoViewGeometry()
    geometry.config = int(pycolmap.TwoViewGeometryConfiguration.CALIBRATED)
    geometry.E = E
    geometry.inlier_matches = matches[distances < MAX_DISTANCE].astype(np.uint32)
    database.write_two_view_geometry(a, b, geometry)


def _moved_back(
    views: Sequence[View], model: Any, places: Mapping[int, NDArray[np.float64]]
) -> tuple[tuple[View, ...], NDArray[np.float64]]:
    """Views with the model's cameras, moved as a whole so that its points come to their places by the given cameras.

    Returns how far each moved, too: pixels.
    """
    kept = [point for point in model.points3D if point in places]
    back = Similarity.between(
        np.array([model.points3D[point].xyz for point in kept]), np.array([places[point] for point in kept])
    )
    refined, moved = [], []
    for n, view in enumerate(views, start=1):
        image, pose = model.images[n], _pose(model, n)
        camera = model.cameras[image.camera_id]
        K = view.K
        K[:2, :2] *= camera.focal_length / _square(K)[0, 0]
        adjusted = Camera(K, back.camera(pose), view.width, view.height, view.calibration.distortion)
        changed = replace(view, calibration=adjusted)
        features = image.get_observation_points2D()
        seen = back(np.array([model.points3D[feature.point3D_id].xyz for feature in features]).reshape(-1, 3))
        shift = changed.project(seen)[0] - view.project(seen)[0]
        refined.append(changed)
        moved.append(float(np.sqrt((shift**2).sum(axis=1).mean())) if len(seen) else 0.0)
    return tuple(refined), np.array(moved)


def _square(K: NDArray[np.float64]) -> NDArray[np.float64]:
    """K without skew, with the mean of its focal lengths.

    Their ratio is not adjusted: cameras that go round an object hardly tell it from a stretch along the axis.
    """
    f = float(np.sqrt(K[0, 0] * K[1, 1]))
    return np.array([[f, 0, K[0, 2]], [0, f, K[1, 2]], [0, 0, 1]])


def _pose(model: Any, image: int) -> NDArray[np.float64]:
    """(4, 4) cam_from_world."""
    return np.vstack([model.images[image].cam_from_world().matrix(), [0, 0, 0, 1]])


def _turn(a: View, b: View) -> float:
    """Angle between the axes of two views, degrees."""
    cosine = float(a.cam_from_world[2, :3] @ b.cam_from_world[2, :3])
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
