"""Stages of a run in a folder: what is damaged or made from something else is as good as absent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, cameras, grain, photographs, plain_view

import recon3d
from recon3d import Bounds, CarvedVolume, Reconstruction, Scene, Settings
from recon3d.io.checkpoints import Checkpoints
from recon3d.pipeline import keep_stages
from recon3d.stereo.refinement import PASSES

ARRAYS = {"planes": np.arange(12, dtype=np.float32).reshape(2, 2, 3), "costs": np.ones((2, 2), np.float32)}
SETTINGS = Settings(n_voxels=8000)


def assert_same(one: dict[str, NDArray[Any]], two: dict[str, NDArray[Any]]) -> None:
    assert set(one) == set(two)
    for name, array in one.items():
        assert two[name].dtype == array.dtype
        np.testing.assert_array_equal(two[name], array)


def test_stages_come_back_as_they_were(tmp_path: Path) -> None:
    folder = Checkpoints(tmp_path / "stages", "key")
    assert list(folder) == []
    names = ["carving", "pass 1 view ../ü 1.png"]
    for name in names:
        folder[name] = ARRAYS
    again = Checkpoints(tmp_path / "stages", "key")
    assert sorted(again) == names
    assert len(again) == 2
    assert_same(again["pass 1 view ../ü 1.png"], ARRAYS)
    assert [path.parent for path in tmp_path.rglob("*.npz")] == [tmp_path / "stages"] * 2
    del again["carving"]
    assert "carving" not in folder
    with pytest.raises(KeyError):
        del folder["carving"]


def test_stages_of_another_key_are_absent_and_replaced(tmp_path: Path) -> None:
    old, new = Checkpoints(tmp_path, "old"), Checkpoints(tmp_path, "new")
    old["carving"] = ARRAYS
    assert "carving" not in new
    new["carving"] = {"labels": np.zeros(3)}
    assert "carving" not in old
    assert_same(new["carving"], {"labels": np.zeros(3)})


@pytest.mark.filterwarnings("error")  # a file left open would warn, too
def test_any_damage_makes_a_stage_absent(tmp_path: Path) -> None:
    folder = Checkpoints(tmp_path, "key")
    folder["view"] = ARRAYS
    path = tmp_path / "view.npz"
    whole = path.read_bytes()
    damaged = [whole[:n] for n in range(0, len(whole), 7)]
    damaged += [whole[:n] + bytes([whole[n] ^ 0xFF]) + whole[n + 1 :] for n in range(len(whole))]
    n_absent = 0
    for content in damaged:
        path.write_bytes(content)
        try:
            assert_same(folder["view"], ARRAYS)  # some bytes, such as a date, mean nothing
        except KeyError:
            n_absent += 1
    assert n_absent > 0.5 * len(damaged)


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


def run(scene: Scene, folder: Path, settings: Settings = SETTINGS, **options: Any) -> tuple[Reconstruction, list[str]]:
    """A reconstruction that keeps its stages, and which of them it made."""
    stages = keep_stages(folder, scene, settings)
    assert stages is not None
    made: list[str] = []

    class Watched(Checkpoints):
        def __setitem__(self, name: str, arrays: dict[str, NDArray[Any]]) -> None:
            made.append(name)
            super().__setitem__(name, arrays)

    result = recon3d.reconstruct(scene, settings, stages=Watched(stages.folder, stages.key), **options)
    return result, made


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


ALL = ["carving", *(f"pass {p} view {n}" for p in range(1, 1 + len(PASSES)) for n in (1, 2, 3, 4))]


@pytest.mark.parametrize("count", [1, 6])
def test_an_interrupted_run_goes_on_to_the_identical_result(
    scene: Scene, undisturbed: Reconstruction, tmp_path: Path, count: int
) -> None:
    with pytest.raises(StoppedError):
        run(scene, tmp_path, progress=stop_after(count))
    assert len(list(tmp_path.iterdir())) == 1 + count
    result, made = run(scene, tmp_path)
    assert made == ALL[1 + count :]
    assert_same_result(result, undisturbed)


def test_a_finished_run_is_not_done_again_but_for_what_was_damaged(
    scene: Scene, undisturbed: Reconstruction, tmp_path: Path
) -> None:
    first, made = run(scene, tmp_path)
    assert made == ALL
    assert_same_result(first, undisturbed)
    (tmp_path / "carving.npz").write_bytes(b"not a stage")
    (tmp_path / "pass 1 view 3.npz").unlink()
    again, made = run(scene, tmp_path)
    assert made == ["carving", "pass 1 view 3"]
    assert_same_result(again, undisturbed)


def test_what_matters_to_a_stage_is_in_its_key(scene: Scene, tmp_path: Path) -> None:
    def key(of: Scene = scene, **changes: Any) -> str:
        stages = keep_stages(tmp_path, of, replace(SETTINGS, **changes))
        assert stages is not None
        return stages.key

    other = replace(scene.views[0], photograph=scene.views[0].image // 2)
    darker = replace(scene, views=(other, *scene.views[1:]))
    different = [
        key(), key(darker), key(n_voxels=9000), key(n_voxels=None, voxel_size=0.2),
        key(carving=recon3d.VisualHull(), matching=recon3d.PASSES), key(carving=recon3d.VoteCarving(min_score=0.5)),
        key(matching=recon3d.PASSES[:2]), key(views=("view0[1-3].png",)), key(max_views=3),
    ]  # fmt: skip
    assert len(set(different)) == len(different)
    # What only comes after matching may change.
    assert key(meshing=recon3d.Meshing("graph-cut", keep_unsupported=False, min_component=0)) == key()
    assert key(carving=recon3d.VoteCarving(np.float64(0.5))) == key(carving=recon3d.VoteCarving(0.5))


def test_no_stages_are_kept_of_a_test_that_may_change_without_a_trace(scene: Scene, tmp_path: Path) -> None:
    for method in (recon3d.GeneralizedVoxelColoring(recon3d.StandardDeviation()), recon3d.VoxelColoring()):
        assert keep_stages(tmp_path, scene, Settings(carving=method)) is None


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
