"""The command line as a user types it."""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

import recon3d
from recon3d import cli
from recon3d.cli.results import record_of, recorded_scene
from recon3d.cli.scenes import plain_photographs
from recon3d.datasets import BuiltInScene
from recon3d.io import read_support, write_middlebury
from recon3d.io.files import write_image
from recon3d.stereo.refinement import PASSES


def run(*arguments: object, expect: int = 0, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    process = subprocess.run(
        [sys.executable, "-m", "recon3d", *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, "COLUMNS": "120", "NO_COLOR": "1"},
        check=False,
        cwd=cwd,
    )
    assert process.returncode == expect, process.stdout + process.stderr
    return process


@pytest.fixture(scope="module")
def photographs(temple: BuiltInScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_middlebury(temple.scene, tmp_path_factory.mktemp("data") / "photographs")


@pytest.fixture(scope="module")
def result(photographs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("result")
    run("reconstruct", photographs, "--voxels", 40_000, "-o", folder, "--mesh-format", "ply", "--mesh-format", "glb")
    return folder


def test_help_says_what_each_command_does() -> None:
    text = run("--help").stdout
    for command in [
        "demo",
        "download",
        "info",
        "board",
        "calibrate",
        "convert",
        "reconstruct",
        "compare",
        "evaluate",
        "render",
        "texture",
        "explain",
    ]:
        assert command in text
        assert "Usage" in run(command, "--help").stdout


def test_the_version_is_printed() -> None:
    assert run("--version").stdout.strip() == f"recon3d {recon3d.__version__}"


def test_the_demo_names_files_that_exist(tmp_path: Path) -> None:
    process = run("demo", "--voxels", 30_000, "-o", tmp_path)
    for name in ("mesh.ply", "voxels.ply", "comparison.png", "turntable.png", "record.json", "evaluation.png"):
        assert str(tmp_path / name) in process.stdout
        assert (tmp_path / name).stat().st_size > 0
    assert "accuracy" in process.stdout
    assert process.stderr == ""  # no bars where there is no terminal


def test_info_lists_the_views(photographs: Path, tmp_path: Path) -> None:
    text = run("info", photographs, "-o", tmp_path, "--figure", tmp_path / "cameras.png").stdout
    assert "Check: nothing wrong was found" in text
    assert re.search(r"advised voxel size: +\S+ mm \(--voxel-size \S+\): \S+ GiB and \S+ CPU seconds", text)
    assert "35 mm" in text
    assert (tmp_path / "cameras.png").is_file()
    assert "8 of 8 (ordinal visibility constraint)" in text
    assert text.count("silhouette") >= 8
    assert (tmp_path / "views.png").is_file()


def test_info_on_a_scene_that_is_refused_tells_what_was_read_and_why(photographs: Path) -> None:
    process = run("info", photographs, "--bounds", "-100,-100,0,100,100,200", expect=1)
    assert "image size:                      160x120" in process.stdout
    assert process.stdout.count("160x120  ") == 8  # the table of the views
    assert "Check: nothing else wrong was found" in process.stdout
    assert process.stderr.startswith("Error: scene photographs: no camera sees the bounds -100,-100,0 to 100,100,200")
    assert run("info", photographs.parent, expect=1).stdout == ""  # not even read


def test_what_is_wrong_with_a_scene_is_said_once(temple: BuiltInScene, tmp_path: Path) -> None:
    views = temple.scene.views
    order = [3 * n % 8 for n in range(8)]
    shuffled = tuple(replace(view, calibration=views[n].calibration) for view, n in zip(views, order, strict=True))
    folder = write_middlebury(replace(temple.scene, views=shuffled), tmp_path / "set")
    process = run("info", folder)
    assert (process.stdout + process.stderr).count("contradict each other") == 1
    process = run("reconstruct", folder, "--voxels", 2000, "--method", "visual-hull", "--no-pictures", "-o", tmp_path)
    assert process.stderr.count("contradict each other") == 1


def test_a_reconstruction_is_written_measured_and_rendered(result: Path, temple: BuiltInScene, tmp_path: Path) -> None:
    assert (result / "mesh.glb").is_file()
    truth = recon3d.write_geometry(tmp_path / "truth.ply", temple.ground_truth)
    text = run("evaluate", result, truth, "-o", tmp_path, "--completeness-threshold", 3).stdout
    assert "completeness (3 mm)" in text
    figures = json.loads((tmp_path / "evaluation.json").read_text())
    assert 0 < figures["accuracy_mm"] < 20
    assert len(figures["curves"]["distance_mm"]) == 100
    assert (tmp_path / "evaluation.png").is_file()
    run("render", result, "-o", tmp_path / "renders")
    assert len(list((tmp_path / "renders" / "views").iterdir())) == 4 * len(temple.scene.views)


def test_a_test_and_its_options_are_chosen_by_name(photographs: Path, tmp_path: Path) -> None:
    process = run(
        "reconstruct", photographs, "--voxels", 8000, "-o", tmp_path, "--no-pictures", "--method", "voxel-coloring",
        "--test", "standard-deviation", "--test-option", "threshold=45", "--views", "view0[1-5]*",
        "--triangles", 500, "--mesh-format", "3mf", "--texture", 128,
    )  # fmt: skip
    assert "128x128" in process.stdout
    made = (tmp_path / "textured.glb").read_bytes()
    assert (tmp_path / "textured.obj").is_file()
    assert "decimated from" in process.stdout
    assert (tmp_path / "mesh.3mf").is_file()
    assert len(recon3d.read_mesh(tmp_path / "mesh.ply").triangles) <= 500
    record = json.loads((tmp_path / "record.json").read_text())
    test = record["settings"]["carving"]["options"]["test"]
    assert test == {"name": "standard-deviation", "options": {"threshold": 45}}
    assert len(record["scene"]["views"]) == 5
    assert "metres, y up" in run("texture", tmp_path, "--size", 128).stdout
    again = (tmp_path / "textured.glb").read_bytes()
    assert len(again) == pytest.approx(len(made), rel=0.02)


def test_the_surface_may_be_made_again_from_the_stages_that_are_kept(photographs: Path, tmp_path: Path) -> None:
    command = ["reconstruct", photographs, "--voxels", 8000, "-o", tmp_path, "--no-pictures", "--views", "view0[1-3]*"]
    command += ["--method", "visual-hull", "--matching", "dense"]

    def unsupported() -> float:
        support = read_support(tmp_path / "mesh.ply")
        assert support is not None
        return float((support == 0).mean())

    def chosen() -> list[object]:
        settings = json.loads((tmp_path / "record.json").read_text())["settings"]
        meshing = settings["meshing"]
        return [len(settings["matching"] or ()), meshing["surface"], meshing["keep_unsupported"]]

    run(*command)
    assert chosen() == [len(PASSES), "poisson", True]
    made = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "stages").iterdir()}
    assert len(made) == 1 + (3 + 1) * len(PASSES)  # carving, and for every pass three views and what it found
    assert unsupported() > 0.2  # three views see a half of it
    run(*command, "--surface", "graph-cut", "--no-keep-unsupported")
    assert chosen() == [len(PASSES), "graph-cut", False]
    assert unsupported() < 0.05
    assert {path.name: path.stat().st_mtime_ns for path in (tmp_path / "stages").iterdir()} == made
    run(*command[:-1], "none")
    assert chosen() == [0, "poisson", True]


def test_tests_are_compared_swept_and_written(photographs: Path, temple: BuiltInScene, tmp_path: Path) -> None:
    truth = recon3d.write_geometry(tmp_path / "truth.ply", temple.ground_truth)
    command = ["compare", photographs, "--tests", "standard-deviation", "--sweep", "threshold=60:79:20"]
    command += ["--voxels", 8000, "--max-views", 4, "-o", tmp_path, "--ground-truth", truth, "--valid", truth]
    text = run(*command, "--completeness-threshold", 3).stdout
    record = json.loads((tmp_path / "comparison.json").read_text())
    labels = [trial["label"] for trial in record["trials"]]
    assert labels == ["standard-deviation threshold=60"]
    assert all(f"| {label} " in text for label in labels)
    assert "within 3 mm" in text
    assert record["trials"][0]["completeness_percent"] > 0
    assert (len(record["views"]), len(record["held_out"])) == (4, 2)
    for name in ("comparison.md", "contact_sheet.png", "trade_off.png"):
        assert str(tmp_path / name) in text
    assert len(list((tmp_path / "trials").glob("*/*.npz"))) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["reconstruct", "nowhere"], "nowhere: no such file or folder"),
        (["reconstruct", "PHOTOGRAPHS", "--test", "magic"], "--test: expected a test among fuzzy, "),
        (["reconstruct", "PHOTOGRAPHS", "--test-option", "colour=3"], "--test-option: "),
        (["reconstruct", "PHOTOGRAPHS", "--voxel-size", "1e-7"], "a voxel size of"),
        (["reconstruct", "PHOTOGRAPHS", "--bounds", "1,2,3"], "--bounds: expected six numbers"),
        (
            ["reconstruct", "PHOTOGRAPHS", "--method", "voxel-coloring", "--method-option", "connectivity=7"],
            "expected connectivity 6, 18, 26, got 7",
        ),
        (["reconstruct", "PHOTOGRAPHS", "--views", "view99.png"], "has no view view99.png"),
        (
            [
                "reconstruct",
                "PHOTOGRAPHS",
                "--method",
                "generalized-voxel-coloring",
                "--method-option",
                "connectivity=7",
            ],
            "expected connectivity 6, 18, 26, got 7",
        ),
        (
            ["reconstruct", "PHOTOGRAPHS", "--method", "vote-carving", "--method-option", "min_score=abc"],
            "expected min_score to be a number in (-1, 1), got 'abc'",
        ),
        (["reconstruct", "PHOTOGRAPHS", "--method-option", "min_score=0.5"], "--method-option: expected --method, too"),
        (
            ["reconstruct", "PHOTOGRAPHS", "--method", "visual-hull", "--method-option", "colour=1"],
            "--method-option: visual-hull has no colour; it has tolerance",
        ),
        (
            ["reconstruct", "PHOTOGRAPHS", "--method", "visual-hull", "--test", "fuzzy"],
            "--test: visual-hull uses no photo-consistency test",
        ),
        (["reconstruct", "PHOTOGRAPHS", "--method", "magic"], "--method: expected auto, visual-hull, "),
        (["reconstruct", "PHOTOGRAPHS", "--voxels", "9", "--voxel-size", "0.1"], "expected n_voxels or voxel_size"),
        (
            ["reconstruct", "PHOTOGRAPHS", "--voxel-size", "nan"],
            "expected voxel_size to be a number in (0, inf), got nan",
        ),
        (["reconstruct", "PHOTOGRAPHS", "--mm-per-unit", "inf"], "expected mm_per_unit > 0, got inf"),
        (["reconstruct", "PHOTOGRAPHS", "--output", __file__], "expected a folder that can be written"),
        (["reconstruct", "little-temple", "--bounds", "0,0,0,1,1,1"], "it has its own bounds"),
        (["compare", "PHOTOGRAPHS", "--tests", "fuzzy,magic"], "expected a test among fuzzy, "),
        (["compare", "PHOTOGRAPHS", "--sweep", "threshold=1:2"], "--sweep: expected NAME=LOW:HIGH:STEP"),
        (["compare", "PHOTOGRAPHS", "--valid", "nowhere.ply"], "--valid: expected --ground-truth, too"),
        (["evaluate", __file__, __file__, "--mm-per-unit", "0"], "--mm-per-unit to be a number in (0, inf), got 0.0"),
        (["reconstruct", "PHOTOGRAPHS", "--smoothing", "-1"], "expected smoothing to be a whole number of at least 0"),
        (["reconstruct", "PHOTOGRAPHS", "--fill-hidden"], "fill_hidden: expected a one-sided carving method"),
        (
            ["reconstruct", "PHOTOGRAPHS", "--views", "all", "--max-views", "3"],
            "expected views 'auto' with max_views=3",
        ),
        (["reconstruct", "PHOTOGRAPHS", "--detail", "eighth"], "--detail: expected auto, full, half, quarter, got"),
        (["reconstruct", "PHOTOGRAPHS", "--memory", "64MiB"], "would be needed at quarter detail, and 0.1 GiB may be"),
        (["demo", "--noise", "nan"], "expected 0 <= noise < 256"),
        (["render", str(Path(__file__).parent)], "expected the folder of a result"),
        (["evaluate", "nowhere.ply", "nowhere.ply"], "nowhere.ply: no such file"),
        (["render", "nowhere.ply"], "nowhere.ply: no such file"),
    ],
)
def test_a_mistake_is_one_line_and_a_failure(arguments: list[str], message: str, photographs: Path) -> None:
    process = run(*(str(photographs) if a == "PHOTOGRAPHS" else a for a in arguments), expect=1)
    assert message in process.stderr
    assert len(process.stderr.strip().splitlines()) == 1
    assert process.stdout == ""


