"""Cameras of photographs."""

from recon3d.calibration.board import Board, cameras_from_board, write_board_pdf
from recon3d.calibration.refinement import RefinedCameras, refine_cameras
from recon3d.calibration.result import CalibratedCamera, Calibration, Observations
from recon3d.calibration.settings import CalibrationSettings
from recon3d.calibration.structure_from_motion import calibrate
from recon3d.calibration.turntable import Turntable, cameras_from_turntable, turntable_cameras

__all__ = [
    "Board",
    "CalibratedCamera",
    "Calibration",
    "CalibrationSettings",
    "Observations",
    "RefinedCameras",
    "Turntable",
    "calibrate",
    "cameras_from_board",
    "cameras_from_turntable",
    "refine_cameras",
    "turntable_cameras",
    "write_board_pdf",
]
