"""The main job: from calibrated photographs to a coloured, measured, rendered reconstruction."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from time import perf_counter
from typing import NamedTuple

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon3d.carving.method import Method
from recon3d.carving.observer import Observer
from recon3d.consistency.spec import identity
from recon3d.errors import EmptyReconstructionError
from recon3d.evaluation.distances import measure
from recon3d.evaluation.photographs import measure_quality
from recon3d.heap import give_back
from recon3d.rendering.ray_caster import RayCaster
from recon3d.result import Reconstruction
from recon3d.scene.scene import Scene
from recon3d.settings import Settings, choose_views
from recon3d.stereo.refinement import refine
from recon3d.surface.extraction import surface_points
from recon3d.surface.meshing import Meshed, Meshing, mesh
from recon3d.surface.repair import Repairs, repair_mesh
from recon3d.surface.uncertainty import predict_uncertainty
from recon3d.surface.vertex_colors import color
from recon3d.surface.visibility import VertexVisibility
from recon3d.tasks import Kept, StageProgress, Store, content_key, once
from recon3d.tasks import Progress as StepProgress
from recon3d.volume.carved import Carved, CarvedVolume
from recon3d.volume.lattice import Lattice
from recon3d.volume.sparse import SparseVolume

SPACING = 1.5  # of the matched points, pixel footprints


Progress = StageProgress


def reconstruct(
    scene: Scene,
    settings: Settings | None = None,
    *,
    ground_truth: o3d.geometry.TriangleMesh | None = None,
    checkpoints: Store | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Carve, match, mesh, measure by the photographs and, given one in the scene's frame, by a ground truth.

    Parameters
    ----------
    checkpoints : such as ``Checkpoints(folder)``. Finished carving, depth maps and passes of matching are kept here,
        and taken from here where all that they depend on is the same: an interrupted run resumes.
    executor : matches several views at a time, see ``recon3d.tasks.map``; the result is the same.
    progress : called after each step of a stage.

    Raises
    ------
    VisibilityError : the views do not satisfy what the method needs.
    VolumeTooLargeError : the volume does not fit into memory.
    EmptyReconstructionError : nothing was left.
    """
    if ground_truth is not None:
        scene.known_scale()
    settings = (settings or Settings()).resolved(scene)
    run = _Run(progress)
    with run.step("views"):
        scene = choose_views(scene, settings)
    with run.step("carving") as done:
        carved = kept_carving(scene, settings.lattice(scene), settings, checkpoints, progress=done)
    points, passes, meshing = None, settings.passes_for(scene), settings.meshing
    if passes:
        with run.step("matching") as done:
            points, carved = refine(
                scene, carved.dense(), passes=passes, checkpoints=checkpoints, executor=executor, progress=done
            )
    with run.step("surface") as done:
        done(0, 3)
        one_sided = settings.method_for(scene).one_sided
        meshed = mesh(carved, points, meshing, spacing=SPACING * scene.pixel_footprint, one_sided=one_sided)
        done(1, 3)
        seen = _seen(scene, meshed, points)
        if not (meshing.keep_unsupported and meshing.max_uncertainty is None):
            seen = _supported(scene, seen, meshing, carved.lattice.voxel_size)
        done(2, 3)
        colored = color(seen.mesh, scene, visibility=seen.visibility, caster=seen.caster)
        done(3, 3)
    with run.step("quality") as done:
        done(0, 1)
        quality = measure_quality(colored, scene, caster=seen.caster if seen.whole else None)
        done(1, 1)
    result = Reconstruction(
        scene,
        settings,
        carved,
        _voxel_points(carved, colored) if points is None else points.to_legacy(),
        None if points is None else points.point.confidence.numpy().ravel(),
        colored,
        seen.support,
        seen.uncertainty,
        seen.repairs,
        run.timings,
        quality,
        decimation=meshed.decimation,
    )
    if ground_truth is None:
        return result
    with run.step("evaluation") as done:
        done(0, 1)
        result = _evaluated(result, ground_truth)
        done(1, 1)
    return result


