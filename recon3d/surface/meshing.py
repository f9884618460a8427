"""How a mesh is made of what carving and matching found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, get_args

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.checks import require_choice, require_flag, require_number, require_whole
from recon3d.surface.decimation import LEAST_TRIANGLES, Decimation, decimate
from recon3d.surface.extraction import mesh_shape, sparse_shape
from recon3d.surface.poisson import MeasuredSpace, Surface, mesh_points
from recon3d.surface.repair import Repairs, repair_mesh
from recon3d.volume.carved import Carved
from recon3d.volume.sparse import SparseVolume

_SMOOTHING = 5  # pairs of Taubin steps on a mesh of voxels


@dataclass(frozen=True)
class Meshing:
    """How a mesh is made: of the points that dense matching found, or of the voxels where nothing was matched."""

    surface: Surface = "poisson"
    """Of points: "poisson" or "graph-cut"."""
    keep_unsupported: bool | None = None
    """Keep unmeasured surface, such as the underside that no view sees, so that the mesh is closed; None: where
    silhouettes bound it, or no points were matched.
    Surface of voxels is measured where a view sees it, surface of points where two views found it."""
    max_uncertainty: float | None = None
    """Of points: surface of a larger predicted uncertainty, world units, is left out, and so is all that was not
    measured; None keeps all."""
    fill_hidden: bool = False
    """Of voxels carved by a one-sided method: mesh what lies hidden behind them, too; solid, but partly guessed."""
    smoothing: int | None = None
    """Of voxels: pairs of Taubin steps; 0: none, 5 when None."""
    min_component: float = 100.0
    """Area, in faces of a voxel, below which a separate piece of the mesh is a small component and dropped; 100 is the
    surface of four voxels cubed, 0 keeps all."""
    triangles: int | None = None
    """At most so many, by collapsing edges (quadrics) before anything is measured of the mesh; None keeps all."""

    def __post_init__(self) -> None:
        require_choice("surface", self.surface, get_args(Surface))
        if self.keep_unsupported is not None:
            require_flag("keep_unsupported", self.keep_unsupported)
        if self.max_uncertainty is not None:
            require_number("max_uncertainty", self.max_uncertainty, "(0, inf)")
        require_flag("fill_hidden", self.fill_hidden)
        if self.smoothing is not None:
            require_whole("smoothing", self.smoothing, least=0)
        require_number("min_component", self.min_component, "[0, inf)")
        if self.triangles is not None:
            require_whole("triangles", self.triangles, LEAST_TRIANGLES)


class Meshed(NamedTuple):
    """A mesh, and what is known of it."""

    mesh: o3d.geometry.TriangleMesh
    """Manifold, normals outwards, without colours; closed, but for small holes that Poisson may leave."""
    measured: NDArray[np.bool_]
    """(n_vertices,) whether a matched point lies near a vertex and faces where it does; True throughout a mesh of
    voxels."""
    repairs: Repairs
    """What was wrong with it before."""
    decimation: Decimation | None = None
    """What fewer triangles cost; None: it has those that it was made with."""


def mesh(
    carved: Carved,
    points: o3d.t.geometry.PointCloud | None = None,
    meshing: Meshing | None = None,
    *,
    spacing: float | None = None,
    one_sided: bool = False,
) -> Meshed:
    """Mesh of matched points inside a carved volume, or of the volume's voxels where no points are given.

    Parameters
    ----------
    carved : what carving or ``refine`` left; unmeasured regions are filled from it.
    points : as ``refine`` finds them.
    meshing : how; ``Meshing()`` when None. What of the mesh is unsupported is known only with the views, so
        ``keep_unsupported`` means nothing here.
    spacing : of the points, see ``mesh_points``; world units.
    one_sided : the voxels are a shell, seen from one side: what is hidden behind it is meshed only if
        ``meshing.fill_hidden``.

    Raises
    ------
    EmptyReconstructionError : no voxel is left, or no point lies in the hull.
    """
    meshing = meshing or Meshing()
    lattice = carved.lattice
    if points is not None:
        measured = MeasuredSpace(points, spacing or lattice.voxel_size / 2)
        found = mesh_points(points, carved.dense(), surface=meshing.surface, spacing=spacing, measured=measured)
    else:
        measured = None
        found = _mesh_of_voxels(carved, _SMOOTHING if meshing.smoothing is None else meshing.smoothing,
                                shell=one_sided and not meshing.fill_hidden)  # fmt: skip
    sound, repairs, _ = repair_mesh(found, min_area=meshing.min_component * lattice.voxel_size**2)
    decimation = None
    if meshing.triangles is not None:
        sound, decimation = decimate(sound, meshing.triangles)
    everywhere = np.ones(len(sound.vertices), np.bool_)
    return Meshed(sound, everywhere if measured is None else measured.holds_surface(sound), repairs, decimation)


def _mesh_of_voxels(carved: Carved, smoothing: int, *, shell: bool) -> o3d.geometry.TriangleMesh:
    """Uncoloured mesh of the accepted voxels, or of all that is solid."""
    if isinstance(carved, SparseVolume):
        return sparse_shape(carved, smoothing=smoothing)
    dense = carved.dense()
    return mesh_shape(dense.volume if shell else dense.with_interior, distance=dense.distance, smoothing=smoothing)
