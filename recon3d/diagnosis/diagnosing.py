"""The checks of a scene, one after the other, and the table of its views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recon3d.checks import require_whole
from recon3d.diagnosis.boxes import box_findings
from recon3d.diagnosis.cameras import camera_findings, cameras_of
from recon3d.diagnosis.epipolar import agreement, triangulated
from recon3d.diagnosis.finding import Finding
from recon3d.diagnosis.holes import hole_findings
from recon3d.diagnosis.masks import mask_findings
from recon3d.diagnosis.matches import Matches, Picture
from recon3d.diagnosis.photographs import photograph_findings, sharpness
from recon3d.errors import SceneError
from recon3d.scene.bounds import Bounds
from recon3d.scene.enclosing import looked_at
from recon3d.scene.neighbours import viewing_angles
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

_FILM_DIAGONAL = 43.27  # mm, of a 35-mm camera's frame


@dataclass(frozen=True)
class Diagnosis:
    """What the checks of a scene, or of cameras alone, have found, and what they have looked at."""

    name: str
    """Of the scene."""
    views: tuple[View, ...]
    bounds: Bounds | None
    """None: of cameras alone."""
    findings: tuple[Finding, ...]
    """Empty: nothing wrong was found."""
    pictures: tuple[Picture, ...]
    """The reduced photographs that were looked at."""
    matches: Matches
    points: NDArray[np.float64]
    """(n, 3) matched points that agree with the cameras, world."""

    def seen(self) -> str:
        """Text of what the findings rest on."""
        n = len(self.pictures)
        return f"{n} of {len(self.views)} views looked at, {len(self.matches.pairs)} pairs of them matched"

    @property
    def centers(self) -> NDArray[np.float64]:
        """(n_views, 3) camera centres, world."""
        return np.array([view.center for view in self.views])

    @property
    def middle(self) -> NDArray[np.float64]:
        """(3,) the bounds' centre, world, or else that of matched points, or where the cameras look; NaN: nowhere."""
        if self.bounds is not None:
            return self.bounds.center
        if len(self.points):
            return np.asarray(np.median(self.points, axis=0))
        try:
            return looked_at(self.views)
        except SceneError:
            return np.full(3, np.nan)

    def table(self) -> list[str]:
        """Lines of a table of the views, below their heading."""
        angles = viewing_angles(self.centers, self.middle)
        np.fill_diagonal(angles, np.nan)
        sharp = {
            picture.view.name: value for picture, value in zip(self.pictures, sharpness(self.pictures), strict=True)
        }
        masks = {picture.view.name: picture.mask for picture in self.pictures if picture.mask is not None}
        width = max(24, *(len(view.name) for view in self.views))
        lines = [f"{'view':{width}} {'size':>10} {'35 mm':>6} {'distance':>9} {'nearest':>8} {'mask':>5} {'sharp':>5}"]
        for view, row in zip(self.views, angles, strict=True):
            focal = np.sqrt(view.K[0, 0] * view.K[1, 1]) / np.hypot(view.width, view.height) * _FILM_DIAGONAL
            share = f"{masks[view.name].mean():.0%}" if view.name in masks else "-"
            nearest = f"{np.nanmin(row):.1f} deg" if np.isfinite(row).any() else "-"
            distance = float(np.linalg.norm(view.center - self.middle))
            relative = f"{sharp[view.name]:.2f}" if view.name in sharp else "-"
            lines.append(
                f"{view.name:{width}} {f'{view.width}x{view.height}':>10} {f'{focal:.0f} mm':>6} "
                f"{f'{distance:.4g}' if np.isfinite(distance) else '-':>9} {nearest:>8} {share:>5} {relative:>5}"
            )
        return lines


def check_scene(scene: Scene, *, max_views: int = 24) -> tuple[Finding, ...]:
    """Look for the classical mistakes in cameras, order of images, bounds, masks and exposure.

    SIFT matches between reduced photographs are trusted where they agree with an epipolar geometry of their own. Where
    they contradict the given cameras, usual mistakes are undone one by one: the one that makes them agree is told.
    Photographs without texture have too few matches; they say nothing about the cameras.

    Parameters
    ----------
    max_views : evenly chosen ones of more are looked at.

    Returns
    -------
    What was found; empty: nothing.
    """
    return diagnose(scene, max_views=max_views).findings


def diagnose(scene: Scene, *, max_views: int = 60) -> Diagnosis:
    """``check_scene`` with what it rests on, for tables and figures."""
    looked_at = diagnose_cameras(scene.views, name=scene.name, max_views=max_views)
    pictures, points = looked_at.pictures, looked_at.points
    cameras, photographs = (
        [finding for finding in looked_at.findings if (finding.about == "cameras") == of_cameras]
        for of_cameras in (True, False)
    )
    # Bounds and masks are compared by the cameras, which must be right for that.
    bounds = [] if cameras else _about("bounds", box_findings(scene, points))
    agree = not cameras and not bounds
    masks = mask_findings(scene, pictures, looked_at.matches, agree=agree)
    masks = _about("masks", masks or (hole_findings(scene, pictures) if agree else []))
    return replace(looked_at, bounds=scene.bounds, findings=(*cameras, *bounds, *masks, *photographs))


def diagnose_cameras(views: Sequence[View], *, name: str = "scene", max_views: int = 60) -> Diagnosis:
    """What matches between photographs say of their cameras and of themselves, where no bounds are known to be right.

    Parameters
    ----------
    name : of the scene, for figures.
    max_views : evenly chosen ones of more are looked at.
    """
    require_whole("max_views", max_views)
    chosen = np.unique(np.linspace(0, len(views) - 1, min(max_views, len(views))).round().astype(int))
    pictures = tuple(Picture.of(views[n]) for n in chosen)
    matches = Matches.between(pictures)
    found = _about("cameras", camera_findings(pictures, matches))
    findings = (*found, *photograph_findings(pictures, matches))
    return Diagnosis(name, tuple(views), None, findings, pictures, matches, _points(pictures, matches))


def _about(what: str, findings: Sequence[Finding]) -> list[Finding]:
    return [replace(finding, about=what) for finding in findings]


def _points(pictures: Sequence[Picture], matches: Matches) -> NDArray[np.float64]:
    """(n, 3) points of the pairs that agree with the cameras, world."""
    if not len(matches.pairs):
        return np.zeros((0, 3))
    cameras = cameras_of(pictures)
    return triangulated(matches, cameras)[agreement(matches, cameras).good[matches.pair]]