class _Run:
    """Times the steps of a run, and reports their progress."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress
        self.timings: dict[str, float] = {}

    @contextmanager
    def step(self, name: str) -> Iterator[StepProgress]:
        """Note how many seconds a block takes; yields what it reports its progress to."""
        start = perf_counter()
        yield partial(self._progress, name) if self._progress else _ignored
        give_back()
        self.timings[name] = round(perf_counter() - start, 3)


def _ignored(_done: int, _total: int) -> None:
    """Progress that nobody asked for."""


class _Seen(NamedTuple):
    """A mesh with what the views see of it."""

    mesh: o3d.geometry.TriangleMesh
    visibility: VertexVisibility
    support: NDArray[np.int64]
    """(n_vertices,) views that see what was measured; 0: not measured."""
    uncertainty: NDArray[np.float64] | None
    """(n_vertices,) world units; None of a mesh of voxels."""
    repairs: Repairs
    caster: RayCaster
    """Of what hides the mesh."""
    whole: bool = True
    """Whether nothing was cut away, so that the mesh is all that hides it."""


def _seen(scene: Scene, meshed: Meshed, points: o3d.t.geometry.PointCloud | None) -> _Seen:
    """Find what the views see of a mesh, once for support, uncertainty, cutting and colours."""
    caster = RayCaster(meshed.mesh)
    visibility = VertexVisibility.of(meshed.mesh, scene, caster)
    support = np.where(meshed.measured, visibility.n_views, 0)
    uncertainty = None if points is None else predict_uncertainty(meshed.mesh, points, scene, visibility, support > 0)
    return _Seen(meshed.mesh, visibility, support, uncertainty, meshed.repairs, caster)


def _supported(scene: Scene, seen: _Seen, meshing: Meshing, voxel_size: float) -> _Seen:
    """The part of a mesh that is supported, and as certain as is asked for; the rest still hides it."""
    kept, limit = seen.support > 0, meshing.max_uncertainty
    if not kept[np.asarray(seen.mesh.triangles)].all(axis=1).any():
        raise EmptyReconstructionError(f"scene {scene.name}: none of the surface was measured")
    if seen.uncertainty is not None and limit is not None:
        kept = kept & (seen.uncertainty <= limit)
        if not kept[np.asarray(seen.mesh.triangles)].all(axis=1).any():
            raise EmptyReconstructionError(
                f"scene {scene.name}: none of the surface is as certain as max_uncertainty {limit:g}; the most certain "
                f"vertex has {seen.uncertainty.min():.3g} world units"
            )
    part, repairs, source = repair_mesh(seen.mesh, kept=kept, min_area=meshing.min_component * voxel_size**2)
    uncertainty = None if seen.uncertainty is None else seen.uncertainty[source]
    return _Seen(part, seen.visibility.of_vertices(source), seen.support[source], uncertainty, seen.repairs + repairs,
                 seen.caster, whole=False)  # fmt: skip


def _evaluated(result: Reconstruction, ground_truth: o3d.geometry.TriangleMesh) -> Reconstruction:
    """The result with the distances of its mesh, and of the part that was measured, to a ground truth."""
    mm_per_unit = result.scene.known_scale()
    distances = measure(result.mesh, ground_truth)
    whole = distances.evaluation(mm_per_unit)
    supported = (result.support > 0)[np.asarray(result.mesh.triangles)].all(axis=1)
    if not supported[distances.owners].any():
        return replace(result, evaluation=whole)
    part = distances.of_part(result.mesh, supported).evaluation(mm_per_unit)
    return replace(result, evaluation=whole, supported_evaluation=part)


def _voxel_points(carved: Carved, colored: o3d.geometry.TriangleMesh) -> o3d.geometry.PointCloud:
    """Coloured centres of the visible voxels, with unit normals outwards; of a sparse volume those of the mesh."""
    if not isinstance(carved, SparseVolume):
        return surface_points(carved.dense().volume, solid=carved.dense().with_interior)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(carved.centers(carved.visible)))
    cloud.colors = o3d.utility.Vector3dVector(carved.colors[carved.visible] / 255.0)
    _, nearest = cKDTree(np.asarray(colored.vertices)).query(np.asarray(cloud.points), workers=-1)
    cloud.normals = o3d.utility.Vector3dVector(np.asarray(colored.vertex_normals)[nearest])
    return cloud


def kept_carving(
    scene: Scene,
    lattice: Lattice,
    settings: Settings,
    checkpoints: Store | None = None,
    *,
    progress: StepProgress | None = None,
    observer: Observer | None = None,
) -> Carved:
    """Carve a lattice as the settings say, or take what an earlier run kept of that.

    Carving by a test that cannot be told from others by its source is done again each time.
    """
    method = settings.method_for(scene)
    options = _content(method)
    kept: Kept[Carved] = Kept(
        checkpoints if options else None, content_key(scene, lattice, options) if checkpoints is not None else "",
        lambda carved: carved.arrays(),
        lambda arrays: (SparseVolume if "slots" in arrays else CarvedVolume).from_arrays(lattice, arrays),
    )  # fmt: skip
    return once(partial(method.carve, progress=progress, observer=observer), "carving", (scene, lattice), kept=kept)


def _content(method: Method) -> dict[str, object] | None:
    """What makes a method carve as it does, its test by its source; None where that cannot be told."""
    options = {option.name: getattr(method, option.name) for option in fields(method)}
    tests = {name: identity(value) for name, value in options.items() if callable(value)}
    return None if None in tests.values() else {"method": type(method).__qualname__, **options, **tests}
