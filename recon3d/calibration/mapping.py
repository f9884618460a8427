"""Poses, intrinsics and points from matches.

References
----------
J. L. Schönberger, J.-M. Frahm, "Structure-from-motion revisited", CVPR 2016 (the incremental mapper).
L. Pan, D. Barath, M. Pollefeys, J. L. Schönberger, "Global structure-from-motion revisited", ECCV 2024.
"""

from __future__ import annotations

import copy
import shutil
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon3d.calibration.colmap import load_pycolmap
from recon3d.calibration.epipolar import firmly_joined
from recon3d.calibration.settings import CalibrationSettings
from recon3d.tasks import StageProgress

ENOUGH = 0.95
"""Fraction of the photographs that the incremental mapper must place; below, the global one is tried too."""

_GAIN = 0.99  # of the mean squared residual: what a coefficient of distortion must bring to be kept
_MAX_ERROR = 4.0  # pixels
_MIN_ANGLE = 1.5  # degrees
_MIN_VIEWS = 3
_MIN_INLIERS = 30  # matches with points that a pose is accepted by
_DISTORTIONS = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")  # each holds the former's parameters and one more


def map_photographs(
    path: Path, digests: Sequence[str], settings: CalibrationSettings, progress: StageProgress
) -> list[Any]:
    """Pycolmap's models of the photographs, the largest first: groups that could not be joined have a model each.

    The incremental mapper goes first. If it leaves photographs over, it tries again with half the matches that a pose
    needs, then the global mapper does; both may put a weakly joined group in a wrong place at no cost in residuals, so
    of theirs only what their matches hold together is kept.

    Parameters
    ----------
    path : the database of features and matches.
    digests : of the photographs to place.
    """
    best = _largest_first(_incremental(path, digests, settings, progress, _MIN_INLIERS))
    for attempt in (_with_fewer_inliers, _global):
        if best and best[0].num_reg_images() >= ENOUGH * len(digests):
            break
        found = _largest_first([_firm(path, model) for model in attempt(path, digests, settings, progress)])
        if found and (not best or found[0].num_reg_images() > best[0].num_reg_images()):
            best = found
    return best


def refine_intrinsics(model: Any, settings: CalibrationSettings, progress: StageProgress) -> Any:
    """Bundle adjustment of a model, with as much distortion as its residuals ask for.

    A coefficient that lowers the mean squared residual by less than 1% is left out: on a narrow field of view it would
    take from the focal length what it gains. The principal point is free where every camera has enough views.
    """
    views = Counter(image.camera_id for image in model.images.values() if image.has_pose)
    many = min(views.values()) >= settings.principal_point_from
    best, least = None, np.inf
    choices = _DISTORTIONS if many else _DISTORTIONS[:2]
    for n, distortion in enumerate(choices):
        progress("intrinsics", n, len(choices))
        trial = _with_distortion(model, distortion)
        adjust(trial, principal_point=many)
        residual = float(np.mean(squared_residuals(trial)))
        if residual < _GAIN * least:
            best, least = trial, residual
    progress("intrinsics", len(choices), len(choices))
    load_pycolmap().ObservationManager(best).filter_all_points3D(_MAX_ERROR, _MIN_ANGLE)
    return best


def squared_residuals(model: Any) -> NDArray[np.float64]:
    """(n_observations,) squared pixels between the features and the projected points."""
    squares = []
    for image in model.images.values():
        for feature in image.get_observation_points2D() if image.has_pose else ():
            pixel = image.project_point(model.points3D[feature.point3D_id].xyz)
            if pixel is not None:
                squares.append(np.sum((pixel - feature.xy) ** 2))
    return np.array(squares)


def _with_fewer_inliers(
    path: Path, digests: Sequence[str], settings: CalibrationSettings, progress: StageProgress
) -> list[Any]:
    return _incremental(path, digests, settings, progress, _MIN_INLIERS // 2)


def _incremental(
    path: Path, digests: Sequence[str], settings: CalibrationSettings, progress: StageProgress, min_inliers: int
) -> list[Any]:
    pycolmap = load_pycolmap()
    options = pycolmap.IncrementalPipelineOptions()
    options.image_names = [f"{digest}.png" for digest in digests]
    options.min_model_size = _MIN_VIEWS
    options.random_seed = settings.seed
    options.extract_colors = False
    options.mapper.abs_pose_min_num_inliers = min_inliers
    placed = 0

    def begun() -> None:
        nonlocal placed
        placed = 2
        progress("mapping", placed, len(digests))

    def one_more() -> None:
        nonlocal placed
        placed = min(placed + 1, len(digests))
        progress("mapping", placed, len(digests))

    progress("mapping", 0, len(digests))
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        found = pycolmap.incremental_mapping(
            path, path.parent, folder, options, initial_image_pair_callback=begun, next_image_callback=one_more
        )
    progress("mapping", len(digests), len(digests))
    return list(found.values())


def _global(path: Path, digests: Sequence[str], settings: CalibrationSettings, progress: StageProgress) -> list[Any]:
    progress("global mapping", 0, 1)
    pycolmap = load_pycolmap()
    options = pycolmap.GlobalPipelineOptions()
    options.image_names = [f"{digest}.png" for digest in digests]
    options.min_model_size = _MIN_VIEWS
    options.random_seed = settings.seed
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        # It writes what it learns of the focal lengths into the database, which the next run shall find as it is.
        own = Path(shutil.copy(path, Path(folder) / "database.db"))
        found = pycolmap.global_mapping(own, path.parent, folder, options)
    progress("global mapping", 1, 1)
    return [model for model in found.values() if model.num_points3D()]


def _firm(path: Path, model: Any) -> Any:
    """The model without the images that its matches do not hold together with the rest."""
    kept = firmly_joined(path, model)
    for image in list(model.images.values()):
        if image.has_pose and image.name not in kept:
            model.deregister_frame(image.frame_id)
    return model


def _largest_first(models: Sequence[Any]) -> list[Any]:
    large = [model for model in models if model.num_reg_images() >= _MIN_VIEWS]
    return sorted(large, key=lambda model: -model.num_reg_images())


def _with_distortion(model: Any, distortion: str) -> Any:
    """Copy of a model whose cameras have another model of distortion."""
    pycolmap = load_pycolmap()
    changed = copy.deepcopy(model)
    n_coefficients = _DISTORTIONS.index(distortion)
    for camera in changed.cameras.values():
        pinhole, coefficients = list(camera.params[:3]), list(camera.params[3:])
        camera.model = getattr(pycolmap.CameraModelId, distortion)
        camera.params = pinhole + (coefficients + [0.0] * n_coefficients)[:n_coefficients]
    return changed


def adjust(
    model: Any,
    *,
    held: Sequence[int] = (),
    intrinsics: bool = True,
    principal_point: bool = False,
) -> None:
    """Bundle adjustment of a model, robust against wrong matches.

    Parameters
    ----------
    held : images that keep their poses.
    intrinsics, principal_point : whether those are adjusted, too.
    """
    pycolmap = load_pycolmap()
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_principal_point = principal_point
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    options.ceres.solver_options.function_tolerance = 1e-7
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.images.values():
        if not image.has_pose:
            continue
        config.add_image(image.image_id)
        if image.image_id in held:
            config.set_constant_rig_from_world_pose(image.frame_id)
        if not intrinsics:
            config.set_constant_cam_intrinsics(image.camera_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
