"""Scenes that are written in a format are read again to the same."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from foreign import taken_by
from formats import farthest_apart, without_skew
from numpy.typing import NDArray
from typer.testing import CliRunner

from recon3d import CarvingVolume, VoxelColoring, carve
from recon3d.cli.commands.convert import Form
from recon3d.cli.entry import app
from recon3d.datasets.synthetic import BuiltInScene, little_temple
from recon3d.errors import ArgumentError
from recon3d.io import FORMATS, WRITERS, open_scene, write_scene
from recon3d.scene.camera import Camera
from recon3d.scene.scene import Scene
from recon3d.scene.view import View


def held(temple: BuiltInScene, form: str) -> Scene:
    """The temple as a format can hold it, in millimetres."""
    scene = temple.scene if WRITERS[form].skew else without_skew(temple.scene)
    return replace(scene, mm_per_unit=1.0, name="little temple")


@pytest.mark.parametrize("form", WRITERS)
def test_cameras_photographs_masks_bounds_and_unit_come_back(temple: BuiltInScene, tmp_path: Path, form: str) -> None:
    scene = held(temple, form)
    folder = write_scene(scene, tmp_path / "set", form)
    assert [name for name, known in FORMATS.items() if known.recognises(folder)] == [form]
    read = open_scene(folder)
    for view, ours in zip(read.views, scene.views, strict=True):
        np.testing.assert_allclose(view.K, ours.K, rtol=0, atol=1e-9)
        np.testing.assert_allclose(view.cam_from_world, ours.cam_from_world, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(view.image, ours.image)
        np.testing.assert_array_equal(view.silhouette, ours.silhouette)  # type: ignore[arg-type]
    np.testing.assert_allclose([read.bounds.low, read.bounds.high], [scene.bounds.low, scene.bounds.high], atol=1e-12)
    assert read.mm_per_unit == 1.0


@pytest.mark.parametrize("form", WRITERS)
def test_what_was_written_carves_to_the_same_volume(temple: BuiltInScene, tmp_path: Path, form: str) -> None:
    scene = held(temple, form)
    read = open_scene(write_scene(scene, tmp_path / "set", form))
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=20_000)
    ours, theirs = (carve(each, volume, VoxelColoring()) for each in (scene, read))
    assert ours.n_accepted
    np.testing.assert_array_equal(ours.labels, theirs.labels)


@pytest.mark.parametrize("form", WRITERS)
def test_views_without_a_silhouette_have_none_again(temple: BuiltInScene, tmp_path: Path, form: str) -> None:
    scene = held(temple, form)
    scene = replace(scene, views=(replace(scene.views[0], mask=None), *scene.views[1:]))
    read = open_scene(write_scene(scene, tmp_path / "set", form))
    assert [view.has_silhouette for view in read.views] == [False] + 7 * [True]


@pytest.mark.parametrize("form", [form for form, writer in WRITERS.items() if not writer.skew])
def test_skew_is_undone_where_a_format_has_none(temple: BuiltInScene, tmp_path: Path, form: str) -> None:
    K = temple.scene.views[0].K
    K[0, 1] = 12.0
    scene = taken_by(temple.scene, K)
    with pytest.warns(UserWarning, match=rf"{form} has no skew, which moves pixels by up to 2 here"):
        folder = write_scene(scene, tmp_path / "set", form)
    read = open_scene(folder, silhouettes="none")
    points = np.random.default_rng(0).uniform(scene.bounds.low, scene.bounds.high, (300, 3))
    for view, ours in zip(read.views, scene.views, strict=True):
        assert view.K[0, 1] == 0
        expected = values_at(ours.image, ours.project(points)[0])
        resampled, left = (values_at(image, view.project(points)[0]) for image in (view.image, ours.image))
        assert np.abs(resampled - expected).mean() < 0.3 * np.abs(left - expected).mean()


def values_at(image: NDArray[np.uint8], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) bilinear values of an image at (n, 2) pixels."""
    u, v = pixels.astype(np.float32).T
    return cv2.remap(image, u[:, None], v[:, None], cv2.INTER_LINEAR)[:, 0].astype(float)


