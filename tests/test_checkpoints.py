"""Finished stages of a run in a folder: what is damaged or was made from something else counts as missing."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import time
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, cameras, grain, photographs, plain_view

import recon3d
from recon3d import (
    Bounds,
    CarvedVolume,
    Matching,
    Meshing,
    Reconstruction,
    Scene,
    Settings,
    VisualHull,
    VoteCarving,
    VoxelColoring,
)
from recon3d.consistency import StandardDeviation
from recon3d.io.checkpoints import Checkpoints
from recon3d.io.files import atomic_folder, atomic_path
from recon3d.stereo.refinement import PASSES
from recon3d.tasks import Arrays, Kept, once, threads

ARRAYS = {"planes": np.arange(12, dtype=np.float32).reshape(2, 2, 3), "costs": np.ones((2, 2), np.float32)}
QUICK = (Matching(stride=4, rounds=1),)
SETTINGS = Settings(n_voxels=8000)


def assert_same(one: dict[str, NDArray[Any]], two: dict[str, NDArray[Any]]) -> None:
    assert set(one) == set(two)
    for name, array in one.items():
        assert two[name].dtype == array.dtype
        np.testing.assert_array_equal(two[name], array)


def test_arrays_come_back_as_they_were(tmp_path: Path) -> None:
    folder = Checkpoints(tmp_path / "stages")
    assert folder.names() == []
    names = ["carving", "pass 1 view ../ü 1.png"]
    for name in names:
        folder.write(name, "key", ARRAYS)
    again = Checkpoints(tmp_path / "stages")
    assert again.names() == names
    found = again.read("pass 1 view ../ü 1.png", "key")
    assert found is not None
    assert_same(found, ARRAYS)
    assert [path.parent for path in tmp_path.rglob("*.npz")] == [tmp_path / "stages"] * 2
    assert again.read("matching", "key") is None


def test_entries_of_another_key_count_as_missing_and_are_overwritten(tmp_path: Path) -> None:
    folder = Checkpoints(tmp_path)
    folder.write("carving", "old", ARRAYS)
    assert folder.read("carving", "new") is None
    folder.write("carving", "new", {"labels": np.zeros(3)})
    assert folder.read("carving", "old") is None
    found = folder.read("carving", "new")
    assert found is not None
    assert_same(found, {"labels": np.zeros(3)})


def test_what_a_killed_run_left_is_removed_an_hour_later(tmp_path: Path) -> None:
    Checkpoints(tmp_path).write("carving", "key", ARRAYS)
    with atomic_path(tmp_path / "view.npz") as temporary:
        left = tmp_path / f"{temporary.name}-of-a-killed-run"
        left.write_bytes(b"half")
    (tmp_path / "view.npz").unlink()
    with atomic_folder(tmp_path / "scene") as temporary:
        left_folder = tmp_path / f"{temporary.name}-of-a-killed-run"
        (left_folder / "images").mkdir(parents=True)
    (tmp_path / "scene").rmdir()
    Checkpoints(tmp_path)
    assert left.exists()  # it may belong to a run that still goes on
    for path in (left, left_folder):
        os.utime(path, (time() - 4000, time() - 4000))
    Checkpoints(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["carving.npz"]


@pytest.mark.filterwarnings("error")  # a file left open would warn, too
def test_whatever_is_damaged_counts_as_missing(tmp_path: Path) -> None:
    folder = Checkpoints(tmp_path)
    folder.write("view", "key", ARRAYS)
    path = tmp_path / "view.npz"
    whole = path.read_bytes()
    damaged = [whole[:n] for n in range(0, len(whole), 7)]
    damaged += [whole[:n] + bytes([whole[n] ^ 0xFF]) + whole[n + 1 :] for n in range(len(whole))]
    n_missing = 0
    for content in damaged:
        path.write_bytes(content)
        found = folder.read("view", "key")
        if found is None:
            n_missing += 1
        else:
            assert_same(found, ARRAYS)  # some bytes, such as a date, mean nothing
    assert n_missing > 0.5 * len(damaged)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return photographs(ball_mesh(1, 24), grain, cameras(4, arc=60, width=80, height=60))


@pytest.fixture(scope="module")
def undisturbed(scene: Scene) -> Reconstruction:
    """Without stages."""
    return recon3d.reconstruct(scene, SETTINGS)


class StoppedError(Exception):
    """What a user's interrupt is to these tests."""


