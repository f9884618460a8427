"""Scenes to try things on."""

from recon3d.datasets.synthetic import SCENES, BuiltInScene, little_temple

__all__ = ["SCENES", "BuiltInScene", "little_temple"]
