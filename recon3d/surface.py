"""From occupied voxels to surfaces: coloured meshes and oriented points."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from recon3d.errors import EmptyReconstructionError
from recon3d.volume import CarvingVolume

_PADDING = 2  # empty voxels around the volume, so that the surface closes
_INNER = (slice(_PADDING, -_PADDING),) * 3


def mesh_volume(
    volume: CarvingVolume,
    *,
    colors_from: CarvingVolume | None = None,
    distance: NDArray[np.float32] | None = None,
    smoothing: int = 5,
) -> o3d.geometry.TriangleMesh:
    """Smooth closed mesh of the occupied voxels, coloured at its vertices, normals outwards.

    Marching cubes between voxel centres, the volume's border counting as empty, on a blurred occupancy that keeps
    every voxel on its side of the level, so that nothing thin is lost; then Taubin's smoothing, which does not shrink.

    Parameters
    ----------
    colors_from : volume whose occupied voxels lend their colours; the volume itself when None.
    distance : (nx, ny, nz) signed distance of voxel centres to a surface that holds the volume, world units, positive
        inside. The mesh follows it to a fraction of a voxel where no more was carved.
    smoothing : pairs of Taubin steps; 0 keeps the marching cubes' facets.

    References
    ----------
    Lewiner et al., "Efficient implementation of marching cubes' cases with topological guarantees", 2003.
    Taubin, "A signal processing approach to fair surface design", SIGGRAPH 1995.
    """
    _require_voxels(volume)
    padded = np.pad(volume.occupied, _PADDING).astype(np.float32)
    # In (0.5, 1] where occupied and [0, 0.5) elsewhere; without ties marching cubes gives manifold edges.
    field = 0.5 * padded + np.clip(0.5 * gaussian_filter(padded, 1.0), 1e-3, 0.5 - 1e-3)
    if distance is not None:
        inside = np.pad(np.clip(distance / volume.voxel_size, -0.5, 0.5) + 0.5, _PADDING)
        carved = (inside > 0.5) & (padded == 0)
        near = gaussian_filter(carved.astype(np.float32), 1.0) > 1e-3 if carved.any() else carved
        field = np.where(near, np.minimum(field, inside), inside)
    vertices, faces, _, _ = marching_cubes(field, 0.5, gradient_direction="ascent")
    # A voxel's index is its centre in marching cubes, its lowest corner in a volume.
    points = volume.origin + (vertices - _PADDING + 0.5) * volume.voxel_size
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(points), o3d.utility.Vector3iVector(faces))
    if smoothing:
        mesh = mesh.filter_smooth_taubin(smoothing)
    mesh.compute_vertex_normals()
    colors = nearest_colors(colors_from or volume, np.asarray(mesh.vertices))
    mesh.vertex_colors = o3d.utility.Vector3dVector(colors)
    return mesh


def surface_points(volume: CarvingVolume, *, solid: CarvingVolume | None = None) -> o3d.geometry.PointCloud:
    """Coloured centres of the surface voxels, with unit normals outwards.

    Parameters
    ----------
    solid : shape on the same lattice that says what is inside, where the volume is only a shell; it gives the
        normals. The volume itself when None.
    """
    _require_voxels(volume)
    surface = volume.surface()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(volume.centers(surface)))
    cloud.colors = o3d.utility.Vector3dVector(volume.colors[surface] / 255.0)
    cloud.normals = o3d.utility.Vector3dVector(_outward_normals((solid or volume).occupied, surface))
    return cloud


def nearest_colors(volume: CarvingVolume, points: NDArray[np.float64], neighbours: int = 8) -> NDArray[np.float64]:
    """(n, 3) colours in [0, 1] at world points (n, 3): mean of the nearest occupied voxels', by inverse distance."""
    centers = volume.centers()
    count = min(neighbours, len(centers))
    distance, index = cKDTree(centers).query(points, k=range(1, count + 1), workers=-1)
    weight = 1 / (distance + 0.1 * volume.voxel_size)
    colors = volume.colors[volume.occupied][index] / 255.0
    return np.asarray(np.clip((colors * weight[..., None]).sum(1) / weight.sum(1, keepdims=True), 0, 1))


def _outward_normals(occupied: NDArray[np.bool_], where: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(n, 3) unit vectors down the gradient of the blurred occupancy at the voxels of a mask."""
    blurred = gaussian_filter(np.pad(occupied, _PADDING).astype(np.float32), 1.0)
    normals = np.empty((int(where.sum()), 3))
    for axis in range(3):
        slope = np.gradient(blurred, axis=axis)[_INNER]
        normals[:, axis] = -slope[where]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, length, out=np.tile([0.0, 0.0, 1.0], (len(normals), 1)), where=length > 1e-9))


def _require_voxels(volume: CarvingVolume) -> None:
    if not volume.n_occupied:
        raise EmptyReconstructionError("the volume holds no voxels, so it has no surface")
