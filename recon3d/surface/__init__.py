"""Meshes: made of voxels and points, repaired, and coloured."""

from recon3d.surface.decimation import Decimation, decimate
from recon3d.surface.extraction import mesh_sparse, mesh_volume, surface_points
from recon3d.surface.meshing import Meshed, Meshing, mesh
from recon3d.surface.minimum_cut import graph_cut
from recon3d.surface.poisson import MeasuredSpace, Surface, mesh_points
from recon3d.surface.repair import Repaired, Repairs, repair_mesh
from recon3d.surface.texture import TexturedMesh, texture_mesh
from recon3d.surface.vertex_colors import color
from recon3d.surface.visibility import VertexVisibility, keep_vertices

__all__ = [
    "Decimation",
    "MeasuredSpace",
    "Meshed",
    "Meshing",
    "Repaired",
    "Repairs",
    "Surface",
    "TexturedMesh",
    "VertexVisibility",
    "color",
    "decimate",
    "graph_cut",
    "keep_vertices",
    "mesh",
    "mesh_points",
    "mesh_sparse",
    "mesh_volume",
    "repair_mesh",
    "surface_points",
    "texture_mesh",
]
