"""The object alone, of a calibration of photographs that show it on a table or the ground."""

from __future__ import annotations

from dataclasses import replace

from recon3d.calibration.result import Calibration, level_world
from recon3d.calibration.writing import undistorted
from recon3d.errors import SceneError
from recon3d.scene.camera import Camera
from recon3d.scene.enclosing import enclosing_box, found_table
from recon3d.scene.ground import TABLE_LEFT_OUT
from recon3d.scene.photograph import Photograph
from recon3d.scene.view import View


def with_object_alone(calibration: Calibration) -> Calibration:
    """The calibration in a world with the table at z = 0, and bounds of what stands on it; notes tell what was found.

    Where no table or ground is recognised, the world stays and there are no bounds.
    """
    try:
        table = found_table(_views(calibration), calibration.points)
    except SceneError as error:
        return replace(calibration, notes={**calibration.notes, "bounds": f"not known: {error}"})
    if table is not None:
        turned = level_world(calibration, table.normal, table.level)
        box, how = enclosing_box(_views(turned), turned.points, object_alone=True)
        if TABLE_LEFT_OUT in how:
            return replace(turned, bounds=box, notes={**turned.notes, "bounds": how})
    return replace(
        calibration, notes={**calibration.notes, "bounds": "not known: no table or ground was recognised to leave out"}
    )


def _views(calibration: Calibration) -> list[View]:
    """Views of a calibration's photographs, without distortion."""
    return [
        View(
            Camera(camera.K, camera.cam_from_world, camera.width, camera.height),
            Photograph(camera.path),
            None,
            camera.name,
        )
        for camera in undistorted(calibration).cameras
    ]
