"""Cameras of photographs."""

from recon3d.calibration.board import Board, cameras_from_board, write_board_pdf
from recon3d.calibration.refinement import RefinedCameras, refine_cameras
from recon3d.calibration.result import CalibratedCamera, Calibration, Observations
from recon3d.calibration.settings import CalibrationSettings
from recon3d.calibration.structure_from_motion import calibrate

__all__ = [
    "Board",
    "CalibratedCamera",
    "Calibration",
    "CalibrationSettings",
    "Observations",
    "RefinedCameras",
    "calibrate",
    "cameras_from_board",
    "refine_cameras",
    "write_board_pdf",
]
