"""Voxels: the lattice they lie on, dense and sparse, and what carving leaves of them."""

from recon3d.volume.carved import Carved, CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice
from recon3d.volume.sparse import SparseVolume

__all__ = [
    "Carved",
    "CarvedVolume",
    "CarvingVolume",
    "Label",
    "Lattice",
    "SparseVolume",
]
