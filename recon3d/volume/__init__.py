"""Voxels: the lattice they lie on, dense and sparse, and what carving leaves of them."""

from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.sparse import SparseVolume

__all__ = [
    "CarvedVolume",
    "CarvingVolume",
    "Label",
    "SparseVolume",
]
