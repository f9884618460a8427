"""Why a voxel was carved or kept."""

from __future__ import annotations

import contextlib
import json
import warnings
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from reference import (
    Result,
    alternating_harmonic,
    brute_force_items,
    color_voxels,
    footprint,
    foreground,
    in_image,
    membership,
)
from scenes import ball_mesh, cameras, photographs, two_planes_mesh, with_noise

import recon3d
from recon3d import Explanation, Label, Scene, Settings, cli, explain
from recon3d.carving import METHODS
from recon3d.carving.hysteresis import CANDIDATE, neighbour_offsets
from recon3d.carving.observer import path_to_consistent
from recon3d.carving.visibility import sweep_direction
from recon3d.datasets.synthetic import BuiltInScene
from recon3d.explaining.evidence import PixelKind
from recon3d.explaining.pointing import voxels_on_ray
from recon3d.io import Checkpoints, write_middlebury
from recon3d.scene.bounds import Bounds
from recon3d.stereo import PASSES

OBSERVED = [name for name, method in METHODS.items() if method.uses_test]


@cache
def world() -> Scene:
    """Two planes, photographed with noise, so that every outcome occurs."""
    return with_noise(photographs(two_planes_mesh(), taken_by=cameras(5, arc=100)), 30.0)


def settings_of(method: str) -> Settings:
    return Settings(n_voxels=2500, carving=METHODS[method]())


@cache
def hull_of(method: str) -> recon3d.CarvedVolume:
    """What the method leaves, or the one that leaves the same with all voxels stored."""
    dense = METHODS[method]().dense()
    return recon3d.reconstruct(world(), Settings(n_voxels=2500, carving=dense)).carved.dense()


def some_voxels(hull: recon3d.CarvedVolume, label: Label, count: int = 3) -> NDArray[np.int64]:
    """A few voxels of a label; of judged ones the least and the most consistent and what is between."""
    voxels = np.argwhere(hull.labels == label)
    order = np.argsort(hull.degree[tuple(voxels.T)], kind="stable")
    return voxels[order[np.linspace(0, len(order) - 1, min(count, len(order))).astype(int)]]


def explained(method: str, voxel: NDArray[np.int64]) -> Explanation:
    volume = hull_of(method).volume
    return explain(world(), settings_of(method), at=volume.origin + volume.voxel_size * (voxel + 0.4))


def voting_pixels(explanation: Explanation) -> list[set[tuple[int, int]]]:
    """Pixels (u, v) that voted, view by view."""
    pixels = []
    for view in explanation.views:
        rows, columns = np.nonzero(view.kinds == PixelKind.VOTED)
        pixels.append({(view.box[0] + int(u), view.box[2] + int(v)) for u, v in zip(columns, rows, strict=True)})
    return pixels


def degree_of(pixels: list[set[tuple[int, int]]]) -> Fraction:
    """Membership mu of pixels (u, v) of the world's views, literally."""
    colors = [
        tuple(int(x) for x in view.image[v, u]) for view, place in zip(world().views, pixels, strict=True)
        for u, v in place
    ]  # fmt: skip
    return membership(colors, "luminance")


@cache
def literal() -> Result:
    volume = hull_of("voxel-coloring").volume
    found = sweep_direction(world().centers, volume.bounds.corners)
    assert found is not None
    full = volume.with_occupancy(np.ones(volume.shape, np.bool_))
    return color_voxels(world(), full, found.direction)


