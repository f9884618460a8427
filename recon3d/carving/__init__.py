"""Carving algorithms: each takes a scene and a volume and leaves the voxels that belong to the object."""

from recon3d.carving.fine_generalized import FineGeneralizedVoxelColoring
from recon3d.carving.fine_visual_hull import FineVisualHull
from recon3d.carving.generalized import GeneralizedVoxelColoring
from recon3d.carving.method import JudgingMethod, Method
from recon3d.carving.probabilistic import ProbabilisticSpaceCarving
from recon3d.carving.roxels import Roxels
from recon3d.carving.space_carving import SpaceCarving
from recon3d.carving.start import any_silhouette
from recon3d.carving.visibility import SweepDirection, largest_admissible_views, spread_views, sweep_direction
from recon3d.carving.visual_hull import VisualHull
from recon3d.carving.vote_carving import VoteCarving
from recon3d.carving.voxel_coloring import VoxelColoring
from recon3d.errors import SceneError
from recon3d.scene.neighbours import matching_neighbours
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.carved import Carved
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice

METHODS: dict[str, type[Method]] = {
    "visual-hull": VisualHull,
    "fine-visual-hull": FineVisualHull,
    "generalized-voxel-coloring": GeneralizedVoxelColoring,
    "fine-generalized-voxel-coloring": FineGeneralizedVoxelColoring,
    "vote-carving": VoteCarving,
    "voxel-coloring": VoxelColoring,
    "space-carving": SpaceCarving,
    "probabilistic-space-carving": ProbabilisticSpaceCarving,
    "roxels": Roxels,
}

N_VOXELS = 1_000_000
"""Approximate number of voxels where nothing is said of it."""


def suitable_method(scene: Scene) -> Method:
    """Vote carving where silhouettes are known or views can be matched, else generalised voxel colouring."""
    if any_silhouette(scene):
        return VoteCarving()
    try:
        matching_neighbours(scene)
    except SceneError:
        return GeneralizedVoxelColoring()
    return VoteCarving()


def carve(
    scene: Scene,
    volume: CarvingVolume | Lattice | None = None,
    method: Method | None = None,
    *,
    progress: Progress | None = None,
) -> Carved:
    """Carve with any method.

    Parameters
    ----------
    volume : where to look: the occupied voxels of a volume, or a whole lattice; a million voxels in the scene's bounds
        when None.
    method : one of ``METHODS`` with its options; the one that suits the scene when None.
    progress : called with the number of steps done and of all.

    Raises
    ------
    SceneError : the method needs silhouettes, and no view has one.
    VisibilityError : the views do not satisfy what the method needs.
    VolumeTooLargeError : the volume does not fit into memory.
    EmptyReconstructionError : nothing was left.
    """
    volume = Lattice.enclosing(scene.bounds, n_voxels=N_VOXELS) if volume is None else volume
    return (method or suitable_method(scene)).carve(scene, volume, progress=progress)


__all__ = [
    "METHODS",
    "FineGeneralizedVoxelColoring",
    "FineVisualHull",
    "GeneralizedVoxelColoring",
    "JudgingMethod",
    "Method",
    "ProbabilisticSpaceCarving",
    "Roxels",
    "SpaceCarving",
    "SweepDirection",
    "VisualHull",
    "VoteCarving",
    "VoxelColoring",
    "carve",
    "largest_admissible_views",
    "matching_neighbours",
    "spread_views",
    "suitable_method",
    "sweep_direction",
]
