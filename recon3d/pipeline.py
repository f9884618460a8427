"""The main job: from calibrated photographs to a coloured, measured, rendered reconstruction."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.carving import METHODS
from recon3d.errors import EmptyReconstructionError
from recon3d.evaluation.distances import evaluate
from recon3d.evaluation.photographs import measure_quality
from recon3d.io.checkpoints import Checkpoints, code_fingerprint
from recon3d.rendering.ray_caster import RayCaster
from recon3d.result import Reconstruction
from recon3d.scene.scene import Scene
from recon3d.settings import Settings, choose_views
from recon3d.stereo.refinement import Stages, refine
from recon3d.surface.extraction import mesh_shape, surface_points
from recon3d.surface.poisson import MeasuredSpace, mesh_points
from recon3d.surface.repair import Repairs, repair_mesh
from recon3d.surface.vertex_colors import color
from recon3d.surface.visibility import VertexVisibility
from recon3d.volume.carved import CarvedVolume
from recon3d.volume.dense import CarvingVolume

_SPACING = 1.5  # of a sharp surface's finest detail, pixel footprints


Progress = Callable[[str, int, int], None]
"""Called with a stage's name, the steps of it that are done, and how many there are."""


def reconstruct(
    scene: Scene,
    settings: Settings | None = None,
    *,
    ground_truth: o3d.geometry.TriangleMesh | None = None,
    stages: Stages | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Carve, match, mesh, measure by the photographs and, given one in the scene's frame, by a ground truth.

    Parameters
    ----------
    stages : what an interrupted run finished is taken from here, and what this one finishes is put here; of the same
        scene and settings, see ``recon3d.io.Checkpoints``.

    Raises
    ------
    VisibilityError : the views do not satisfy what the method needs.
    VolumeTooLargeError : the volume does not fit into memory.
    EmptyReconstructionError : nothing was left.
    """
    settings = (settings or Settings()).resolved(scene)
    report = progress or (lambda _stage, _done, _total: None)
    timings: dict[str, float] = {}

    with _timed(timings, "views"):
        scene = choose_views(scene, settings)
    with _timed(timings, "carving"):
        volume = CarvingVolume.enclosing(scene.bounds, voxel_size=settings.voxel_size, n_voxels=settings.n_voxels)
        hull = carve(scene, volume, settings, stages, progress=lambda done, total: report("carving", done, total))
    sharp = None
    if settings.quality == "dense":
        with _timed(timings, "matching"):
            sharp, hull = refine(
                scene, hull, stages=stages, progress=lambda done, total: report("matching", done, total)
            )
    with _timed(timings, "surface"):
        report("surface", 0, 3)
        min_area = settings.min_component * volume.voxel_size**2
        if sharp:
            spacing = _SPACING * scene.pixel_footprint
            measured = MeasuredSpace(sharp, spacing)
            mesh = mesh_points(sharp, hull, surface=settings.surface, spacing=spacing, measured=measured)
        else:
            mesh = _carved_mesh(hull, settings)
        mesh, repairs, _ = repair_mesh(mesh, min_area=min_area)
        report("surface", 1, 3)
        caster = RayCaster(mesh)
        visibility = VertexVisibility.of(mesh, scene, caster)
        support = visibility.n_views
        if sharp:
            support[~measured.holds(np.asarray(mesh.vertices))] = 0
        if not settings.keep_unsupported:
            mesh, visibility, support, repairs = _supported(scene, mesh, visibility, support, repairs, min_area)
        report("surface", 2, 3)
        mesh = color(mesh, scene, visibility=visibility, caster=caster)
        points = sharp.to_legacy() if sharp else surface_points(hull.volume, solid=hull.with_interior)
        confidence = sharp.point.confidence.numpy().ravel() if sharp else None
        report("surface", 3, 3)
    with _timed(timings, "quality"):
        report("quality", 0, 1)
        quality = measure_quality(mesh, scene, caster=caster if settings.keep_unsupported else None)
        report("quality", 1, 1)
    evaluation = None
    if ground_truth is not None:
        with _timed(timings, "evaluation"):
            report("evaluation", 0, 1)
            evaluation = evaluate(mesh, ground_truth, mm_per_unit=scene.mm_per_unit)
            report("evaluation", 1, 1)
    return Reconstruction(
        scene, settings, hull, points, confidence, mesh, support, repairs, timings, quality, evaluation
    )


def keep_stages(folder: Path | str, scene: Scene, settings: Settings) -> Checkpoints | None:
    """Stages of a run in a folder, for ``reconstruct``; None where a photo-consistency test decides.

    A test may be a user's own and change without a trace; carving by one is done again.
    """
    settings = settings.resolved(scene)
    scene = choose_views(scene, settings)
    if settings.test is not None:
        return None
    chosen = ("n_voxels", "voxel_size", "method", "method_options", "views", "max_views")
    told = {name: value for name, value in settings.record().items() if name in chosen}
    chosen_by = json.dumps(told, sort_keys=True, default=np.generic.item)
    return Checkpoints(folder, f"{code_fingerprint()} {scene.fingerprint()} {chosen_by}")


def _supported(
    scene: Scene,
    mesh: o3d.geometry.TriangleMesh,
    visibility: VertexVisibility,
    support: NDArray[np.int64],
    repairs: Repairs,
    min_area: float,
) -> tuple[o3d.geometry.TriangleMesh, VertexVisibility, NDArray[np.int64], Repairs]:
    """The part of a mesh that is supported, and what is known of it."""
    supported = support > 0
    if not supported[np.asarray(mesh.triangles)].all(axis=1).any():
        raise EmptyReconstructionError(f"scene {scene.name}: nothing was measured of any of the surface")
    part, more, source = repair_mesh(mesh, kept=supported, min_area=min_area)
    return part, visibility.of_vertices(source), support[source], repairs + more


def _carved_mesh(hull: CarvedVolume, settings: Settings) -> o3d.geometry.TriangleMesh:
    """Mesh of the accepted voxels, or of all that is solid."""
    shell = METHODS[settings.method].one_sided and not settings.fill_hidden
    return mesh_shape(
        hull.volume if shell else hull.with_interior, distance=hull.distance, smoothing=settings.smoothing
    )


def carve(
    scene: Scene, volume: CarvingVolume, settings: Settings, stages: Stages | None = None, **callbacks: Any
) -> CarvedVolume:
    """Carve a volume with the method and test of resolved settings, or take what an earlier run kept of that.

    Callbacks such as ``progress`` go to the method.
    """
    if stages is not None and "carving" in stages:
        return CarvedVolume.from_arrays(volume, stages["carving"])
    hull = METHODS[settings.method].carve(scene, volume, settings.test, **callbacks, **settings.method_options)
    if stages is not None:
        stages["carving"] = hull.arrays()
    return hull


@contextmanager
def _timed(timings: dict[str, float], name: str) -> Iterator[None]:
    """Note how many seconds a block took."""
    start = perf_counter()
    yield
    timings[name] = round(perf_counter() - start, 3)
