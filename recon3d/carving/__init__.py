"""Carving algorithms by name; each takes a scene, a volume and a photo-consistency test and returns a photo hull."""

from collections.abc import Callable
from typing import NamedTuple

from recon3d.carving.coarse_to_fine import fine_generalized_voxel_coloring, fine_visual_hull
from recon3d.carving.generalized import generalized_voxel_coloring
from recon3d.carving.probabilistic import probabilistic_space_carving
from recon3d.carving.roxels import roxels
from recon3d.carving.space_carving import space_carving
from recon3d.carving.visibility import SweepDirection, largest_admissible_views, spread_views, sweep_direction
from recon3d.carving.visual_hull import visual_hull
from recon3d.carving.vote_carving import vote_carving
from recon3d.carving.voxel_coloring import voxel_coloring
from recon3d.scene.neighbours import matching_neighbours
from recon3d.volume.carved import CarvedVolume, Label


class Method(NamedTuple):
    """A carving algorithm: ``carve(scene, volume, test=None, *, progress=None, **options)``."""

    carve: Callable[..., CarvedVolume]
    one_sided: bool = False
    """Whether the views must satisfy the ordinal visibility constraint."""
    uses_test: bool = True
    """Whether a photo-consistency test decides; such a method takes an ``observer``, too."""


METHODS: dict[str, Method] = {
    "visual-hull": Method(visual_hull, uses_test=False),
    "generalized-voxel-coloring": Method(generalized_voxel_coloring),
    "vote-carving": Method(vote_carving, uses_test=False),
    "voxel-coloring": Method(voxel_coloring, one_sided=True),
    "space-carving": Method(space_carving),
    "probabilistic-space-carving": Method(probabilistic_space_carving, uses_test=False),
    "roxels": Method(roxels, uses_test=False),
}

__all__ = [
    "METHODS",
    "CarvedVolume",
    "Label",
    "Method",
    "SweepDirection",
    "fine_generalized_voxel_coloring",
    "fine_visual_hull",
    "generalized_voxel_coloring",
    "largest_admissible_views",
    "matching_neighbours",
    "probabilistic_space_carving",
    "roxels",
    "space_carving",
    "spread_views",
    "sweep_direction",
    "visual_hull",
    "vote_carving",
    "voxel_coloring",
]
