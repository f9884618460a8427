"""Compiling ahead of the first run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import recon3d

COUNT = """
import sys
from numba.core import event
import recon3d

class Counter(event.Listener):
    kernels = set()
    def on_start(self, event):
        function = event.data["dispatcher"].py_func
        if function.__module__.startswith("recon3d."):
            self.kernels.add(function.__name__)
    def on_end(self, event):
        pass

event.register("numba:compile", Counter())
built_in = recon3d.little_temple(n_views=6, width=96, height=72, supersampling=1)
result = recon3d.reconstruct(built_in.scene, recon3d.Settings(n_voxels=5000), ground_truth=built_in.ground_truth)
print(*sorted(Counter.kernels))
"""


def test_a_default_run_finds_all_its_kernels_compiled(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(Path(recon3d.__path__[0]).parent)}
    done = subprocess.run(
        [sys.executable, "-m", "recon3d.cli.precompile"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    compiled = subprocess.run(
        [sys.executable, "-c", COUNT], env=environment, capture_output=True, text=True, check=True
    )
    assert compiled.stdout.split() == []
