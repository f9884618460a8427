"""From occupied voxels to surfaces: coloured meshes and oriented points."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.bricks import BRICK, EMPTY
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice
from recon3d.volume.sparse import SparseVolume

_PADDING = 2  # empty voxels around the volume, so that the surface closes


_INNER = (slice(_PADDING, -_PADDING),) * 3


_BLUR_RADIUS = 4  # voxels that scipy's Gaussian of one voxel reaches


_BLOCK = 8  # bricks along the edge of what is meshed at a time


_BATCH = 1 << 17  # points coloured at a time


def mesh_volume(
    volume: CarvingVolume,
    *,
    colors_from: CarvingVolume | None = None,
    distance: NDArray[np.float32] | None = None,
    smoothing: int = 5,
) -> o3d.geometry.TriangleMesh:
    """Smooth closed mesh of the occupied voxels, coloured at its vertices by the nearest voxels, normals outwards.

    Parameters
    ----------
    colors_from : volume whose occupied voxels lend their colours; the volume itself when None.
    distance : (nx, ny, nz), and
    smoothing : of the shape, see ``mesh_shape``.
    """
    mesh = mesh_shape(volume, distance=distance, smoothing=smoothing)
    colors = nearest_colors(colors_from or volume, np.asarray(mesh.vertices))
    mesh.vertex_colors = o3d.utility.Vector3dVector(colors)
    return mesh


def mesh_shape(
    volume: CarvingVolume, *, distance: NDArray[np.float32] | None = None, smoothing: int = 5
) -> o3d.geometry.TriangleMesh:
    """Smooth closed mesh of the occupied voxels, without colours, normals outwards.

    Marching cubes between voxel centres, the volume's border counting as empty, on a blurred occupancy that keeps
    every voxel on its side of the level, so that nothing thin is lost; then Taubin's smoothing, which does not shrink.

    Parameters
    ----------
    distance : (nx, ny, nz) signed distance of voxel centres to a surface that holds the volume, world units, positive
        inside. The mesh follows it to a fraction of a voxel where no more was carved.
    smoothing : pairs of Taubin steps; 0 keeps the marching cubes' facets.

    References
    ----------
    Lewiner et al., "Efficient implementation of marching cubes' cases with topological guarantees", 2003.
    Taubin, "A signal processing approach to fair surface design", SIGGRAPH 1995.
    """
    _require_voxels(volume)
    occupied = np.pad(volume.occupied, _PADDING)
    if distance is not None:
        distance = np.pad(distance, _PADDING, constant_values=-volume.voxel_size)
    return mesh_level(_level_field(occupied, distance, volume.voxel_size), 0.5, volume, _PADDING, smoothing)


def mesh_level(
    field: NDArray[np.float32], level: float, volume: CarvingVolume, padding: int, smoothing: int
) -> o3d.geometry.TriangleMesh:
    """Uncoloured mesh of a field's level set, normals to where it is lower; closed where the field's border is lower.

    Parameters
    ----------
    field : (nx + 2 padding, ny + 2 padding, nz + 2 padding) at the centres of a volume's voxels and of some around it.
    smoothing : pairs of Taubin steps.
    """
    vertices, faces, _, _ = marching_cubes(field, level, gradient_direction="ascent")
    # A voxel's index is its centre in marching cubes, its lowest corner in a volume.
    return _smooth_mesh(vertices - padding + 0.5, faces, smoothing, volume.lattice)


def mesh_sparse(volume: SparseVolume, *, smoothing: int = 5) -> o3d.geometry.TriangleMesh:
    """Smooth closed mesh of a sparse volume, coloured by its visible voxels, normals outwards; see ``sparse_shape``."""
    mesh = sparse_shape(volume, smoothing=smoothing)
    lenders = volume.visible if volume.visible.any() else volume.surface()
    mesh.vertex_colors = o3d.utility.Vector3dVector(
        blend_colors(volume.centers(lenders), volume.colors[lenders], volume.voxel_size, np.asarray(mesh.vertices))
    )
    return mesh


def sparse_shape(volume: SparseVolume, *, smoothing: int = 5) -> o3d.geometry.TriangleMesh:
    """Smooth closed mesh of a sparse volume, without colours, normals outwards.

    The mesh that ``mesh_shape`` makes of the same voxels, except within 4 voxels of the lattice's border, made block
    by block: neighbouring blocks share a layer of samples, and their vertices are welded where they lie on the same
    edge of the lattice.

    Parameters
    ----------
    smoothing : pairs of Taubin steps; 0 keeps the marching cubes' facets.

    Raises
    ------
    EmptyReconstructionError : no voxel is occupied.
    """
    _require_voxels(volume)
    vertices, faces, edges = [], [], []
    n_vertices = 0
    for low, field in _surface_blocks(volume):
        local, triangles, _, _ = marching_cubes(field, 0.5, gradient_direction="ascent")
        vertices.append(low + local + 0.5)
        faces.append(triangles.astype(np.int64) + n_vertices)
        edges.append(_lattice_edges(low, local, volume.shape))
        n_vertices += len(local)
    _, first, welded = np.unique(np.concatenate(edges), return_index=True, return_inverse=True)
    return _smooth_mesh(np.concatenate(vertices)[first], welded[np.concatenate(faces)], smoothing, volume.lattice)


def _surface_blocks(volume: SparseVolume) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float32]]]:
    """Blocks that hold some surface: the lowest voxel (3,) and the field of their samples, one more than their cells.

    The lowest cells lie between the lattice and the empty voxels before it.
    """
    slots = np.pad(volume.slots, ((1, _BLOCK), (1, _BLOCK), (1, _BLOCK)), constant_values=EMPTY)
    n_cells = _BLOCK * BRICK
    side = n_cells + 1 + 2 * _BLUR_RADIUS
    for block in product(*(range((n + n_cells) // n_cells) for n in volume.shape)):
        near = slots[tuple(slice(_BLOCK * b, _BLOCK * (b + 1) + 1) for b in block)]
        if near.max() < 0 and near.min() == near.max():
            continue  # empty or solid throughout
        low = n_cells * np.array(block) - 1
        field = _level_field(*volume.box(low - _BLUR_RADIUS, (side, side, side)), volume.voxel_size)
        field = field[(slice(_BLUR_RADIUS, -_BLUR_RADIUS),) * 3]
        if field.min() < 0.5 < field.max():
            yield low, np.ascontiguousarray(field)


def _lattice_edges(
    low: NDArray[np.int64], vertices: NDArray[np.float32], shape: tuple[int, int, int]
) -> NDArray[np.int64]:
    """(n,) number of the lattice's edge that each vertex (n, 3) of a block lies on, or of the cell that it lies in."""
    corner = np.floor(vertices)
    between = vertices > corner
    i, j, k = (corner.astype(np.int64) + low + 1).T
    cell = (i * (shape[1] + 2) + j) * (shape[2] + 2) + k
    # Marching cubes puts a vertex on an edge along one axis, or inside a cell.
    return np.asarray(4 * cell + np.where(between.sum(axis=1) == 1, between.argmax(axis=1), 3))