def stop_after(count: int, stage: str = "matching") -> Callable[[str, int, int], None]:
    def report(name: str, done: int, _total: int) -> None:
        if (name, done) == (stage, count):
            raise StoppedError

    return report


class Watched(Checkpoints):
    """Checkpoints that know what was read from them, and what written."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.found: list[str] = []
        self.made: list[str] = []

    def read(self, name: str, key: str) -> dict[str, NDArray[Any]] | None:
        arrays = super().read(name, key)
        if arrays is not None:
            self.found.append(name)
        return arrays

    def write(self, name: str, key: str, arrays: Arrays) -> None:
        self.made.append(name)
        super().write(name, key, arrays)


def run(
    scene: Scene, folder: Path, settings: Settings = SETTINGS, **options: Any
) -> tuple[Reconstruction, list[str], list[str]]:
    """A reconstruction that keeps its stages, which of them it made, and which it found."""
    watched = Watched(folder)
    result = recon3d.reconstruct(scene, settings, checkpoints=watched, **options)
    return result, watched.made, watched.found


def assert_same_result(one: Reconstruction, two: Reconstruction) -> None:
    assert_same(one.carved.arrays(), two.carved.arrays())
    for a, b in ((one.points.points, two.points.points), (one.points.colors, two.points.colors)):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))
    assert one.confidence is not None
    assert two.confidence is not None
    np.testing.assert_array_equal(one.confidence, two.confidence)
    np.testing.assert_array_equal(np.asarray(one.mesh.vertices), np.asarray(two.mesh.vertices))
    np.testing.assert_array_equal(np.asarray(one.mesh.triangles), np.asarray(two.mesh.triangles))
    np.testing.assert_array_equal(one.support, two.support)


def names_of_pass(n: int) -> list[str]:
    return [*(f"pass {n} view {view}" for view in (1, 2, 3, 4)), f"pass {n}"]


ALL = ["carving", *(name for n in range(1, 1 + len(PASSES)) for name in names_of_pass(n))]


@pytest.mark.parametrize("count", [1, 6])
def test_an_interrupted_run_resumes_to_the_identical_result(
    scene: Scene, undisturbed: Reconstruction, tmp_path: Path, count: int
) -> None:
    with pytest.raises(StoppedError):
        run(scene, tmp_path, progress=stop_after(count))
    finished = 1 + count + (count - 1) // 4  # carving, views, and the passes before
    assert Checkpoints(tmp_path).names() == sorted(ALL[:finished])
    result, made, found = run(scene, tmp_path)
    assert made == ALL[finished:]
    assert len(found) == len(set(found))  # nothing is read twice
    assert_same_result(result, undisturbed)


def test_a_finished_run_is_not_done_again_but_for_what_was_damaged(
    scene: Scene, undisturbed: Reconstruction, tmp_path: Path
) -> None:
    first, made, _ = run(scene, tmp_path)
    assert made == ALL
    assert_same_result(first, undisturbed)
    again, made, found = run(scene, tmp_path)
    assert made == []
    assert found == ["carving", *(f"pass {n + 1}" for n in range(len(PASSES)))]
    assert_same_result(again, undisturbed)
    (tmp_path / "carving.npz").write_bytes(b"not a stage")
    (tmp_path / "pass 1.npz").unlink()
    (tmp_path / "pass 1 view 3.npz").unlink()
    again, made, _ = run(scene, tmp_path)
    assert made == ["carving", "pass 1 view 3", "pass 1"]
    assert_same_result(again, undisturbed)


def test_the_result_is_the_same_for_any_number_of_workers(
    scene: Scene, undisturbed: Reconstruction, tmp_path: Path
) -> None:
    with threads(3) as executor:
        result, made, _ = run(scene, tmp_path, executor=executor)
    assert sorted(made) == sorted(ALL)
    assert_same_result(result, undisturbed)


@pytest.mark.parametrize(
    "changes",
    [
        "darker", {"n_voxels": 9000}, {"n_voxels": None, "voxel_size": 0.2}, {"carving": VoteCarving(min_score=0.5)},
        {"carving": VisualHull()},
    ],
)  # fmt: skip
def test_another_carving_is_made_with_all_that_depends_on_it(scene: Scene, tmp_path: Path, changes: Any) -> None:
    settings = replace(SETTINGS, matching=QUICK)
    run(scene, tmp_path, settings)
    if changes == "darker":
        darker = replace(scene.views[0], photograph=scene.views[0].image // 2)
        _, made, _ = run(replace(scene, views=(darker, *scene.views[1:])), tmp_path, settings)
    else:
        _, made, _ = run(scene, tmp_path, replace(settings, **changes))
    assert made == ["carving", *names_of_pass(1)]


def test_what_comes_before_a_change_is_not_made_again(scene: Scene, tmp_path: Path) -> None:
    settings = replace(SETTINGS, carving=VoteCarving(0.6), matching=QUICK)
    run(scene, tmp_path, settings)
    meshing = Meshing("graph-cut", keep_unsupported=False, min_component=0)
    equal = replace(settings, carving=VoteCarving(np.float64(0.6)), meshing=meshing)
    assert run(scene, tmp_path, equal)[1] == []
    assert run(scene, tmp_path, replace(settings, matching=QUICK * 2))[1] == ["pass 1", *names_of_pass(2)]
    assert run(scene, tmp_path, replace(settings, matching=(replace(QUICK[0], rounds=2),)))[1] == names_of_pass(1)


def test_carving_by_a_test_is_kept_unless_its_source_cannot_be_told(scene: Scene, tmp_path: Path) -> None:
    def made_and_found(test: Any) -> tuple[list[str], list[str]]:
        settings = Settings(n_voxels=3000, carving=VoxelColoring(test), views="all")
        return run(scene, tmp_path, settings)[1:]

    assert made_and_found(StandardDeviation(60.0)) == (["carving"], [])
    assert made_and_found(StandardDeviation(60.0)) == ([], ["carving"])
    assert made_and_found(StandardDeviation(61.0)) == (["carving"], [])
    assert made_and_found(unknown_test()) == ([], [])


def unknown_test() -> Any:
    """A test made of a closure, whose source does not tell all of it."""
    threshold = 60.0
    return lambda patches: StandardDeviation(threshold)(patches)


def test_a_fingerprint_tells_all_that_a_scene_is_made_of() -> None:
    def scene_of(**changes: Any) -> Scene:
        made: dict[str, Any] = {"width": 6, "height": 4, "name": "a", "K": K, "mask": None, "unit": 1.0, "side": 1.0}
        made |= changes
        view = plain_view(made["K"], width=made["width"], height=made["height"], name=made["name"])
        view = replace(view, mask=made["mask"])
        return Scene((view,), Bounds([-1, -1, -1], [made["side"], 1, 1]), "scene", made["unit"])

    K = np.array([[5.0, 0, 2.5], [0, 5.0, 1.5], [0, 0, 1]])
    longer = K * [[1.01, 1, 1], [1, 1, 1], [1, 1, 1]]
    everything, nothing = np.ones((4, 6), np.bool_), np.zeros((4, 6), np.bool_)
    different = [
        scene_of(), scene_of(width=4, height=6), scene_of(name="b"), scene_of(K=longer), scene_of(mask=everything),
        scene_of(mask=nothing), scene_of(unit=2.0), scene_of(side=1.5),
    ]  # fmt: skip
    assert len({scene.fingerprint() for scene in different}) == len(different)
    assert scene_of().fingerprint() == replace(scene_of(), name="other", notes={"format": "none"}).fingerprint()


def test_a_hull_comes_back_from_its_arrays(undisturbed: Reconstruction) -> None:
    hull = undisturbed.carved
    again = CarvedVolume.from_arrays(hull.volume.with_occupancy(np.zeros(hull.volume.shape, np.bool_)), hull.arrays())
    assert_same(again.arrays(), hull.arrays())
    assert again.counts() == hull.counts()
    bare = replace(hull, distance=None)
    assert "distance" not in bare.arrays()
    assert CarvedVolume.from_arrays(hull.volume, bare.arrays()).distance is None


def test_a_folder_in_the_place_of_a_stage_is_told_before_anything_is_computed(tmp_path: Path) -> None:
    (tmp_path / "carving.npz").mkdir()
    with pytest.raises(recon3d.DataError, match=r"carving\.npz: expected a file of a finished stage.*got a folder"):
        once(lambda: pytest.fail("computed"), "carving", kept=Kept(Checkpoints(tmp_path), "key", vars, vars))
