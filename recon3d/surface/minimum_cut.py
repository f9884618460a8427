"""From oriented points to a closed surface: the minimum cut of the carved volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_fill_holes, gaussian_filter, generate_binary_structure

from recon3d.errors import ArgumentError, EmptyReconstructionError
from recon3d.kernels.min_cut import SINK, min_cut
from recon3d.kernels.splatting import OrientedPoints, splat_planes
from recon3d.kernels.types import Votes
from recon3d.surface.extraction import mesh_level
from recon3d.volume.carved import CarvedVolume
from recon3d.volume.dense import CarvingVolume

_OFFSETS = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])  # d ^ 1 leads back from d


_FACE = 2 / 3  # so that the lattice's areas are right on average over all directions (Boykov, Kolmogorov 2003)


_ROUND = generate_binary_structure(3, 2)  # face and edge neighbours, whose repeated dilation is nearly a ball


_UNIT = 1000  # the cut's whole numbers in the cost of a face that no point lies near


_DEAREST = 100_000  # faces that a voxel may cost, so that whole numbers do not overflow


_DOUBT = 0.1  # support that counts half


_PRIOR = 0.1  # weight of the cut's own smooth surface beside the points'


_OUTSIDE = 0.2  # cost of a voxel in the margin around the hull


_SHARP = 0.02  # voxels that the surface keeps from voxel centres


_PADDING = 2  # empty voxels around the volume, so that the surface closes


def graph_cut(
    points: o3d.t.geometry.PointCloud,
    hull: CarvedVolume,
    *,
    attraction: float = 2.0,
    evidence: float = 1.5,
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
        ``confidence`` (n,) or (n, 1) in (0, 1]. Those outside the hull and its margin are left out.
    hull : what was carved: its ``solid`` holds the object, give or take the margin.
    attraction : of the surface by support: the Gaussian sum of the confidences of the points near a voxel, 1 at the
        median of the voxels that hold points.
    evidence : most that a voxel near points costs, in faces.
    ballooning : cost of an unobserved voxel that is empty, in face costs; a large one fills deep cavities with gaps.
    spread : standard deviation of a point's reach, voxels.
    margin : voxels around the hull that may become solid, too, at a cost, where carving went too far.
    smoothing : pairs of Taubin steps on the mesh.

    Returns
    -------
    o3d.geometry.TriangleMesh
        Closed and edge-manifold, without colours and enclosed cavities, normals outwards.

    Raises
    ------
    ArgumentError : attributes are missing, misshapen or out of range.
    EmptyReconstructionError : no point lies in the hull, or everything is cheapest empty.

    References
    ----------
    Vogiatzis, Hernandez, Torr, Cipolla, "Multiview stereo via volumetric graph-cuts and occlusion robust
    photo-consistency", PAMI 2007 (costs of faces, ballooning). Hernandez, Vogiatzis, Cipolla, "Probabilistic
    visibility for multi-view stereo", CVPR 2007 (evidence for empty and solid). Boykov, Kolmogorov, "Computing
    geodesics and minimal surfaces via graph cuts", ICCV 2003 (areas on a lattice).
    """
    if not (0 <= attraction < np.inf and 0 < spread < np.inf and margin >= 0):
        raise ArgumentError(
            f"expected attraction and margin >= 0 and spread > 0, got {attraction}, {margin} and {spread}"
        )
    if not (0 < evidence <= _DEAREST and 0 <= ballooning <= _DEAREST):
        raise ArgumentError(
            f"expected evidence in (0, {_DEAREST}] and ballooning in [0, {_DEAREST}], got {evidence} and {ballooning}"
        )
    solid = hull.with_interior.occupied
    nodes = binary_dilation(solid, _ROUND, iterations=margin) if margin else solid
    oriented = _OrientedPoints.read(points).inside(hull.volume, nodes)
    support, behind = _votes(oriented, hull.volume, spread)
    terminal = np.where(solid, ballooning, -_OUTSIDE) + evidence * support / (support + _DOUBT) * np.clip(behind, -1, 1)
    occupied = binary_fill_holes(_cut(nodes, np.exp(-0.5 * attraction * support), terminal))
    if not occupied.any():
        raise EmptyReconstructionError(
            f"the cut left none of the hull's {int(solid.sum()):,} voxels; more evidence or ballooning would keep some"
        )
    distance = _surface_distance(occupied, hull, support, behind)
    return mesh_level(np.pad(distance, _PADDING, constant_values=-1), 0.0, hull.volume, _PADDING, smoothing)


