from . import calibration as calibration
from . import carving as carving
from . import consistency as consistency
from . import datasets as datasets
from . import diagnosis as diagnosis
from . import errors as errors
from . import evaluation as evaluation
from . import io as io
from . import rendering as rendering
from . import reporting as reporting
from . import scene as scene
from . import stereo as stereo
from . import study as study
from . import surface as surface
from . import volume as volume
from ._version import __version__ as __version__
from .calibration import calibrate, turntable_cameras
from .carving import METHODS, VisualHull, VoteCarving, VoxelColoring, carve
from .consistency import TESTS, ConsistencyTest, FuzzyAdaptiveHysteresis, Patches, Verdict, load_test
from .datasets import SCENES, little_temple
from .errors import ArgumentError, DataError, Recon3dError, SceneError
from .evaluation import Evaluation, Quality, evaluate
from .explaining import Explanation, explain
from .io import open_scene, read_mesh, write_geometry
from .pipeline import reconstruct
from .rendering import render
from .reporting import save, show_mesh
from .result import Reconstruction
from .scene import Bounds, Camera, Photograph, Scene, View
from .settings import Settings
from .stereo import Matching, refine
from .study import Comparison, compare
from .surface import Meshing, TexturedMesh, color, mesh, texture_mesh
from .volume import CarvedVolume, CarvingVolume, Label, SparseVolume

__all__ = [
    "METHODS",
    "SCENES",
    "TESTS",
    "ArgumentError",
    "Bounds",
    "Camera",
    "CarvedVolume",
    "CarvingVolume",
    "Comparison",
    "ConsistencyTest",
    "DataError",
    "Evaluation",
    "Explanation",
    "FuzzyAdaptiveHysteresis",
    "Label",
    "Matching",
    "Meshing",
    "Patches",
    "Photograph",
    "Quality",
    "Recon3dError",
    "Reconstruction",
    "Scene",
    "SceneError",
    "Settings",
    "SparseVolume",
    "TexturedMesh",
    "Verdict",
    "View",
    "VisualHull",
    "VoteCarving",
    "VoxelColoring",
    "calibrate",
    "carve",
    "color",
    "compare",
    "evaluate",
    "explain",
    "little_temple",
    "load_test",
    "mesh",
    "open_scene",
    "read_mesh",
    "reconstruct",
    "refine",
    "render",
    "save",
    "show_mesh",
    "texture_mesh",
    "turntable_cameras",
    "write_geometry",
]
