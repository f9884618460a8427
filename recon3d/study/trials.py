"""One photo-consistency test at a time under conditions that are the same for all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d._version import __version__
from recon3d.carving import GeneralizedVoxelColoring, JudgingMethod, VoxelColoring
from recon3d.carving.visibility import spread_views
from recon3d.errors import ArgumentError, EmptyReconstructionError, FailedTestError
from recon3d.evaluation.distances import Evaluation, evaluate
from recon3d.evaluation.photographs import measure_quality
from recon3d.pipeline import Progress, reconstruct
from recon3d.rendering.renderer import Renderer
from recon3d.rendering.sheets import portrait
from recon3d.result import Reconstruction
from recon3d.scene.scene import Scene
from recon3d.scene.view import View
from recon3d.settings import Settings, choose_views, method_name
from recon3d.study.memory import peak_memory
from recon3d.study.variants import Variant
from recon3d.summary import labelled_row
from recon3d.tasks import content_key
from recon3d.volume.lattice import Lattice

PICTURE_WIDTH = 200
"""Pixels of each picture on a contact sheet."""


_SHOWN = 4  # cameras on the contact sheet


_WARM_UP_VOXELS = 1000


@dataclass(frozen=True)
class Trial:
    """Figures of one test; None where nothing was left, or nothing was known to measure against."""

    label: str
    family: str
    """Label without the swept parameter."""
    value: float | None
    """Of the swept parameter; None where the test is not swept."""
    accepted: int
    """Voxels."""
    carving_s: float
    """Seconds of carving, everything compiled and loaded before."""
    memory_mib: float | None
    """What the whole run, carving and meshing, adds to the process at its highest (``peak_memory``)."""
    holes: int | None = None
    """Handles through the closed pieces of the mesh, and rims of its open ones."""
    floating: int | None = None
    """Pieces beside the largest, with the small components that the mesh goes without."""
    roughness_degrees: float | None = None
    """Mean angle between neighbouring triangles; see ``ShapeQuality.dihedral_degrees``."""
    median_error: float | None = None
    """Of re-projection, grey levels; see ``Reprojection``."""
    mean_error: float | None = None
    rms_error: float | None = None
    overlap_percent: float | None = None
    """Silhouettes, intersection over union."""
    accuracy_mm: float | None = None
    completeness_percent: float | None = None
    precision_percent: float | None = None
    """Share of the mesh within the completeness' threshold of the ground truth."""