@pytest.mark.parametrize("label", [Label.BACKGROUND, Label.INCONSISTENT, Label.HIDDEN, Label.CONSISTENT])
def test_voxel_colouring_is_explained_as_the_literal_reference_does_it(label: Label) -> None:
    volume = hull_of("voxel-coloring").volume
    for index in some_voxels(hull_of("voxel-coloring"), label, 5):
        explanation = explained("voxel-coloring", index)
        voxel = explanation.voxel
        assert explanation.label == literal().labels[voxel] == label
        boxes = [footprint(view, volume, voxel) or [] for view in world().views]
        seen = [
            [pixel for pixel in box if in_image(view, pixel)] for view, box in zip(world().views, boxes, strict=True)
        ]
        votes = literal().votes.get(voxel, [[] for _ in world().views])
        assert voting_pixels(explanation) == [set(pixels) for pixels in votes]
        for view, evidence, pixels, vote in zip(world().views, explanation.views, seen, votes, strict=True):
            assert evidence.kinds.size == len(pixels)
            background = sum(not foreground(view, pixel) for pixel in pixels)
            assert evidence.count(PixelKind.BACKGROUND) == background
            taken = 0 if label == Label.BACKGROUND else len(pixels) - background - len(vote)
            assert evidence.count(PixelKind.TAKEN) == taken
        excluding = [
            view.name for view, box, pixels in zip(world().views, boxes, seen, strict=True)
            if box and len(pixels) == len(box) and not any(foreground(view, pixel) for pixel in pixels)
        ]  # fmt: skip
        assert list(explanation.excluded_by) == excluding
        assert bool(excluding) == (label == Label.BACKGROUND)
        assert len(explanation.judgements) == (voxel in literal().degree)
        if explanation.last:
            n_views = literal().n_views[voxel]
            assert explanation.last.degree == float(literal().degree[voxel])
            assert explanation.last.low == float(alternating_harmonic(2 * n_views))
            assert explanation.last.high == float(alternating_harmonic(2 * n_views + 1))
            assert explanation.last.n_views == n_views


@pytest.mark.parametrize("method", OBSERVED)
def test_the_pixels_told_give_the_degree_told(method: str) -> None:
    hull = hull_of(method)
    for label in (Label.INCONSISTENT, Label.CONSISTENT):
        for index in some_voxels(hull, label, 4):
            explanation = explained(method, index)
            pixels = voting_pixels(explanation)
            n_views = sum(bool(place) for place in pixels)
            last = explanation.last
            assert last is not None
            assert last.degree == float(degree_of(pixels))
            assert np.float32(last.degree) == hull.degree[explanation.voxel]
            assert last.n_views == n_views == hull.n_views[explanation.voxel]
            assert (last.low, last.high) == tuple(float(alternating_harmonic(2 * n_views + k)) for k in (0, 1))


def test_generalised_voxel_colouring_tells_the_pixels_that_see_the_voxel_first() -> None:
    hull = hull_of("generalized-voxel-coloring")
    items = brute_force_items(world(), hull.volume, hull.with_interior.occupied)
    for index in some_voxels(hull, Label.CONSISTENT, 5):
        explanation = explained("generalized-voxel-coloring", index)
        flat = np.ravel_multi_index(explanation.voxel, hull.volume.shape)
        expected = [{(int(u), int(v)) for v, u in np.argwhere(item == flat)} for item in items]
        assert voting_pixels(explanation) == expected


@pytest.mark.parametrize("method", OBSERVED)
def test_candidates_are_told_through_which_voxels_they_are_connected(method: str) -> None:
    hull = hull_of(method)
    limits = np.array([[np.nan] * 2, *([float(alternating_harmonic(2 * n + k)) for k in (0, 1)] for n in range(1, 6))])
    low, high = np.moveaxis(limits[hull.n_views], -1, 0)
    between = (hull.degree > low + 1e-6) & (hull.degree < high - 1e-6)
    for label in (Label.INCONSISTENT, Label.CONSISTENT):
        candidates = np.argwhere(between & (hull.labels == label))
        for index in candidates[np.linspace(0, len(candidates) - 1, 6).astype(int)]:
            explanation = explained(method, index)
            last = explanation.last
            assert last is not None
            assert last.is_candidate
            assert last.path[0] == explanation.voxel == tuple(index)
            assert last.connected == (label == Label.CONSISTENT)
            assert explanation.hysteresis().startswith("kept" if last.connected else "dropped")
            assert "accepted voxel" in explanation.outcome()
            for a, b in pairwise(last.path):
                assert max(abs(x - y) for x, y in zip(a, b, strict=True)) == 1
            assert all(hull.labels[voxel] == label for voxel in last.path)


