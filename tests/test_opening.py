"""Scenes of many large photographs."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from recon3d.datasets.synthetic import BuiltInScene, ring
from recon3d.errors import DataError
from recon3d.io import open_scene, write_middlebury
from recon3d.io.files import write_image
from recon3d.scene.bounds import Bounds
from recon3d.scene.image_file import ImageFile
from recon3d.scene.pixel_cache import PIXELS

N, WIDTH, HEIGHT = 300, 4000, 3000
MIB = 2**20


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Middlebury set of 300 photographs of 12 megapixels, all one file."""
    return made_set(tmp_path_factory.mktemp("large"), N)


def made_set(folder: Path, n_views: int) -> Path:
    """A Middlebury set of photographs that are all one file, and show a square before black."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[1300:1700, 1800:2200] = 200
    first = write_image(folder / "0.jpg", image)
    lines = [str(n_views)]
    taken = ring(np.zeros(3), n_views=n_views, distance=5.0, width=WIDTH, height=HEIGHT, focal=3000.0, elevation=20)
    for n, camera in enumerate(taken):
        if n:
            (folder / f"{n}.jpg").hardlink_to(first)
        numbers = [*camera.K.ravel(), *camera.cam_from_world[:3, :3].ravel(), *camera.cam_from_world[:3, 3]]
        lines.append(f"{n}.jpg " + " ".join(f"{number:.17g}" for number in numbers))
    (folder / "large_par.txt").write_text("\n".join(lines) + "\n")
    (folder / "README.txt").write_text("(-0.5 -0.5 -0.5) (0.5 0.5 0.5)\n")
    return folder


@pytest.mark.parametrize("silhouettes", ["auto", "threshold", "none"])
def test_many_large_photographs_open_without_their_pixels(
    large: Path, silhouettes: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded = []
    decode = ImageFile.decode
    monkeypatch.setattr(ImageFile, "decode", lambda file, **options: decoded.append(file) or decode(file, **options))
    kept = PIXELS.limit
    PIXELS.limit = 0  # forget what other tests have read
    PIXELS.limit = kept
    tracemalloc.start()
    scene = open_scene(large, silhouettes=silhouettes)
    summary = scene.summary()
    keys = scene.fingerprint(), hash(scene)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # A photograph takes 34 MiB, all of them 10 GiB; three are looked at to see whether the box fits.
    assert peak < 300 * MIB
    assert len(decoded) == (0 if silhouettes == "none" else 3)
    assert len(scene.views) == N
    assert summary["image size"] == f"{WIDTH}x{HEIGHT}"
    assert summary["silhouettes"] == (0 if silhouettes == "none" else N)
    assert keys == (open_scene(large, silhouettes=silhouettes).fingerprint(), hash(scene))


def test_the_command_line_tells_of_them_in_little_memory(tmp_path: Path) -> None:
    folder = made_set(tmp_path, 40)  # 1.3 GiB of pixels
    script = (
        "import resource, sys, recon3d.scene, recon3d.io, recon3d.carving;"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss;"
        "from recon3d.cli.entry import app;"
        "sys.argv = ['recon3d', 'info', sys.argv[1]];"
        "app(standalone_mode=False);"
        "print('added', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    done = subprocess.run([sys.executable, "-c", script, folder], capture_output=True, text=True, check=True)
    assert f"{WIDTH}x{HEIGHT}" in done.stdout
    assert int(done.stdout.split("added")[1]) * 1024 < 400 * MIB


def test_a_fingerprint_is_the_same_in_another_process(temple: BuiltInScene, tmp_path: Path) -> None:
    folder = write_middlebury(temple.scene, tmp_path / "set")
    script = "import sys, recon3d; print(recon3d.open_scene(sys.argv[1], silhouettes=sys.argv[2]).fingerprint())"
    for silhouettes in ("auto", "segmented"):
        done = subprocess.run(
            [sys.executable, "-c", script, folder, silhouettes], capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == open_scene(folder, silhouettes=silhouettes).fingerprint()


def test_an_open3d_box_and_a_unit_may_be_given(temple: BuiltInScene, tmp_path: Path) -> None:
    folder = write_middlebury(temple.scene, tmp_path / "set")
    bounds = temple.scene.bounds.padded(0.001)
    scene = open_scene(folder, bounds=bounds.to_open3d(), mm_per_unit=10)
    assert (scene.bounds, scene.mm_per_unit) == (bounds, 10)
    assert open_scene(folder).mm_per_unit == 1000
    assert scene.notes["silhouettes from"] == "auto"
    masks = open_scene(folder, silhouettes=folder / "silhouettes")
    assert masks.notes["silhouettes from"] == str((folder / "silhouettes").resolve())
    with pytest.raises(DataError, match="nowhere: expected a folder of mask images"):
        open_scene(folder, silhouettes="nowhere")


def test_a_box_is_still_checked_where_all_photographs_can_be_looked_at(
    temple: BuiltInScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_middlebury(temple.scene, tmp_path / "set")
    decoded = []
    decode = ImageFile.decode
    monkeypatch.setattr(ImageFile, "decode", lambda file, **options: decoded.append(file) or decode(file, **options))
    with pytest.warns(UserWarning, match=r"holds .*% of what is bright"):
        open_scene(folder, silhouettes="segmented", bounds=Bounds(temple.scene.bounds.center, temple.scene.bounds.high))
    assert len(decoded) == len(temple.scene.views)
