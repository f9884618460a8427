"""What is wrong with a scene, in words."""

from recon3d.diagnosis.diagnosing import Diagnosis, check_scene, diagnose, diagnose_cameras
from recon3d.diagnosis.finding import Finding

__all__ = ["Diagnosis", "Finding", "check_scene", "diagnose", "diagnose_cameras"]
