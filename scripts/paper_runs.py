"""Runs of the paper's method, each in a folder of its own and taken up again from there."""

import json
import re
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
from recon3d.rendering.sheets import portrait
from recon3d.settings import choose_views

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
    """A finished run, as its folder holds it; no record: nothing was left."""

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
        """The paper's method with a change, from its folder where it has been run before."""
        if title in self.results:
            return self.results[title]
        everything = photographs(self.folder, silhouettes)
        scene = everything if views is None else first_views(everything, views)
        settings = recon3d.Settings(**{"n_voxels": self.n_voxels, "carving": carving, **options})
        settings = settings.resolved(scene)
        folder = self.runs / self.name / re.sub(r"\W+", "-", title).strip("-")
        print(f"{self.name}: {title}", flush=True)
        record = finished(folder, scene, settings)
        if record is None:
            try:
                record = reconstruct_into(folder, scene, settings)
            except recon3d.errors.EmptyReconstructionError:
                return self.results.setdefault(title, Result(title, scene))
        mesh = recon3d.read_mesh(folder / "mesh.ply")
        evaluation = recon3d.evaluate(mesh, self.truth, valid=self.valid) if self.truth else None
        scene = scene.subset(record["scene"]["views"])
        return self.results.setdefault(title, Result(title, scene, record, mesh, evaluation))

    def proposed(self) -> Result:
        """The paper's own method."""
        return self.run("proposed")


def finished(folder: Path, scene: recon3d.Scene, settings: recon3d.Settings) -> dict[str, Any] | None:
    """Record of a run that a folder holds, if it is of this scene, these settings and this version."""
    if not (folder / "record.json").is_file():
        return None
    record: dict[str, Any] = json.loads((folder / "record.json").read_text())
    wanted = (settings.record(), choose_views(scene, settings), scene.notes, recon3d.__version__)
    expected = [wanted[0], [view.name for view in wanted[1].views], wanted[2]["source"], wanted[3]]
    found = [record["settings"], record["scene"]["views"], record["scene"]["source"], record["recon3d"]]
    return record if found == json.loads(json.dumps(expected)) else None


def reconstruct_into(folder: Path, scene: recon3d.Scene, settings: recon3d.Settings) -> dict[str, Any]:
    """Reconstruct and save; returns the record."""
    with suppress(recon3d.errors.EmptyReconstructionError):  # compiled first, so that the time is the method's own
        recon3d.reconstruct(scene, replace(settings, n_voxels=1000))
    recon3d.save(recon3d.reconstruct(scene, settings), folder, pictures=False)
    return dict(json.loads((folder / "record.json").read_text()))
