"""Where further photographs would help a reconstruction most."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.checks import require_whole
from recon3d.errors import ArgumentError
from recon3d.evaluation.distances import sample_surface
from recon3d.rendering.orbit import look_at, up_direction
from recon3d.rendering.ray_caster import RayCaster
from recon3d.scene.bounds import place_text
from recon3d.scene.camera import Camera
from recon3d.scene.scene import Scene
from recon3d.surface.sights import Sights

_SAMPLES = 4000  # of the surface
_CANDIDATES = 500  # directions over the whole sphere
_LOWEST = 10.0  # degrees that a photograph may be taken from below the lowest there is
_CLEARANCE = 0.1  # pixel footprints before the surface where a line of sight ends
_HALF = 0.5  # worth of being seen by the first of two views, while views are chosen one by one
_UNCERTAIN = 1.0  # pixel footprints; surface with a larger uncertainty counts as not measured


@dataclass(frozen=True)
class NextView:
    """A photograph that would help."""

    camera: Camera
    """With the intrinsics of the nearest view, looking at the middle of the bounds."""
    nearest: str
    """Name of the view whose direction is nearest."""
    angle: float
    """Degrees between both directions, seen from the middle of the bounds."""
    gain: float
    """Share of the surface, in [0, 1], that could be measured with all proposals, and not without this one."""

    @property
    def center(self) -> NDArray[np.float64]:
        """(3,) where it would be taken, world."""
        R, t = self.camera.cam_from_world[:3, :3], self.camera.cam_from_world[:3, 3]
        return np.asarray(-R.T @ t)

    @property
    def direction(self) -> NDArray[np.float64]:
        """(3,) unit, where it would look, world."""
        return np.asarray(self.camera.cam_from_world[2, :3])


@dataclass(frozen=True)
class Coverage:
    """Which part of a surface is missing, and the views that would help most."""

    hardly_seen: float
    """Share of the surface, in [0, 1], that fewer than two views see."""
    unmeasured: float
    """Share of the surface, in [0, 1], that was not measured, or only to more than a pixel's footprint."""
    gain: float
    """Share of the surface, in [0, 1], that could be measured with all proposals, and was not."""
    samples: NDArray[np.float64]
    """(n, 3) world, places on the unmeasured surface."""
    proposals: tuple[NextView, ...]
    """The most needed first; fewer than were asked for where more would not help."""

    def summary(self) -> dict[str, object]:
        """Table of what is missing, and of where to photograph from."""
        rows: dict[str, object] = {
            "seen by fewer than two views": f"{self.hardly_seen:.1%} of the surface",
            "not measured, or uncertain": f"{self.unmeasured:.1%} of the surface",
        }
        for n, view in enumerate(self.proposals):
            place = place_text(view.center, float(np.ptp(self.samples, axis=0).max())).replace(",", ", ")
            toward = ", ".join(f"{x:.4g}" for x in view.direction)
            rows[f"next view {n + 1}"] = (
                f"from ({place}) towards ({toward}), {view.angle:.0f} degrees from {view.nearest}"
            )
        if self.proposals:
            needed = ", ".join(f"{view.gain:.1%}" for view in self.proposals)
            rows["with these views"] = (
                f"{self.gain:.1%} more of the surface could be measured; without each: {needed} less"
            )
        else:
            rows["next views"] = "none would help: no view around the object sees more of the unmeasured surface"
        return rows


def propose_views(
    mesh: o3d.geometry.TriangleMesh,
    scene: Scene,
    n: int,
    *,
    support: NDArray[np.int64] | None = None,
    uncertainty: NDArray[np.float64] | None = None,
    seed: int = 0,
) -> Coverage:
    """Choose the views that would let most of the unmeasured surface be measured.

    A place can be measured where two views see it steeply enough, from directions far enough apart to triangulate and
    near enough to match, one of them new. Candidates stand around the middle of the bounds, as far away as the views
    there are, and hardly lower than the lowest of these. They are chosen one by one, each the one with the largest
    gain, then exchanged one by one while that gains more.

    Parameters
    ----------
    mesh : the result, closed: where it ends, nothing is known to be missing.
    n : how many views to propose.
    support : (n_vertices,) views that measured each vertex; where it is None, as seen from the views.
    uncertainty : (n_vertices,) of each vertex, world units; None where it is not known.
    seed : of the samples on the surface.

    References
    ----------
    Nemhauser, Wolsey, Fisher, "An analysis of approximations for maximizing submodular set functions", Mathematical
    Programming 1978 (greedy choice).
    """
    require_whole("n", n)
    for name, values in (("support", support), ("uncertainty", uncertainty)):
        if values is not None and values.shape != (len(mesh.vertices),):
            raise ArgumentError(f"expected {name} of {len(mesh.vertices):,} vertices, got shape {values.shape}")
    spacing = float(np.sqrt(mesh.get_surface_area() / _SAMPLES))
    places, owners = sample_surface(mesh, spacing, np.random.default_rng(seed))
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)[owners]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    caster, clearance = RayCaster(mesh), _CLEARANCE * scene.pixel_footprint
    own = Sights.of([view.calibration for view in scene.views], places, normals, caster, clearance)
    hardly = own.seen.sum(axis=0) < 2
    needed = hardly if support is None else (support[np.asarray(mesh.triangles)[owners]] == 0).any(axis=1)
    if uncertainty is not None:
        largest = uncertainty[np.asarray(mesh.triangles)[owners]].max(axis=1)
        needed = needed | (largest > _UNCERTAIN * scene.pixel_footprint)
    candidates = candidate_cameras(scene)
    there = Sights.of(candidates, places[needed], normals[needed], caster, clearance)
    choice = _Choice(own.part(needed), there)
    chosen = choice.best(n)
    proposals = [_proposal(scene, candidates[index], gain / len(places)) for index, gain in chosen]
    gain = choice.measured([index for index, _ in chosen]).sum() / len(places)
    return Coverage(float(hardly.mean()), float(needed.mean()), float(gain), places[needed], tuple(proposals))


