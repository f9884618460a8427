"""Roxels: voxels with colour and opacity, each responsible for a share of the pixels that may show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon3d.carving.method import Method
from recon3d.carving.observations import observed_colors, without_background
from recon3d.carving.observer import Observer
from recon3d.carving.start import clear_around_cameras
from recon3d.checks import require_number, require_whole
from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.responsibility import Matter, PixelModel, respond
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice

_HIDDEN = 0.1  # a voxel that less of the light reaches in every view is hidden


@dataclass(frozen=True)
class Roxels(Method):
    """Colour and opacity of every voxel, so that opaque, half-transparent and empty places together explain the views.

    A ray meets voxels 1, 2, ... with opacities a and colours c, and shows colour I of the pixel::

        T_i = prod_{k < i} (1 - a_k)                                  light that reaches voxel i
        r_i = T_i a_i N(I; c_i, sigma0^2) / (the same, summed over the ray, + T_end U)

    r_i is voxel i's responsibility for the pixel, U the uniform density of colours that no voxel explains.
    Each round takes all responsibilities from the opacities and colours of the round before, and then::

        c_i = sum_views r_i I / sum_views r_i
        a_i = sum_views r_i / sum_views (r_i + responsibilities of all behind i on the ray)

    which is how often a ray ends in i among those that reach it: the steps of expectation maximisation for rays that
    end in one voxel each. So what only some views agree on, or what lets some of the background through, ends between
    0 and 1.

    Views may be anywhere. Background of their silhouettes never votes, and a voxel whose footprint in some image is
    background alone is carved.

    Notes
    -----
    A pixel is the mean colour of the voxel's footprint, on the ray through the voxel's centre. Where one surface is
    seen through another, the model explains the mixed colour by either, not by their sum.

    Needs 16 bytes a voxel of the volume, 40 a voxel that the silhouettes leave, and for each of these 8 more a view.

    The accepted voxels are a thick shell, since a surface shares its opacity with what lies just behind; for a mesh
    take ``with_interior``.

    References
    ----------
    De Bonet, Viola, "Roxels: responsibility weighted 3D volume reconstruction", ICCV 1999. Rebuilt from a summary
    (responsibilities from opacity and agreement, colours and opacities from responsibilities); the opacity's
    formula, the uniform density and the start are ours.
    """

    sigma0: float = 12.0
    """Standard deviation, in grey levels, of a pixel about the colour of its voxel."""
    initial: float = 0.1
    """Opacity, in (0, 1), of every voxel before the first round. Each begins with its views' mean colour."""
    threshold: float = 0.5
    """Voxels with this opacity or more are accepted; in (0, 1]."""
    rounds: int = 12
    """How often responsibilities, colours and opacities are computed."""

    def __post_init__(self) -> None:
        require_number("sigma0", self.sigma0, "(0, inf)")
        require_number("initial", self.initial, "(0, 1)")
        require_number("threshold", self.threshold, "(0, 1]")
        require_whole("rounds", self.rounds)

    def carve(
        self,
        scene: Scene,
        volume: CarvingVolume | Lattice,
        *,
        progress: Progress | None = None,
        observer: Observer | None = None,  # noqa: ARG002 # no verdicts are made
    ) -> CarvedVolume:
        """Compute all responsibilities, colours and opacities round by round.

        Returns
        -------
        CarvedVolume
            Its degree is the opacity. Voxels below the threshold are inconsistent, or hidden where less than a tenth of
            the light reaches them in every view.

        Raises
        ------
        EmptyReconstructionError : no voxel is opaque enough.
        """
        volume = CarvingVolume.full(volume)
        views = scene.packed

        hull, occupied = without_background(views, volume)
        clear_around_cameras(occupied, scene, volume)
        observed = observed_colors(views, occupied, volume)
        voxels, shown, seen = observed
        at = tuple(voxels.T)

        centers = (scene.centers - volume.origin) / volume.voxel_size
        matter = Matter(np.zeros(volume.shape, np.float32), np.zeros((*volume.shape, 3), np.float32))
        matter.opacity[at] = self.initial
        matter.colors[at] = shown.sum(axis=1, dtype=np.float32) / seen.sum(axis=1, dtype=np.float32)[:, None]
        new = Matter(matter.opacity[at], matter.colors[at])
        visible = np.zeros(seen.shape, np.float32)
        # The normal density's height is left out of the agreement, so the uniform one is taken relative to it.
        model = PixelModel(self.sigma0, min((2 * np.pi * self.sigma0**2) ** 1.5 / 256**3, 1.0))
        for n in range(self.rounds):
            respond(observed, centers, matter, model, new, visible)
            matter.opacity[at], matter.colors[at] = new
            if progress:
                progress(n + 1, self.rounds)

        accepted = new.opacity >= self.threshold
        hidden = ~accepted & (visible.max(axis=1, initial=0) < _HIDDEN)
        hull.set_labels(voxels[~accepted], Label.INCONSISTENT)
        hull.set_labels(voxels[hidden], Label.HIDDEN)
        hull.set_labels(voxels[accepted], Label.CONSISTENT)
        hull.record(voxels[~hidden], np.clip(new.opacity[~hidden], 0, 1), (visible[~hidden] >= _HIDDEN).sum(axis=1))
        hull.accept(voxels[accepted], np.rint(new.colors[accepted]).astype(np.uint8))
        if not hull.volume.n_occupied:
            raise EmptyReconstructionError(f"scene {scene.name}: all voxels were carved ({hull.count_text()})")
        return hull
