"""The main job: from calibrated photographs to a coloured, measured, rendered reconstruction."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d._version import __version__
from recon3d.carving import METHODS, PhotoHull
from recon3d.coloring import color_from_views
from recon3d.errors import DataError, EmptyReconstructionError
from recon3d.evaluation import Evaluation, error_map, evaluate, triangles_near
from recon3d.html import Summarised
from recon3d.io.files import (
    MESH_SUFFIXES,
    read_geometry,
    read_mesh,
    read_support,
    write_geometry,
    write_image,
    write_json,
)
from recon3d.io.stages import StageFolder, code_fingerprint
from recon3d.mending import Mending, drop_specks, mend_mesh
from recon3d.quality import Quality, measure_quality
from recon3d.rendering import Renderer, comparison_sheet, keep_vertices, turntable, without_unseen
from recon3d.scene import Scene
from recon3d.settings import Settings, choose_views
from recon3d.stereo import Stages, mesh_points, near_points, sharpen_hull
from recon3d.surface import mesh_shape, surface_points
from recon3d.volume import CarvingVolume

_SPACING = 1.5  # of a sharp surface's finest detail, pixel footprints

Progress = Callable[[str, int, int], None]
"""Called with a stage's name, the steps of it that are done, and how many there are."""


@dataclass(frozen=True, repr=False)
class Reconstruction(Summarised):
    """A finished run: what went in, what came out, and how long it took."""

    scene: Scene
    """With the views that were used."""
    settings: Settings
    hull: PhotoHull
    """What carving left; of a sharp result, after the depths found carved it once more."""
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
    mending: Mending
    """What was wrong with the mesh before."""
    timings: dict[str, float]
    """Seconds of each step."""
    quality: Quality
    """Of the mesh, by the photographs that it was made of."""
    evaluation: Evaluation | None = None
    """Of the mesh, where a ground truth was given."""

    def save(
        self, folder: Path | str, *, mesh_formats: Sequence[str] = ("ply",), pictures: bool = True
    ) -> dict[str, Path]:
        """Write meshes, points, voxels, pictures and the record into a folder; each file whole or not at all.

        Parameters
        ----------
        mesh_formats : of "ply", "obj", "glb", "stl".
        pictures : whether to render the comparison with the photographs and the turntable.

        Returns
        -------
        dict
            What was written: role to path.
        """
        folder = Path(folder)
        known = [suffix[1:] for suffix in MESH_SUFFIXES]
        unknown = [name for name in mesh_formats if name not in known]
        if unknown:
            raise ValueError(f"expected mesh formats among {', '.join(known)}, got {', '.join(unknown)}")
        # The record tells a finished result: it goes first and comes last.
        record = self.record()
        (folder / "record.json").unlink(missing_ok=True)
        written = {
            f"mesh ({name})": write_geometry(folder / f"mesh.{name}", self.mesh, support=self.support)
            for name in mesh_formats
        }
        written["points"] = write_geometry(folder / "points.ply", self.points, confidence=self.confidence)
        written["voxel grid"] = write_geometry(folder / "voxels.ply", self.hull.volume.to_voxel_grid())
        if pictures:
            written |= save_pictures(self.mesh, self.scene, folder)
        written["figures"] = write_json(folder / "record.json", record)
        return written

    def record(self) -> dict[str, Any]:
        """Every parameter, version, timing and figure of the run, for a JSON file."""
        volume = self.hull.volume
        return {
            "recon3d": __version__,
            "versions": {
                "python": platform.python_version(),
                **{name: version(name) for name in ("numpy", "numba", "scipy", "opencv-python-headless")},
                "open3d": o3d.__version__,
            },
            "scene": {
                "name": self.scene.name,
                "views": [view.name for view in self.scene.views],
                "bounds": [list(self.scene.bounds.min_bound), list(self.scene.bounds.max_bound)],
                "mm_per_unit": self.scene.mm_per_unit,
                **self.scene.notes,
            },
            "settings": self.settings.record(),
            "volume": {"shape": list(volume.shape), "voxel_size": volume.voxel_size, "origin": list(volume.origin)},
            "voxels": self.hull.counts(),
            "mesh": {
                "vertices": len(self.mesh.vertices),
                "triangles": len(self.mesh.triangles),
                "support": np.bincount(self.support).tolist(),
                **self.mending.record(),
            },
            "timings_s": self.timings,
            "quality": self.quality.record(),
            "evaluation": self.evaluation.record() if self.evaluation else None,
        }

    def summary(self) -> dict[str, object]:
        """Table of the run."""
        volume = self.hull.volume
        mm = volume.voxel_size * self.scene.mm_per_unit
        supported = float((self.support > 0).mean())
        return {
            "scene": f"{self.scene.name}, {len(self.scene.views)} views",
            "voxels": f"{volume.occupied.size:,} of {mm:.3g} mm, {volume.n_occupied:,} accepted",
            "mesh": f"{len(self.mesh.triangles):,} triangles, {supported:.0%} of them measured, the rest the hull's",
            **({"mended": str(self.mending)} if str(self.mending) else {}),
            "time": ", ".join(f"{name} {seconds:.2f} s" for name, seconds in self.timings.items()),
            **self.quality.summary(),
            **(self.evaluation.summary() if self.evaluation else {}),
        }

    def picture(self) -> NDArray[np.uint8]:
        """The mesh from four sides."""
        return turntable(self.scene, Renderer(self.mesh), frames=4, size=200)


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
        scene and settings, see ``recon3d.io.StageFolder``.

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
    if settings.quality == "sharp":
        with _timed(timings, "matching"):
            sharp, hull = sharpen_hull(
                scene, hull, stages=stages, progress=lambda done, total: report("matching", done, total)
            )
    with _timed(timings, "surface"):
        report("surface", 0, 3)
        spacing = _SPACING * scene.pixel_footprint
        if sharp:
            mesh = mesh_points(sharp, hull, surface=settings.surface, spacing=spacing)
        else:
            mesh = _carved_mesh(hull, settings)
        report("surface", 1, 3)
        mesh, specks = drop_specks(mesh, settings.min_piece * volume.voxel_size**2)
        if not settings.keep_unsupported:
            mesh = without_unseen(mesh, scene)
            if sharp:
                mesh = keep_vertices(mesh, near_points(np.asarray(mesh.vertices), sharp, spacing))
                if not mesh.has_triangles():
                    raise EmptyReconstructionError(f"scene {scene.name}: no point lies near any of the surface")
        mesh, mending = mend_mesh(mesh)
        report("surface", 2, 3)
        mesh, support = color_from_views(mesh, scene)
        if sharp:
            support[~near_points(np.asarray(mesh.vertices), sharp, spacing)] = 0
        points = sharp.to_legacy() if sharp else surface_points(hull.volume, solid=hull.solid)
        confidence = sharp.point.confidence.numpy().ravel() if sharp else None
        report("surface", 3, 3)
    with _timed(timings, "quality"):
        report("quality", 0, 1)
        quality = measure_quality(mesh, scene)
        report("quality", 1, 1)
    evaluation = None
    if ground_truth is not None:
        with _timed(timings, "evaluation"):
            report("evaluation", 0, 1)
            evaluation = evaluate(mesh, ground_truth, mm_per_unit=scene.mm_per_unit)
            report("evaluation", 1, 1)
    mending = replace(mending, specks=specks)
    return Reconstruction(
        scene, settings, hull, points, confidence, mesh, support, mending, timings, quality, evaluation
    )


