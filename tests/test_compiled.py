"""Compiled kernels on disk, in a copy of the package that other processes use: wherever there is a place for them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import recon3d

CALLEE = """
from recon3d.kernels import kernel

@kernel()
def times(x):
    return 2 * x
"""
CALLER = """
from recon3d.kernels import kernel, span
from recon3d.kernels.callee import times

@kernel(parallel=True)
def scale(part, values):
    for n in span(part, len(values)):
        values[n] = times(values[n])
"""
RUN = """
import numpy as np
from recon3d.kernels.caller import scale
values = np.arange(3)
scale(values)
stats = scale.__wrapped__.stats
print(*values, sum(stats.cache_hits.values()), stats.cache_path)
"""


class Copy:
    """A copy of the package with two kernels of its own, and what its processes have in their environment."""

    def __init__(self, root: Path) -> None:
        self.root, self.kernels = root, root / "recon3d" / "kernels"
        package = Path(recon3d.__path__[0]) / "kernels"
        shutil.copytree(package, self.kernels, ignore=shutil.ignore_patterns("__pycache__"))
        (root / "recon3d" / "__init__.py").touch()
        (self.kernels / "callee.py").write_text(CALLEE)
        (self.kernels / "caller.py").write_text(CALLER)
        self.environment = {
            name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")
        } | {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1", "HOME": str(root / "home")}

    def make_read_only(self) -> None:
        """As good as: root may write wherever there is a folder."""
        (self.kernels / "__pycache__").touch()

    def start(self, before: str = "") -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", before + RUN], cwd=self.root, env=self.environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip

    def run(self, before: str = "") -> tuple[str, bool, Path | None]:
        """Three values, whether they came from compiled code on disk, and the folder that it is in."""
        return self.result(self.start(before))

    def result(self, process: subprocess.Popen[str]) -> tuple[str, bool, Path | None]:
        output, errors = process.communicate()
        assert (process.returncode, errors) == (0, "")
        *values, hits, folder = output.split()
        return " ".join(values), bool(int(hits)), None if folder == "None" else Path(folder)


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    return Copy(tmp_path)


def test_code_is_kept_beside_the_source_for_the_next_process(copy: Copy) -> None:
    assert copy.run() == ("0 2 4", False, copy.kernels / "__pycache__")
    assert copy.run() == ("0 2 4", True, copy.kernels / "__pycache__")


def test_arguments_of_other_types_run_other_code(copy: Copy) -> None:
    before = (
        "import numpy as np; from recon3d.kernels.caller import scale\n"
        "for values in (np.arange(3.0), np.arange(6)[::2], np.arange(3, dtype=np.float32)):\n"
        "    expected = 2 * values; scale(values); assert (values == expected).all()\n"
    )
    assert copy.run(before)[0] == "0 2 4"


def test_code_follows_a_change_of_a_kernel_that_is_called(copy: Copy) -> None:
    copy.run()
    (copy.kernels / "callee.py").write_text(CALLEE.replace("2", "3"))
    assert copy.run()[:2] == ("0 3 6", False)
    assert len(list((copy.kernels / "__pycache__").glob("caller.*.nbc"))) == 1  # the old one is gone


def test_broken_files_are_as_good_as_none(copy: Copy) -> None:
    copy.run()
    files = list((copy.kernels / "__pycache__").glob("*.nbc"))
    for number, file in enumerate(files):
        file.write_bytes(file.read_bytes()[: 1000 * (number % 2)])
    assert copy.run()[:2] == ("0 2 4", False)
    assert copy.run()[:2] == ("0 2 4", True)


@pytest.mark.parametrize("variable", ["HOME", "NUMBA_CACHE_DIR"])
def test_read_only_installation_keeps_code_in_the_users_folder(copy: Copy, variable: str) -> None:
    copy.make_read_only()
    copy.environment[variable] = str(copy.root / "own")
    _, _, folder = copy.run()
    assert folder is not None
    assert folder.is_relative_to(copy.root / "own")
    assert copy.run() == ("0 2 4", True, folder)


@pytest.mark.parametrize("home", ["", "file"])
def test_without_a_home_code_is_kept_in_a_private_temporary_folder(copy: Copy, home: str) -> None:
    copy.make_read_only()
    (copy.root / "file").touch()
    (copy.root / "temporary").mkdir()
    copy.environment |= {
        "HOME": str(copy.root / "file") if home == "file" else home,
        "TMPDIR": str(copy.root / "temporary"),
    }
    _, _, folder = copy.run()
    assert folder is not None
    assert folder.parent == copy.root / "temporary"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert copy.run() == ("0 2 4", True, folder)
    # What others could have written is not trusted.
    folder.chmod(0o777)
    assert copy.run() == ("0 2 4", False, None)


def test_without_any_place_every_process_compiles(copy: Copy) -> None:
    copy.make_read_only()
    (copy.root / "file").touch()
    copy.environment["HOME"] = str(copy.root / "file")
    nowhere = f"import tempfile; tempfile.tempdir = {str(copy.root / 'file')!r}"
    for _ in range(2):
        assert copy.run(nowhere) == ("0 2 4", False, None)


def test_two_processes_may_compile_at_once(copy: Copy) -> None:
    processes = [copy.start(), copy.start()]
    assert [copy.result(process)[0] for process in processes] == ["0 2 4"] * 2
    assert copy.run()[:2] == ("0 2 4", True)
    assert not list(copy.kernels.glob("__pycache__/*.tmp"))


def test_forked_processes_have_threads_of_their_own(copy: Copy) -> None:
    fork = (
        "import multiprocessing, warnings; import numpy as np; from recon3d.kernels.caller import scale; "
        "warnings.simplefilter('ignore'); scale(np.arange(3)); "
        "process = multiprocessing.get_context('fork').Process(target=scale, args=(np.arange(3),)); "
        "process.start(); process.join(60); assert process.exitcode == 0\n"
    )
    assert copy.run(fork)[0] == "0 2 4"
