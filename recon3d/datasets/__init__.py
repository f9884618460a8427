"""Scenes to try things on: made ones, and public photographs to download."""

from recon3d.datasets.catalogue import DATASETS, Dataset
from recon3d.datasets.downloads import Download, download, obtain
from recon3d.datasets.synthetic import SCENES, BuiltInScene, little_temple

__all__ = ["DATASETS", "SCENES", "BuiltInScene", "Dataset", "Download", "download", "little_temple", "obtain"]
