"""Views agree when their windows around the voxel look alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon3d.checks import require_number, require_whole
from recon3d.consistency.base import Patches, Verdict
from recon3d.errors import ArgumentError


@dataclass(frozen=True)
class Correlation:
    """Mean normalised cross-correlation of the views' windows, pair by pair, against one threshold.

    The windows are samples of the views' luminance on a small plane through the voxel's centre that faces the views.
    Consistent when the mean of NCC_jk over all pairs of views >= T; a change of brightness or contrast between views
    does not matter. A window with a deviation below ``min_deviation`` is flat: two flat windows agree (1), a flat
    one and another do not (0), so that a uniform surface is kept whatever its colours. One view always agrees.

    The degree is (1 + NCC) / 2, clipped at 0. Windows see past the voxel, so pixels of hidden surface take part, and
    the plane fits surface that faces the cameras best.

    References
    ----------
    G. Vogiatzis, C. Hernandez, P. H. S. Torr, R. Cipolla, "Multiview stereo via volumetric graph-cuts and occlusion
    robust photo-consistency", PAMI 29(12), 2007, among the users of the measure. Rebuilt from the summary in Barhoumi
    et al., 2013, section 2; the plane and the rule for flat windows are ours.
    """

    threshold: float = 0.3
    """T, in [-1, 1]. Chosen by ``scripts/tune_tests.py``; low, since the mean is over all pairs of views, however far
    apart."""
    window_side: int = 5
    """Samples on a side of the window, 3 or more."""
    min_deviation: float = 2.0
    """Grey levels; a window with less contrast is flat."""

    def __post_init__(self) -> None:
        require_number("threshold", self.threshold, "[-1, 1]")
        require_whole("window_side", self.window_side, least=3)
        require_number("min_deviation", self.min_deviation, "(0, inf)")

    def __call__(self, patches: Patches) -> Verdict:
        """Mean correlation of every voxel against T.

        Raises
        ------
        ArgumentError : the patches come without windows.
        """
        limit = np.full(patches.n_voxels, (1 + self.threshold) / 2)
        if not patches.n_voxels:
            return Verdict(np.empty(0), limit, limit)
        if patches.windows is None:
            raise ArgumentError("correlation compares windows of the views: expected patches with windows")
        windows = patches.windows.astype(np.float64)
        seen = ~np.isnan(windows[..., 0])
        windows = np.where(seen[..., None], windows, 0)
        windows -= windows.mean(axis=-1, keepdims=True)
        norm = np.sqrt((windows**2).sum(axis=-1))
        textured = norm >= self.min_deviation * np.sqrt(windows.shape[-1])
        windows *= np.divide(1, norm, out=np.zeros_like(norm), where=textured)[..., None]
        n_textured = np.count_nonzero(textured, axis=1)
        n_flat = np.count_nonzero(seen & ~textured, axis=1)
        # All pairs at once: |sum_j z_j|^2 holds each pair of unit vectors twice, and each with itself.
        both_ways = (windows.sum(axis=1) ** 2).sum(axis=-1) - n_textured + n_flat * (n_flat - 1)
        n_pairs = (n_textured + n_flat) * (n_textured + n_flat - 1)
        ncc = np.divide(both_ways, n_pairs, out=np.ones_like(both_ways), where=n_pairs > 0)
        return Verdict(np.clip((1 + ncc) / 2, 0, 1), limit, limit)