class _Choice:
    """Which candidates measure most of the places that need it."""

    def __init__(self, own: Sights, there: Sights) -> None:
        self._there = there
        n_candidates, n_places = there.seen.shape
        self._with_own = np.zeros((n_candidates, n_places), np.bool_)
        for index in range(len(own.seen)):
            self._with_own |= there.matchable(own, index)
        self._pairs: dict[int, NDArray[np.bool_]] = {}

    def _pair(self, index: int) -> NDArray[np.bool_]:
        """(n_candidates, n) places that a candidate and each other can measure together."""
        if index not in self._pairs:
            self._pairs[index] = self._there.matchable(self._there, index)
        return self._pairs[index]

    def measured(self, chosen: list[int]) -> NDArray[np.bool_]:
        """(n,) places that can be measured with some candidates."""
        found = self._with_own[chosen].any(axis=0)
        for index in chosen:
            found |= self._pair(index)[chosen].any(axis=0)
        return np.asarray(found)

    def _with_each(self, chosen: list[int]) -> NDArray[np.bool_]:
        """(n_candidates, n) places that can be measured with some candidates and each other one."""
        found = self._with_own | self.measured(chosen)
        for index in chosen:
            found |= self._pair(index)
        return np.asarray(found)

    def best(self, n: int) -> list[tuple[int, int]]:
        """At most n candidates, and how many places cannot be measured without each of them; none that adds nothing."""
        chosen: list[int] = []
        for left in range(n, 0, -1):
            found = self._with_each(chosen)
            worth = found.sum(axis=1).astype(np.float64)
            if left > 1:  # the next one may be the second view
                worth += _HALF * (self._there.steep & ~found).sum(axis=1)
            chosen.append(int(worth.argmax()))
        return self._worth(self._exchanged(chosen))

    def _worth(self, chosen: list[int]) -> list[tuple[int, int]]:
        """Each candidate with how many places cannot be measured without it, most first; none without any."""
        total = int(self.measured(chosen).sum())
        worth = {}
        for index in chosen:
            others = [other for other in chosen if other != index]
            worth[index] = total - int(self.measured(others).sum())
        least = min(worth, key=lambda index: worth[index])
        if worth[least] == 0:
            rest = [index for index in dict.fromkeys(chosen) if index != least]
            return self._worth(rest) if rest else []
        return sorted(worth.items(), key=lambda each: -each[1])

    def _exchanged(self, chosen: list[int]) -> list[int]:
        """The candidates, one after the other replaced by a better one, until none is better."""
        most, improved = int(self.measured(chosen).sum()), True
        while improved:
            improved = False
            for at in range(len(chosen)):
                others = chosen[:at] + chosen[at + 1 :]
                counts = self._with_each(others).sum(axis=1)
                if counts.max() > most:
                    most, improved = int(counts.max()), True
                    chosen = [*chosen[:at], int(counts.argmax()), *chosen[at + 1 :]]
        return chosen


def candidate_cameras(scene: Scene) -> list[Camera]:
    """Cameras around the middle of the bounds that look at it, each with the intrinsics of the nearest view.

    Directions are spread evenly over the sphere, but for those below the views there are.
    """
    middle, up = scene.bounds.center, up_direction(scene)
    offsets = scene.centers - middle
    distances = np.linalg.norm(offsets, axis=1)
    own = offsets / distances[:, None]
    lowest = float(np.arcsin(np.clip(own @ up, -1, 1)).min()) - np.radians(_LOWEST)
    rank = np.arange(_CANDIDATES) + 0.5
    z, turn = 1 - 2 * rank / _CANDIDATES, np.pi * (1 + np.sqrt(5)) * rank  # the golden angle
    directions = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    directions = directions[np.arcsin(np.clip(directions @ up, -1, 1)) >= lowest]
    cameras = []
    for direction in directions:
        nearest = scene.views[int((own @ direction).argmax())].calibration
        side = up if abs(direction @ up) < 0.999 else np.eye(3)[np.abs(up).argmin()]
        pose = look_at(middle + np.median(distances) * direction, middle, side)
        cameras.append(replace(nearest, cam_from_world=pose, distortion=()))
    return cameras


def _proposal(scene: Scene, camera: Camera, gain: float) -> NextView:
    """A candidate with the view that is nearest to it."""
    offsets = scene.centers - scene.bounds.center
    own = offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
    cosines = own @ -camera.cam_from_world[2, :3]
    nearest = int(cosines.argmax())
    return NextView(
        camera, scene.views[nearest].name, float(np.degrees(np.arccos(np.clip(cosines.max(), -1, 1)))), gain
    )
