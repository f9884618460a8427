"""Mistakes in cameras, found by matches between the photographs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from recon3d.diagnosis.epipolar import BEFORE, GOOD, Agreement, Cameras, agreement
from recon3d.diagnosis.finding import Finding
from recon3d.diagnosis.half_pixel import half_pixel_findings
from recon3d.diagnosis.hypotheses import Hypothesis, focal_lengths, reordered, usual_mistakes
from recon3d.diagnosis.matches import Matches, Picture
from recon3d.diagnosis.order import assigned

_FEWEST_PAIRS = 3
_SHARE = 0.8  # of the pairs that agree where cameras are right
_WRONG_VIEWS = 0.34  # of all views at most, that are named
_BETTER = 5.0  # times smaller than as given is the error of what names a mistake
_SUSPECT = 1.0  # reduced pixels of the median pair from which on usual mistakes are tried
_CLEARLY, _FARTHER = 0.6, 5.0  # reduced pixels, and times the median pair's error, from which on one pair is wrong
_FAR_OUT = 0.35  # of the image's sides, from its middle
_MOST_ORDERED = 80  # views whose order is searched


def cameras_of(pictures: Sequence[Picture]) -> Cameras:
    """The cameras of reduced photographs."""
    given = [picture.view.calibration for picture in pictures]
    sizes = np.array([(camera.width, camera.height) for camera in given], np.float64)
    small = np.array([(picture.camera.width, picture.camera.height) for picture in pictures], np.float64)
    reduced = np.tile(np.eye(3), (len(given), 1, 1))
    for axis, s in enumerate((small / sizes).T):
        reduced[:, axis, axis], reduced[:, axis, 2] = s, (s - 1) / 2
    return Cameras(
        np.array([camera.K for camera in given]), np.array([camera.cam_from_world for camera in given]), sizes, reduced
    )


def camera_findings(pictures: Sequence[Picture], matches: Matches) -> list[Finding]:
    """The mistake that explains why matches contradict the cameras; none where they agree, or are too few."""
    if len(matches.pairs) < _FEWEST_PAIRS:
        return []
    cameras, names = cameras_of(pictures), [picture.view.name for picture in pictures]
    given = agreement(matches, cameras)
    mostly = given.good.mean() >= _SHARE
    wrong = _outliers(matches, given, len(pictures))
    if mostly and not len(wrong) and given.error < _SUSPECT:
        return half_pixel_findings(matches, cameras)
    told = f"Matches between the photographs contradict the cameras ({_told(pictures, given)})"
    for tried in (usual_mistakes(names), focal_lengths()):
        explaining = _best(tried, matches, cameras, given)
        # Where all pairs but those of a few views agree, a mistake in all cameras must make them agree better.
        if explaining and not (len(wrong) and _without(wrong, matches, given).average <= 1.2 * explaining[0][0]):
            first, others = explaining[0][1], dict.fromkeys(other.kind for _, other in explaining[1:])
            others.pop(first.kind, None)
            alike = f" The matches would also agree with: {', '.join(others)}." if others else ""
            return [Finding(first.kind, f"{told}: {first.message}{alike}", first.advice)]
    if len(wrong):
        return [_of_views(pictures, matches, cameras, given, wrong)]
    return [] if mostly else [_in_order(names, matches, cameras, given, told) or _unexplained(pictures, told)]


def _best(
    tried: Iterable[Hypothesis], matches: Matches, cameras: Cameras, given: Agreement
) -> list[tuple[float, Hypothesis]]:
    """The mistakes that explain the matches best, each with the average disagreement that is left.

    Several where the photographs do not tell them apart.
    """
    explaining = []
    for hypothesis in tried:
        found = agreement(matches, hypothesis.undone(cameras))
        if _explains(found, given):
            explaining.append((found.average, hypothesis))
    least = min((average for average, _ in explaining), default=0.0)
    return [(average, hypothesis) for average, hypothesis in explaining if average <= 1.1 * least + 0.03]


def _in_order(names: Sequence[str], matches: Matches, cameras: Cameras, given: Agreement, told: str) -> Finding | None:
    """The finding that photographs and cameras are in different orders, where another one explains the matches."""
    if len(names) > _MOST_ORDERED or len(np.unique(cameras.sizes, axis=0)) > 1:
        return None
    order = assigned(matches, cameras)
    if not _explains(agreement(matches, reordered(cameras, order)), given):
        return None
    moved = [n for n in range(len(names)) if order[n] != n]
    which = ", ".join(f"{names[n]} needs that of {names[order[n]]}" for n in moved[:4])
    return Finding(
        "images in another order",
        f"{told}: photographs and cameras are in different orders. By the matches, each needs another one's camera: "
        f"{which}{' ...' if len(moved) > 4 else ''}.",
        "Give each camera with the name of its photograph.",
        tuple(names[n] for n in moved),
    )


def _unexplained(pictures: Sequence[Picture], told: str) -> Finding:
    """The finding that matches contradict the cameras for no known reason, or for a principal point far out."""
    view = pictures[0].view
    u, v = view.K[:2, 2]
    if np.abs((view.K[:2, 2] + 0.5) / (view.width, view.height) - 0.5).max() > _FAR_OUT:
        return Finding(
            "principal point",
            f"{told}, and the principal point of {view.name} is ({u:.4g}, {v:.4g}) in an image of "
            f"{view.width}x{view.height} pixels, far from its middle.",
            "Check cx and cy: they are in pixels from the upper left pixel's centre, and K is that of these very "
            "photographs.",
        )
    return Finding(
        "cameras contradict matches",
        f"{told}, and no usual mistake (axes, inverse, size of K, reversed or shifted order) explains it.",
        "Check that the calibration is of these very photographs, in this order, with all distortion, "
        "or calibrate them anew (recon3d calibrate).",
    )


def _explains(found: Agreement, given: Agreement) -> bool:
    """Whether cameras make matches agree, clearly better than as given."""
    if found.good.mean() < _SHARE or found.error >= GOOD:
        return False
    nearer = given.error > _BETTER * found.error or given.average > _BETTER * found.average
    return nearer or (given.in_front < BEFORE and found.error < 1.2 * given.error + 0.1)


def _clearly_good(given: Agreement) -> NDArray[np.bool_]:
    """(n_pairs,) which pairs agree about as well as the median pair.

    A camera that is turned a little about the object stays near its epipolar lines: a pair is wrong, too, that is much
    farther from them than the median pair.
    """
    return given.good & (given.errors < max(_CLEARLY, _FARTHER * given.error))


def _outliers(matches: Matches, given: Agreement, n_views: int) -> NDArray[np.int64]:
    """Views all of whose pairs are wrong, while those of the others agree; few, or none."""
    good = _clearly_good(given)
    left = np.ones(len(matches.pairs), np.bool_)
    wrong: list[int] = []
    while (left & ~good).any():
        total = np.bincount(matches.pairs[left].ravel(), minlength=n_views)
        bad = np.bincount(matches.pairs[left & ~good].ravel(), minlength=n_views)
        share = np.where(bad > 0, bad / np.maximum(total, 1), 0) + 1e-3 * bad
        worst = int(np.argmax(share))
        if share[worst] < _SHARE or bad[worst] < 2:
            break
        wrong.append(worst)
        left &= ~(matches.pairs == worst).any(axis=1)
    if not wrong or len(wrong) > _WRONG_VIEWS * n_views or good[left].sum() < _FEWEST_PAIRS:
        return np.zeros(0, np.int64)
    return np.sort(wrong) if good[left].mean() >= _SHARE else np.zeros(0, np.int64)


def _without(wrong: NDArray[np.int64], matches: Matches, given: Agreement) -> Agreement:
    """The agreement of the pairs that no wrong view is of."""
    left = ~np.isin(matches.pairs, wrong).any(axis=1)
    return Agreement(given.errors[left], given.before[left])


def _of_views(
    pictures: Sequence[Picture], matches: Matches, cameras: Cameras, given: Agreement, wrong: NDArray[np.int64]
) -> Finding:
    """The finding that some views' cameras are wrong, or exchanged."""
    names, rest = [picture.view.name for picture in pictures], _without(wrong, matches, given)
    n_pairs = np.bincount(matches.pairs.ravel(), minlength=len(names))
    bad = matches.pairs[~_clearly_good(given)]
    for a in wrong[:2]:
        # An exchanged one has other wrong pairs, too, or hardly any pairs.
        others = np.union1d(bad[~(bad == a).any(axis=1)], np.flatnonzero(n_pairs < 2)).astype(np.int64)
        for b in others:
            order = np.arange(len(names))
            order[[a, b]] = b, a
            after = agreement(matches, reordered(cameras, order))
            if a != b and after.good.all() and after.average <= 1.3 * rest.average + 0.05:
                a, b = sorted((int(a), int(b)))
                return Finding(
                    "views exchanged",
                    f"The cameras of {names[a]} and {names[b]} are exchanged: with each other's, matches agree.",
                    "Give each camera with the name of its photograph.",
                    (names[a], names[b]),
                )
    of_wrong = np.isin(matches.pairs, wrong).any(axis=1)
    pixels = _told(pictures, Agreement(given.errors[of_wrong], given.before[of_wrong]))
    told = tuple(names[n] for n in wrong)
    one = len(wrong) == 1
    return Finding(
        "one wrong camera" if one else "wrong cameras",
        f"{'The camera' if one else 'Cameras'} of {', '.join(told)} contradict{'s' * one} matches with the other views "
        f"({pixels}); the others agree.",
        f"Leave {'that view' if one else 'those views'} out, or calibrate {'it' if one else 'them'} anew.",
        told,
    )


def _told(pictures: Sequence[Picture], given: Agreement) -> str:
    """Text of a median error in pixels of the photographs, or that points lie behind the cameras."""
    scale = float(np.median([picture.view.width / picture.camera.width for picture in pictures]))
    pixels = f"{given.error * scale:.{0 if given.error * scale > 9.5 else 1}f} pixels"
    if given.in_front >= BEFORE:
        return f"by {pixels}"
    return "points lie behind the cameras" + (f", by {pixels}" if given.error >= GOOD else "")
