from __future__ import annotations

import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from formats import farthest_apart, without_skew, write_colmap, write_masks, write_photographs

from recon3d.datasets.synthetic import BuiltInScene
from recon3d.errors import DataError
from recon3d.io import open_scene
from recon3d.io.files import write_image
from recon3d.scene.scene import Scene


@pytest.fixture(scope="module")
def scene(temple: BuiltInScene) -> Scene:
    return without_skew(temple.scene)


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("place", ["sparse/0", "sparse", "", "colmap/sparse/0"])
def test_a_workspace_is_read_to_the_same_cameras(scene: Scene, tmp_path: Path, place: str, binary: bool) -> None:
    write_photographs(scene, tmp_path / "images")
    write_masks(scene, tmp_path / "masks")
    write_colmap(scene, tmp_path / place, binary=binary)
    for newer in ("rigs", "frames"):
        (tmp_path / place / f"{newer}.{'bin' if binary else 'txt'}").write_bytes(b"\1" * 100)
    read = open_scene(tmp_path)
    assert farthest_apart(read, scene) < 1e-6
    for ours, its in zip(scene.views, read.views, strict=True):
        np.testing.assert_array_equal(its.image, ours.image)
        np.testing.assert_array_equal(its.silhouette, ours.silhouette)
    assert read.notes["bounds"].endswith(", found from the silhouettes of 8 views")
    tight = scene.bounds
    assert (np.array(read.bounds.low) < np.array(tight.low) + 0.1 * tight.longest).all()
    assert (np.array(read.bounds.high) > np.array(tight.high) - 0.1 * tight.longest).all()
    assert (read.bounds.extent < 1.3 * tight.extent).all()


@pytest.mark.parametrize("given", ["sparse/0", "sparse"])
def test_a_models_own_folder_is_read_with_the_photographs_above(scene: Scene, tmp_path: Path, given: str) -> None:
    write_photographs(scene, tmp_path / "set" / "images")
    write_masks(scene, tmp_path / "set" / "masks")
    write_colmap(scene, tmp_path / "set" / "sparse/0")
    read = open_scene(tmp_path / "set" / given)
    assert farthest_apart(read, scene) < 1e-6
    assert read.name == "set"
    assert all(view.has_silhouette for view in read.views)


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize(
    ("lens", "coefficients", "expected"),
    [
        ("SIMPLE_RADIAL", (-0.1,), (-0.1, 0, 0, 0)),
        ("RADIAL", (-0.1, 0.02), (-0.1, 0.02, 0, 0)),
        ("OPENCV", (-0.1, 0.02, 1e-3, -2e-3), (-0.1, 0.02, 1e-3, -2e-3)),
        ("FULL_OPENCV", (-0.1, 0.02, 1e-3, -2e-3, 0.1, 0.2, 0.3, 0.4), (-0.1, 0.02, 1e-3, -2e-3, 0.1, 0.2, 0.3, 0.4)),
        ("SIMPLE_PINHOLE", (), ()),
    ],
)
def test_the_lens_is_kept(
    scene: Scene, tmp_path: Path, lens: str, coefficients: tuple[float, ...], expected: tuple[float, ...], binary: bool
) -> None:
    write_photographs(scene, tmp_path / "images")
    write_colmap(scene, tmp_path / "sparse", binary=binary, lens=lens, coefficients=coefficients)
    read = open_scene(tmp_path, bounds=scene.bounds, silhouettes="none")
    view, ours = read.views[0], scene.views[0]
    assert view.calibration.distortion == expected
    one_focal = lens in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
    np.testing.assert_allclose(view.K[0], ours.K[0], rtol=0, atol=1e-9)
    assert view.K[1, 1] == ours.K[0, 0] if one_focal else ours.K[1, 1]


@pytest.mark.parametrize("binary", [False, True])
def test_a_lens_that_cannot_be_undone_is_refused_by_name(scene: Scene, tmp_path: Path, binary: bool) -> None:
    write_photographs(scene, tmp_path / "images")
    write_colmap(scene, tmp_path / "sparse", binary=binary, lens="OPENCV_FISHEYE", coefficients=(0.1, 0, 0, 0))
    with pytest.raises(DataError, match=r"OPENCV_FISHEYE cannot be undone.*image_undistorter"):
        open_scene(tmp_path)


def test_a_model_number_of_later_versions_is_refused(scene: Scene, tmp_path: Path) -> None:
    write_photographs(scene, tmp_path / "images")
    write_colmap(scene, tmp_path / "sparse", binary=True)
    data = bytearray((tmp_path / "sparse/cameras.bin").read_bytes())
    data[12:16] = struct.pack("<i", 77)
    (tmp_path / "sparse/cameras.bin").write_bytes(data)
    with pytest.raises(DataError, match="the camera model 77 cannot be undone"):
        open_scene(tmp_path)


def test_without_masks_the_box_is_found_from_the_points(scene: Scene, tmp_path: Path) -> None:
    write_photographs(scene, tmp_path / "images")
    rng = np.random.default_rng(0)
    points = rng.uniform(scene.bounds.low, scene.bounds.high, (500, 3))
    far = rng.uniform(-50, 50, (20, 3))
    write_colmap(scene, tmp_path / "sparse", points=np.vstack([points, far]))
    read = open_scene(tmp_path, silhouettes="none")
    assert ", found from 5" in read.notes["bounds"]
    np.testing.assert_allclose(read.bounds.low, scene.bounds.low, rtol=0, atol=0.15 * scene.bounds.longest)
    np.testing.assert_allclose(read.bounds.high, scene.bounds.high, rtol=0, atol=0.15 * scene.bounds.longest)


