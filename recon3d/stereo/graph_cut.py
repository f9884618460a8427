"""From oriented points to a closed surface: the minimum cut of the carved volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_fill_holes, gaussian_filter

from recon3d.carving import PhotoHull
from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.min_cut import SINK, min_cut
from recon3d.kernels.splatting import splat_planes
from recon3d.surface import blend_colors, mesh_level

_OFFSETS = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])  # d ^ 1 leads back from d
_FACE = 2 / 3  # so that the lattice's areas are right on average over all directions (Boykov, Kolmogorov 2003)
_UNIT = 1000  # the cut's whole numbers in the cost of a face that no point lies near
_DOUBT = 0.1  # support that counts half
_PRIOR = 0.03  # weight of the cut's own smooth surface beside the points'
_OUTSIDE = 0.2  # cost of a voxel in the margin around the hull
_SHARP = 0.02  # voxels that the surface keeps from voxel centres
_PADDING = 2  # empty voxels around the volume, so that the surface closes


def graph_cut(
    points: o3d.t.geometry.PointCloud,
    hull: PhotoHull,
    *,
    attraction: float = 2.0,
    evidence: float = 2.0,
    ballooning: float = 0.01,
    spread: float = 0.7,
    margin: int = 2,
    smoothing: int = 1,
) -> o3d.geometry.TriangleMesh:
    """Closed surface through oriented points with outliers and gaps, inside a carved hull.

    Every voxel of the hull is solid or empty, whichever makes the sum of these least: each face between solid and
    empty costs exp(-attraction * support), so that the surface runs where there are points and is small where there
    are none; each voxel near points costs up to ``evidence`` on the wrong side of their planes; each empty voxel
    costs ``ballooning``. The minimum is exact, up to costs rounded to a thousandth of a face. The surface is then the
    zero of the points' mean distance to their planes, on the cut's side of every voxel's centre.

    Parameters
    ----------
    points : on the CPU, world units; ``positions`` (n, 3), ``normals`` (n, 3) of unit length and outwards,
        ``confidence`` (n,) or (n, 1) in (0, 1], ``colors`` (n, 3), uint8 or floats in [0, 1]. Those outside the hull
        and its margin are left out.
    hull : what was carved: its ``solid`` holds the object, give or take the margin.
    attraction : of the surface by support: the Gaussian sum of the confidences of the points near a voxel, 1 at the
        median of the voxels that hold points.
    evidence : most that a voxel near points costs, in faces.
    ballooning : keeps solid what nobody speaks of, in faces a voxel; much of it fills deep cavities with gaps.
    spread : standard deviation of a point's reach, voxels.
    margin : voxels around the hull that may become solid, too, at a cost, where carving went too far.
    smoothing : pairs of Taubin steps on the mesh.

    Returns
    -------
    o3d.geometry.TriangleMesh
        Closed and edge-manifold, coloured by the nearest points, normals outwards; without enclosed cavities.

    Raises
    ------
    ValueError : attributes are missing, misshapen or out of range.
    EmptyReconstructionError : no point lies in the hull, or everything is cheapest empty.

    References
    ----------
    Vogiatzis, Hernandez, Torr, Cipolla, "Multiview stereo via volumetric graph-cuts and occlusion robust
    photo-consistency", PAMI 2007 (costs of faces, ballooning). Hernandez, Vogiatzis, Cipolla, "Probabilistic
    visibility for multi-view stereo", CVPR 2007 (evidence for empty and solid). Boykov, Kolmogorov, "Computing
    geodesics and minimal surfaces via graph cuts", ICCV 2003 (areas on a lattice).
    """
    if not (attraction >= 0 and evidence > 0 and ballooning >= 0 and spread > 0 and margin >= 0):
        raise ValueError(
            "expected attraction, ballooning and margin >= 0, evidence and spread > 0, got "
            f"{attraction}, {ballooning}, {margin}, {evidence} and {spread}"
        )
    solid = hull.solid.occupied
    nodes = binary_dilation(solid, iterations=margin) if margin else solid
    oriented = _OrientedPoints.read(points).inside(hull, nodes)
    support, behind = _fields(oriented, nodes.shape, spread)
    terminal = np.where(solid, ballooning, -_OUTSIDE) + evidence * support / (support + _DOUBT) * np.clip(behind, -1, 1)
    occupied = binary_fill_holes(_cut(nodes, np.exp(-0.5 * attraction * support), terminal))
    if not occupied.any():
        raise EmptyReconstructionError(
            f"the cut left none of the hull's {int(solid.sum()):,} voxels; with more evidence or ballooning it keeps more"
        )
    distance = _surface_distance(occupied, hull, support, behind)
    mesh = mesh_level(
        np.pad(distance, _PADDING, constant_values=-1), 0.0, hull.volume, _PADDING, smoothing
    )
    vertices = np.asarray(mesh.vertices)
    mesh.vertex_colors = o3d.utility.Vector3dVector(
        blend_colors(oriented.world, oriented.colors, hull.volume.voxel_size, vertices)
    )
    return mesh