def kept_traceback(stderr: str) -> str:
    """What the file holds that the one line of an error names."""
    assert len(stderr.strip().splitlines()) == 1
    found = re.search(rf"{re.escape(tempfile.gettempdir())}/recon3d-\w+\.txt", stderr)
    assert found, stderr
    text = Path(found[0]).read_text()
    Path(found[0]).unlink()
    return text


def test_an_error_inside_a_users_test_names_the_line_of_their_code(photographs: Path, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("def fails(patches):\n    return patches.nothing\n")
    command = ["reconstruct", photographs, "--voxels", 3000, "-o", tmp_path / "out", "--method", "voxel-coloring"]
    stderr = run(*command, "--test", "own:fails", expect=1, cwd=tmp_path).stderr
    place = f"{tmp_path / 'own.py'}:2"
    assert f"own:fails failed: AttributeError: 'Patches' object has no attribute 'nothing' ({place})" in stderr
    assert "return patches.nothing" in kept_traceback(stderr)


@pytest.mark.parametrize("error", [ValueError("could not broadcast\nshapes"), IndexError(3), AssertionError()])
def test_a_bug_is_told_as_one_and_not_as_the_users_mistake(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("recon3d.io.reading_geometry.read_mesh", broken)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # which it replaces
    monkeypatch.setattr("sys.argv", ["recon3d", "render", "some.ply"])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == 2
    stderr = capsys.readouterr().err
    assert stderr.startswith("Error: this is a bug in recon3d, please report it with ")
    assert stderr.strip().endswith(" ".join(f"{type(error).__name__}: {error}".split()))
    told = kept_traceback(stderr)
    assert f"recon3d {recon3d.__version__}: render some.ply" in told
    assert "in broken\n    raise error" in told
    monkeypatch.setattr("sys.argv", ["recon3d", "render", "some.ply", "--debug"])
    with pytest.raises(type(error)):
        cli.main()


def test_the_help_needs_none_of_the_heavy_modules() -> None:
    code = "import sys; from recon3d.cli.entry import app; app(['--help'], standalone_mode=False); print(*sys.modules)"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"open3d", "numba", "cv2", "scipy", "matplotlib", "skimage"} & set(process.stdout.split())


def test_the_help_of_a_reconstruction_has_a_panel_for_every_step() -> None:
    text = run("reconstruct", "--help").stdout
    panels = re.findall(r"^[╭+][─-]+ (\w+) [─-]", text, re.MULTILINE)
    assert panels[-7:] == ["Input", "Carving", "Matching", "Surface", "Measuring", "Output", "Advanced"]


def test_debug_shows_the_traceback() -> None:
    assert "Traceback" in run("reconstruct", "nowhere", "--debug", expect=1).stderr


def test_a_wrong_option_is_a_failure() -> None:
    run("reconstruct", "--no-such-option", expect=2)


def test_the_evaluation_script_prints_both_figures(result: Path, temple: BuiltInScene, tmp_path: Path) -> None:
    truth = recon3d.write_geometry(tmp_path / "truth.ply", temple.ground_truth)
    script = Path(__file__).parents[1] / "scripts" / "evaluate_middlebury.py"
    process = subprocess.run(
        [sys.executable, script, result / "mesh.ply", truth, "--output", tmp_path],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    figures = json.loads((tmp_path / "evaluation.json").read_text())
    assert f"accuracy     {figures['accuracy_mm']:.2f} mm" in process.stdout
    assert f"completeness {figures['completeness_percent']:.1f} %" in process.stdout


def test_a_result_shows_where_it_is_uncertain_and_from_where_to_photograph(result: Path, tmp_path: Path) -> None:
    run("render", result, "--mode", "uncertainty", "-o", tmp_path)
    assert (tmp_path / "uncertainty.png").is_file()
    told = run("info", result, "--next-views", 2, "--figure", tmp_path / "next.png").stdout
    assert "seen by fewer than two views:" in told
    assert "next view 1:" in told
    assert (tmp_path / "next.png").stat().st_size > 10_000
    refused = run("info", result, "--next-views", 2, "--silhouettes", "none", expect=1).stderr
    assert "--next-views: expected a result and --figure alone" in refused


def test_a_result_is_rendered_and_measured_with_what_its_record_says(
    temple: BuiltInScene, photographs: Path, tmp_path: Path
) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(photographs, bare)
    (bare / "README.txt").unlink()
    box = ",".join(str(x) for corner in (temple.scene.bounds.low, temple.scene.bounds.high) for x in corner)
    options = [f"--bounds={box}", "--mm-per-unit", 10, "--voxels", 20_000, "--no-pictures", "--mesh-format", "obj"]
    run("reconstruct", bare, "-o", tmp_path / "out", *options)
    run("render", tmp_path / "out")
    assert (tmp_path / "out" / "renders" / "turntable.png").is_file()
    truth = recon3d.write_geometry(tmp_path / "truth.ply", temple.ground_truth)
    run("evaluate", tmp_path / "out", truth)
    figures = json.loads((tmp_path / "out" / "evaluation" / "evaluation.json").read_text())
    assert figures["accuracy_mm"] < 0.2  # in units of a tenth of a metre's thousandth: 100 times less than in metres


def test_a_result_is_of_the_photographs_at_the_recorded_detail(result: Path, tmp_path: Path) -> None:
    record = json.loads((result / "record.json").read_text())
    widths = {}
    for detail in ("full", "half"):
        changed = {**record, "scene": {**record["scene"], "detail": detail}}
        (tmp_path / "record.json").write_text(json.dumps(changed))
        widths[detail] = recorded_scene(tmp_path, record_of(tmp_path)).views[0].width
    assert widths["full"] == 2 * widths["half"]


def test_two_units_are_told_from_a_bad_result(temple: BuiltInScene, result: Path, tmp_path: Path) -> None:
    small = o3d.geometry.TriangleMesh(temple.ground_truth).scale(1e-5, (0, 0, 0))
    truth = recon3d.write_geometry(tmp_path / "truth.ply", small)
    assert "are both in one unit" in run("evaluate", result, truth, expect=1).stderr


def test_a_record_that_is_none_names_its_file(result: Path, tmp_path: Path) -> None:
    shutil.copy(result / "mesh.ply", tmp_path)
    record = json.loads((result / "record.json").read_text())
    (tmp_path / "record.json").write_text(json.dumps({**record, "scene": {**record["scene"], "detail": "unheard of"}}))
    assert f"{tmp_path / 'record.json'}: expected the record of a run" in run("render", tmp_path, expect=1).stderr


def test_plain_photographs_may_lie_in_the_only_sub_folder(photographs: Path, tmp_path: Path) -> None:
    folder = tmp_path / "rose" / "images"
    folder.mkdir(parents=True)
    for n in range(2):
        write_image(folder / f"{n}.png", np.zeros((4, 4, 3), np.uint8))
    assert plain_photographs(str(folder)) == folder
    assert plain_photographs(str(folder.parent)) == folder
    (folder.parent / "notes.txt").write_text("calibration unknown")
    assert plain_photographs(str(folder.parent)) is None
    assert plain_photographs(str(tmp_path)) is None
    assert plain_photographs(str(photographs)) is None  # its cameras are known
    assert plain_photographs("little-temple") is None
