"""Views agree when they have a similar colour in store, all of them or each with its neighbour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from recon3d.checks import require_number
from recon3d.consistency.base import Patches, Verdict, verdict_of
from recon3d.errors import ArgumentError
from recon3d.kernels.view_colors import cached_distances


@dataclass(frozen=True)
class ColorCaching:
    """First a test for matt surface, then one for shiny surface that compares angular neighbours only.

    The pixels of a view are its cache. Two caches are as far apart as their two most similar colours (Euclidean, RGB).
    Consistent when d_all, the largest distance of any two views, is at most T1; else when d_near, the largest distance
    of two views that are neighbours in viewing angle, is at most T2, since a highlight changes little between near
    views. d_near <= d_all, so T2 should be below T1.

    Neighbours are the edges of the minimum spanning tree of the angles between the views: for cameras along an arc
    their order, for others the generalisation that needs no axis. So the order in which views are given does not
    matter (unless two angles are equal and the tree is not unique). Distances take a time that grows with the square of
    the pixels of a view.

    The degree is the better of the two tests', each limit / (limit + value) as in ``verdict_of``.

    References
    ----------
    V. Chhabra, "Reconstructing specular objects with image based rendering using color caching", Master's thesis,
    Worcester Polytechnic Institute, 2001. Rebuilt from the summary in Barhoumi et al., 2013, section 2.
    """

    threshold: float = 30.0
    """T1, distance in RGB (0 to 441) that any two views may have. Chosen by ``scripts/tune_tests.py``, as is T2."""
    neighbour_threshold: float = 20.0
    """T2, distance that angular neighbours may have."""

    needs_directions: ClassVar[bool] = True

    def __post_init__(self) -> None:
        require_number("threshold", self.threshold, "[0, inf)")
        require_number("neighbour_threshold", self.neighbour_threshold, "[0, inf)")

    def __call__(self, patches: Patches) -> Verdict:
        """The better of the two tests of every voxel.

        Raises
        ------
        ArgumentError : the patches come without directions.
        """
        directions = patches.directions
        if directions is None:
            if patches.n_voxels:
                raise ArgumentError("colour caching orders the views by angle: expected patches with directions")
            directions = np.empty((0, patches.view_starts.shape[1] - 1, 3), np.float32)
        of_all, of_neighbours = np.empty(patches.n_voxels), np.empty(patches.n_voxels)
        cached_distances(patches.colors, patches.view_starts, directions, of_all, of_neighbours)
        matt, shiny = verdict_of(of_all, self.threshold), verdict_of(of_neighbours, self.neighbour_threshold)
        return Verdict(np.maximum(matt.degree, shiny.degree), matt.low, matt.high)
