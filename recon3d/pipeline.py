"""The main job: from calibrated photographs to a coloured, measured, rendered reconstruction."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import fields
from functools import partial
from time import perf_counter

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon3d.carving.method import Method
from recon3d.carving.observer import Observer
from recon3d.consistency.spec import identity
from recon3d.errors import EmptyReconstructionError
from recon3d.evaluation.distances import evaluate
from recon3d.evaluation.photographs import measure_quality
from recon3d.rendering.ray_caster import RayCaster
from recon3d.result import Reconstruction
from recon3d.scene.scene import Scene
from recon3d.settings import Settings, choose_views
from recon3d.stereo.refinement import refine
from recon3d.surface.extraction import mesh_shape, mesh_sparse, surface_points
from recon3d.surface.poisson import MeasuredSpace, mesh_points
from recon3d.surface.repair import Repairs, repair_mesh
from recon3d.surface.vertex_colors import color
from recon3d.surface.visibility import VertexVisibility
from recon3d.tasks import Kept, Store, content_key, once
from recon3d.tasks import Progress as StepProgress
from recon3d.volume.carved import Carved, CarvedVolume
from recon3d.volume.lattice import Lattice
from recon3d.volume.sparse import SparseVolume

_SPACING = 1.5  # of a sharp surface's finest detail, pixel footprints


Progress = Callable[[str, int, int], None]
"""Called with a stage's name, the steps of it that are done, and how many there are."""


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
    settings = (settings or Settings()).resolved(scene)
    report = progress or (lambda _stage, _done, _total: None)
    timings: dict[str, float] = {}

    with _timed(timings, "views"):
        scene = choose_views(scene, settings)
    with _timed(timings, "carving"):
        lattice = settings.lattice(scene)
        hull = kept_carving(
            scene, lattice, settings, checkpoints, progress=lambda done, total: report("carving", done, total)
        )
    sharp, passes, meshing = None, settings.passes_for(scene), settings.meshing
    if passes:
        with _timed(timings, "matching"):
            sharp, hull = refine(
                scene, hull.dense(), passes=passes, checkpoints=checkpoints, executor=executor,
                progress=lambda done, total: report("matching", done, total),
            )  # fmt: skip
    with _timed(timings, "surface"):
        report("surface", 0, 3)
        min_area = meshing.min_component * lattice.voxel_size**2
        if sharp:
            spacing = _SPACING * scene.pixel_footprint
            measured = MeasuredSpace(sharp, spacing)
            mesh = mesh_points(sharp, hull.dense(), surface=meshing.surface, spacing=spacing, measured=measured)
        else:
            mesh = _carved_mesh(hull, settings)
        mesh, repairs, _ = repair_mesh(mesh, min_area=min_area)
        report("surface", 1, 3)
        caster = RayCaster(mesh)
        visibility = VertexVisibility.of(mesh, scene, caster)
        support = visibility.n_views
        if sharp:
            support[~measured.holds(np.asarray(mesh.vertices))] = 0
        if not meshing.keep_unsupported:
            mesh, visibility, support, repairs = _supported(scene, mesh, visibility, support, repairs, min_area)
        report("surface", 2, 3)
        mesh = color(mesh, scene, visibility=visibility, caster=caster)
        points = sharp.to_legacy() if sharp else _voxel_points(hull, mesh)
        confidence = sharp.point.confidence.numpy().ravel() if sharp else None
        report("surface", 3, 3)
    with _timed(timings, "quality"):
        report("quality", 0, 1)
        quality = measure_quality(mesh, scene, caster=caster if meshing.keep_unsupported else None)
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


def _carved_mesh(hull: Carved, settings: Settings) -> o3d.geometry.TriangleMesh:
    """Mesh of the accepted voxels, or of all that is solid."""
    smoothing = 5 if settings.meshing.smoothing is None else settings.meshing.smoothing
    if isinstance(hull, SparseVolume):
        return mesh_sparse(hull, smoothing=smoothing)
    hull = hull.dense()
    shell = settings.carving is not None and settings.carving.one_sided and not settings.meshing.fill_hidden
    return mesh_shape(hull.volume if shell else hull.with_interior, distance=hull.distance, smoothing=smoothing)


def _voxel_points(hull: Carved, mesh: o3d.geometry.TriangleMesh) -> o3d.geometry.PointCloud:
    """Coloured centres of the visible voxels, with unit normals outwards; of a sparse volume those of the mesh."""
    if not isinstance(hull, SparseVolume):
        return surface_points(hull.dense().volume, solid=hull.dense().with_interior)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(hull.centers(hull.visible)))
    cloud.colors = o3d.utility.Vector3dVector(hull.colors[hull.visible] / 255.0)
    _, nearest = cKDTree(np.asarray(mesh.vertices)).query(np.asarray(cloud.points), workers=-1)
    cloud.normals = o3d.utility.Vector3dVector(np.asarray(mesh.vertex_normals)[nearest])
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
        checkpoints if options else None, content_key(scene, lattice, options), lambda carved: carved.arrays(),
        lambda arrays: (SparseVolume if "slots" in arrays else CarvedVolume).from_arrays(lattice, arrays),
    )  # fmt: skip
    return once(partial(method.carve, progress=progress, observer=observer), "carving", (scene, lattice), kept=kept)


def _content(method: Method) -> dict[str, object] | None:
    """What makes a method carve as it does, its test by its source; None where that cannot be told."""
    options = {option.name: getattr(method, option.name) for option in fields(method)}
    tests = {name: identity(value) for name, value in options.items() if callable(value)}
    return None if None in tests.values() else {"method": type(method).__qualname__, **options, **tests}


@contextmanager
def _timed(timings: dict[str, float], name: str) -> Iterator[None]:
    """Note how many seconds a block took."""
    start = perf_counter()
    yield
    timings[name] = round(perf_counter() - start, 3)
