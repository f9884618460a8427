from ._version import __version__ as __version__
from .carving import (
    METHODS,
    Label,
    PhotoHull,
    fine_generalized_voxel_coloring,
    fine_visual_hull,
    generalized_voxel_coloring,
    largest_admissible_views,
    probabilistic_space_carving,
    roxels,
    space_carving,
    visual_hull,
    vote_carving,
    voxel_coloring,
)
from .coloring import color_from_views
from .comparison import Comparison, compare
from .consistency import (
    TESTS,
    ConsistencyTest,
    FuzzyAdaptiveHysteresis,
    Hysteresis,
    Patches,
    StandardDeviation,
    Verdict,
    load_test,
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
from .evaluation import Evaluation, error_map, evaluate, triangles_near
from .explanation import Explanation, explain
from .figures import plot_evaluation, save_evaluation, show_mesh
from .io import (
    open_scene,
    read_geometry,
    read_mesh,
    read_middlebury,
    read_support,
    write_geometry,
    write_middlebury,
)
from .mending import Mending, drop_specks, mend_mesh
from .pipeline import (
    Reconstruction,
    evaluate_files,
    reconstruct,
    save_error_maps,
    save_pictures,
)
from .quality import Quality, Reprojection, ShapeQuality, measure_quality
from .rendering import (
    Renderer,
    Rendering,
    comparison_sheet,
    count_seeing_views,
    seeing_views,
    turntable,
    without_unseen,
)
from .scene import Scene, View, make_bounds
from .settings import Settings
from .silhouettes import (
    with_mask_files,
    with_segmented_silhouettes,
    with_threshold_silhouettes,
    without_silhouettes,
)
from .sparse import SparseVolume
from .stereo.graph_cut import graph_cut
from .surface import mesh_sparse, mesh_volume, surface_points
from .trials import Trial
from .volume import CarvingVolume

__all__ = [
    "METHODS",
    "SCENES",
    "TESTS",
    "BuiltInScene",
    "CarvingVolume",
    "Comparison",
    "ConsistencyTest",
    "DataError",
    "EmptyReconstructionError",
    "Evaluation",
    "Explanation",
    "FuzzyAdaptiveHysteresis",
    "Hysteresis",
    "Label",
    "Mending",
    "Patches",
    "PhotoHull",
    "Quality",
    "Recon3dError",
    "Reconstruction",
    "Renderer",
    "Rendering",
    "Reprojection",
    "Scene",
    "SceneError",
    "Settings",
    "ShapeQuality",
    "SparseVolume",
    "StandardDeviation",
    "Trial",
    "Verdict",
    "View",
    "VisibilityError",
    "VolumeTooLargeError",
    "color_from_views",
    "compare",
    "comparison_sheet",
    "count_seeing_views",
    "drop_specks",
    "error_map",
    "evaluate",
    "evaluate_files",
    "explain",
    "fine_generalized_voxel_coloring",
    "fine_visual_hull",
    "generalized_voxel_coloring",
    "graph_cut",
    "largest_admissible_views",
    "little_temple",
    "load_test",
    "make_bounds",
    "measure_quality",
    "mend_mesh",
    "mesh_sparse",
    "mesh_volume",
    "open_scene",
    "plot_evaluation",
    "probabilistic_space_carving",
    "read_geometry",
    "read_mesh",
    "read_middlebury",
    "read_support",
    "reconstruct",
    "roxels",
    "save_error_maps",
    "save_evaluation",
    "save_pictures",
    "seeing_views",
    "show_mesh",
    "space_carving",
    "surface_points",
    "triangles_near",
    "turntable",
    "visual_hull",
    "vote_carving",
    "voxel_coloring",
    "with_mask_files",
    "with_segmented_silhouettes",
    "with_threshold_silhouettes",
    "without_silhouettes",
    "without_unseen",
    "write_geometry",
    "write_middlebury",
]
