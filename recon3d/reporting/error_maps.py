"""A mesh coloured by its distance to another one."""

from __future__ import annotations

import numpy as np
import open3d as o3d

from recon3d.errors import ArgumentError
from recon3d.evaluation.distances import distance_to_mesh


def error_map(
    mesh: o3d.geometry.TriangleMesh,
    ground_truth: o3d.geometry.TriangleMesh,
    *,
    mm_per_unit: float = 1000.0,
    full_scale_mm: float = 5.0,
) -> o3d.geometry.TriangleMesh:
    """The mesh with each vertex coloured by its exact distance to the ground truth, from blue (0) to red (full scale).

    Swap the two meshes to see what of the ground truth is missing.
    """
    from matplotlib import colormaps

    if not full_scale_mm > 0:
        raise ArgumentError(f"expected a positive full scale, got {full_scale_mm}")
    distance = distance_to_mesh(np.asarray(mesh.vertices), ground_truth) * mm_per_unit
    colored = o3d.geometry.TriangleMesh(mesh)
    shades = colormaps["turbo"](np.clip(distance / full_scale_mm, 0, 1))[:, :3]
    colored.vertex_colors = o3d.utility.Vector3dVector(shades)
    return colored
