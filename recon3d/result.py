"""What a finished run holds."""

from __future__ import annotations

import platform
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d._version import __version__
from recon3d.evaluation.distances import Evaluation
from recon3d.evaluation.photographs import Quality
from recon3d.io.geometry import from_arrays, geometry_arrays
from recon3d.rendering.renderer import Renderer
from recon3d.rendering.sheets import turntable
from recon3d.scene.scene import Scene
from recon3d.settings import Settings
from recon3d.summary import Summarised
from recon3d.surface.repair import Repairs, triangle_areas
from recon3d.tasks import versions
from recon3d.volume.carved import Carved


@dataclass(frozen=True, repr=False)
class Reconstruction(Summarised):
    """A finished run: what went in, what came out, and how long it took."""

    scene: Scene
    """With the views that were used."""
    settings: Settings
    carved: Carved
    """What carving left; of a dense result, after carving by the matched depths."""
    points: o3d.geometry.PointCloud
    """Coloured, with outward normals: the centres of the surface voxels, or the points that dense matching found."""
    confidence: NDArray[np.float64] | None
    """(n_points,) of matched points, in (0, 1); None of voxels."""
    mesh: o3d.geometry.TriangleMesh
    """Smooth, coloured from the views; closed, but for rims that ``quality`` counts, unless what is unsupported was
    left out."""
    support: NDArray[np.int64]
    """(n_vertices,) how many views see each vertex of the mesh; of a sharp mesh 0 where no point lies near it. Where
    it is 0, the hull closes the mesh."""
    repairs: Repairs
    """What was wrong with the mesh before."""
    timings: dict[str, float]
    """Seconds of each step."""
    quality: Quality
    """Of the mesh, by the photographs that it was made of."""
    evaluation: Evaluation | None = None
    """Of the mesh, where a ground truth was given."""

    @property
    def supported_share(self) -> float:
        """Share of the mesh's area, in [0, 1], that was measured: triangles whose vertices all have support."""
        triangles = np.asarray(self.mesh.triangles)
        areas = triangle_areas(np.asarray(self.mesh.vertices), triangles)
        return float(areas[(self.support[triangles] > 0).all(axis=1)].sum() / areas.sum())

    def __getstate__(self) -> dict[str, Any]:
        """Open3D's legacy geometry does not pickle: its arrays do."""
        arrays = {name: geometry_arrays(getattr(self, name)) for name in ("points", "mesh")}
        return {field.name: getattr(self, field.name) for field in fields(self)} | arrays

    def __setstate__(self, state: dict[str, Any]) -> None:
        made = {
            "points": from_arrays(o3d.geometry.PointCloud(), state["points"]),
            "mesh": from_arrays(o3d.geometry.TriangleMesh(), state["mesh"]),
        }
        self.__dict__.update(state | made)

    def record(self) -> dict[str, Any]:
        """Every parameter, version, timing and figure of the run, for a JSON file."""
        lattice = self.carved.lattice
        return {
            "recon3d": __version__,
            "versions": {"python": platform.python_version(), **versions()},
            "scene": {
                "name": self.scene.name,
                "views": [view.name for view in self.scene.views],
                "bounds": [list(self.scene.bounds.low), list(self.scene.bounds.high)],
                "mm_per_unit": self.scene.mm_per_unit,
                **self.scene.notes,
            },
            "settings": self.settings.record(),
            "volume": {"shape": list(lattice.shape), "voxel_size": lattice.voxel_size, "origin": list(lattice.origin)},
            "voxels": self.carved.counts(),
            "mesh": {
                "vertices": len(self.mesh.vertices),
                "triangles": len(self.mesh.triangles),
                "support": np.bincount(self.support).tolist(),
                **self.repairs.record(),
            },
            "timings_s": self.timings,
            "quality": self.quality.record(),
            "evaluation": self.evaluation.record() if self.evaluation else None,
        }

    def summary(self) -> dict[str, object]:
        """Table of the run."""
        lattice = self.carved.lattice
        mm = lattice.voxel_size * self.scene.mm_per_unit
        supported = self.supported_share
        return {
            "scene": f"{self.scene.name}, {len(self.scene.views)} views",
            "voxels": f"{lattice.n_voxels:,} of {mm:.3g} mm, {self.carved.n_accepted:,} accepted",
            "mesh": f"{len(self.mesh.triangles):,} triangles; {supported:.0%} of the surface measured, "
            f"{1 - supported:.0%} filled from the hull",
            **({"mended": str(self.repairs)} if str(self.repairs) else {}),
            "time": ", ".join(f"{name} {seconds:.2f} s" for name, seconds in self.timings.items()),
            **self.quality.summary(),
            **(self.evaluation.summary() if self.evaluation else {}),
        }

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB picture of the mesh from four sides."""
        return turntable(self.scene, Renderer(self.mesh), frames=4, size=200)
