"""Records of runs: those of today stay readable, and whatever is in a damaged one, it ends in one line."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import recon3d
from recon3d.cli.results import record_of, recorded_settings
from recon3d.io.files import write_json
from recon3d.io.run_record import FORMAT, read_run_record

PASS = {
    "stride": 4, "radius": 5, "spacing": 2, "contrast": 20.0, "rounds": 3, "reach": 10.0, "cavities": 0.3,
    "neighbours": 6, "compared": 4, "max_cost": 0.6,
}  # fmt: skip
MEASURED = {
    "accuracy_percent": 90.0, "accuracy_mm": 2.95, "completeness_threshold_mm": 1.25, "completeness_percent": 76.5,
    "median_mm": 0.219, "mean_reconstruction_to_ground_truth_mm": 1.1, "mean_ground_truth_to_reconstruction_mm": 0.83,
    "reconstruction_samples": 566737, "ground_truth_samples": 520293, "samples_left_out": 0,
}  # fmt: skip
COMPARED = {"pixels": 3486, "median": 0.6, "mean": 2.93, "rms": 7.18, "overlap": 0.99}

FIRST: dict[str, Any] = {
    "recon3d": "0.1.0",
    "versions": {"python": "3.11.7", "numpy": "2.4.6"},
    "scene": {
        "format": "Middlebury",
        "source": "photographs",
        "name": "little-temple",
        "views": ["view01.png", "view02.png"],
        "bounds": [[-0.054, -0.04, -0.002], [0.054, 0.04, 0.126]],
        "mm_per_unit": 1000.0,
    },
    "settings": {
        "views": "auto",
        "max_views": None,
        "n_voxels": 1000000,
        "voxel_size": None,
        "carving": {"name": "vote-carving", "options": {"min_score": 0.6, "truncation": 4.0}},
        "matching": [PASS, PASS],
        "meshing": {
            "surface": "poisson", "keep_unsupported": True, "max_uncertainty": None, "fill_hidden": False,
            "smoothing": None, "min_component": 100.0,
        },
    },
    "volume": {"shape": [105, 78, 124], "voxel_size": 0.00104, "origin": [-0.0548, -0.0407, -0.0027]},
    "voxels": {"unseen": 0, "background": 569884, "inconsistent": 76632, "hidden": 327538, "consistent": 41506},
    "mesh": {
        "vertices": 302761, "triangles": 605830, "support": [103555, 1578, 10616, 19558], "supported_share": 0.6,
        "predicted_accuracy": 0.00046, "small_components": 49, "non_manifold_edges": 15, "non_manifold_vertices": 24,
        "inward_pieces": 0,
    },
    "timings_s": {"views": 0.01, "carving": 11.795},
    "quality": {
        "reprojection": COMPARED,
        "views": {"view01.png": COMPARED, "view02.png": {**COMPARED, "overlap": None}},
        "shape": {
            "components": 1, "floating_share": 0.0, "boundary_loops": 0, "genus": None, "nonmanifold_edges": 0,
            "nonmanifold_vertices": 0, "dihedral_degrees": 6.96,
        },
    },
    "evaluation": MEASURED,
    "supported_evaluation": None,
}  # fmt: skip
"""As runs wrote it before records had a version."""

BAD: list[Any] = [
    None,
    True,
    -1,
    3,
    0.5,
    1e308,
    "",
    "x",
    "²",
    [],
    [[]],
    {},
    {"a": 1},
    [1, "a"],
    [-1.0, 2, 3],
    [[1, 2, 3]] * 2,
]


def written(folder: Path, record: object) -> Path:
    (folder / "record.json").write_text(json.dumps(record), encoding="utf-8")
    return folder


def test_records_of_the_first_format_are_read(tmp_path: Path) -> None:
    record = record_of(written(tmp_path, FIRST))
    assert record is not None
    assert record.format == 1
    assert record.scene.views == ["view01.png", "view02.png"]
    assert record.scene.silhouettes == "auto"
    assert record.scene.detail == "full"
    assert record.mesh is not None
    assert record.mesh.decimation is None
    assert record.quality is not None
    assert record.quality.views["view02.png"].overlap is None
    assert record.evaluation is not None
    assert record.evaluation.completeness_percent == 76.5
    settings = recorded_settings(tmp_path, record, None)
    assert settings.matching == (recon3d.stereo.Matching(**PASS),) * 2


def test_a_run_writes_what_its_schema_tells(tmp_path: Path) -> None:
    scene = recon3d.little_temple(n_views=8, width=80, height=60).scene
    settings = recon3d.Settings(n_voxels=3000, matching=None)
    little_result = recon3d.reconstruct(scene, settings)
    told = json.loads(write_json(tmp_path / "told.json", little_result.record()).read_text())
    record = read_run_record(written(tmp_path, told) / "record.json")
    assert record.format == FORMAT
    assert record.scene.views == [view.name for view in little_result.scene.views]
    for part, known in ((told, record), (told["mesh"], record.mesh), (told["volume"], record.volume)):
        assert set(part) == set(known.__struct_fields__), "a field has no schema"
    assert recorded_settings(tmp_path, record, None) == little_result.settings


def test_a_record_of_a_newer_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(recon3d.DataError, match=r"record\.json: the record's format is 2, of a newer recon3d"):
        record_of(written(tmp_path, {**FIRST, "format": 2, "scene": "of another kind"}))


def places(value: object, before: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Ways to all that a record holds."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, each in inside:
        yield (*before, name)
        yield from places(each, (*before, name))


def changed(way: tuple[str | int, ...], value: object) -> dict[str, Any]:
    """The record with another value in a place; an ellipsis: with none."""
    record = copy.deepcopy(FIRST)
    at: Any = record
    for name in way[:-1]:
        at = at[name]
    if value is ...:
        del at[way[-1]]
    else:
        at[way[-1]] = value
    return record


def refusal(folder: Path) -> str:
    """Why a record cannot be used; empty: it can."""
    try:
        record = record_of(folder)
        recorded_settings(folder, record, None)
    except recon3d.DataError as error:
        return str(error)
    return ""


def test_a_damaged_record_is_one_line_whatever_is_wrong_with_it(tmp_path: Path) -> None:
    refused = 0
    ways = list(places(FIRST))
    for way in ways:
        for value in (..., *BAD):
            written(tmp_path, changed(way, value))
            told = refusal(tmp_path)
            assert told == "" or (str(tmp_path) in told and "\n" not in told and "--bounds" not in told), told
            refused += told != ""
    assert refused > 5 * len(ways)


@pytest.mark.parametrize(
    "text",
    [
        b"", b"{}", b"[]", b"3", b"{", b'{"scene": 3}', b"\xff\xfe", b"[" * 200_000, b'{"scene":' * 200_000,
        b'{"scene": {"name": "a", "views": ["b"], "bounds": [[0, 0, 0], [1e999, 1, 1]], "mm_per_unit": 1}}',
        b'{"scene": {"name": "a", "views": ["b"], "bounds": [[0, 0, 0], [NaN, 1, 1]], "mm_per_unit": 1}}',
        b'{"scene": {"name": "a", "views": ["b"], "bounds": [[0, 0, 0], [-1, 1, 1]], "mm_per_unit": 1}}',
        b'{"scene": {"name": "a", "views": ["b"], "bounds": [[0, 0, 0], [1, 1, 1]], "mm_per_unit": 1e999}}',
    ],
)  # fmt: skip
def test_what_is_no_record_is_one_line(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "record.json").write_bytes(text)
    with pytest.raises(recon3d.DataError, match=r"record\.json: expected the record of a run"):
        record_of(tmp_path)


def test_a_folder_in_its_place_is_told(tmp_path: Path) -> None:
    (tmp_path / "record.json").mkdir()
    with pytest.raises(recon3d.DataError, match=r"record\.json: the record cannot be read"):
        record_of(tmp_path)
