"""What a run needs, in memory, temporary files and time, and the level of detail that fits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np
import psutil

from recon3d.carving import N_VOXELS
from recon3d.carving.vote_carving import reading_scale
from recon3d.checks import require_choice
from recon3d.errors import NoRoomError
from recon3d.scene.bounds import Bounds
from recon3d.scene.mask import ComputedMask
from recon3d.scene.neighbours import viewing_angles
from recon3d.scene.pixel_cache import PIXELS
from recon3d.scene.regions import bounds_mask
from recon3d.scene.scene import Scene
from recon3d.scene.view import View
from recon3d.settings import Settings, choose_views
from recon3d.volume.lattice import BYTES_PER_VOXEL

Detail = Literal["auto", "full", "half", "quarter"]
"""Levels of detail: the scale at which photographs are read; "auto": the finest that fits."""

SCALES: dict[str, float] = {"full": 1.0, "half": 0.5, "quarter": 0.25}
"""Of the levels of detail, the finest first."""

MOST_MEMORY = 4 * 2**30
"""Bytes that "auto" keeps within where no other limit is given, or half of the machine's memory where that is less."""

MOST_SECONDS = 600.0
"""CPU seconds that "auto" keeps within."""

_GIB, _MIB = 2**30, 2**20
_LOOKED_AT, _SMALL = 12, 0.125  # views, and their scale, of which the covered share is taken
_AROUND = 120.0  # degrees between two views' directions above which views stand all around
_SPACING = 1.5  # of the matched points, pixel footprints

# Fitted to runs that scripts/measure_needs.py measures.
_BYTES_FIXED = 380 * _MIB  # what is imported, and compiled code
_BYTES_OF_BAND = 180 * _MIB  # rays that are cast at a time
_BYTES_OF_FUSED = 260  # a matched pixel, of the one view whose planes are averaged
_BYTES_OF_POINT, _BYTES_OF_NODE = 250, 250  # a matched point and a triangle, while Poisson makes it
_BYTES_OF_KEPT_POINT, _BYTES_OF_TRIANGLE = 100, 400  # the same while the mesh is repaired, seen and measured
_CONFIRMED = 0.5  # of the matched pixels, which become points
_IN_BOX = 0.5  # of what the bounds cover in a view, where the object's mask is still to be made
_TRIANGLES_OF_CELL = 2.3  # that a surface cuts out of a cell's face
_FILLERS = 20  # triangles for each voxel's face of the hull's unmeasured surface
_UNMEASURED = 0.08  # of the area of the bounds' faces, where views stand all around; about all of it where they do not
_SECONDS_FIXED = 6.0
_SECONDS_OF_VOXEL = 4e-7  # and view
_SECONDS_OF_PIXEL = 1.8e-5  # that shows what may be the object, and is matched in all passes
_SECONDS_OF_TRIANGLE = 4.5e-5
_BYTES_OF_STORED = 21  # a pixel of a view and pass in the temporary file


@dataclass(frozen=True)
class Needs:
    """What a run is expected to need; memory and time are right within a factor of about 1.5."""

    memory: float
    """Bytes of the process at its highest."""
    temporary: float
    """Bytes of temporary files."""
    seconds: float
    """CPU seconds."""

    def __str__(self) -> str:
        return f"{self.memory / _GIB:.1f} GiB and {_rounded(self.seconds):,.0f} CPU seconds"


class Chosen(NamedTuple):
    """A scene at a level of detail."""

    scene: Scene
    told: str
    """What was chosen, and why, in one line."""
    needs: Needs
    """Of a run of it."""


@dataclass(frozen=True)
class _Extent:
    """How much there is to see in a scene."""

    n_views: int
    pixels: float
    """Of all views."""
    padded: float
    """Of one view, padded to the largest."""
    covered: float
    """Pixels of all views that show what may be the object."""
    surface: float
    """Area of the object, pixel footprints squared."""
    footprint: float
    """World units."""
    all_around: bool
    """Whether views stand on all sides."""

    @classmethod
    def of(cls, scene: Scene) -> _Extent:
        """Look at some of the views, at a small scale; masks that would have to be made are not asked for."""
        views = scene.views
        some = [views[n] for n in np.unique(np.linspace(0, len(views) - 1, min(_LOOKED_AT, len(views))).astype(int))]
        share = float(np.mean([_covered_share(view, scene.bounds) for view in some]))
        pixels = float(sum(view.width * view.height for view in views))
        # The sides of a convex body have four times the area of its shadow, on average over all directions (Cauchy).
        all_around = bool(np.nanmax(viewing_angles(scene.centers, scene.bounds.center)) > _AROUND)
        sides = 4 if all_around else 2
        return cls(
            len(views),
            pixels,
            float(max(view.width for view in views) * max(view.height for view in views)),
            share * pixels,
            sides * share * pixels / len(views),
            scene.pixel_footprint,
            all_around,
        )

    def at(self, scale: float) -> _Extent:
        """That of the photographs at a scale."""
        square = scale**2
        return _Extent(
            self.n_views, self.pixels * square, self.padded * square, self.covered * square, self.surface * square,
            self.footprint / scale, self.all_around,
        )  # fmt: skip


def needs(scene: Scene, settings: Settings | None = None) -> Needs:
    """What ``reconstruct`` of a scene is expected to need."""
    settings = settings or Settings()
    used = _used(scene, settings)
    return _needs(used, settings, _Extent.of(used))