def test_a_dropped_candidate_tells_how_many_hang_together() -> None:
    labels = np.zeros((6, 5, 4), np.uint8)
    for voxel in ((0, 0, 0), (1, 1, 1), (2, 1, 1), (5, 4, 3)):
        labels[voxel] = CANDIDATE
    faces, all_sides = neighbour_offsets(6), neighbour_offsets(26)
    assert path_to_consistent(labels, (0, 0, 0), all_sides) == (((0, 0, 0),), 3)
    assert path_to_consistent(labels, (0, 0, 0), faces) == (((0, 0, 0),), 1)
    assert path_to_consistent(labels, (5, 4, 3), all_sides) == (((5, 4, 3),), 1)
    labels[3, 1, 1] = Label.CONSISTENT
    assert path_to_consistent(labels, (1, 1, 1), faces) == (((1, 1, 1), (2, 1, 1), (3, 1, 1)), 2)
    labels[0, 0, 1] = Label.CONSISTENT
    assert path_to_consistent(labels, (1, 1, 1), all_sides)[0] == ((1, 1, 1), (0, 0, 1))


def test_every_outcome_says_what_it_is() -> None:
    hull = hull_of("voxel-coloring")
    expected = {
        Label.BACKGROUND: "background: carved before any test: outside the silhouettes of view",
        Label.INCONSISTENT: "inconsistent: carved, its degree",
        Label.HIDDEN: "hidden: no pixel is free to show it",
        Label.CONSISTENT: "consistent: accepted, its degree",
    }
    for label, text in expected.items():
        explanation = explained("voxel-coloring", some_voxels(hull, label, 1)[0])
        assert explanation.outcome().startswith(text)
        assert text in repr(explanation)
    wide = replace(world(), bounds=Bounds([-3.5, -2.5, -2.5], [2.5, 2.5, 2.5]))
    settings = Settings(voxel_size=0.5, carving=recon3d.VoxelColoring())
    wide_hull = recon3d.reconstruct(wide, settings).carved
    unseen = wide_hull.volume.origin + 0.5 * (np.argwhere(wide_hull.labels == Label.UNSEEN)[0] + 0.5)
    assert explain(wide, settings, at=unseen).outcome() == "unseen: no image shows it, or a camera stands there"


def test_the_lines_count_the_pixels() -> None:
    explanation = explained("voxel-coloring", some_voxels(hull_of("voxel-coloring"), Label.CONSISTENT)[-1])
    rows = explanation.summary()
    for view in explanation.views:
        line = str(rows[f"view {view.name}"])
        if view.count(PixelKind.VOTED):
            values = view.luminances
            assert line.startswith(f"{len(values)} of {view.kinds.size} pixels voted, luminance {values.min()}..")


@pytest.mark.parametrize("method", METHODS)
def test_every_dense_methodtells_the_label_and_what_it_cannot_tell(method: str) -> None:
    hull = hull_of(method)
    for label in (Label.CONSISTENT, Label.BACKGROUND):
        explanation = explained(method, some_voxels(hull, label, 2)[-1])
        assert explanation.label == label
        assert ("not known" in explanation.summary()) == (method not in (*OBSERVED, "visual-hull", "fine-visual-hull"))
        assert bool(explanation.excluded_by) == (label == Label.BACKGROUND)
        picture = explanation.picture()
        assert picture.dtype == np.uint8
        assert picture.ndim == 3
        assert (picture == 255).all(axis=2).mean() < 0.9