def test_photographs_that_are_missing_are_named_and_left_out(scene: Scene, tmp_path: Path) -> None:
    write_photographs(scene, tmp_path / "images")
    write_colmap(scene, tmp_path / "sparse")
    (tmp_path / "images/view03.png").unlink()
    with pytest.warns(UserWarning, match=r"left out, their photographs are missing: view03\.png$"):
        read = open_scene(tmp_path, bounds=scene.bounds, silhouettes="none")
    assert len(read.views) == 7
    shutil.rmtree(tmp_path / "images")
    with pytest.raises(DataError, match=r"none of its 8 photographs is there: looked for view01\.png in .*sparse"):
        open_scene(tmp_path)


def test_smaller_copies_of_the_photographs_have_smaller_cameras(scene: Scene, tmp_path: Path) -> None:
    for view in scene.views:
        write_image(tmp_path / "images" / view.name, view.image_at(0.5))
    write_colmap(scene, tmp_path / "sparse")
    read = open_scene(tmp_path, bounds=scene.bounds, silhouettes="none")
    half = scene.views[0].calibration.at(0.5)
    np.testing.assert_allclose(read.views[0].K, half.K, rtol=0, atol=1e-9)
    write_image(tmp_path / "images/view02.png", np.zeros((100, 100, 3), np.uint8))
    with pytest.raises(DataError, match=r"view02\.png: expected a photograph of 160x120 pixels.*got 100x100"):
        open_scene(tmp_path)


def test_the_largest_of_several_models_is_read(scene: Scene, tmp_path: Path) -> None:
    write_photographs(scene, tmp_path / "images")
    write_colmap(scene.subset(["view01.png", "view02.png"]), tmp_path / "sparse/0")
    write_colmap(scene, tmp_path / "sparse/1")
    assert len(open_scene(tmp_path, bounds=scene.bounds, silhouettes="none").views) == 8


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin", "points3D.bin"])
@pytest.mark.parametrize("kept", [3, 30, 100])
def test_a_truncated_file_is_a_data_error(scene: Scene, tmp_path: Path, file: str, kept: int) -> None:
    write_photographs(scene, tmp_path / "images")
    write_colmap(scene, tmp_path / "sparse", binary=True)
    whole = (tmp_path / "sparse" / file).read_bytes()
    (tmp_path / "sparse" / file).write_bytes(whole[:kept])
    with pytest.raises(DataError, match=file):
        open_scene(tmp_path)


@pytest.mark.parametrize(
    ("file", "line", "message"),
    [
        ("cameras.txt", "1 PINHOLE 160", "expected CAMERA_ID, MODEL"),
        ("cameras.txt", "1 PINHOLE 160 120 1 2 x 4", r"cameras\.txt:1: expected 4 numbers"),
        ("cameras.txt", "1 PINHOLE 160 120 1 2 3", r"cameras\.txt:1: expected 4 finite numbers, got 3"),
        ("images.txt", "1 1 0 0 0 0 0 0 9 view01.png", "has camera 9, which is not in cameras"),
        ("images.txt", "1 1 0 0 0 0 view01.png", r"images\.txt:1: expected IMAGE_ID"),
        ("images.txt", "", "expected at least one image"),
        ("points3D.txt", "1 0.5 x 0.5 9 9 9 0 1 0", r"points3D\.txt:1: expected 3 numbers"),
        ("points3D.txt", "1 0.5", r"points3D\.txt:1: expected 3 finite numbers"),
    ],
)
def test_a_malformed_text_is_refused_with_file_and_line(
    scene: Scene, tmp_path: Path, file: str, line: str, message: str
) -> None:
    write_photographs(scene, tmp_path / "images")
    write_colmap(scene, tmp_path / "sparse")
    (tmp_path / "sparse" / file).write_text(f"{line}\n")
    with pytest.raises(DataError, match=message):
        open_scene(tmp_path)


@pytest.mark.parametrize("folder", ["photos_kermit", "photos_kermit/sparse_text", "photos_kermit/undistorted"])
def test_a_real_workspace_is_read(real_data: Path, folder: str) -> None:
    scene = open_scene(real_data / folder)
    assert len(scene.views) == 11
    assert scene.notes["no silhouettes"] == "the background has many colors"
    assert ", found from 5" in scene.notes["bounds"]


def test_a_real_models_points_are_where_its_photographs_show_them(real_data: Path) -> None:
    model = real_data / "photos_kermit/sparse_text"
    rows = [line.split() for line in (model / "points3D.txt").read_text().splitlines() if line[:1] != "#"]
    points = {int(row[0]): [float(x) for x in row[1:4]] for row in rows}
    lines = [line.split() for line in (model / "images.txt").read_text().splitlines() if line[:1] != "#"]
    seen = {head[9]: np.array(body, float).reshape(-1, 3) for head, body in zip(lines[::2], lines[1::2], strict=True)}
    residuals = []
    for view in open_scene(model, silhouettes="none").views:
        measured = seen[view.name][seen[view.name][:, 2] >= 0]
        world = np.array([points[int(key)] for key in measured[:, 2]])
        R, t = view.cam_from_world[:3, :3], view.cam_from_world[:3, 3]
        pixels = cv2.projectPoints(world, R, t, view.K, np.array(view.calibration.distortion))[0][:, 0]
        residuals.extend(np.linalg.norm(pixels + 0.5 - measured[:, :2], axis=1))
    # COLMAP's own mean is 0.41 pixels.
    np.testing.assert_allclose(np.mean(residuals), 0.41, atol=0.02)


def test_the_cows_model_has_the_cameras_of_its_par_file(real_data: Path) -> None:
    expected = open_scene(real_data / "rendered/cow_room", silhouettes="none")
    read = open_scene(real_data / "rendered/cow_room_colmap", bounds=expected.bounds)
    assert farthest_apart(read, expected) < 1e-4
    assert all(view.has_silhouette for view in read.views)