def keep_stages(folder: Path | str, scene: Scene, settings: Settings) -> StageFolder | None:
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
    return StageFolder(folder, f"{code_fingerprint()} {scene.fingerprint()} {chosen_by}")


def _carved_mesh(hull: PhotoHull, settings: Settings) -> o3d.geometry.TriangleMesh:
    """Mesh of the accepted voxels, or of all that is solid."""
    shell = METHODS[settings.method].one_sided and not settings.fill_hidden
    return mesh_shape(hull.volume if shell else hull.solid, distance=hull.distance, smoothing=settings.smoothing)


def carve(
    scene: Scene, volume: CarvingVolume, settings: Settings, stages: Stages | None = None, **callbacks: Any
) -> PhotoHull:
    """Carve a volume with the method and test of resolved settings, or take what an earlier run kept of that.

    Callbacks such as ``progress`` go to the method.
    """
    if stages is not None and "carving" in stages:
        return PhotoHull.from_arrays(volume, stages["carving"])
    hull = METHODS[settings.method].carve(scene, volume, settings.test, **callbacks, **settings.method_options)
    if stages is not None:
        stages["carving"] = hull.arrays()
    return hull


def evaluate_files(
    reconstruction: Path | str,
    ground_truth: Path | str,
    *,
    real: Path | str | None = None,
    real_within_mm: float = 0.1,
    supported: bool = False,
    mm_per_unit: float = 1000.0,
    **options: Any,
) -> Evaluation:
    """Measure a mesh, point cloud or voxel grid file against a ground truth file.

    Parameters
    ----------
    real : mesh of the part of the ground truth that is real data; ground truth farther than ``real_within_mm`` from
        it is filler, where nothing is measured.
    supported : leave out of the reconstruction what only the hull closes: vertices whose ``support`` is 0.
    options : passed to ``evaluate``.

    Raises
    ------
    DataError : a file is missing or holds no geometry of the kind that is needed.
    """
    shape = _supported_part(reconstruction) if supported else read_geometry(reconstruction)
    truth, mask = read_ground_truth(ground_truth, real=real, real_within_mm=real_within_mm, mm_per_unit=mm_per_unit)
    return evaluate(shape, truth, real=mask, mm_per_unit=mm_per_unit, **options)


