"""Dense matching inside the carved hull, and the surfaces made of it."""

from recon3d.stereo.depth_maps import DepthMap, Matching
from recon3d.stereo.fusion import Fusion, fuse
from recon3d.stereo.graph_cut import graph_cut
from recon3d.stereo.meshing import Surface, mesh_points, near_points
from recon3d.stereo.sharpen import PASSES, Stages, sharpen, sharpen_hull

__all__ = [
    "PASSES",
    "DepthMap",
    "Fusion",
    "Matching",
    "Stages",
    "Surface",
    "fuse",
    "graph_cut",
    "mesh_points",
    "near_points",
    "sharpen",
    "sharpen_hull",
]