def advised_voxel_size(scene: Scene) -> float:
    """Edge length in world units: a million voxels, as by default, but none finer than a pixel's footprint."""
    return max(Settings(n_voxels=N_VOXELS).lattice(scene).voxel_size, scene.pixel_footprint)


def at_detail(
    scene: Scene, detail: Detail = "auto", *, settings: Settings | None = None, memory: float | None = None
) -> Chosen:
    """The scene at a level of detail: its photographs, cameras and masks at that scale.

    Parameters
    ----------
    detail : "full", "half", "quarter", or "auto": the finest that keeps within the memory and ``MOST_SECONDS``.
    settings : that it will be reconstructed with.
    memory : bytes that a run may take; ``MOST_MEMORY``, for "auto" alone, when None.

    Raises
    ------
    NoRoomError : the level, or any with "auto", would take more than the memory that is given; says what would fit.
    """
    require_choice("detail", detail, get_args(Detail))
    settings = settings or Settings()
    used = _used(scene, settings)
    extent = _Extent.of(used)
    expected = {level: _needs(used, settings, extent.at(scale)) for level, scale in SCALES.items()}
    limit = min(MOST_MEMORY, psutil.virtual_memory().total / 2) if memory is None else memory
    roomy = [level for level, need in expected.items() if need.memory <= limit]
    if detail == "auto":
        quick = [level for level in roomy if expected[level].seconds <= MOST_SECONDS]
        level = (quick or roomy[-1:] or list(SCALES)[-1:])[0]
    else:
        level = detail
    if memory is not None and level not in roomy:
        way_out = f"--detail {roomy[0]} would fit" if roomy else "use fewer views (--max-views), or more memory"
        raise NoRoomError(
            f"scene {scene.name}: about {expected[level]} would be needed at {level} detail, and "
            f"{memory / _GIB:.1f} GiB may be taken; {way_out}"
        )
    chosen = scene.shrunk(SCALES[level])
    if level != "full":
        chosen.notes["detail"] = level
    sizes = sorted({f"{view.width}x{view.height}" for view in chosen.views})
    told = f"{level}, {', '.join(sizes)} pixels of {scene.length(chosen.pixel_footprint)}, about {expected[level]}"
    if detail == "auto" and level != "full":
        told += f"; full would take {expected['full']}, more than {limit / _GIB:.1f} GiB or {MOST_SECONDS:.0f} seconds"
    return Chosen(chosen, told, expected[level])


def _used(scene: Scene, settings: Settings) -> Scene:
    """The scene with the views that the settings ask for; all where it takes long to find which are admissible."""
    one_sided = settings.carving is not None and settings.carving.one_sided
    return scene if one_sided else choose_views(scene, settings)


def _needs(scene: Scene, settings: Settings, extent: _Extent) -> Needs:
    """What a run needs of so many pixels: its stages' peaks, of which the highest counts."""
    lattice = settings.lattice(scene)
    passes = settings.passes_for(scene)
    kept = min(PIXELS.limit, 4 * extent.pixels)  # photographs and masks
    voxels = BYTES_PER_VOXEL * lattice.n_voxels
    carving_seconds = _SECONDS_FIXED + _SECONDS_OF_VOXEL * lattice.n_voxels * extent.n_views
    if not passes:
        return Needs(_BYTES_FIXED + kept + voxels + 16 * extent.pixels, 0.0, carving_seconds)
    scale = min(1.0, reading_scale(scene, lattice.voxel_size) * extent.footprint / scene.pixel_footprint)
    read = scale**2 * extent.pixels  # by carving
    last = passes[-1]
    points = _CONFIRMED * extent.covered / last.stride**2
    others = min(last.neighbours, extent.n_views - 1)
    x, y, z = scene.bounds.extent / lattice.voxel_size
    unmeasured = 2 * (x * y + y * z + z * x) * (_UNMEASURED if extent.all_around else 1.0)
    triangles = _TRIANGLES_OF_CELL * extent.surface / _SPACING**2 + _FILLERS * unmeasured
    stages = {
        "carving": voxels + 12 * read,
        "matching": 8 * extent.padded * (2 * others + 3) + _BYTES_OF_BAND + 4 * read,
        "fusion": _BYTES_OF_FUSED * extent.padded / last.stride**2 + 160 * points + 4 * read,
        "Poisson": _BYTES_OF_POINT * points + _BYTES_OF_NODE * triangles + voxels / 2 + 4 * read,
        "surface": _BYTES_OF_KEPT_POINT * points + _BYTES_OF_TRIANGLE * triangles + voxels / 2 + 4 * read,
        "colors": 60 * extent.padded + (extent.n_views + 100) * triangles / 2 + 4 * read,
    }
    seconds = carving_seconds + _SECONDS_OF_PIXEL * extent.covered + _SECONDS_OF_TRIANGLE * triangles
    return Needs(_BYTES_FIXED + kept + max(stages.values()), _BYTES_OF_STORED * extent.pixels, seconds)


def _covered_share(view: View, bounds: Bounds) -> float:
    """Share of a view's pixels that show what lies in the bounds, and in its mask where there is one already."""
    small = replace(view, mask=None if isinstance(view.mask, ComputedMask) else view.mask).shrunk(_SMALL)
    covered, silhouette = bounds_mask(bounds, small), small.silhouette
    share = float((covered if silhouette is None else covered & silhouette).mean())
    return _IN_BOX * share if isinstance(view.mask, ComputedMask) else share


def _rounded(seconds: float) -> float:
    """Seconds to two digits."""
    return round(seconds, 1 - int(np.log10(max(seconds, 10.0))))