def _supported_part(file: Path | str) -> o3d.geometry.TriangleMesh:
    """Mesh of a file without the vertices that nothing was measured of."""
    mesh, support = read_mesh(file), read_support(file)
    if support is None:
        raise DataError(f"{file}: expected a mesh.ply that recon3d wrote, got one without support of its vertices")
    part = keep_vertices(mesh, support > 0)
    if not part.has_triangles():
        raise DataError(f"{file}: no triangle of the mesh is supported")
    return part


def read_ground_truth(
    ground_truth: Path | str,
    *,
    real: Path | str | None = None,
    real_within_mm: float = 0.1,
    mm_per_unit: float = 1000.0,
) -> tuple[o3d.geometry.TriangleMesh | o3d.geometry.PointCloud, NDArray[np.bool_] | None]:
    """Mesh or point cloud to measure against, and the mask of its ``real`` part; see ``evaluate_files``.

    Raises
    ------
    DataError : a file is missing or holds no geometry of the kind that is needed.
    """
    truth = read_geometry(ground_truth)
    if isinstance(truth, o3d.geometry.VoxelGrid):
        raise DataError(f"{ground_truth}: expected a mesh or point cloud as ground truth, got a voxel grid")
    if real is None:
        return truth, None
    if not isinstance(truth, o3d.geometry.TriangleMesh):
        raise DataError(f"{ground_truth}: a real part can be told only of a mesh, got a point cloud")
    return truth, triangles_near(truth, read_mesh(real), real_within_mm / mm_per_unit)


def save_error_maps(
    reconstruction: Path | str,
    ground_truth: Path | str,
    folder: Path | str,
    *,
    mm_per_unit: float = 1000.0,
    full_scale_mm: float = 5.0,
) -> dict[str, Path]:
    """Write two mesh files' mutual error maps as PLY and as one picture; returns role to path.

    In the picture's upper row the reconstruction's distance to the ground truth, in the lower row the ground truth's
    to the reconstruction: what is wrong, and what is missing.
    """
    folder = Path(folder)
    first, second = read_mesh(reconstruction), read_mesh(ground_truth)
    scale = {"mm_per_unit": mm_per_unit, "full_scale_mm": full_scale_mm}
    wrong, missing = error_map(first, second, **scale), error_map(second, first, **scale)
    strips = [turntable(None, Renderer(mesh), frames=6) for mesh in (wrong, missing)]
    return {
        "errors": write_geometry(folder / "error_map.ply", wrong),
        "missing": write_geometry(folder / "missing_map.ply", missing),
        f"error maps (red: {full_scale_mm:g} mm)": write_image(folder / "error_map.png", np.vstack(strips)),
    }


def save_pictures(
    mesh: o3d.geometry.TriangleMesh, scene: Scene, folder: Path | str, *, every_view: bool = False
) -> dict[str, Path]:
    """Render a mesh beside the photographs, and from all around; returns role to path.

    Parameters
    ----------
    every_view : also write each view's coloured, shaded, normals and depth pictures into ``views/``, and compare all
        views instead of four.
    """
    folder = Path(folder)
    renderer = Renderer(mesh)
    shown = len(scene.views) if every_view else 4
    written = {
        "comparison": write_image(folder / "comparison.png", comparison_sheet(scene, renderer, views=shown)),
        "turntable": write_image(folder / "turntable.png", turntable(scene, renderer)),
    }
    if every_view:
        for view in scene.views:
            for mode, picture in renderer.render_view(view).pictures().items():
                write_image(folder / "views" / f"{Path(view.name).stem}_{mode}.png", picture)
        written["views"] = folder / "views"
    return written


@contextmanager
def _timed(timings: dict[str, float], name: str) -> Iterator[None]:
    """Note how many seconds a block took."""
    start = perf_counter()
    yield
    timings[name] = round(perf_counter() - start, 3)
