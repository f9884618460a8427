"""Probabilistic space carving: every voxel exists with a probability, and nothing is carved before the end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.method import Method
from recon3d.carving.observations import observed_colors, without_background
from recon3d.carving.observer import Observer
from recon3d.carving.start import clear_around_cameras
from recon3d.checks import require_number, require_whole
from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.existence import ColorModel, blend, exist
from recon3d.scene.packed import PackedViews
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice

_BINS = 8  # a channel, of the histogram of independent colours


_UNIFORM = 0.1  # share of independent colours that may be anything


_HIDDEN = 0.3  # a voxel that no view sees with more than this probability is hidden


@dataclass(frozen=True)
class ProbabilisticSpaceCarving(Method):
    """Voxels that more probably exist than not, given what the views that may see them show.

    Where voxel v exists, each view j that sees it shows its one unknown colour with normal noise; any other view,
    and every view where v does not exist, shows a colour drawn from all the scene's foreground::

        L1(v) = sum over sets S of views  prod_{j in S} w_j  prod_{j not in S} (1 - w_j) g(c_j)
                                          integral g(c) prod_{j in S} N(c_j; c, sigma0^2) dc
        L0(v) = prod_j g(c_j)
        p(v)  = prior L1 / (prior L1 + (1 - prior) L0)
        w_j   = (1 - outliers) prod over voxels u before v on j's ray (1 - p(u))

    c_j is the mean colour of v's footprint in view j, g the histogram of foreground colours. All p begin at the
    prior; a round computes every w_j and then every p(v) from the p of the round before. A view that alone sees
    v leaves p(v) at the prior. Only at the end do voxels go, so that one that noise has made doubtful does not
    uncover, and so carve, those behind it.

    Views may be anywhere. Background of their silhouettes never votes, and a voxel whose footprint in some image is
    background alone is carved.

    Notes
    -----
    The sum over sets is taken by which view is the first in S; after it each view's factor uses the mean of the
    colours so far (assumed density filtering), exact where every w_j is 0 or 1.

    Needs 4 bytes a voxel of the volume, 28 a voxel that the silhouettes leave, and for each of these 8 more a view.

    References
    ----------
    Broadhurst, Drummond, Cipolla, "A probabilistic framework for space carving", ICCV 2001. Rebuilt from a summary
    (two likelihoods a voxel, visibility as a product along rays); the noise model, the histogram, the outliers and
    the rounds over all voxels at once, for cameras anywhere, are ours.
    """

    sigma0: float = 8.0
    """Standard deviation, in grey levels, of one surface's colour from view to view."""
    prior: float = 0.3
    """Probability, in (0, 1), that a voxel exists, before any image is seen."""
    threshold: float = 0.4
    """Voxels with this probability or more are accepted; in (0, 1)."""
    rounds: int = 12
    """How often all probabilities are computed; what lies behind many wrong voxels needs more."""
    outliers: float = 0.01
    """Share of the views, in [0, 1), that show another colour although they see the voxel (highlights, moved
    silhouettes)."""

    def __post_init__(self) -> None:
        require_number("sigma0", self.sigma0, "(0, inf)")
        require_number("prior", self.prior, "(0, 1)")
        require_number("threshold", self.threshold, "(0, 1)")
        require_whole("rounds", self.rounds)
        require_number("outliers", self.outliers, "[0, 1)")

    def carve(
        self,
        scene: Scene,
        volume: CarvingVolume | Lattice,
        *,
        progress: Progress | None = None,
        observer: Observer | None = None,  # noqa: ARG002 # no verdicts are made
    ) -> CarvedVolume:
        """Compute all probabilities round by round.

        Returns
        -------
        CarvedVolume
            Its degree is the probability p; a voxel that no view sees with a probability above 0.3 is hidden.

        Raises
        ------
        EmptyReconstructionError : no visible voxel is probable enough.
        """
        volume = CarvingVolume.full(volume)
        views = scene.packed

        hull, occupied = without_background(views, volume)
        clear_around_cameras(occupied, scene, volume)
        observed = observed_colors(views, occupied, volume)
        voxels = observed.voxels

        centers = (scene.centers - volume.origin) / volume.voxel_size
        model = ColorModel(_color_density(views), self.sigma0, self.outliers, self.prior)
        probability = np.zeros(volume.shape, np.float32)
        probability[tuple(voxels.T)] = self.prior
        posterior = np.empty(len(voxels), np.float32)
        weights = np.zeros(observed.seen.shape, np.float32)
        for n in range(self.rounds):
            exist(observed, centers, probability, model, posterior, weights)
            probability[tuple(voxels.T)] = posterior
            if progress:
                progress(n + 1, self.rounds)

        visible = weights.max(axis=1, initial=0) > _HIDDEN
        accepted = visible & (posterior >= self.threshold)
        hull.set_labels(voxels[~visible], Label.HIDDEN)
        hull.set_labels(voxels[visible & ~accepted], Label.INCONSISTENT)
        hull.set_labels(voxels[accepted], Label.CONSISTENT)
        hull.record(voxels[visible], posterior[visible].astype(np.float64), (weights[visible] > _HIDDEN).sum(axis=1))
        means = np.empty((len(voxels), 3), np.uint8)
        blend(observed.colors, weights, means)
        hull.accept(voxels[accepted], means[accepted])
        if not hull.volume.n_occupied:
            raise EmptyReconstructionError(f"scene {scene.name}: all voxels were carved ({hull.count_text()})")
        return hull


def _color_density(views: PackedViews) -> NDArray[np.float64]:
    """(8, 8, 8) density of foreground colours, all views together, per cubed grey level."""
    edges = np.linspace(0, 256, _BINS + 1)
    histogram, _ = np.histogramdd(views.images[views.foreground], bins=(edges, edges, edges))
    uniform = np.full(histogram.shape, 1 / histogram.size)
    share = histogram / histogram.sum() if histogram.any() else uniform
    return ((1 - _UNIFORM) * share + _UNIFORM * uniform) / (256 / _BINS) ** 3