@dataclass(frozen=True)
class TrialSetup:
    """What is the same for all tests."""

    used: Scene
    held_out: tuple[View, ...]
    shown: Scene
    """Views of the contact sheet."""
    settings: Settings
    """Resolved; the test of its method is replaced by each of those compared."""
    method: JudgingMethod
    """Of the settings."""
    voxels: int
    """Of the volume."""
    ground_truth: o3d.geometry.TriangleMesh | o3d.geometry.PointCloud | None
    options: Mapping[str, Any]
    """Of ``evaluate``."""

    def run(self, entry: Variant, progress: Progress) -> tuple[Trial, NDArray[np.uint8]]:
        """Figures of a test, and its row (height, width, 3) of the contact sheet."""
        settings = replace(self.settings, carving=replace(self.method, test=entry.test))
        try:
            self._warm_up(settings)
            start = perf_counter()
            with peak_memory() as peak:
                result = reconstruct(self.used, settings, progress=progress)
        except EmptyReconstructionError:
            trial = Trial(entry.label, entry.family, entry.value, 0, round(perf_counter() - start, 3), peak.mib)
            blank = [np.full((1, PICTURE_WIDTH, 3), 255, np.uint8)] * len(self.shown.views)
            return trial, labelled_row(f"{entry.label}: nothing left", blank, width=PICTURE_WIDTH)
        except FailedTestError as error:
            raise FailedTestError(f"{entry.label}: {error}") from error
        renderer = Renderer(result.mesh)
        row = self.row(entry.label, [renderer.render_view(view).picture() for view in self.shown.views])
        return self._measured(entry, result, peak.mib), row

    def row(self, label: str, pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """A row (height, width, 3) of the contact sheet: a picture from each camera, of the object alone."""
        views = self.shown.views
        cut = [portrait(picture, view, self.used) for picture, view in zip(pictures, views, strict=True)]
        return labelled_row(label, cut, width=PICTURE_WIDTH)

    def _warm_up(self, settings: Settings) -> None:
        """Let a test and what carves with it be compiled and loaded."""
        small = Lattice.enclosing(self.used.bounds, n_voxels=_WARM_UP_VOXELS)
        with suppress(EmptyReconstructionError):
            settings.method_for(self.used).carve(self.used, small)

    def _measured(self, entry: Variant, result: Reconstruction, memory_mib: float | None) -> Trial:
        """Figures of a reconstruction."""
        quality = result.quality
        if self.held_out:
            quality = measure_quality(result.mesh, replace(self.used, views=self.held_out))
        photographs, shape = quality.overall, quality.shape
        trial = Trial(
            entry.label,
            entry.family,
            entry.value,
            result.carved.n_accepted,
            result.timings["carving"],
            memory_mib,
            holes=shape.boundary_loops + (shape.genus or 0),
            floating=shape.components - 1 + result.repairs.small_components,
            roughness_degrees=shape.dihedral_degrees,
            median_error=photographs.median,
            mean_error=photographs.mean,
            rms_error=photographs.rms,
            overlap_percent=None if photographs.overlap is None else 100 * photographs.overlap,
        )
        if self.ground_truth is None:
            return trial
        figures = evaluate(result.mesh, self.ground_truth, mm_per_unit=self.used.known_scale(), **self.options)
        return replace(
            trial,
            accuracy_mm=figures.accuracy_mm,
            completeness_percent=figures.completeness_percent,
            precision_percent=figures.precision_percent,
        )

    def record(self) -> dict[str, Any]:
        """The conditions for a JSON file."""
        plain = {name: value for name, value in self.settings.record().items() if name != "views"}
        del plain["carving"]["options"]["test"]
        return {
            "recon3d": __version__,
            "scene": self.used.name,
            "source": self.used.notes.get("source"),
            "settings": plain,
            "voxels": self.voxels,
            "views": [view.name for view in self.used.views],
            "held_out": [view.name for view in self.held_out],
            "evaluation": None
            if self.ground_truth is None
            else {
                name: self.options.get(name, getattr(Evaluation, name))
                for name in ("accuracy_percent", "completeness_threshold_mm")
            },
        }

    def fingerprint(self) -> str:
        """Hash of all inputs that affect the result of a trial, but the test."""
        scenes = [
            replace(self.used, views=views) for views in (self.used.views, self.held_out, self.shown.views) if views
        ]
        truth: Any = self.ground_truth
        shape = [
            np.asarray(getattr(truth, name)) for name in ("vertices", "triangles", "points") if hasattr(truth, name)
        ]
        return content_key(self.record(), scenes, shape, self.options)


def set_up_trials(
    scene: Scene,
    settings: Settings | None,
    hold_out: int | Sequence[str],
    ground_truth: o3d.geometry.TriangleMesh | o3d.geometry.PointCloud | None,
    options: Mapping[str, Any],
) -> TrialSetup:
    """Choose the views, and refuse what cannot be compared."""
    settings = settings or Settings(carving=VoxelColoring())
    method = settings.carving or GeneralizedVoxelColoring()
    if not isinstance(method, JudgingMethod):
        raise ArgumentError(f"{method_name(method)} uses no photo-consistency test, so there is nothing to compare")
    if method.test != type(method)().test:
        raise ArgumentError(f"expected a method with its own test, since tests are compared, got {method.test!r}")
    if options and ground_truth is None:
        raise ArgumentError(f"expected a ground truth for {', '.join(options)}")
    resolved = replace(settings, carving=method).resolved(scene)
    admitted = choose_views(scene, replace(resolved, max_views=None))
    held_out = _held_out(scene, admitted, hold_out)
    names = [view.name for view in held_out]
    rest = tuple(view for view in admitted.views if view.name not in names)
    if not rest:
        raise ArgumentError(f"expected views to be left for the tests, got all of {', '.join(names)} held out")
    used = spread_views(replace(admitted, views=rest), resolved.max_views or len(rest))
    chosen = np.unique(np.linspace(0, len(admitted.views) - 1, min(_SHOWN, len(admitted.views))).round().astype(int))
    return TrialSetup(
        used,
        held_out,
        replace(admitted, views=tuple(admitted.views[n] for n in chosen)),
        replace(resolved, views="all", max_views=None),
        method,
        resolved.lattice(scene).n_voxels,
        ground_truth,
        options,
    )


def _held_out(scene: Scene, admitted: Scene, hold_out: int | Sequence[str]) -> tuple[View, ...]:
    """Views that no test is to see."""
    if not isinstance(hold_out, int):
        return scene.subset(hold_out).views
    if hold_out < 0 or hold_out == 1:
        raise ArgumentError(f"expected to hold out every n-th view, n of 2 or more, 0 (none) or names, got {hold_out}")
    return admitted.views[hold_out - 1 :: hold_out] if hold_out else ()