@pytest.mark.parametrize("method", ["visual-hull", "generalized-voxel-coloring"])
def test_silhouettes_exclude_by_the_voxels_centre_where_the_dense_methoddoes(method: str) -> None:
    hull = hull_of(method)
    for index in some_voxels(hull, Label.BACKGROUND, 6):
        explanation = explained(method, index)
        for view, evidence in zip(world().views, explanation.views, strict=True):
            (u, v), _ = (x[0] for x in view.project(explanation.center[None]))
            assert view.silhouette is not None
            around = view.silhouette[max(round(v) - 1, 0) : round(v) + 2, max(round(u) - 1, 0) : round(u) + 2]
            # The outline is smooth, so a pixel beside it may be on either side.
            assert around.all() <= (not evidence.excludes) or not around.size
            assert bool(evidence.excludes) or around.any() or not around.size


def test_a_view_without_silhouette_excludes_nothing() -> None:
    views = world().views
    scene = replace(world(), views=(replace(views[0], mask=None), *views[1:]))
    hull = hull_of("visual-hull")
    for index in some_voxels(hull, Label.BACKGROUND, 4):
        place = hull.volume.origin + hull.volume.voxel_size * (index + 0.5)
        told = explain(scene, settings_of("visual-hull"), at=place).views
        assert not told[0].excludes
        assert [view.excludes for view in told[1:]] == [
            view.excludes for view in explained("visual-hull", index).views[1:]
        ]


def test_a_pixel_means_the_first_accepted_voxel_on_its_ray() -> None:
    hull = hull_of("voxel-coloring")
    items = brute_force_items(world(), hull.volume, hull.volume.occupied)
    for row, column in np.argwhere(items[2] >= 0)[::90]:
        clicked = explain(world(), settings_of("voxel-coloring"), pixel=(world().views[2].name, column, row))
        assert np.ravel_multi_index(clicked.voxel, hull.volume.shape) == items[2, row, column]
        assert "first accepted voxel" in clicked.chosen


def test_a_pixel_of_a_hole_means_what_came_nearest_to_being_accepted() -> None:
    hull = hull_of("voxel-coloring")
    asked = {"degree": 0, "silhouettes": 0}
    view = world().views[1]
    for row in range(0, view.height, 3):
        for column in range(0, view.width, 3):
            try:
                ray = voxels_on_ray(world(), hull.volume, (view.name, column, row))
            except ValueError:
                continue
            if any(hull.volume.occupied[voxel] for voxel in ray):
                continue
            judged = [voxel for voxel in ray if not np.isnan(hull.degree[voxel])]
            kind = "degree" if judged else "silhouettes"
            asked[kind] += 1
            if asked[kind] > 2:
                continue
            clicked = explain(world(), settings_of("voxel-coloring"), pixel=(view.name, column, row))
            assert kind in clicked.chosen
            assert view.silhouette is not None
            assert ("silhouette leaves this pixel out" in clicked.chosen) != view.silhouette[row, column]
            if judged:
                assert hull.degree[clicked.voxel] == max(hull.degree[voxel] for voxel in judged)
            else:
                fewest = [
                    len(explain(world(), settings_of("voxel-coloring"), at=hull.volume.origin
                                + hull.volume.voxel_size * (np.array(voxel) + 0.5)).excluded_by) for voxel in ray
                ]  # fmt: skip
                assert len(clicked.excluded_by) == min(fewest)
    assert min(asked.values()) > 0


def test_an_observer_changes_nothing() -> None:
    for method in OBSERVED:
        hull, watched = hull_of(method), explained(method, np.array([3, 3, 3])).carved
        np.testing.assert_array_equal(hull.labels, watched.labels)
        np.testing.assert_array_equal(hull.degree, watched.degree)


