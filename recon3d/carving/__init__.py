"""Carving algorithms by name; each takes a scene, a volume and a photo-consistency test and returns a photo hull."""

from collections.abc import Callable

from recon3d.carving.photo_hull import Label, PhotoHull
from recon3d.carving.visibility import SweepDirection, largest_admissible_views, sweep_direction
from recon3d.carving.voxel_coloring import voxel_coloring

METHODS: dict[str, Callable[..., PhotoHull]] = {"voxel-coloring": voxel_coloring}

__all__ = [
    "METHODS",
    "Label",
    "PhotoHull",
    "SweepDirection",
    "largest_admissible_views",
    "sweep_direction",
    "voxel_coloring",
]
