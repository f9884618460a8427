"""Why photographs could not be placed, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from recon3d.calibration.features import MIN_INLIERS, Pair
from recon3d.calibration.photographs import PhotoFile

_FEW_FEATURES = 100
_FINE = 2.0  # pixels: the scale of features that blur takes away
_NEEDED = 30  # matches that a pose is accepted by


def reasons_of(
    photographs: Sequence[PhotoFile],
    groups: Sequence[set[str]],
    pairs: Sequence[Pair],
    scales: Mapping[str, NDArray[np.float64]],
) -> dict[str, str]:
    """Why photographs are not in the first group, by their names.

    Parameters
    ----------
    groups : digests of the photographs that were placed together, the largest first; may be empty.
    pairs : what was matched between the photographs.
    scales : of the features of every photograph, by its digest.
    """
    placed = groups[0] if groups else set()
    names = {photograph.digest: photograph.name for photograph in photographs}
    fine = {digest: int(np.count_nonzero(found < _FINE)) for digest, found in scales.items()}
    usual = float(np.median([fine[digest] for digest in placed or fine]))
    return {
        photograph.name: _reason(photograph.digest, groups, pairs, names, scales, fine, usual)
        for photograph in photographs
        if photograph.digest not in placed
    }


def advice(n_photographs: int, pairs: Sequence[Pair], scales: Mapping[str, NDArray[np.float64]]) -> str:
    """What to change where too few of the photographs could be placed."""
    verified = [pair for pair in pairs if pair.inliers >= MIN_INLIERS]
    if verified and sum(pair.panoramic for pair in verified) > len(verified) / 2:
        return (
            "Most seem to be taken from one spot, or of one plane: walk around the object, a step of about 10 degrees "
            "from photograph to photograph"
        )
    features = float(np.median([len(found) for found in scales.values()]))
    return (
        f"They have {features:.0f} features (median) and overlap {2 * len(verified) / n_photographs:.1f} others "
        "(mean): give the object texture or stand it on printed paper, photograph it in steps of about 10 degrees, or "
        "stand it on a printed board, which needs no texture: recon3d board, then recon3d calibrate --board"
    )


def _reason(
    digest: str,
    groups: Sequence[set[str]],
    pairs: Sequence[Pair],
    names: Mapping[str, str],
    scales: Mapping[str, NDArray[np.float64]],
    fine: Mapping[str, int],
    usual: float,
) -> str:
    n_features = len(scales[digest])
    if fine[digest] < 0.25 * usual and fine[digest] < 0.5 * n_features:
        return f"blurred: {fine[digest]} fine features, the others have {usual:.0f}"
    if n_features < _FEW_FEATURES:
        return f"almost no texture: {n_features} features"
    mine = sorted((pair for pair in pairs if digest in (pair.first, pair.second)), key=lambda pair: -pair.inliers)
    if not mine or mine[0].inliers < MIN_INLIERS:
        most = mine[0].inliers if mine else 0
        return f"overlaps no other photograph: at most {most} matches, {MIN_INLIERS} are needed"
    best = mine[0]
    other = names[best.second if best.first == digest else best.first]
    verified = [pair for pair in mine if pair.inliers >= MIN_INLIERS]
    if all(pair.panoramic for pair in verified):
        return f"taken from the spot of {other}, or of one plane: {best.inliers} matches without parallax"
    for n, group in enumerate(groups[1:], start=2):
        if digest in group:
            return f"placed only with {len(group) - 1} others, which too few matches join with the rest (group {n})"
    joined = [pair for pair in verified if {pair.first, pair.second} & (groups[0] if groups else set())]
    if not joined:
        return f"overlaps only photographs that were not placed either: {best.inliers} matches with {other}"
    if best.inliers < _NEEDED:
        return f"too few matches: {best.inliers} with {other}, {_NEEDED} are needed; photograph between them"
    return f"its {best.inliers} matches with {other} agree with no pose; photograph between them"
