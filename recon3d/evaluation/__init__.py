"""How good a reconstruction is: by a ground truth, by its photographs, and by its shape."""

from recon3d.evaluation.distances import Evaluation, evaluate, triangles_near
from recon3d.evaluation.files import evaluate_files, read_ground_truth
from recon3d.evaluation.next_views import Coverage, NextView, propose_views
from recon3d.evaluation.photographs import Quality, Reprojection, measure_quality
from recon3d.evaluation.shape import ShapeQuality

__all__ = [
    "Coverage",
    "Evaluation",
    "NextView",
    "Quality",
    "Reprojection",
    "ShapeQuality",
    "evaluate",
    "evaluate_files",
    "measure_quality",
    "propose_views",
    "read_ground_truth",
    "triangles_near",
]