def _level_field(
    occupied: NDArray[np.bool_], distance: NDArray[np.float32] | None, voxel_size: float
) -> NDArray[np.float32]:
    """Smooth field in [0, 1] above 0.5 inside, of a padded volume."""
    inside = carved = None
    if distance is not None:
        inside = np.clip(distance / voxel_size, -0.5, 0.5) + 0.5
        carved = (inside > 0.5) & ~occupied
    if inside is None or carved is None or carved.any():
        sharp = occupied.astype(np.float32)
        # In (0.5, 1] where occupied and [0, 0.5) elsewhere.
        field = 0.5 * sharp + np.clip(0.5 * gaussian_filter(sharp, 1.0), 1e-3, 0.5 - 1e-3)
        if inside is not None and carved is not None:
            near = gaussian_filter(carved.astype(np.float32), 1.0) > 1e-3
            field = np.where(near, np.minimum(field, inside), inside)
    else:
        field = inside
    # Without ties marching cubes gives manifold edges, and its vertices keep clear of the lattice's points.
    return np.asarray(np.where(field > 0.5, np.maximum(field, 0.5 + 1e-3), np.minimum(field, 0.5 - 1e-3)), np.float32)


def _smooth_mesh(
    points: NDArray[np.floating], faces: NDArray[np.integer], smoothing: int, lattice: Lattice
) -> o3d.geometry.TriangleMesh:
    """Mesh with normals after some pairs of Taubin steps; of points (n, 3) in voxels from the lattice's origin.

    Smoothed in voxels, since Open3D weighs by distances that must not be tiny.
    """
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(points.astype(np.float64)), o3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    if smoothing:
        mesh = mesh.filter_smooth_taubin(smoothing)
    mesh.compute_vertex_normals()
    mesh.scale(lattice.voxel_size, np.zeros(3))
    mesh.translate(lattice.origin)
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
    return blend_colors(volume.centers(), volume.colors[volume.occupied], volume.voxel_size, points, neighbours)


def blend_colors(
    centers: NDArray[np.float64],
    colors: NDArray[np.uint8],
    voxel_size: float,
    points: NDArray[np.float64],
    neighbours: int = 8,
) -> NDArray[np.float64]:
    """(n, 3) colours in [0, 1] at world points (n, 3): mean of the nearest centres' (m, 3), by inverse distance."""
    tree = cKDTree(centers)
    count = min(neighbours, len(centers))
    blended = np.empty((len(points), 3))
    for start in range(0, len(points), _BATCH):
        part = slice(start, start + _BATCH)
        distance, index = tree.query(points[part], k=range(1, count + 1), workers=-1)
        weight = 1 / (distance + 0.1 * voxel_size)
        total = (colors[index] / 255.0 * weight[..., None]).sum(1)
        blended[part] = np.clip(total / weight.sum(1, keepdims=True), 0, 1)
    return blended


def _outward_normals(occupied: NDArray[np.bool_], where: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(n, 3) unit vectors down the gradient of the blurred occupancy at the voxels of a mask."""
    blurred = gaussian_filter(np.pad(occupied, _PADDING).astype(np.float32), 1.0)
    normals = np.empty((int(where.sum()), 3))
    for axis in range(3):
        slope = np.gradient(blurred, axis=axis)[_INNER]
        normals[:, axis] = -slope[where]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, length, out=np.tile([0.0, 0.0, 1.0], (len(normals), 1)), where=length > 1e-9))


def _require_voxels(volume: CarvingVolume | SparseVolume) -> None:
    if not volume.n_occupied:
        raise EmptyReconstructionError("the volume holds no voxels, so it has no surface")
