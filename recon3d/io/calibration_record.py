"""Scenes that ``recon3d.calibrate`` wrote: a COLMAP model with what that has no place for, in ``calibration.json``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated
from recon3d.io.colmap import read_colmap
from recon3d.io.parsing import numbers, read_json
from recon3d.scene.bounds import Bounds

CALIBRATION_FILE = "calibration.json"


def is_calibration(path: Path) -> bool:
    """Whether a folder holds the record of a calibration."""
    return (path / CALIBRATION_FILE).is_file() and (path / "sparse").is_dir()


def read_calibration(path: Path) -> Calibrated:
    """Cameras, photographs and points of the model, with the record's name, bounds and scale.

    Raises
    ------
    DataError : a file is missing or malformed.
    """
    file = path / CALIBRATION_FILE
    record = read_json(file)
    try:
        unit, box = record["mm_per_unit"], record["bounds"]
        mm_per_unit = None if unit is None else float(numbers([unit], 1, f"{file}: mm_per_unit")[0])
        corners = None if box is None else numbers(box, 6, f"{file}: bounds").reshape(2, 3)
        summary = {str(name): str(value) for name, value in record["summary"].items()}
        name = str(record["name"])
    except (KeyError, TypeError, AttributeError) as error:
        raise DataError(f"{file}: expected the record of a calibration, got something else ({error!r})") from None
    return replace(
        read_colmap(path),
        name=name,
        bounds=None if corners is None else Bounds(*corners),
        bounds_from="" if corners is None else summary.get("bounds", "above the printed board"),
        mm_per_unit=mm_per_unit,
        notes={"format": "calibrated by recon3d", **{key: summary[key] for key in summary if key.startswith("not ")}},
    )
