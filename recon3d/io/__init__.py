"""Scenes and geometry, in and out of files."""

from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.checkpoints import Checkpoints
from recon3d.io.geometry import write_geometry
from recon3d.io.middlebury import write_middlebury
from recon3d.io.opening import FORMATS, Format, open_scene
from recon3d.io.printing import write_print
from recon3d.io.reading_geometry import read_geometry, read_mesh, read_support, read_uncertainty
from recon3d.io.writing import WRITERS, write_scene

__all__ = [
    "FORMATS",
    "WRITERS",
    "Calibrated",
    "CalibratedImage",
    "Checkpoints",
    "Format",
    "open_scene",
    "read_geometry",
    "read_mesh",
    "read_support",
    "read_uncertainty",
    "write_geometry",
    "write_middlebury",
    "write_print",
    "write_scene",
]
