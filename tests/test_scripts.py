"""The scripts that make the project's figures."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from types import ModuleType

import pytest
from open3d.geometry import TriangleMesh

import recon3d
from recon3d.consistency import TESTS
from recon3d.datasets.synthetic import BuiltInScene


def script(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "scripts"))
    return importlib.import_module(name)


def test_the_papers_page_has_every_part_and_is_taken_up_where_it_was_left(
    temple: BuiltInScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recon3d.evaluation.distances.SAMPLES_PER_DIAGONAL", 100)
    main = script("reproduce_paper", monkeypatch).main
    folder = recon3d.io.write_middlebury(temple.scene, tmp_path / "photographs")
    truth = recon3d.write_geometry(tmp_path / "truth.ply", temple.ground_truth)
    options = {"temple_truth": truth, "rose": folder, "output": tmp_path / "page", "voxels": 4000}
    main(folder, folder, **options)

    page = re.sub(" +", " ", (tmp_path / "page" / "index.md").read_text())
    assert re.findall("^## (.*?)[:,]", page, re.MULTILINE) == [
        "Fig. 2", "Fig. 3", "Fig. 5", "Fig. 5", "Fig. 6", "Fig. 7", "Table 1", "What was tried",
    ]  # fmt: skip
    pictures = set(re.findall(r"!\[\]\((.*?)\)", page))
    assert pictures == {f"pictures/{path.name}" for path in (tmp_path / "page" / "pictures").iterdir()}
    html = (tmp_path / "page" / "index.html").read_text()
    assert set(re.findall("src='(.*?)'", html)) == pictures
    assert "proposed method, 8 views (paper) | 8.97 mm, 72.1%, 310 s" in page
    assert re.search(r"measured here \| \d+\.\d\d mm, \d+\.\d%, \d+\.\d\d s \| \d+\.\d\d s \(no ground truth", page)

    monkeypatch.setattr("recon3d.reconstruct", None)
    main(folder, folder, **options)
    assert re.sub(" +", " ", (tmp_path / "page" / "index.md").read_text()) == page


def test_every_parameter_of_the_sweep_is_one_of_its_test(monkeypatch: pytest.MonkeyPatch) -> None:
    tune = script("tune_tests", monkeypatch)
    assert set(tune.GRIDS) == set(TESTS)
    for name, options in tune.GRIDS.items():
        tests = [TESTS[name](**option) for option in options]
        assert TESTS[name]() in tests or name == "minkowski", f"{name}'s default is none of the sweep's settings"


def test_the_f_score_falls_from_all_to_none(temple: BuiltInScene, monkeypatch: pytest.MonkeyPatch) -> None:
    tune = script("tune_tests", monkeypatch)
    result = recon3d.reconstruct(temple.scene, recon3d.Settings(n_voxels=20_000, carving=recon3d.VoxelColoring()))
    monkeypatch.setattr("recon3d.reconstruct", lambda *_: result)
    scores = [
        tune.Measured(temple.scene, moved).f_score(recon3d.consistency.StandardDeviation())
        for moved in (TriangleMesh(result.mesh).translate((shift, 0, 0)) for shift in (0.0, 0.02, 1.0))
    ]
    assert scores[0] == 100
    assert 10 < scores[1] < 90
    assert scores[2] == 0
