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
from recon3d.evaluation.thin_parts import lost_thin_parts
from recon3d.io.geometry import from_arrays, geometry_arrays
from recon3d.io.run_record import FORMAT
from recon3d.rendering.renderer import Renderer
from recon3d.rendering.sheets import turntable
from recon3d.scene.scene import Scene
from recon3d.settings import Settings
from recon3d.summary import Summarised
from recon3d.surface.decimation import Decimation
from recon3d.surface.repair import Repairs, triangle_areas
from recon3d.surface.uncertainty import predicted_distance
from recon3d.surface.visibility import keep_vertices
from recon3d.tasks import versions
from recon3d.volume.carved import Carved

_LEAST_OVERLAP = 0.7  # of mesh and silhouettes
_MOST_DIFFERENT = 30.0  # grey levels
_LEAST_MEASURED = 0.02  # of the surface, by dense matching


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
    """Coloured from the views. Closed, but for the open boundaries that ``quality`` counts, unless unsupported surface
    was left out."""
    support: NDArray[np.int64]
    """(n_vertices,) views that measured each vertex of the mesh: that see it and, with dense matching, near a matched
    point. 0: filled from the hull."""
    uncertainty: NDArray[np.float64] | None
    """(n_vertices,) predicted distance of each vertex of the mesh to the true surface, world units: 68% lie within it,
    95% within twice as much. Infinite where the surface was filled; None of a mesh of voxels."""
    repairs: Repairs
    """What was wrong with the mesh before."""
    timings: dict[str, float]
    """Seconds of each step."""
    quality: Quality
    """Of the mesh, by the photographs that it was made of."""
    evaluation: Evaluation | None = None
    """Of the whole mesh, where a ground truth was given."""
    supported_evaluation: Evaluation | None = None
    """Of the measured part alone, where a ground truth was given; None also where nothing was measured."""
    decimation: Decimation | None = None
    """What fewer triangles cost, where they were asked for."""

    @property
    def supported_share(self) -> float:
        """Share of the mesh's area, in [0, 1], that was measured: triangles whose vertices all have support."""
        triangles = np.asarray(self.mesh.triangles)
        areas = triangle_areas(np.asarray(self.mesh.vertices), triangles)
        return float(areas[(self.support[triangles] > 0).all(axis=1)].sum() / areas.sum())

    def predicted_accuracy(self, share: float = 0.9) -> float | None:
        """Distance to the true surface, world units, within which a share of the measured vertices is predicted to lie.

        None of a mesh of voxels, and where nothing was measured.
        """
        if self.uncertainty is None or not np.isfinite(self.uncertainty).any():
            return None
        return predicted_distance(self.uncertainty, share)

    def doubt(self) -> str | None:
        """One sentence on why the result cannot be right, by its own photographs; None: nothing speaks against it."""
        overall, share = self.quality.overall, self.supported_share
        if overall.overlap is not None and overall.overlap < _LEAST_OVERLAP:
            told = f"the mesh and the silhouettes overlap by only {overall.overlap:.0%}"
        elif overall.median is not None and overall.median > _MOST_DIFFERENT:
            told = (
                f"half of the mesh's pixels differ from the photographs by more than {overall.median:.0f} grey levels"
            )
        elif self.confidence is not None and share < _LEAST_MEASURED:
            told = f"only {share:.1%} of the surface could be measured"
        else:
            return None
        return (
            f"the result cannot be right: {told}; recon3d info tells what may be wrong with cameras, masks and bounds"
        )

    def lost_parts(self) -> str | None:
        """One sentence on long parts of the silhouettes that are thinner than the voxels, and lost; None: none are."""
        lost = lost_thin_parts(self.mesh, self.scene.views, self.scene.bounds, self.carved.lattice.voxel_size)
        if lost is None:
            return None
        return (
            f"thin parts that the silhouettes show are not in the mesh ({', '.join(lost.views[:3])}"
            f"{' ...' * (len(lost.views) > 3)}): they are thinner than a voxel of {self.carved.lattice.voxel_size:.3g} "
            f"world units; --voxel-size {lost.voxel_size:.2g} may keep them"
        )

    def supported_mesh(self) -> o3d.geometry.TriangleMesh:
        """The part of the mesh that was measured: triangles whose vertices all have support."""
        return keep_vertices(self.mesh, self.support > 0)

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
            "format": FORMAT,
            "recon3d": __version__,
            "versions": {"python": platform.python_version(), **versions()},
            "scene": {
                **self.scene.notes,  # first: what says where the bounds are from must not replace them
                "name": self.scene.name,
                "views": [view.name for view in self.scene.views],
                "bounds": [list(self.scene.bounds.low), list(self.scene.bounds.high)],
                "mm_per_unit": self.scene.mm_per_unit,
            },
            "settings": self.settings.record(),
            "volume": {"shape": list(lattice.shape), "voxel_size": lattice.voxel_size, "origin": list(lattice.origin)},
            "voxels": self.carved.counts(),
            "mesh": {
                "vertices": len(self.mesh.vertices),
                "triangles": len(self.mesh.triangles),
                "support": np.bincount(self.support).tolist(),
                "supported_share": self.supported_share,
                "predicted_accuracy": self.predicted_accuracy(),
                **self.repairs.record(),
                "decimation": self.decimation.record() if self.decimation else None,
            },
            "timings_s": self.timings,
            "quality": self.quality.record(),
            "evaluation": self.evaluation.record() if self.evaluation else None,
            "supported_evaluation": self.supported_evaluation.record() if self.supported_evaluation else None,
        }

    def summary(self) -> dict[str, object]:
        """Table of the run, what was measured first."""
        lattice = self.carved.lattice
        share, side = self.supported_share, self.scene.length(self.carved.lattice.voxel_size)
        distances = {"measured surface": self.supported_evaluation, "whole mesh": self.evaluation}
        if share == 1:
            del distances["whole mesh"]
        predicted = self.predicted_accuracy()
        fewer = self.decimation.told(self.scene.mm_per_unit) if self.decimation else ""
        return {
            "scene": f"{self.scene.name}, {len(self.scene.views)} views",
            "surface": f"{share:.0%} measured" + (f", {1 - share:.0%} filled from the hull" if share < 1 else ""),
            **(
                {}
                if predicted is None
                else {"uncertainty": f"90% of the measured surface within {self.scene.length(predicted)}, predicted"}
            ),
            **{name: distance.headline() for name, distance in distances.items() if distance},
            **self.quality.summary(),
            "mesh": "; ".join(filter(None, (f"{len(self.mesh.triangles):,} triangles", fewer, str(self.repairs)))),
            "voxels": f"{lattice.n_voxels:,} of {side}, {self.carved.n_accepted:,} accepted",
            "time": ", ".join(f"{name} {seconds:.2f} s" for name, seconds in self.timings.items()),
        }

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB picture of the mesh from four sides."""
        return turntable(self.scene, Renderer(self.mesh), frames=4, size=200)
