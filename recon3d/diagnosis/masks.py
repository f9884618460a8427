"""Whether masks are of one object, and white for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from recon3d.diagnosis.finding import Finding
from recon3d.diagnosis.matches import Matches, Picture
from recon3d.scene.enclosing import silhouettes_explained
from recon3d.scene.scene import NO_SILHOUETTES, Scene

_FEWEST = 4  # views with masks
_EXPLAINED = 0.97  # of the silhouettes, on average
_NAMED = 4


def mask_findings(scene: Scene, pictures: Sequence[Picture], matches: Matches, *, agree: bool) -> list[Finding]:
    """What is wrong with masks that are given, or with there being none.

    Parameters
    ----------
    agree : compare the masks with each other, too, by the cameras.
    """
    if NO_SILHOUETTES in scene.notes and not len(matches.pairs):
        return [
            Finding(
                "neither masks nor matches",
                f"Nothing tells the object from the background: there are no masks, {scene.notes[NO_SILHOUETTES]}, and "
                "no photographs could be matched with each other.",
                "Give masks (--silhouettes FOLDER), or sharper and brighter photographs with smaller steps between.",
            )
        ]
    inverted = [picture.view.name for picture in pictures if picture.inverted]
    masked = [picture for picture in pictures if picture.mask is not None]
    if inverted:
        all_of_them = len(inverted) == len(masked) + len(inverted)
        which = "masks are" if all_of_them else f"masks of {', '.join(inverted[:_NAMED])} are"
        return [
            Finding(
                "inverted masks",
                f"The {which} inverted: they call the image's border object, and its middle not.",
                "Give masks that are white for the object, black for the background.",
                tuple(inverted),
            )
        ]
    if not agree or len(masked) < _FEWEST:
        return []
    shares = silhouettes_explained([picture.view for picture in masked], scene.bounds)
    if shares.mean() >= _EXPLAINED:
        return []
    worst = _without(masked, scene)
    if worst is not None:
        name = masked[worst].view.name
        return [
            Finding(
                "one wrong mask",
                f"The mask of {name} contradicts all others: without it what lies in all of them explains them.",
                "Check that mask, and the camera of its view, or leave the view out.",
                (name,),
            )
        ]
    return [
        Finding(
            "masks contradict each other",
            f"The masks contradict each other: what lies in all of them fills only {shares.mean():.0%} of the average "
            "one.",
            "Check that the masks are those of these views, in their order, and that the bounds hold the object.",
        )
    ]


def _without(masked: Sequence[Picture], scene: Scene) -> int | None:
    """The mask without which the others agree, or None."""
    if len(masked) <= _FEWEST:
        return None
    scores = []
    for n in range(len(masked)):
        others = [picture.view for k, picture in enumerate(masked) if k != n]
        scores.append(float(silhouettes_explained(others, scene.bounds).mean()))
    best = int(np.argmax(scores))
    return best if scores[best] >= _EXPLAINED else None
