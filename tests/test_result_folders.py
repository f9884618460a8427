"""Folders of results: for one command at a time; a killed one leaves no lock, and a full disk what was there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import recon3d
from recon3d.cli.results import writable

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="folders cannot be locked there")


def test_a_folder_is_one_commands_alone_until_that_ends_however_it_does(tmp_path: Path) -> None:
    holds = "import sys; from pathlib import Path; from recon3d.cli.results import writable\n"
    holds += "writable(Path(sys.argv[1])); print('held', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", holds, tmp_path / "out"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(recon3d.ArgumentError, match=r"out: another command writes into it now; wait"):
            writable(tmp_path / "out")
        writable(tmp_path / "another")
        other.kill()
        other.wait()
        for _ in range(2):  # one process may write into it again and again
            assert writable(tmp_path / "out") == tmp_path / "out"
    assert not list((tmp_path / "out").iterdir())


def test_a_file_in_its_place_is_told(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(recon3d.ArgumentError, match=r"out: expected a folder that can be written"):
        writable(tmp_path / "out")


FULL = """
import resource, sys
from pathlib import Path
import numpy as np, open3d as o3d
from recon3d.io.checkpoints import Checkpoints
from recon3d.io.files import write_image, write_text
from recon3d.io.geometry import write_geometry

folder = Path(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
noise = np.random.default_rng(0).integers(0, 255, (400, 400, 3)).astype(np.uint8)
ball = o3d.geometry.TriangleMesh.create_sphere(1, 100)
for name, write in {
    "a.txt": lambda: write_text(folder / "a.txt", "x" * 1_000_000),
    "a.png": lambda: write_image(folder / "a.png", noise),
    "a.npz": lambda: Checkpoints(folder).write("a", "key", {"x": noise}),
    "a.ply": lambda: write_geometry(folder / "a.ply", ball),
}.items():
    try:
        write()
    except OSError as error:
        print(name, name in str(error))
"""


def test_a_full_disk_names_the_file_and_leaves_what_was_there(tmp_path: Path) -> None:
    names = ["a.txt", "a.png", "a.npz", "a.ply"]
    for name in names:
        (tmp_path / name).write_text("earlier")
    told = subprocess.run([sys.executable, "-c", FULL, tmp_path], capture_output=True, text=True, check=True).stdout
    assert told.splitlines() == [f"{name} True" for name in names]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
    assert all((tmp_path / name).read_text() == "earlier" for name in names)
