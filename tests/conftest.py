from __future__ import annotations

import os
from pathlib import Path

import pytest
from sfm_world import blocks, taken, world

from recon3d.datasets.synthetic import BuiltInScene, little_temple, photograph
from recon3d.scene.scene import Scene


@pytest.fixture(scope="session")
def temple() -> BuiltInScene:
    """The built-in temple, small: eight photographs of 160x120 pixels."""
    return little_temple(n_views=8, width=160, height=120)


@pytest.fixture(scope="session")
def sfm_scene() -> Scene:
    """A textured box on a plate, from twelve cameras that structure from motion finds."""
    return photograph(world(), blocks, taken())


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of real photographs that holds ``templeSparseRing``, ``templeRing`` and ``dinoSparseRing``."""
    folder = os.environ.get("RECON3D_DATA")
    if not folder:
        pytest.skip("RECON3D_DATA does not name a folder of real photographs")
    if not Path(folder).is_dir():
        pytest.skip(f"RECON3D_DATA={folder} is not a folder")
    return Path(folder)
