"""Tests side by side: each as it would be alone, none run twice, mistakes found before any work."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

import recon3d
from recon3d.cli.arguments import keywords, sweep_of
from recon3d.consistency import TESTS, Hysteresis, StandardDeviation
from recon3d.consistency.deviation import Adaptive
from recon3d.consistency.fuzzy import FuzzySingle
from recon3d.consistency.spec import identity
from recon3d.datasets import BuiltInScene
from recon3d.errors import ArgumentError, FailedTestError
from recon3d.evaluation import measure_quality
from recon3d.rendering.sheets import portrait
from recon3d.scene import without_silhouettes
from recon3d.study import trials
from recon3d.study.variants import expand_variants

SETTINGS = recon3d.Settings(n_voxels=15_000, carving=recon3d.VoxelColoring())
SPACING = 2e-3


def accept_all(patches: recon3d.Patches, level: float = 0.5) -> recon3d.Verdict:
    limit = np.full(patches.n_voxels, level)
    return recon3d.Verdict(np.ones(patches.n_voxels), limit, limit)


def closure(level: float) -> Callable[[recon3d.Patches], recon3d.Verdict]:
    return lambda patches: accept_all(patches, level)


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Tests that were run, in order."""
    seen: list[object] = []
    original = trials.reconstruct

    def counted(scene: recon3d.Scene, settings: recon3d.Settings, **rest: object) -> recon3d.Reconstruction:
        assert isinstance(settings.carving, recon3d.VoxelColoring)
        seen.append(settings.carving.test)
        return original(scene, settings, **rest)  # type: ignore[arg-type]

    monkeypatch.setattr(trials, "reconstruct", counted)
    return seen


@pytest.fixture(scope="module")
def measured(temple: BuiltInScene) -> recon3d.Comparison:
    return recon3d.compare(
        temple.scene,
        ["fuzzy", "standard-deviation"],
        settings=SETTINGS,
        ground_truth=temple.ground_truth,
        sweep=("threshold", (0, 40, 60)),
        spacing=SPACING,
    )


def test_all_means_every_test_by_its_name() -> None:
    assert [entry.label for entry in expand_variants("all")] == list(TESTS)


def test_a_sweep_varies_the_tests_that_have_its_parameter() -> None:
    found = expand_variants(
        {"plain": "fuzzy", "one": FuzzySingle(trim=0.2), "own": accept_all}, ("threshold", (0.25, 0.5))
    )
    assert [entry.label for entry in found] == ["plain", "one threshold=0.25", "one threshold=0.5", "own"]
    assert [entry.value for entry in found] == [None, 0.25, 0.5, None]
    assert found[2].test == FuzzySingle(trim=0.2, threshold=0.5)
    assert [entry.family for entry in found[1:3]] == ["one", "one"]
    levels = expand_variants([accept_all], ("level", np.array([0.1, 0.2])))  # type: ignore[arg-type]
    assert [entry.label for entry in levels] == ["accept_all level=0.1", "accept_all level=0.2"]


def test_a_test_given_as_a_value_is_called_by_what_is_not_as_usual() -> None:
    labels = [entry.label for entry in expand_variants([Adaptive(), Adaptive(base=5), accept_all])]
    assert labels == ["Adaptive", "Adaptive base=5", "accept_all"]


