"""Views agree up to the highlight that each may see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon3d.checks import require_number
from recon3d.consistency.base import Patches, Verdict, verdict_of
from recon3d.consistency.moments import Moments
from recon3d.errors import ArgumentError

_GREY_LEVELS = 255.0


@dataclass(frozen=True)
class Specular:
    """The views' mean colours lie on a line in RGB that ends in the light's colour.

    A shiny point shows its diffuse colour in most views, and in others a mixture with the colour of the light.
    Consistent when no mean is farther than T (Euclidean, RGB) from the line through the light's colour and the mean of
    the views' means. What a highlight could explain is accepted: with a white light, any two greys agree, so the
    test leaves more than others and needs coloured objects.

    The degree is T / (T + distance), as in ``verdict_of``.

    References
    ----------
    R. Yang, M. Pollefeys, G. Welch, "Dealing with textureless regions and specular highlights: a progressive space
    carving scheme using a novel photo-consistency measure", ICCV 2003. Rebuilt from the summary in Barhoumi et al.,
    2013, section 2; the line through the mean is ours.
    """

    threshold: float = 30.0
    """T, distance in RGB, 0 to 441. Chosen by ``scripts/tune_tests.py``."""
    light: tuple[float, float, float] = (_GREY_LEVELS, _GREY_LEVELS, _GREY_LEVELS)
    """Colour of the light in the images, 0 to 255."""

    def __post_init__(self) -> None:
        require_number("threshold", self.threshold, "[0, inf)")
        if not isinstance(self.light, tuple) or len(self.light) != 3:
            raise ArgumentError(f"expected a light of three channels, got {self.light!r}")
        for channel in self.light:
            require_number("each channel of light", channel, f"[0, {_GREY_LEVELS}]")

    def __call__(self, patches: Patches) -> Verdict:
        """Largest distance of a view's mean colour from the line of every voxel."""
        moments = Moments.of(patches)
        seen = moments.seen[..., None]
        from_light = np.where(seen, moments.means - np.array(self.light), 0)
        along = from_light.sum(axis=1)
        length = np.linalg.norm(along, axis=1, keepdims=True)
        # Where all means are the light's colour there is no line, and no distance from it.
        along = np.divide(along, length, out=np.zeros_like(along), where=length > 0)[:, None]
        off = from_light - (from_light * along).sum(axis=-1, keepdims=True) * along
        return verdict_of(np.sqrt((off**2).sum(axis=-1)).max(axis=1, initial=0), self.threshold)
