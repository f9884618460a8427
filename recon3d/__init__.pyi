from ._version import __version__ as __version__
from .carving import (
    METHODS,
    Label,
    PhotoHull,
    largest_admissible_views,
    probabilistic_space_carving,
    roxels,
    space_carving,
    voxel_coloring,
)
from .consistency import (
    TESTS,
    ConsistencyTest,
    FuzzyAdaptiveHysteresis,
    Patches,
    StandardDeviation,
    Verdict,
)
from .datasets import SCENES, BuiltInScene, little_temple
from .errors import (
    DataError,
    EmptyReconstructionError,
    Recon3dError,
    SceneError,
    VisibilityError,
    VolumeTooLargeError,
)
from .evaluation import Evaluation, evaluate, triangles_near
from .figures import plot_evaluation, save_evaluation, show_mesh
from .io import (
    open_scene,
    read_geometry,
    read_mesh,
    read_middlebury,
    write_geometry,
    write_middlebury,
)
from .pipeline import Reconstruction, Settings, evaluate_files, reconstruct, save_pictures
from .rendering import Renderer, Rendering, comparison_sheet, turntable
from .scene import Scene, View, make_bounds
from .silhouettes import (
    with_mask_files,
    with_segmented_silhouettes,
    with_threshold_silhouettes,
    without_silhouettes,
)
from .surface import mesh_volume, surface_points
from .volume import CarvingVolume

__all__ = [
    "METHODS",
    "SCENES",
    "TESTS",
    "BuiltInScene",
    "CarvingVolume",
    "ConsistencyTest",
    "DataError",
    "EmptyReconstructionError",
    "Evaluation",
    "FuzzyAdaptiveHysteresis",
    "Label",
    "Patches",
    "PhotoHull",
    "Recon3dError",
    "Reconstruction",
    "Renderer",
    "Rendering",
    "Scene",
    "SceneError",
    "Settings",
    "StandardDeviation",
    "Verdict",
    "View",
    "VisibilityError",
    "VolumeTooLargeError",
    "comparison_sheet",
    "evaluate",
    "evaluate_files",
    "largest_admissible_views",
    "little_temple",
    "make_bounds",
    "mesh_volume",
    "open_scene",
    "plot_evaluation",
    "probabilistic_space_carving",
    "read_geometry",
    "read_mesh",
    "read_middlebury",
    "reconstruct",
    "roxels",
    "save_evaluation",
    "save_pictures",
    "show_mesh",
    "space_carving",
    "surface_points",
    "triangles_near",
    "turntable",
    "voxel_coloring",
    "with_mask_files",
    "with_segmented_silhouettes",
    "with_threshold_silhouettes",
    "without_silhouettes",
    "write_geometry",
    "write_middlebury",
]
