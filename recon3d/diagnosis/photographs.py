"""Photographs that differ where they should not, or do not where they should."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from recon3d.diagnosis.finding import Finding
from recon3d.diagnosis.matches import Matches, Picture

_SAME = 0.005  # mean difference over the standard deviation of one picture
_BRIGHTER, _REDDER = float(np.log(1.4)), float(np.log(1.2))
_UNIFORM = 4.0  # times its spread over the matches is a difference that is of the whole photograph
_JOINED = 4  # pictures that tell which one differs
_DARK = 4.0  # grey levels that are added, so that noise in the dark has no ratio
_NAMED = 4


def photograph_findings(pictures: Sequence[Picture], matches: Matches) -> list[Finding]:
    """Duplicates, and photographs of another exposure or white balance."""
    return [*_duplicates(pictures), *_exposure(pictures, matches)]


def sharpness(pictures: Sequence[Picture]) -> NDArray[np.float64]:
    """(n,) variance of the Laplacian inside the mask, over that of the median picture."""
    values = []
    for picture in pictures:
        laplacian = cv2.Laplacian(picture.grey, cv2.CV_32F)
        held = laplacian if picture.mask is None or not picture.mask.any() else laplacian[picture.mask]
        values.append(float(held.var()))
    return np.array(values) / max(float(np.median(values)), 1e-12)


def _duplicates(pictures: Sequence[Picture]) -> list[Finding]:
    small = [
        cv2.resize(picture.grey, (64, 64), interpolation=cv2.INTER_AREA).astype(np.float32) for picture in pictures
    ]
    pairs = [
        (a, b)
        for b in range(len(small))
        for a in range(b)
        if np.abs(small[a] - small[b]).mean() < _SAME * max(float(small[a].std()), 1.0)
    ]
    if not pairs:
        return []
    names = [picture.view.name for picture in pictures]
    told = ", ".join(f"{names[b]} shows what {names[a]} shows" for a, b in pairs[:_NAMED])
    return [
        Finding(
            "duplicate views",
            f"The same photograph is there twice: {told}{' ...' if len(pairs) > _NAMED else ''}.",
            "Leave one of each pair out; where their cameras differ, one has the wrong photograph.",
            tuple(dict.fromkeys(names[n] for pair in pairs for n in pair)),
        )
    ]


def _gains(pictures: Sequence[Picture], matches: Matches) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(n, 3) logarithms of how much brighter, by channel, a picture shows the same places than others joined with it.

    NaN where that is not known. And (n,) for which the ratio to a picture beside it alone says so: it is large, and the
    same all over; shadows and gloss change parts.
    """
    smooth = [cv2.blur(picture.image, (5, 5)).astype(np.float64) + _DARK for picture in pictures]
    n = len(pictures)
    signs, ratios = np.zeros((len(matches.pairs), n)), np.zeros((len(matches.pairs), 3))
    clear = np.zeros(n, np.bool_)
    for pair, views in enumerate(matches.pairs):
        places = matches.places[matches.pair == pair].round().astype(int)
        seen = []
        for side, view in enumerate(views):
            height, width = smooth[view].shape[:2]
            u, v = np.clip(places[:, side], 0, [width - 1, height - 1]).T
            seen.append(np.log(smooth[view][v, u]))
        differences = seen[1] - seen[0]
        signs[pair, views] = -1, 1
        ratios[pair] = np.median(differences, axis=0)
        spread = np.median(np.abs(differences - ratios[pair]))
        clear[views] |= np.abs(ratios[pair].mean()) > max(0.8 * _BRIGHTER, _UNIFORM * spread)
    gains = np.linalg.pinv(signs) @ ratios
    _, parts = connected_components(signs.T @ signs != 0, directed=False)
    for part in range(parts.max() + 1):
        joined = parts == part
        gains[joined] -= np.median(gains[joined], axis=0) if joined.sum() >= _JOINED else np.nan
    return np.asarray(gains, np.float64), clear


def _exposure(pictures: Sequence[Picture], matches: Matches) -> list[Finding]:
    """Photographs that are brighter, or of another tint, all over."""
    gains, clear = _gains(pictures, matches)
    names = [picture.view.name for picture in pictures]
    brightness = gains.mean(axis=1)
    tint = gains - brightness[:, None]
    exposed = np.flatnonzero((np.abs(brightness) > _BRIGHTER) & clear)
    tinted = np.flatnonzero(np.abs(tint).max(axis=1) > _REDDER)
    findings = []
    if len(exposed):
        worst = ", ".join(f"{names[n]} {np.exp(brightness[n]):.2f} times" for n in exposed[:_NAMED])
        findings.append(
            Finding(
                "exposure",
                f"The same places are brighter or darker in some photographs than in the median one: {worst}"
                f"{' ...' if len(exposed) > _NAMED else ''}.",
                "Photo-consistency compares colours: lock exposure and light, or equalise the photographs.",
                tuple(names[n] for n in exposed),
            )
        )
    if len(tinted):
        findings.append(
            Finding(
                "white balance",
                f"The same places have other colours in {', '.join(names[n] for n in tinted[:_NAMED])}"
                f"{' ...' if len(tinted) > _NAMED else ''}, by up to "
                f"{np.expm1(np.nanmax(np.abs(tint[tinted]))):.0%} in one channel.",
                "Lock the white balance, or develop all photographs with the same.",
                tuple(names[n] for n in tinted),
            )
        )
    return findings
