"""Cameras that were adjusted after a scene was opened, in a file beside the result that was made with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from recon3d.errors import ArgumentError, DataError
from recon3d.io.files import write_json
from recon3d.io.parsing import read_json
from recon3d.scene.camera import Camera
from recon3d.scene.scene import Scene

REFINED_FILE = "cameras.json"


def write_refined_cameras(folder: Path, scene: Scene, given: Scene) -> Path:
    """Write a scene's cameras, and of which scene they are the adjusted ones; returns the file."""
    cameras = {
        view.name: {"K": view.K.tolist(), "cam_from_world": view.cam_from_world.tolist()} for view in scene.views
    }
    return write_json(folder / REFINED_FILE, {"of": given.fingerprint(), "cameras": cameras})


def with_refined_cameras(folder: Path, given: Scene, *, of_views: bool = True) -> Scene | None:
    """The scene with the cameras that are kept in a folder; None where none are, or those of another scene.

    Parameters
    ----------
    of_views : whether photographs, masks and bounds must be those that the cameras were adjusted for.

    Raises
    ------
    DataError : the file is malformed.
    """
    file = folder / REFINED_FILE
    if not file.is_file():
        return None
    record = read_json(file)
    try:
        if of_views and record["of"] != given.fingerprint():
            return None
        views = []
        for view in given.views:
            told, camera = record["cameras"][view.name], view.calibration
            matrices = np.array(told["K"], np.float64), np.array(told["cam_from_world"], np.float64)
            changed = Camera(*matrices, camera.width, camera.height, camera.distortion)
            views.append(replace(view, calibration=changed))
    except (KeyError, TypeError, ValueError, ArgumentError) as error:
        raise DataError(f"{file}: expected a camera for each view, got something else ({error!r})") from None
    return replace(given, views=tuple(views))