def test_a_distorted_lens_is_written_undistorted(temple: BuiltInScene, tmp_path: Path) -> None:
    def bent(view: View) -> View:
        camera = Camera(view.K, view.cam_from_world, view.width, view.height, (-0.2, 0.1, 0.0, 0.0))
        return View(camera, view.photograph, view.mask, view.name)

    scene = replace(temple.scene, views=tuple(map(bent, temple.scene.views)))
    read = open_scene(write_scene(scene, tmp_path / "set", "neus"))
    for view, ours in zip(read.views, scene.views, strict=True):
        assert not view.calibration.distortion
        np.testing.assert_array_equal(view.image, ours.image)
        np.testing.assert_array_equal(view.silhouette, ours.silhouette)  # type: ignore[arg-type]


def test_a_unit_that_is_not_known_is_not_made_up(temple: BuiltInScene, tmp_path: Path) -> None:
    scene = without_skew(temple.scene)
    first = open_scene(write_scene(replace(scene, mm_per_unit=None), tmp_path / "colmap", "colmap"))
    second = open_scene(write_scene(first, tmp_path / "middlebury", "middlebury"))
    for read in (first, second):
        assert read.mm_per_unit is None
        assert read.notes["unit"].startswith("not known")
        assert str(read.summary()["extent"]).endswith("(no scale)")


def test_nothing_is_left_of_a_scene_that_could_not_be_written(
    temple: BuiltInScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError("the disk is full")

    monkeypatch.setattr("recon3d.io.writing.write_readme", fail)
    with pytest.raises(OSError, match="full"):
        write_scene(temple.scene, tmp_path / "set", "neus")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_holds_something_is_not_written_to(temple: BuiltInScene, tmp_path: Path) -> None:
    (tmp_path / "old.txt").write_text("of another scene")
    with pytest.raises(ArgumentError, match="expected a new folder, or an empty one"):
        write_scene(temple.scene, tmp_path, "neus")
    with pytest.raises(
        ArgumentError, match="expected a format colmap, transforms, neus, middlebury, open3d, got 'nvm'"
    ):
        write_scene(temple.scene, tmp_path / "set", "nvm")
    assert [path.name for path in tmp_path.iterdir()] == ["old.txt"]


def test_an_empty_folder_may_be_there(temple: BuiltInScene, tmp_path: Path) -> None:
    write_scene(temple.scene, tmp_path, "neus")
    assert (tmp_path / "cameras_sphere.npz").is_file()
    (tmp_path / "any").mkdir()
    assert tmp_path.stat().st_mode == (tmp_path / "any").stat().st_mode


def test_photographs_of_several_sizes_do_not_fit_one_middlebury_set(temple: BuiltInScene, tmp_path: Path) -> None:
    scene = without_skew(temple.scene)
    first = scene.views[0]
    half = View(first.calibration.scaled(80, 60), first.image_at(0.5), None, "half.png")
    scene = replace(scene, views=(*scene.views, half))
    with pytest.raises(ArgumentError, match="photographs of one size, got 160x120, 80x60"):
        write_scene(scene, tmp_path / "set", "middlebury")
    for form in ("neus", "open3d", "transforms"):
        read = open_scene(write_scene(scene, tmp_path / form, form), silhouettes="none")
        assert (read.views[-1].width, read.views[-1].height) == (80, 60)


def test_the_command_line_converts_from_format_to_format(tmp_path: Path) -> None:
    scene = little_temple(n_views=4, width=160, height=120).scene
    source = write_scene(scene, tmp_path / "neus", "neus")
    done = CliRunner().invoke(app, ["convert", str(source), "--to", "middlebury", "-o", str(tmp_path / "middlebury")])
    assert done.exit_code == 0, done.output
    assert str(tmp_path / "middlebury") in done.output
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = open_scene(tmp_path / "middlebury")
    named = tuple(replace(view, name=ours.name) for view, ours in zip(read.views, scene.views, strict=True))
    assert farthest_apart(replace(read, views=named), scene) < 1e-9
    assert [form.value for form in Form] == list(WRITERS)