@pytest.mark.parametrize(
    ("tests", "sweep", "message"),
    [
        (["magic"], None, "expected a test among fuzzy"),
        (["no_such_module:test"], None, "no module 'no_such_module'"),
        ([], None, "expected tests of different labels, got none"),
        (["fuzzy", "fuzzy"], None, "of different labels, got fuzzy"),
        (["fuzzy"], ("treshold", [1.0]), "a parameter among intensity, trim, got 'treshold'"),
        (["fuzzy-single"], ("threshold", []), "expected one or more values of threshold"),
        (["fuzzy-single"], ("threshold", [0.5, 2]), "fuzzy-single, threshold=2: expected threshold to be"),
    ],
)
def test_a_wrong_test_or_sweep_is_refused(tests: list[str], sweep: tuple[str, list[float]], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        expand_variants(tests, sweep)


def test_every_built_in_test_has_an_identity_of_its_own() -> None:
    found = [identity(make()) for make in TESTS.values()]
    assert None not in found
    assert len(set(found)) == len(TESTS)
    assert identity(Adaptive()) == identity(Adaptive()) != identity(Adaptive(base=5))
    (swept,) = expand_variants(["adaptive"], ("base", np.array([5])))  # type: ignore[arg-type]
    assert identity(swept.test) == identity(Adaptive(base=5))


def test_what_cannot_be_told_apart_has_no_identity() -> None:
    assert identity(closure(0.5)) is None
    assert identity(Hysteresis(closure(0.5))) is None
    known = [
        accept_all,
        partial(accept_all, level=0.1),
        partial(accept_all, level=0.2),
        Hysteresis(accept_all),
    ]
    assert len({identity(test) for test in known} - {None}) == len(known)


def test_a_test_from_a_module_is_swept_and_known_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = "class Own:\n    def __init__(self, level=0.5):\n        self.level = level\n    __call__ = print\n"
    (tmp_path / "swept_own.py").write_text(source + "def plain(patches, level=0.5): ...\n")
    monkeypatch.chdir(tmp_path)
    names = ["swept_own:Own", "swept_own:plain"]
    found = expand_variants([*names, "fuzzy"], ("level", (0.1, 0.2)))
    assert [entry.label for entry in found] == [*(f"{name} level={x}" for name in names for x in (0.1, 0.2)), "fuzzy"]
    assert [entry.test.options for entry in found[:4]] == 2 * [{"level": 0.1}, {"level": 0.2}]  # type: ignore[attr-defined]
    told = [identity(entry.test) for entry in found]
    assert None not in told
    assert len(set(told)) == 5
    assert told == [identity(entry.test) for entry in expand_variants([*names, "fuzzy"], ("level", (0.1, 0.2)))]
    with pytest.raises(ValueError, match="expected a parameter among level, got 'height'"):
        expand_variants(names, ("height", (1.0,)))


def test_a_trial_is_what_the_test_does_alone(temple: BuiltInScene, measured: recon3d.Comparison) -> None:
    names = [view.name for view in temple.scene.views]
    assert measured.conditions["held_out"] == names[3::4]
    assert measured.conditions["views"] == [name for name in names if name not in names[3::4]]
    used = temple.scene.subset(measured.conditions["views"])
    for trial, test in zip(
        measured.trials[::3],
        (recon3d.FuzzyAdaptiveHysteresis(), StandardDeviation(60)),
        strict=True,
    ):
        alone = recon3d.reconstruct(used, replace(SETTINGS, carving=recon3d.VoxelColoring(test)))
        assert trial.accepted == alone.carved.volume.n_occupied
        quality = measure_quality(alone.mesh, temple.scene.subset(names[3::4]))
        assert trial.median_error == quality.overall.median
        assert trial.rms_error == quality.overall.rms
        assert trial.overlap_percent == 100 * quality.overall.overlap  # type: ignore[operator]
        assert trial.floating == quality.shape.components - 1 + alone.repairs.small_components > 0
        assert trial.roughness_degrees == quality.shape.dihedral_degrees
        figures = recon3d.evaluate(alone.mesh, temple.ground_truth, spacing=SPACING)
        assert (trial.accuracy_mm, trial.completeness_percent) == (figures.accuracy_mm, figures.completeness_percent)
        assert trial.precision_percent == pytest.approx(100 * (figures.accuracy_distances <= 1.25).mean())
        assert trial.carving_s > 0


def test_a_test_that_leaves_nothing_is_a_row_of_its_own(measured: recon3d.Comparison) -> None:
    empty = measured.trials[1]
    assert (empty.label, empty.accepted, empty.holes) == ("standard-deviation threshold=0", 0, None)
    heading, _, row, *_ = measured.table()
    assert row[heading.index("accepted")] == "0"
    assert row[heading.index("accuracy (mm)")] == "-"


def test_table_sheet_and_plot_are_written(temple: BuiltInScene, measured: recon3d.Comparison, tmp_path: Path) -> None:
    written = measured.save(tmp_path)
    assert json.loads(written["figures"].read_text())["trials"][0]["label"] == "fuzzy"
    lines = [line for line in written["table"].read_text().splitlines() if line.startswith("|")]
    assert len(lines) == 2 + len(measured.trials)
    assert len({len(line) for line in lines}) == 1  # reads as plain text, too
    assert all(path.stat().st_size > 0 for path in written.values())
    # The photographs, three results of equal height, and one line of text for the one that left nothing.
    shown = [temple.scene.views[n] for n in (0, 2, 5, 7)]
    shapes = [portrait(view.image, view, temple.scene).shape for view in shown]
    heights = [round(200 * height / width) for height, width, _ in shapes]
    assert 4 * max(heights) < measured.sheet.shape[0] < 5 * max(heights)
    assert measured.sheet.shape[1] == 5 * 200
    for n, height in enumerate(heights):
        photograph = measured.sheet[:height, 200 * (n + 1) : 200 * (n + 2)]
        assert (photograph.mean(axis=(1, 2)) < 160).all()  # black background
    assert set(measured.summary()) == {trial.label for trial in measured.trials}
    assert "<th>completeness (%)</th>" in measured._repr_html_()


def test_the_trade_off_is_precision_against_completeness_where_a_ground_truth_is(
    temple: BuiltInScene, measured: recon3d.Comparison
) -> None:
    axes = measured.plot().axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("completeness (%)", "precision (%)")
    assert [line.get_label() for line in axes.lines] == ["fuzzy", "standard-deviation"]
    swept = [trial for trial in measured.trials if trial.value]
    np.testing.assert_array_equal(axes.lines[1].get_xdata(), [trial.completeness_percent for trial in swept])
    np.testing.assert_array_equal(axes.lines[1].get_ydata(), [trial.precision_percent for trial in swept])
    assert [text.get_text() for text in axes.texts] == ["", "40", "60"]
    for scene, xlabel in ((temple.scene, "overlap (%)"), (without_silhouettes(temple.scene), "accepted")):
        axes = recon3d.compare(scene, [accept_all], settings=SETTINGS).plot().axes[0]
        assert axes.get_xlabel() == xlabel
        assert len(axes.lines) == 1


def test_views_that_are_held_out_do_not_change_the_result(temple: BuiltInScene) -> None:
    views = list(temple.scene.views)
    views[3] = replace(views[3], photograph=views[3].image[::-1].copy())
    spoilt = replace(temple.scene, views=tuple(views))
    a, b = (
        recon3d.compare(scene, ["fuzzy"], settings=SETTINGS, hold_out=["view04*"]) for scene in (temple.scene, spoilt)
    )
    assert a.conditions["held_out"] == ["view04.png"]
    assert a.trials[0].accepted == b.trials[0].accepted
    assert a.trials[0].median_error < b.trials[0].median_error  # type: ignore[operator]
    none = recon3d.compare(temple.scene, ["fuzzy"], settings=replace(SETTINGS, max_views=3), hold_out=0)
    assert (none.conditions["held_out"], len(none.conditions["views"])) == ([], 3)
    assert "views that the tests used" in none.markdown()


def test_what_is_finished_is_not_run_again(temple: BuiltInScene, runs: list[object], tmp_path: Path) -> None:
    def interrupted(stage: str, done: int, _total: int) -> None:
        if (stage, done) == ("tests", 1):
            raise KeyboardInterrupt

    tests = {"fuzzy": "fuzzy", "own": accept_all, "closure": closure(0.5)}
    with pytest.raises(KeyboardInterrupt):
        recon3d.compare(temple.scene, tests, settings=SETTINGS, folder=tmp_path, progress=interrupted)
    assert len(runs) == 1
    first = recon3d.compare(temple.scene, tests, settings=SETTINGS, folder=tmp_path)
    assert len(runs) == 3  # the first was kept
    second = recon3d.compare(temple.scene, tests, settings=SETTINGS, folder=tmp_path)
    assert len(runs) == 4  # nothing tells one closure from another
    assert second.trials[:2] == first.trials[:2]
    np.testing.assert_array_equal(second.sheet, first.sheet)

    next((tmp_path / "trials").glob("*/own.npz")).write_text("cut short")
    recon3d.compare(temple.scene, {"own": accept_all}, settings=SETTINGS, folder=tmp_path)
    assert len(runs) == 5


def test_other_inputs_are_another_trial(temple: BuiltInScene, runs: list[object], tmp_path: Path) -> None:
    inputs: dict[str, object] = {
        "scene": temple.scene,
        "settings": replace(SETTINGS, n_voxels=4000),
        "ground_truth": temple.ground_truth,
        "spacing": 4e-3,
    }
    first, *others = temple.scene.views
    moved = o3d.geometry.TriangleMesh(temple.ground_truth).translate((1e-3, 0, 0))
    changes: list[dict[str, object]] = [
        {},
        {"scene": replace(temple.scene, views=(replace(first, photograph=255 - first.image), *others))},
        {"scene": without_silhouettes(temple.scene)},
        {"hold_out": 5},
        {"settings": replace(SETTINGS, n_voxels=5000)},
        {"accuracy_percent": 80.0},
        {"ground_truth": moved},
    ]
    for n, change in enumerate([*changes, *changes]):
        recon3d.compare(tests=[accept_all], folder=tmp_path, **{**inputs, **change})  # type: ignore[arg-type]
        assert len(runs) == min(n + 1, len(changes))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"settings": recon3d.Settings(carving=recon3d.VisualHull())}, "visual-hull uses no photo-consistency test"),
        ({"settings": recon3d.Settings(carving=recon3d.VoxelColoring(Adaptive()))}, "expected a method with its own"),
        ({"hold_out": 1}, "expected to hold out every n-th view, n of 2 or more"),
        ({"hold_out": ["*"]}, "expected views to be left for the tests"),
        ({"accuracy_percent": 80}, "expected a ground truth for accuracy_percent"),
    ],
)
def test_a_wrong_condition_is_refused_before_any_work(
    options: dict[str, object], message: str, temple: BuiltInScene, runs: list[object]
) -> None:
    with pytest.raises(ValueError, match=message):
        recon3d.compare(temple.scene, ["fuzzy"], **options)  # type: ignore[arg-type]
    assert not runs


