"""Runs of the paper's method; finished ones are kept."""

import json
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from open3d.geometry import TriangleMesh

import recon3d
from recon3d.carving.visibility import sweep_direction
from recon3d.io import Checkpoints
from recon3d.io.geometry import from_arrays, geometry_arrays
from recon3d.rendering.sheets import portrait
from recon3d.settings import choose_views
from recon3d.tasks import Arrays, Kept, content_key, once

PROPOSED = recon3d.VoxelColoring()
HEAD = ("", "voxels accepted", "carving", "accuracy (90%)", "completeness (1.25 mm)")


@lru_cache
def photographs(folder: Path, silhouettes: str) -> recon3d.Scene:
    """The scene of a folder."""
    return recon3d.open_scene(folder, silhouettes=silhouettes)


def first_views(scene: recon3d.Scene, count: int) -> recon3d.Scene:
    """The first views, as the paper takes them, or the most spread of those that its constraint admits."""
    first = scene.subset([view.name for view in scene.views[:count]])
    if sweep_direction(first.centers, scene.bounds.corners):
        return first
    return choose_views(scene, recon3d.Settings(max_views=count, carving=PROPOSED))


@dataclass(frozen=True)
class Result:
    """A finished run; no record: nothing was left."""

    title: str
    scene: recon3d.Scene
    record: dict[str, Any] | None = None
    mesh: TriangleMesh | None = None
    evaluation: recon3d.Evaluation | None = None

    def row(self) -> tuple[str, ...]:
        """Cells under HEAD."""
        if self.record is None:
            return (self.title, "none", "", "", "")
        measured = self.evaluation
        figures = (f"{measured.accuracy_mm:.2f} mm", f"{measured.completeness_percent:.1f}%") if measured else ("", "")
        return (
            self.title,
            f"{self.record['voxels']['consistent']:,}",
            f"{self.record['timings_s']['carving']:.2f} s",
            *figures,
        )

    def picture(self, mode: str) -> NDArray[np.uint8]:
        """The mesh from the middle view, upright; white where nothing was left."""
        view = self.scene.views[len(self.scene.views) // 2]
        if self.mesh is None:
            return portrait(np.full((view.height, view.width, 3), 255, np.uint8), view, self.scene)
        return portrait(recon3d.rendering.Renderer(self.mesh).render_view(view).picture(mode), view, self.scene)


@dataclass(frozen=True)
class DataSet:
    """Photographs, what to measure against, and the folder of finished runs."""

    name: str
    folder: Path
    runs: Path
    n_voxels: int
    truth: TriangleMesh | None = None
    valid: NDArray[np.bool_] | None = None
    results: dict[str, Result] = field(default_factory=dict)

    def run(
        self,
        title: str,
        *,
        silhouettes: str = "auto",
        views: int | None = 8,
        carving: recon3d.VoxelColoring = PROPOSED,
        **options: Any,
    ) -> Result:
        """The paper's method with a change; a run that is finished is not made again."""
        if title in self.results:
            return self.results[title]
        everything = photographs(self.folder, silhouettes)
        scene = everything if views is None else first_views(everything, views)
        settings = recon3d.Settings(**{"n_voxels": self.n_voxels, "carving": carving, **options})
        settings = settings.resolved(scene)
        print(f"{self.name}: {title}", flush=True)
        kept = Kept(Checkpoints(self.runs / self.name), content_key(scene, settings.record()), _arrays, _restored)
        try:
            record, mesh = once(reconstructed, title, (scene, settings), kept=kept)
        except recon3d.errors.EmptyReconstructionError:
            return self.results.setdefault(title, Result(title, scene))
        evaluation = recon3d.evaluate(mesh, self.truth, valid=self.valid) if self.truth else None
        scene = scene.subset(record["scene"]["views"])
        return self.results.setdefault(title, Result(title, scene, record, mesh, evaluation))

    def proposed(self) -> Result:
        """The paper's own method."""
        return self.run("proposed")


def reconstructed(scene: recon3d.Scene, settings: recon3d.Settings) -> tuple[dict[str, Any], TriangleMesh]:
    """Record and mesh of a run."""
    with suppress(recon3d.errors.EmptyReconstructionError):  # compiled first, so that the time is the method's own
        recon3d.reconstruct(scene, replace(settings, n_voxels=1000))
    result = recon3d.reconstruct(scene, settings)
    return result.record(), result.mesh


def _arrays(found: tuple[dict[str, Any], TriangleMesh]) -> Arrays:
    """Record and mesh for a file."""
    return {"record": np.array(json.dumps(found[0], default=np.generic.item)), **geometry_arrays(found[1])}


def _restored(arrays: Arrays) -> tuple[dict[str, Any], TriangleMesh]:
    """Record and mesh of arrays that were kept."""
    record = dict(json.loads(str(arrays["record"])))
    return record, from_arrays(TriangleMesh(), {name: array for name, array in arrays.items() if name != "record"})
