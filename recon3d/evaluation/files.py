"""Evaluation of files: a reconstruction and a ground truth as they lie on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.evaluation.distances import Evaluation, evaluate, triangles_near
from recon3d.io.reading_geometry import read_geometry, read_mesh, read_support
from recon3d.surface.visibility import keep_vertices


def evaluate_files(
    reconstruction: Path | str,
    ground_truth: Path | str,
    *,
    valid: Path | str | None = None,
    valid_within_mm: float = 0.1,
    supported: bool = False,
    mm_per_unit: float = 1000.0,
    **options: Any,
) -> Evaluation:
    """Measure a mesh, point cloud or voxel grid file against a ground truth file.

    Parameters
    ----------
    valid : mesh of the part of the ground truth that is real data; ground truth farther than ``valid_within_mm`` from
        it is filler, where nothing is measured.
    supported : measure only the vertices of the reconstruction with ``support`` > 0.
    options : passed to ``evaluate``.

    Raises
    ------
    DataError : a file is missing or holds no geometry of the kind that is needed.
    """
    shape = _supported_part(reconstruction) if supported else read_geometry(reconstruction)
    truth, mask = read_ground_truth(ground_truth, valid=valid, valid_within_mm=valid_within_mm, mm_per_unit=mm_per_unit)
    return evaluate(shape, truth, valid=mask, mm_per_unit=mm_per_unit, **options)


def _supported_part(file: Path | str) -> o3d.geometry.TriangleMesh:
    """Mesh of a file, its measured vertices alone."""
    mesh, support = read_mesh(file), read_support(file)
    if support is None:
        raise DataError(f"{file}: expected a mesh.ply that recon3d wrote, got one without support of its vertices")
    part = keep_vertices(mesh, support > 0)
    if not part.has_triangles():
        raise DataError(f"{file}: no triangle of the mesh is supported")
    return part


def read_ground_truth(
    ground_truth: Path | str,
    *,
    valid: Path | str | None = None,
    valid_within_mm: float = 0.1,
    mm_per_unit: float = 1000.0,
) -> tuple[o3d.geometry.TriangleMesh | o3d.geometry.PointCloud, NDArray[np.bool_] | None]:
    """Mesh or point cloud to measure against, and the mask (n,) of its ``valid`` part; see ``evaluate_files``.

    Raises
    ------
    DataError : a file is missing or holds no geometry of the kind that is needed.
    """
    truth = read_geometry(ground_truth)
    if isinstance(truth, o3d.geometry.VoxelGrid):
        raise DataError(f"{ground_truth}: expected a mesh or point cloud as ground truth, got a voxel grid")
    if valid is None:
        return truth, None
    if not isinstance(truth, o3d.geometry.TriangleMesh):
        raise DataError(f"{ground_truth}: only a mesh can have a valid part, got a point cloud")
    return truth, triangles_near(truth, read_mesh(valid), valid_within_mm / mm_per_unit)
