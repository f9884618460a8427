"""Why a voxel was carved or kept: the carving run once more with an eye on that voxel."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon3d.carving import METHODS, Label, PhotoHull
from recon3d.carving.observing import Judgement, Voxel, VoxelWatcher
from recon3d.carving.views import ViewArrays
from recon3d.carving.visual_hull import silhouette_outlines
from recon3d.carving.voxel_coloring import neighbour_offsets
from recon3d.explanation_figure import Crop, NeighbourSlices, PixelKind, draw_explanation
from recon3d.html import Summarised
from recon3d.kernels.footprints import footprint
from recon3d.kernels.item_buffer import enter_box, next_voxel
from recon3d.kernels.silhouettes import distance_at
from recon3d.pipeline import carve
from recon3d.scene import Scene
from recon3d.settings import Settings, choose_views
from recon3d.volume import CarvingVolume

_LUMINANCE = np.array([299, 587, 114])  # thousandths, as the fuzzy test has it
_TAKEN = {
    "voxel-coloring": "claimed by accepted voxels nearer to the camera",
    "generalized-voxel-coloring": "see another voxel",
    "space-carving": "not free in their sweep",
}
_UNKNOWN = {
    "visual-hull": "nothing: the silhouettes alone decide",
    "vote-carving": "which depth maps voted: all votes around a voxel are blurred into one distance before they count",
    "probabilistic-space-carving": "one deciding moment: the degree is the voxel's probability after the last round, "
    "and all voxels change each other's",
    "roxels": "one deciding moment: the degree is the voxel's opacity after the last round, "
    "and all voxels on a ray change each other's",
}


@dataclass(frozen=True)
class ViewEvidence:
    """What one view shows of a voxel."""

    name: str
    """The view's."""
    box: tuple[int, int, int, int]
    """B_j(v): first and last column u, first and last row v; a last one before its first: not seen."""
    kinds: NDArray[np.uint8]
    """(rows, columns) ``PixelKind`` of the pixels in the box, as they were when the voxel was last judged."""
    colors: NDArray[np.uint8]
    """(rows, columns, 3) RGB of the pixels in the box."""
    excludes: str = ""
    """By how much the view's silhouette excludes the voxel; empty: it does not."""

    @property
    def sees(self) -> bool:
        """Whether any of the box lies in the image, before the camera."""
        return bool(self.kinds.size)

    @property
    def luminances(self) -> NDArray[np.int64]:
        """(n,) 8-bit luminances of the pixels that voted."""
        return np.asarray((self.colors[self.kinds == PixelKind.VOTED] @ _LUMINANCE + 500) // 1000)

    def count(self, kind: PixelKind) -> int:
        """Pixels of a kind."""
        return int(np.count_nonzero(self.kinds == kind))


@dataclass(frozen=True, repr=False)
class Explanation(Summarised):
    """What happened to one voxel, and why."""

    scene: Scene
    """With the views that were used."""
    settings: Settings
    """Resolved."""
    hull: PhotoHull
    """The whole result."""
    voxel: Voxel
    """(i, j, k)."""
    judgements: tuple[Judgement, ...]
    """Every verdict of the test on the voxel, the last being the decisive one; empty: it was never asked."""
    views: tuple[ViewEvidence, ...]
    """View by view, in the scene's order."""
    chosen: str = ""
    """Why this voxel, where a pixel was asked about."""

    @property
    def label(self) -> Label:
        """What became of the voxel."""
        return Label(int(self.hull.labels[self.voxel]))

    @property
    def center(self) -> NDArray[np.float64]:
        """(3,) middle of the voxel, world units."""
        return self.hull.volume.origin + self.hull.volume.voxel_size * (np.array(self.voxel) + 0.5)

    @property
    def last(self) -> Judgement | None:
        """The decisive judgement."""
        return self.judgements[-1] if self.judgements else None

    @property
    def excluded_by(self) -> tuple[str, ...]:
        """Names of the views whose silhouettes exclude the voxel."""
        return tuple(view.name for view in self.views if view.excludes)

    def outcome(self) -> str:
        """The verdict and its reason in a sentence."""
        reasons = {
            Label.UNSEEN: "no image shows it, so nothing is known of it",
            Label.BACKGROUND: f"carved before any test: outside the silhouettes of {', '.join(self.excluded_by)}",
            Label.HIDDEN: "no pixel is free to show it: it lies inside, or behind accepted voxels in every view",
        }
        if self.last is None or self.label in reasons:
            return f"{self.label.name.lower()}: {reasons.get(self.label, self._unjudged())}"
        return f"{self.label.name.lower()}: {_reason(self.last)}"

    def _unjudged(self) -> str:
        """Why a voxel that no test judged was carved or kept."""
        if self.label == Label.CONSISTENT:
            return "kept, and some pixel sees it"
        return f"carved by {self.settings.method} as a whole, not by one judgement"

    def hysteresis(self) -> str:
        """What the hysteresis decided, and through which voxels."""
        last = self.last
        if last is None or last.low == last.high:
            return "none: there is one threshold" if last else "not reached"
        if not last.is_candidate:
            return "not asked: the degree alone decides"
        if not last.path:
            return "a candidate that was not resolved in the end"
        if not last.connected:
            return f"dropped: no accepted voxel touches it or the {last.n_connected - 1} candidates around it"
        through = " - ".join(f"{_text(voxel)} {self.hull.degree[voxel]:.3f}" for voxel in last.path[1:][-4:])
        skipped = "... - " if len(last.path) > 5 else ""
        return f"kept: candidates connect it to an accepted voxel, {skipped}{through}"

    def neighbours(self) -> str:
        """Labels of the voxels around, and the range of their degrees."""
        at = np.array(self.voxel) + neighbour_offsets(_connectivity(self.settings))
        at = at[((at >= 0) & (at < self.hull.labels.shape)).all(axis=1)]
        labels, degrees = self.hull.labels[tuple(at.T)], self.hull.degree[tuple(at.T)]
        parts = []
        for label in Label:
            known = degrees[(labels == label) & ~np.isnan(degrees)]
            span = f" ({known.min():.3f} to {known.max():.3f})" if len(known) else ""
            parts.append(f"{np.count_nonzero(labels == label)} {label.name.lower()}{span}")
        return ", ".join(part for part in parts if not part.startswith("0 "))

    def describe(self, view: ViewEvidence) -> str:
        """What a view showed of the voxel, in a line."""
        n = view.kinds.size
        if not view.sees:
            return "does not show it"
        if view.excludes:
            return f"silhouette excludes it: {view.excludes}"
        asked = view.count(PixelKind.VOTED) + view.count(PixelKind.TAKEN)
        if not asked:
            return f"{view.count(PixelKind.FOREGROUND)} of {n} pixels are foreground"
        values = view.luminances
        text = f"{len(values)} of {n} pixels voted"
        text += f", luminance {values.min()}..{values.max()}" if len(values) else ""
        rest = ((PixelKind.TAKEN, _TAKEN.get(self.settings.method, "")), (PixelKind.BACKGROUND, "background"))
        return text + "".join(f"; {view.count(kind)} {name}" for kind, name in rest if view.count(kind))

    def summary(self) -> dict[str, object]:
        """Table of all that is known."""
        volume, last = self.hull.volume, self.last
        rows: dict[str, object] = {
            "voxel": f"{_text(self.voxel)} of {' x '.join(map(str, volume.shape))}",
            "centre": _place(self.center),
            **({"chosen": self.chosen} if self.chosen else {}),
            "outcome": self.outcome(),
        }
        if last:
            rows["degree"] = f"{last.degree:.4f}, thresholds {last.low:.4f} and {last.high:.4f}, views {last.n_views}"
            if len(self.judgements) > 1:
                rows["judged"] = f"{len(self.judgements)} times: {_history(self.judgements)}"
            rows["hysteresis"] = self.hysteresis()
        elif not np.isnan(self.hull.degree[self.voxel]):
            rows["degree"] = f"{self.hull.degree[self.voxel]:.4f}, views {self.hull.n_views[self.voxel]}"
        if self.hull.distance is not None:
            rows["depth (voxels)"] = f"{self.hull.distance[self.voxel] / volume.voxel_size:.2f} inside the surface"
        if self.settings.method in _UNKNOWN:
            rows["not known"] = _UNKNOWN[self.settings.method]
        else:
            rows["test"] = repr(self.settings.test)
        rows["neighbours"] = self.neighbours()
        return rows | {f"view {view.name}": self.describe(view) for view in self.views}

    def picture(self) -> NDArray[np.uint8]:
        """The voxel's boxes in the photographs, the pixels' luminances, degree and thresholds, and the neighbours."""
        seeing = [view for view in self.views if view.sees]
        images = {view.name: view.image for view in self.scene.views}
        crops = [
            Crop(images[view.name], view.box, view.kinds, f"{view.name}\n{_caption(view)}", bool(view.excludes))
            for view in sorted(seeing, key=lambda view: view.count(PixelKind.VOTED) == 0)
        ]
        low = np.array(self.voxel) - 1
        labels = np.full((3, 3, 3), -1)
        degrees = np.full((3, 3, 3), np.nan)
        for step in np.ndindex(3, 3, 3):
            at = low + step
            if (at >= 0).all() and (at < self.hull.labels.shape).all():
                labels[step], degrees[step] = self.hull.labels[tuple(at)], self.hull.degree[tuple(at)]
        through = tuple(np.array(self.last.path[1]) - low) if self.last and self.last.connected else None
        return draw_explanation(
            f"Voxel {_text(self.voxel)}, {self.outcome()}",
            crops,
            [(view.name, view.colors[view.kinds == PixelKind.VOTED], view.luminances) for view in seeing],
            [(judgement.degree, judgement.low, judgement.high) for judgement in self.judgements],
            NeighbourSlices(labels, degrees, through),
        )


def explain(
    scene: Scene,
    settings: Settings | None = None,
    *,
    at: ArrayLike | None = None,
    pixel: tuple[str, float, float] | None = None,
) -> Explanation:
    """Carve once more, and tell what became of one voxel and why.

    The engines are deterministic: the same scene and settings give the same judgements again, and an observer keeps
    those of the voxel. For a finished run ask ``explain(result.scene, result.settings, at=...)``.

    Parameters
    ----------
    scene, settings : as for ``reconstruct``.
    at : (3,) a place in the voxel, world units.
    pixel : name of a view, and a pixel (u, v) in it. Explained is the first accepted voxel on the pixel's ray, which
        is what the result shows there; behind a hole through which nothing is seen, the voxel on the ray that came
        nearest to being accepted: of those that were judged the one with the highest degree, else the one that the
        fewest silhouettes exclude. ``chosen`` says which it is, and which carved voxel before an accepted one had the
        highest degree: where a hole shows what lies behind it, ask about that one by ``at``.

    Raises
    ------
    ValueError : neither or both of at and pixel, a place outside the volume, a pixel outside the image, or one whose
        ray misses the volume.
    SceneError : no view of that name.
    EmptyReconstructionError : everything was carved.
    """
    if (at is None) == (pixel is None):
        raise ValueError("expected a place (at) or a pixel, one of them")
    settings = (settings or Settings()).resolved(scene)
    scene = choose_views(scene, settings)
    volume = CarvingVolume.enclosing(scene.bounds, voxel_size=settings.voxel_size, n_voxels=settings.n_voxels)
    views = ViewArrays(scene)
    chosen = ""
    if pixel is not None:
        ray = voxels_on_ray(scene, volume, pixel)
        voxel, chosen = _most_telling(scene, views, carve(scene, volume, settings), ray)
    else:
        voxel = voxel_at(volume, at)
    boxes, _, _ = views.footprints(np.array([voxel]), volume)
    watcher = VoxelWatcher(voxel, boxes[0], neighbour_offsets(_connectivity(settings)))
    asks = METHODS[settings.method].uses_test
    hull = carve(scene, volume, settings, **({"observer": watcher} if asks else {}))
    evidence = _evidence(scene, views, hull, watcher, asks)
    return Explanation(scene, settings, hull, voxel, tuple(watcher.judgements), evidence, chosen)


def voxel_at(volume: CarvingVolume, at: ArrayLike | None) -> Voxel:
    """The voxel of a volume that holds a place (3,) in the world."""
    place = np.asarray(at, np.float64)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ValueError(f"expected a place of three finite numbers, got {at!r}")
    index = np.floor((place - volume.origin) / volume.voxel_size).astype(np.int64)
    if (index < 0).any() or (index >= volume.shape).any():
        low, high = (_place(corner) for corner in (volume.bounds.min_bound, volume.bounds.max_bound))
        raise ValueError(f"the place {_place(place)} lies outside the volume, which spans {low} to {high}")
    i, j, k = (int(n) for n in index)
    return i, j, k


def voxels_on_ray(scene: Scene, volume: CarvingVolume, pixel: tuple[str, float, float]) -> list[Voxel]:
    """All voxels of a volume on the ray of a pixel (view, u, v), from the camera on."""
    name, u, v = pixel
    view = scene.subset([name]).views[0]
    if not (-0.5 <= u < view.width - 0.5 and -0.5 <= v < view.height - 0.5):
        raise ValueError(f"view {view.name} has {view.width}x{view.height} pixels, got pixel {u:g},{v:g}")
    start = (view.center - volume.origin) / volume.voxel_size
    step = view.cam_from_world[:3, :3].T @ np.linalg.inv(view.K) @ [u, v, 1.0]
    shape, place = np.array(volume.shape), np.empty(3, np.int64)
    ray: list[Voxel] = []
    inside = enter_box(shape, start, step, place)
    while inside:
        i, j, k = (int(n) for n in place)
        ray.append((i, j, k))
        inside = next_voxel(shape, start, step, place)
    if not ray:
        raise ValueError(f"the ray of pixel {u:g},{v:g} of view {view.name} misses the volume")
    return ray


def _most_telling(scene: Scene, views: ViewArrays, hull: PhotoHull, ray: list[Voxel]) -> tuple[Voxel, str]:
    """The voxel on a ray that someone who clicks on its pixel means, and why it."""
    first = next((n for n, voxel in enumerate(ray) if hull.volume.occupied[voxel]), None)
    before = ray[:first]
    judged = [voxel for voxel in before if not np.isnan(hull.degree[voxel])]
    best = max(judged, key=lambda voxel: float(hull.degree[voxel]), default=None)
    if first is not None:
        text = f"first accepted voxel on the pixel's ray; {len(before)} before it are empty"
        if best is not None:
            center = hull.volume.origin + hull.volume.voxel_size * (np.array(best) + 0.5)
            text += f", of which {_place(center)} with the highest degree, {hull.degree[best]:.3f}"
        return ray[first], text
    if best is not None:
        return best, f"of {len(ray)} voxels on the pixel's ray none is accepted; this one has the highest degree"
    silhouettes = _Silhouettes(scene, views, hull)
    best = min(ray, key=lambda voxel: sum(bool(text) for text in silhouettes.excluding(voxel)))
    return best, f"of {len(ray)} voxels on the pixel's ray none is accepted; the fewest silhouettes exclude this one"


def _evidence(
    scene: Scene,
    views: ViewArrays,
    hull: PhotoHull,
    watcher: VoxelWatcher,
    asks: bool,
) -> tuple[ViewEvidence, ...]:
    """What every view shows of a watched voxel, and showed if the method asks a test."""
    voxel, judgements = watcher.voxel, watcher.judgements
    excluding = _Silhouettes(scene, views, hull).excluding(voxel)
    # A voxel that was visited and not judged had lost all its pixels before.
    visited = judgements or (asks and hull.labels[voxel] == Label.HIDDEN)
    others = PixelKind.TAKEN if visited else PixelKind.FOREGROUND
    evidence = []
    for n, (view, box) in enumerate(zip(scene.views, watcher.boxes, strict=True)):
        u0, u1, v0, v1 = (int(x) for x in box)
        cut = np.s_[v0 : v1 + 1, u0 : u1 + 1]
        kinds = np.where(views.foreground[n][cut], others, PixelKind.BACKGROUND).astype(np.uint8)
        if judgements:
            kinds[judgements[-1].votes[n]] = PixelKind.VOTED
        evidence.append(ViewEvidence(view.name, (u0, u1, v0, v1), kinds, views.images[n][cut], excluding[n]))
    return tuple(evidence)


class _Silhouettes:
    """Which views exclude voxels, by the same rule as the engine that made a hull."""

    def __init__(self, scene: Scene, views: ViewArrays, hull: PhotoHull) -> None:
        self.scene, self.views, self.volume = scene, views, hull.volume
        self.outlines = silhouette_outlines(scene) if hull.distance is not None else None

    def excluding(self, voxel: Voxel) -> list[str]:
        """View by view how far it excludes a voxel; empty where it does not."""
        return self._by_centers(voxel) if self.outlines else self._by_footprints(voxel)

    def _by_centers(self, voxel: Voxel) -> list[str]:
        """Where hulls have distances: a voxel's centre must lie inside the outline."""
        assert self.outlines is not None  # noqa: S101 # for mypy
        x, y, z = self.volume.origin + (np.array(voxel) + 0.5) * self.volume.voxel_size
        known = iter(range(len(self.outlines.sizes)))
        texts = []
        for view in self.scene.views:
            n = next(known) if view.silhouette is not None else None
            value = np.inf
            if n is not None:
                arrays = (array[n : n + 1] for array in self.outlines)
                projections, sizes, scales, distances = arrays
                value = distance_at(x, y, z, projections, sizes, scales, distances, np.empty(1))
            outside = -value * self.scene.mm_per_unit
            texts.append(f"its centre lies {outside:.2g} mm outside" if value <= 0 else "")
        return texts

    def _by_footprints(self, voxel: Voxel) -> list[str]:
        """Elsewhere: its footprint, if wholly in the image, must hold foreground."""
        views, size = self.views, self.volume.voxel_size
        x, y, z = self.volume.origin + np.array(voxel) * size
        texts = []
        for n, (width, height) in enumerate(views.sizes):
            u0, u1, v0, v1, whole = footprint(views.projections[n], width, height, x, y, z, size)
            box = views.foreground[n, v0 : v1 + 1, u0 : u1 + 1]
            texts.append(f"all {box.size} pixels are background" if whole and not box.any() else "")
        return texts


def _reason(judgement: Judgement) -> str:
    """Why a judged voxel was carved or kept."""
    degree, low, high = judgement.degree, judgement.low, judgement.high
    if degree >= high:
        return f"accepted, its degree {degree:.3f} reaches the {'' if low == high else 'high '}threshold {high:.3f}"
    if degree <= low:
        where = f"below the threshold {low:.3f}" if low == high else f"not above the low threshold {low:.3f}"
        return f"carved, its degree {degree:.3f} is {where}"
    band = f"its degree {degree:.3f} lies between {low:.3f} and {high:.3f}"
    if judgement.connected:
        steps = len(judgement.path) - 1
        how = "it touches an accepted voxel" if steps == 1 else f"candidates lead to an accepted voxel in {steps} steps"
        return f"accepted, {band}, and {how}"
    return f"carved, {band}, and candidates connect it to no accepted voxel"


def _history(judgements: tuple[Judgement, ...]) -> str:
    """Degrees of all judgements, repeated ones once."""
    runs = [(text, len(list(run))) for text, run in groupby(f"{judgement.degree:.3f}" for judgement in judgements)]
    return ", ".join(f"{text} ({times} times)" if times > 1 else text for text, times in runs)


def _caption(view: ViewEvidence) -> str:
    """A few words on a view, for the picture."""
    if view.excludes:
        return "excludes it"
    asked = view.count(PixelKind.VOTED) + view.count(PixelKind.TAKEN)
    return f"{view.count(PixelKind.VOTED)} of {view.kinds.size} voted" if asked else ""


def _connectivity(settings: Settings) -> Any:
    return settings.method_options.get("connectivity", 26)


def _text(voxel: Voxel) -> str:
    return f"({', '.join(map(str, voxel))})"


def _place(point: NDArray[np.float64]) -> str:
    return ",".join(f"{x:.6g}" for x in point)
