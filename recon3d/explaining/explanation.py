"""Why a voxel was carved or kept: the carving run once more with an eye on that voxel."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon3d.carving import (
    GeneralizedVoxelColoring,
    JudgingMethod,
    Method,
    ProbabilisticSpaceCarving,
    Roxels,
    SpaceCarving,
    VoteCarving,
    VoxelColoring,
)
from recon3d.carving.hysteresis import Connectivity, neighbour_offsets
from recon3d.carving.observations import UnclaimedPixels
from recon3d.carving.observer import Judgement, Voxel, VoxelWatcher, voxel_text
from recon3d.errors import ArgumentError
from recon3d.explaining.evidence import PixelKind, ViewEvidence, view_evidence
from recon3d.explaining.figure import NeighbourSlices, draw_explanation
from recon3d.explaining.pointing import most_telling, voxel_at, voxels_on_ray
from recon3d.pipeline import kept_carving
from recon3d.scene.bounds import place_text
from recon3d.scene.scene import Scene
from recon3d.settings import Settings, choose_views, method_name
from recon3d.stereo.refinement import refine
from recon3d.summary import Summarised
from recon3d.tasks import Store
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume

_TAKEN: dict[type[Method], str] = {
    VoxelColoring: "claimed by accepted voxels nearer to the camera",
    GeneralizedVoxelColoring: "see another voxel",
    SpaceCarving: "not free in their sweep",
}


_UNKNOWN: dict[type[Method], str] = {
    VoteCarving: "which depth maps voted: all votes around a voxel are blurred into one distance before they count",
    ProbabilisticSpaceCarving: "one deciding moment: the degree is the voxel's probability after the last round, "
    "and all voxels change each other's",
    Roxels: "one deciding moment: the degree is the voxel's opacity after the last round, "
    "and all voxels on a ray change each other's",
}


@dataclass(frozen=True, repr=False)
class Explanation(Summarised):
    """What happened to one voxel, and why."""

    scene: Scene
    """With the views that were used."""
    settings: Settings
    """Resolved."""
    carved: CarvedVolume
    """The whole result; of a dense one, what matching left, with the degrees of carving."""
    voxel: Voxel
    """(i, j, k)."""
    judgements: tuple[Judgement, ...]
    """Every verdict of the test on the voxel, the last being the decisive one; empty: it was never asked."""
    views: tuple[ViewEvidence, ...]
    """View by view, in the scene's order."""
    chosen: str = ""
    """Why this voxel, where a pixel was asked about."""
    label_before_matching: Label | None = None
    """What carving had made of the voxel, before matching carved on; None: the result is not a sharp one."""
    n_points: int = 0
    """Matched points in the voxel."""

    @property
    def method(self) -> Method:
        """What carved."""
        return self.settings.method_for(self.scene)

    @property
    def label(self) -> Label:
        """What became of the voxel."""
        return Label(int(self.carved.labels[self.voxel]))

    @property
    def center(self) -> NDArray[np.float64]:
        """(3,) middle of the voxel, world units."""
        return self.carved.volume.origin + self.carved.volume.voxel_size * (np.array(self.voxel) + 0.5)

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
            Label.UNSEEN: "no image shows it, or a camera stands there",
            Label.BACKGROUND: f"carved before any test: outside the silhouettes of {', '.join(self.excluded_by)}",
            Label.HIDDEN: "no pixel is free to show it: it lies inside, or behind accepted voxels in every view",
        }
        if self.label == Label.INCONSISTENT and self.label_before_matching in (Label.HIDDEN, Label.CONSISTENT):
            return "inconsistent: carved by matching, the surface that the photographs agree on lies behind it"
        if self.last is None or self.label in reasons:
            return f"{self.label.name.lower()}: {reasons.get(self.label, self._unjudged())}"
        return f"{self.label.name.lower()}: {_reason(self.last)}"

    def _unjudged(self) -> str:
        """Why a voxel that no test judged was carved or kept."""
        if self.label == Label.CONSISTENT:
            return "kept, and some pixel sees it"
        return f"carved by {method_name(self.method)} as a whole, not by one judgement"

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
        through = " - ".join(f"{voxel_text(voxel)} {self.carved.degree[voxel]:.3f}" for voxel in last.path[1:][-4:])
        skipped = "... - " if len(last.path) > 5 else ""
        return f"kept: candidates connect it to an accepted voxel, {skipped}{through}"

    def neighbours(self) -> str:
        """Labels of the voxels around, and the range of their degrees."""
        at = np.array(self.voxel) + neighbour_offsets(_connectivity(self.method))
        at = at[((at >= 0) & (at < self.carved.labels.shape)).all(axis=1)]
        labels, degrees = self.carved.labels[tuple(at.T)], self.carved.degree[tuple(at.T)]
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
        rest = ((PixelKind.TAKEN, _TAKEN.get(type(self.method), "")), (PixelKind.BACKGROUND, "background"))
        return text + "".join(f"; {view.count(kind)} {name}" for kind, name in rest if view.count(kind))

    def summary(self) -> dict[str, object]:
        """Table of all that is known."""
        volume, last = self.carved.volume, self.last
        rows: dict[str, object] = {
            "voxel": f"{voxel_text(self.voxel)} of {' x '.join(map(str, volume.shape))}",
            "centre": place_text(self.center, volume.voxel_size),
            **({"chosen": self.chosen} if self.chosen else {}),
            "outcome": self.outcome(),
        }
        if last:
            rows["degree"] = f"{last.degree:.4f}, thresholds {last.low:.4f} and {last.high:.4f}, views {last.n_views}"
            if len(self.judgements) > 1:
                rows["judged"] = f"{len(self.judgements)} times: {_history(self.judgements)}"
            rows["hysteresis"] = self.hysteresis()
        elif not np.isnan(self.carved.degree[self.voxel]):
            rows["degree"] = f"{self.carved.degree[self.voxel]:.4f}, views {self.carved.n_views[self.voxel]}"
        if self.carved.distance is not None:
            depth = float(self.carved.distance[self.voxel]) / volume.voxel_size
            rows["distance"] = f"{abs(depth):.2f} voxels {'inside' if depth > 0 else 'outside'}"
        if self.label_before_matching is not None:
            rows["matching"] = (
                f"carving left it {self.label_before_matching.name.lower()}; "
                f"{self.n_points} points of the mesh lie in it"
            )
        if type(self.method) in _UNKNOWN:
            rows["not known"] = _UNKNOWN[type(self.method)]
        if isinstance(self.method, JudgingMethod):
            rows["test"] = repr(self.method.test)
        rows["neighbours"] = self.neighbours()
        return rows | {f"view {view.name}": self.describe(view) for view in self.views}

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB picture.

        The voxel's boxes in the photographs, the pixels' luminances, degree and thresholds, and the neighbours.
        """
        low = np.array(self.voxel) - 1
        labels = np.full((3, 3, 3), -1)
        degrees = np.full((3, 3, 3), np.nan)
        for step in np.ndindex(3, 3, 3):
            at = low + step
            if (at >= 0).all() and (at < self.carved.labels.shape).all():
                labels[step], degrees[step] = self.carved.labels[tuple(at)], self.carved.degree[tuple(at)]
        through = tuple(np.array(self.last.path[1]) - low) if self.last and self.last.connected else None
        return draw_explanation(
            f"Voxel {voxel_text(self.voxel)}, {self.outcome()}",
            [view for view in self.views if view.sees],
            self.judgements,
            NeighbourSlices(labels, degrees, through),
        )


def explain(
    scene: Scene,
    settings: Settings | None = None,
    *,
    at: ArrayLike | None = None,
    pixel: tuple[str, float, float] | None = None,
    checkpoints: Store | None = None,
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
    checkpoints : as for ``reconstruct``; without those that a run with dense matching kept, it matches once more.

    Raises
    ------
    ArgumentError : neither or both of at and pixel, a place outside the volume, a pixel outside the image, or one whose
        ray misses the volume.
    SceneError : no view of that name.
    EmptyReconstructionError : everything was carved.
    """
    if (at is None) == (pixel is None):
        raise ArgumentError("expected a place (at) or a pixel, one of them")
    settings = (settings or Settings()).resolved(scene)
    scene = choose_views(scene, settings)
    method = settings.method_for(scene).dense()
    # What a sparse volume's stage holds does not tell why voxels were carved.
    kept = checkpoints if method == settings.carving else None
    settings = replace(settings, carving=method)
    lattice, views = settings.lattice(scene), scene.packed
    volume = CarvingVolume.full(lattice)
    asks = method.uses_test
    chosen = ""
    if pixel is not None:
        ray = voxels_on_ray(scene, volume, pixel)
        carved = kept_carving(scene, lattice, settings, kept).dense()
        hull, points = _matched(scene, carved, settings, checkpoints)
        voxel, chosen = most_telling(scene, views, hull, ray)
        chosen += _background(scene, pixel)
    else:
        voxel = voxel_at(volume, at)
    boxes, _, _ = UnclaimedPixels(views, volume).footprints(np.array([voxel]))
    watcher = VoxelWatcher(voxel, boxes[0], neighbour_offsets(_connectivity(method)))
    if asks:
        carved = kept_carving(scene, lattice, settings, observer=watcher).dense()
    elif pixel is None:
        carved = kept_carving(scene, lattice, settings, kept).dense()
    if pixel is None:
        hull, points = _matched(scene, carved, settings, checkpoints)
    evidence = view_evidence(scene, views, carved, watcher, asks=asks)
    found = Explanation(scene, settings, hull, voxel, tuple(watcher.judgements), evidence, chosen)
    if points is None:
        return found
    inside = (np.floor((points - volume.origin) / volume.voxel_size) == voxel).all(axis=1)
    return replace(found, label_before_matching=Label(int(carved.labels[voxel])), n_points=int(inside.sum()))


def _matched(
    scene: Scene, carved: CarvedVolume, settings: Settings, checkpoints: Store | None
) -> tuple[CarvedVolume, NDArray[np.float32] | None]:
    """What matching leaves of a volume, with the degrees of carving, and points (n, 3); None without matching."""
    passes = settings.passes_for(scene)
    if not passes:
        return carved, None
    cloud, left = refine(scene, carved, passes=passes, checkpoints=checkpoints)
    distance = None if carved.distance is None else left.distance
    return replace(carved, volume=left.volume, labels=left.labels, distance=distance), cloud.point.positions.numpy()


def _background(scene: Scene, pixel: tuple[str, float, float]) -> str:
    """A remark where a pixel cannot show the object; empty where it may."""
    name, u, v = pixel
    silhouette = scene.subset([name]).views[0].silhouette
    outside = silhouette is not None and not silhouette[math.floor(v + 0.5), math.floor(u + 0.5)]
    return "; the silhouette leaves this pixel out" if outside else ""


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


def _connectivity(method: Method) -> Connectivity:
    """Neighbours of a voxel that matter, all where no hysteresis decides."""
    return method.connectivity if isinstance(method, JudgingMethod) else 26