def test_an_error_of_a_test_names_it(temple: BuiltInScene) -> None:
    def short(patches: recon3d.Patches) -> recon3d.Verdict:
        return accept_all(patches.part(0, 1)) if patches.n_voxels else accept_all(patches)

    with pytest.raises(FailedTestError, match=r"^mine: .* judged 1 voxels of "):
        recon3d.compare(temple.scene, {"mine": short}, settings=SETTINGS)
    with pytest.raises(FailedTestError, match=r"^mine: .*expected a Verdict, got int"):
        recon3d.compare(temple.scene, {"mine": lambda _: 3}, settings=SETTINGS)  # type: ignore[dict-item,return-value]


def test_a_sweep_on_the_command_line_holds_both_ends() -> None:
    assert sweep_of("threshold=0.2:0.6:0.1") == ("threshold", [0.2, 0.3, 0.4, 0.5, 0.6])
    name, values = sweep_of("bins=4:9:4")
    assert (name, values) == ("bins", [4, 8])
    assert all(isinstance(value, int) for value in values)
    for wrong in ("threshold", "threshold=1:2", "threshold=a:b:c", "=1:2:1", "threshold=2:1:1", "threshold=1:2:0"):
        with pytest.raises(ValueError, match="--sweep: expected NAME=LOW:HIGH:STEP"):
            sweep_of(wrong)


@pytest.mark.parametrize("option", ["x=0:²:1", "x=0:1:nan", "x=0:1:-1", "x=0:1:1e-320", "x=0:{[]:1}:1", "=0:1:1",
                                    f"x=0:1:{'-' * 5000}1"])  # fmt: skip
def test_what_is_no_sweep_is_refused(option: str) -> None:
    with pytest.raises(ArgumentError, match="--sweep: expected NAME=LOW:HIGH:STEP, got"):
        sweep_of(option)


def test_a_sweep_of_a_billion_values_is_refused() -> None:
    with pytest.raises(ArgumentError, match="expected at most 10000 values, got 1000000000 by"):
        sweep_of("x=0:1:1e-9")


@pytest.mark.parametrize("text", ["{[]:1}", f"{'-' * 5000}1", "(" * 300, "1 +", "\0"])
def test_an_option_that_is_no_literal_is_text(text: str) -> None:
    assert keywords([f"a={text}"]) == {"a": text}
