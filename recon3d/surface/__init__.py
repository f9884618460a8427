"""Meshes: made of voxels and points, repaired, and coloured."""

from recon3d.surface.extraction import mesh_sparse, mesh_volume, surface_points
from recon3d.surface.graph_cut import graph_cut
from recon3d.surface.poisson import Surface, mesh_points, near_points
from recon3d.surface.repair import Repairs, drop_small_components, repair_mesh
from recon3d.surface.vertex_colors import color_from_views
from recon3d.surface.visibility import count_seeing_views, vertex_visibility, without_unseen

__all__ = [
    "Repairs",
    "Surface",
    "color_from_views",
    "count_seeing_views",
    "drop_small_components",
    "graph_cut",
    "mesh_points",
    "mesh_sparse",
    "mesh_volume",
    "near_points",
    "repair_mesh",
    "surface_points",
    "vertex_visibility",
    "without_unseen",
]