def test_the_choice_of_views_of_a_result_is_kept() -> None:
    scene = photographs(ball_mesh(), taken_by=cameras(8, arc=360))
    done = recon3d.reconstruct(scene, Settings(n_voxels=1000, max_views=3, carving=recon3d.VoxelColoring()))
    explanation = explain(done.scene, done.settings, at=[0.0, 0.0, 0.9])
    assert [view.name for view in explanation.scene.views] == [view.name for view in done.scene.views]
    np.testing.assert_array_equal(explanation.carved.labels, done.carved.labels)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "expected a place"),
        ({"at": [0, 0, 0], "pixel": ("view01.png", 3, 3)}, "expected a place"),
        ({"at": [0, 0]}, "expected a place of three finite numbers"),
        ({"at": [0, 0, np.nan]}, "expected a place of three finite numbers"),
        ({"at": [0, 0, 9]}, "the place 0,0,9 lies outside the volume, which spans -1"),
        ({"pixel": ("view01.png", 48, 3)}, "view view01.png has 48x36 pixels, got pixel 48,3"),
        ({"pixel": ("view01.png", 0, 0)}, "the ray of pixel 0,0 of view view01.png misses the volume"),
    ],
)
def test_a_bad_place_is_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        explain(world(), settings_of("voxel-coloring"), **arguments)  # type: ignore[arg-type]


def test_an_unknown_view_is_named_and_the_known_ones_too() -> None:
    with pytest.raises(recon3d.SceneError, match=r"has no view view77\.png; it has view01\.png"):
        explain(world(), settings_of("voxel-coloring"), pixel=("view77.png", 3, 3))


def test_a_sharp_result_is_explained_with_what_matching_left(temple: BuiltInScene, tmp_path: Path) -> None:
    settings = Settings(n_voxels=8000, carving=recon3d.VisualHull(), matching=PASSES)
    checkpoints = Checkpoints(tmp_path)
    sharp = recon3d.reconstruct(temple.scene, settings, checkpoints=checkpoints)
    hull = sharp.carved.dense()
    carved = recon3d.carve(temple.scene, settings.lattice(temple.scene), recon3d.VisualHull()).dense().labels
    away = np.argwhere((carved == Label.CONSISTENT) & (hull.labels == Label.INCONSISTENT))[0]
    bared = np.argwhere((carved == Label.HIDDEN) & (hull.labels == Label.CONSISTENT))[0]
    for voxel, outcome in ((away, "inconsistent: carved by matching, "), (bared, "consistent: kept, ")):
        low = hull.volume.origin + hull.volume.voxel_size * voxel
        found = explain(temple.scene, settings, at=low + 0.5 * hull.volume.voxel_size, checkpoints=checkpoints)
        assert found.carved.counts() == hull.counts()
        assert found.outcome().startswith(outcome)
        points = np.asarray(sharp.points.points)
        inside = ((points >= low) & (points < low + hull.volume.voxel_size)).all(axis=1).sum()
        label = Label(int(carved[tuple(voxel)])).name.lower()
        assert found.summary()["matching"] == f"carving left it {label}; {inside} points of the mesh lie in it"


OWN_TEST = """
import numpy as np
from recon3d import Verdict

def at_most(patches, spread=60):
    low = np.minimum.reduceat(patches.colors.max(axis=1), patches.starts[:-1]) if patches.n_voxels else np.empty(0)
    high = np.maximum.reduceat(patches.colors.max(axis=1), patches.starts[:-1]) if patches.n_voxels else np.empty(0)
    limit = np.full(patches.n_voxels, 1 - spread / 255)
    return Verdict(1 - (high - low.astype(float)) / 255, limit, limit)
"""