@dataclass(frozen=True)
class _OrientedPoints:
    """Points with all that is known of them."""

    world: NDArray[np.float64]
    """(n, 3) positions, world units."""
    normals: NDArray[np.float32]
    """(n, 3) of unit length, outwards."""
    confidence: NDArray[np.float32]
    """(n,) in (0, 1]."""

    def __post_init__(self) -> None:
        n = len(self.world)
        if not self.world.shape == self.normals.shape == (n, 3) or self.confidence.shape != (n,):
            raise ArgumentError(
                f"expected points with positions and normals (n, 3) and confidence (n,), got {self.world.shape}, "
                f"{self.normals.shape} and {self.confidence.shape}"
            )
        if not np.isfinite(self.world).all():
            raise ArgumentError("expected finite positions of points")
        if not (np.abs(np.linalg.norm(self.normals, axis=1) - 1) < 1e-2).all():
            raise ArgumentError("expected normals of unit length at all points")
        if not ((self.confidence > 0) & (self.confidence <= 1)).all():
            raise ArgumentError("expected confidences of points in (0, 1]")

    @classmethod
    def read(cls, cloud: o3d.t.geometry.PointCloud) -> _OrientedPoints:
        """From an Open3D tensor point cloud."""
        names = ("positions", "normals", "confidence")
        missing = [name for name in names if name not in cloud.point]
        if missing:
            raise ArgumentError(f"expected points with {', '.join(names)}, got no {missing[0]}")
        positions, normals, confidence = (cloud.point[name].cpu().numpy() for name in names)
        confidence = confidence[:, 0] if confidence.ndim == 2 and confidence.shape[1] == 1 else confidence
        return cls(positions.astype(np.float64), normals.astype(np.float32), confidence.astype(np.float32))

    def on_lattice(self, volume: CarvingVolume) -> NDArray[np.float64]:
        """(n, 3) positions in a volume's voxels, whose centres lie at integers."""
        return np.asarray((self.world - volume.origin) / volume.voxel_size - 0.5)

    def inside(self, volume: CarvingVolume, mask: NDArray[np.bool_]) -> _OrientedPoints:
        """Those in a mask (nx, ny, nz) of a volume's voxels."""
        nearest = np.rint(self.on_lattice(volume)).astype(np.int64)
        kept = np.asarray(((nearest >= 0) & (nearest < volume.shape)).all(axis=1))
        kept[kept] = mask[tuple(nearest[kept].T)]
        if not kept.any():
            raise EmptyReconstructionError(f"none of {len(kept):,} points lies in the hull: are both in one frame?")
        return _OrientedPoints(self.world[kept], self.normals[kept], self.confidence[kept])


def _votes(
    points: _OrientedPoints, volume: CarvingVolume, spread: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Support of voxels (nx, ny, nz), about 1 at the surface, and mean distance behind the points' planes, voxels."""
    lattice = points.on_lattice(volume)
    support, behind = np.zeros(volume.shape, np.float32), np.zeros(volume.shape, np.float32)
    radius = int(np.ceil(2.5 * spread))
    oriented = OrientedPoints(lattice.astype(np.float32), points.normals, points.confidence)
    splat_planes(oriented, spread, radius, Votes(behind, support))
    np.divide(behind, support, out=behind, where=support > 0)
    holding = np.unique(np.ravel_multi_index(tuple(np.rint(lattice).astype(np.int64).T), volume.shape))
    return support / np.median(support.ravel()[holding]), behind


def _cut(nodes: NDArray[np.bool_], passage: NDArray[np.float32], terminal: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(nx, ny, nz) the solid voxels of the minimum cut, all others than the nodes being empty.

    Parameters
    ----------
    nodes : (nx, ny, nz) voxels that may be solid.
    passage : (nx, ny, nz) in (0, 1]; a face between two voxels costs the product of theirs.
    terminal : (nx, ny, nz) what a voxel costs when it is empty; negative: when it is solid.
    """
    index = np.full(np.array(nodes.shape) + 2, -1, np.int32)
    n = int(np.count_nonzero(nodes))
    index[1:-1, 1:-1, 1:-1][nodes] = np.arange(n, dtype=np.int32)
    at = np.argwhere(nodes) + 1
    neighbours = np.column_stack([index[tuple((at + offset).T)] for offset in _OFFSETS])
    outer = neighbours < 0
    own = passage[nodes][:, None]
    faces = _FACE * own * np.where(outer, own, own[neighbours, 0])
    # A face to what is empty for certain is a cost of being solid.
    rest = terminal[nodes] - np.where(outer, faces, 0).sum(axis=1)
    tree = np.empty(n, np.uint8)
    min_cut(neighbours, _whole(np.where(outer, 0, faces)), _whole(rest), tree)
    occupied = np.zeros(nodes.shape, np.bool_)
    occupied[nodes] = tree != SINK
    return occupied


def _whole(costs: NDArray[np.floating]) -> NDArray[np.int32]:
    """Costs in whole numbers of the cut's unit."""
    return np.asarray(np.rint(_UNIT * costs), np.int32)


def _surface_distance(
    occupied: NDArray[np.bool_], hull: CarvedVolume, support: NDArray[np.float32], behind: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(nx, ny, nz) signed distance in voxels near the surface: the points', the hull's or the smoothed cut's."""
    blurred = gaussian_filter(np.pad(occupied, _PADDING).astype(np.float32), 1.0)[(slice(_PADDING, -_PADDING),) * 3]
    smooth = np.sqrt(2 * np.pi) * (blurred - 0.5)  # a plane's, which a Gaussian of one voxel blurred
    if hull.distance is not None:
        outline = hull.distance / hull.volume.voxel_size
        smooth = np.where((np.abs(outline) < 1) & ((outline > 0) == occupied), outline, smooth)
    distance = (support * behind + _PRIOR * smooth) / (support + _PRIOR)
    return np.asarray(np.where(occupied, np.maximum(distance, _SHARP), np.minimum(distance, -_SHARP)), np.float32)
