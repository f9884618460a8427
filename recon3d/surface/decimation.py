"""Meshes of fewer triangles, and how far they lie from what they were made of."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
import open3d as o3d

from recon3d.checks import require_whole
from recon3d.errors import ArgumentError
from recon3d.rendering.ray_caster import RayCaster
from recon3d.surface.repair import repair_mesh

LEAST_TRIANGLES = 4
"""A closed mesh has no fewer."""


@dataclass(frozen=True)
class Decimation:
    """What fewer triangles cost: distances between a mesh and the decimated one, world units."""

    triangles_before: int
    triangles: int
    typical_error: float
    """90% of the vertices of the one lie within it of the other, whichever of the two ways is farther."""
    largest_error: float
    """All do."""

    def record(self) -> dict[str, float]:
        """The figures by name."""
        return asdict(self)

    def told(self, mm_per_unit: float | None) -> str:
        """One line, in millimetres where the scale is known."""
        unit = "units (no scale)" if mm_per_unit is None else "mm"
        typical, largest = (error * (mm_per_unit or 1) for error in (self.typical_error, self.largest_error))
        return (
            f"decimated from {self.triangles_before:,}, which moved 90% of it by less than {typical:.2g} {unit}, "
            f"the rest by at most {largest:.2g} {unit}"
        )


class Decimated(NamedTuple):
    """A mesh of fewer triangles."""

    mesh: o3d.geometry.TriangleMesh
    """Manifold, with normals; its colours are those of the given mesh, merged."""
    decimation: Decimation | None
    """None: the mesh had no more triangles than were asked for, and is as it was."""


def decimate(mesh: o3d.geometry.TriangleMesh, triangles: int) -> Decimated:
    """A mesh of at most so many triangles, by collapsing edges where that moves the surface least (quadrics).

    Parameters
    ----------
    mesh : manifold.
    triangles : at least 4.

    Raises
    ------
    ArgumentError : fewer triangles are asked for than the shape of the mesh needs.

    References
    ----------
    Garland, Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997.
    """
    require_whole("triangles", triangles, LEAST_TRIANGLES)
    if len(mesh.triangles) <= triangles:
        return Decimated(mesh, None)
    fewer = mesh.simplify_quadric_decimation(triangles)
    if not len(fewer.triangles) or len(fewer.triangles) > triangles:
        raise ArgumentError(
            f"expected triangles that the shape of the mesh can do with, got {triangles:,}: of "
            f"{len(mesh.triangles):,}, {len(fewer.triangles):,} are left"
        )
    fewer.remove_unreferenced_vertices()
    fewer = repair_mesh(fewer).mesh
    fewer.compute_vertex_normals()
    errors = [
        RayCaster(surface).distances(np.asarray(other.vertices)) for surface, other in ((fewer, mesh), (mesh, fewer))
    ]
    told = Decimation(
        len(mesh.triangles),
        len(fewer.triangles),
        max(float(np.quantile(error, 0.9)) for error in errors),
        max(float(error.max()) for error in errors),
    )
    return Decimated(fewer, told)