def typed(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    """Run the command line in this process."""
    monkeypatch.setattr("sys.argv", ["recon3d", *map(str, arguments)])
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # which it replaces
    with contextlib.suppress(SystemExit):
        cli.main()


@pytest.fixture
def saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of a result by a user's own test, in a current directory that holds the test."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_own_test.py").write_text(OWN_TEST)
    write_middlebury(world(), tmp_path / "photographs")
    typed(
        monkeypatch, "reconstruct", "photographs", "--voxels", 2500, "-o", tmp_path / "out", "--no-pictures",
        "--method", "voxel-coloring", "--test", "my_own_test:at_most", "--test-option", "spread=70",
        "--silhouettes", "photographs/silhouettes",
    )  # fmt: skip
    return tmp_path / "out"


def test_a_saved_result_is_explained_with_its_own_scene_and_test(
    saved: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    typed(monkeypatch, "explain", saved, "--pixel", "view02.png,24,18", "--test", "my_own_test:at_most")
    printed = capsys.readouterr()
    assert printed.err == ""  # the same voxels as recorded
    assert "consistent: accepted" in printed.out
    assert "my_own_test:at_most(spread=70)" in printed.out
    assert "thresholds 0.7255 and 0.7255" in printed.out
    written = Path(printed.out.split("picture:")[1].strip())
    assert written.parent == saved / "explanations"
    assert written.stat().st_size > 0


def test_a_result_that_would_now_be_another_is_warned_of(
    saved: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record = json.loads((saved / "record.json").read_text())
    record["voxels"]["consistent"] += 1
    (saved / "record.json").write_text(json.dumps(record))
    capsys.readouterr()
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        typed(monkeypatch, "explain", saved, "--at", "0,0,0.6", "--test", "my_own_test:at_most")
    assert "Warning: " in (text := capsys.readouterr().err)
    assert "other voxels are left than recorded" in text


def test_mistakes_are_one_line(
    saved: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record = json.loads((saved / "record.json").read_text())
    opaque = {"name": "voxel-coloring", "options": {"test": {"name": "mine.Test", "options": {}}}}
    for name, change in (("sourceless", {"scene": {**record["scene"], "source": None}}),
                         ("testless", {"settings": {**record["settings"], "carving": opaque}}),
                         ("bare", {"settings": None})):  # fmt: skip
        (saved.parent / name).mkdir()
        (saved.parent / name / "record.json").write_text(json.dumps({**record, **change}))
    own = ["--test", "my_own_test:at_most"]
    for arguments, message in (
        ([saved], "expected --at X,Y,Z or --pixel VIEW,U,V"),
        ([saved, "--at", "0,0,0"], "the test my_own_test:at_most is not the package's own, and code is not run"),
        ([saved, "--at", "1,2"], "--at: expected three numbers X,Y,Z, got '1,2'"),
        ([saved, "--at", "0,0,9", *own], "lies outside the volume"),
        ([saved, "--pixel", "view01.png"], "--pixel: expected a view's name and two numbers U,V"),
        ([saved, "--pixel", "view77.png,3,3", *own], "has no view view77.png"),
        ([saved, "--pixel", "view01.png,0,0", *own], "misses the volume"),
        ([saved / "nowhere", "--at", "0,0,0"], "expected the folder of a result, with a record.json"),
        (["sourceless", "--at", "0,0,0", *own], "no record says which scene this was made of"),
        (["testless", "--at", "0,0,0"], "the test mine.Test is not the package's own"),
        (["bare", "--at", "0,0,0"], "expected the folder of a result, with a record.json that tells the settings"),
    ):
        capsys.readouterr()
        typed(monkeypatch, "explain", *arguments)
        printed = capsys.readouterr()
        assert message in printed.err
        assert len(printed.err.strip().splitlines()) == 1
        assert printed.out == ""


def test_a_record_runs_no_code_that_the_user_did_not_name(
    saved: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record = json.loads((saved / "record.json").read_text())
    marker = saved.parent / "marker"
    hostile = {"name": "subprocess:Popen", "options": {"args": ["touch", str(marker)]}}
    record["settings"]["carving"] = {"name": "voxel-coloring", "options": {"test": hostile}}
    (saved / "record.json").write_text(json.dumps(record))
    for test in ([], ["--test", "my_own_test:at_most"]):
        capsys.readouterr()
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            typed(monkeypatch, "explain", saved, "--at", "0,0,0.6", *test)
        err = capsys.readouterr().err
        assert "subprocess:Popen" in err
        assert ("code is not run because a file names it" in err) != bool(test)
    assert not marker.exists()
