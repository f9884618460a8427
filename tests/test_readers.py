"""Scenes that the test writes as other programs do are read to the same cameras."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import open3d as o3d
import pytest
from formats import (
    farthest_apart,
    metashape,
    transforms,
    without_skew,
    write_colmap,
    write_masks,
    write_opencv,
    write_photographs,
)
from scenes import rotation

from recon3d.datasets.synthetic import BuiltInScene
from recon3d.errors import DataError
from recon3d.io import FORMATS, open_scene
from recon3d.io.files import write_image
from recon3d.scene.scene import Scene

CHUNK = (0.25, rotation(np.array([0.3, -0.5, 0.8])), np.array([3.0, -2.0, 1.0]))


@pytest.fixture(scope="module")
def scene(temple: BuiltInScene) -> Scene:
    return without_skew(temple.scene)


def write_transforms(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "images")
    (folder / "transforms.json").write_text(json.dumps(transforms(scene)))


def write_neus(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "image", [f"{n:06d}.png" for n in range(len(scene.views))])
    size = scene.bounds.longest / 2
    matrices = {}
    for n, view in enumerate(scene.views):
        matrices[f"world_mat_{n}"] = 3.7 * np.vstack([view.projection, [0, 0, 0, 1]])
        matrices[f"scale_mat_{n}"] = np.diag([size, size, size, 1.0])
        matrices[f"scale_mat_{n}"][:3, 3] = scene.bounds.center
    np.savez(folder / "cameras_sphere.npz", **matrices)


def write_mvsnet(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "images", [f"{n:08d}.png" for n in range(len(scene.views))])
    (folder / "cams").mkdir()
    for n, view in enumerate(scene.views):
        rows = ["\n".join(" ".join(map(repr, row)) for row in m.tolist()) for m in (view.cam_from_world, view.K)]
        text = f"extrinsic\n{rows[0]}\n\nintrinsic\n{rows[1]}\n\n0.5 0.01 192 0.7\n"
        (folder / f"cams/{n:08d}_cam.txt").write_text(text)
    (folder / "pair.txt").write_text("1\n0\n1 1 10.0\n")


def write_metashape(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "photos")
    (folder / "cameras.xml").write_text(metashape(scene, chunk=CHUNK))


def write_trajectory(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "color", [f"{9 + n}.png" for n in range(len(scene.views))])  # 10 comes after 9
    trajectory = o3d.camera.PinholeCameraTrajectory()
    trajectory.parameters = [view.camera for view in scene.views]
    assert o3d.io.write_pinhole_camera_trajectory(str(folder / "trajectory.json"), trajectory)


def write_parameters(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder)
    for view in scene.views:
        file = (folder / view.name).with_suffix(".json")
        assert o3d.io.write_pinhole_camera_parameters(str(file), view.camera)


def write_colmap_scene(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "images")
    write_colmap(scene, folder / "sparse/0")


def write_yaml(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "images")
    write_opencv(scene, folder / "calib.yml")


def write_xml(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder)
    write_opencv(scene, folder / "calib.xml", form="{stem}_{word}")


def write_numbered(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "images")
    write_opencv(scene, folder / "calib.yaml", form="{word}{n}")


WRITERS: dict[str, Callable[[Scene, Path], None]] = {
    "colmap": write_colmap_scene,
    "transforms": write_transforms,
    "neus": write_neus,
    "mvsnet": write_mvsnet,
    "metashape": write_metashape,
    "open3d": write_trajectory,
    "open3d, one a view": write_parameters,
    "opencv, YAML": write_yaml,
    "opencv, XML": write_xml,
    "opencv, by number": write_numbered,
}


@pytest.mark.parametrize("form", WRITERS)
def test_the_same_cameras_and_photographs_are_read(scene: Scene, tmp_path: Path, form: str) -> None:
    WRITERS[form](scene, tmp_path)
    own_box = form in ("neus", "metashape")
    read = open_scene(tmp_path, bounds=None if own_box else scene.bounds, silhouettes="none")
    named = replace(
        read, views=tuple(replace(view, name=ours.name) for view, ours in zip(read.views, scene.views, strict=True))
    )
    assert farthest_apart(named, scene) < 1e-6
    for view, ours in zip(read.views, scene.views, strict=True):
        if form != "metashape":  # has a lens
            np.testing.assert_array_equal(view.image, ours.image)
    if own_box:
        np.testing.assert_allclose(read.bounds.center, scene.bounds.center, rtol=0, atol=1e-9)
        assert read.bounds.longest >= scene.bounds.longest - 1e-9
    assert read.notes["format"]


@pytest.mark.parametrize("form", WRITERS)
def test_exactly_one_reader_knows_a_scene(scene: Scene, tmp_path: Path, form: str) -> None:
    WRITERS[form](scene, tmp_path)
    assert [name for name, known in FORMATS.items() if known.recognises(tmp_path)] == [form.partition(",")[0]]


@pytest.mark.parametrize("form", WRITERS)
def test_masks_and_a_box_are_found_whatever_the_format(scene: Scene, tmp_path: Path, form: str) -> None:
    WRITERS[form](scene, tmp_path)
    names = [view.name for view in open_scene(tmp_path, bounds=scene.bounds, silhouettes="none").views]
    for view, name in zip(scene.views, names, strict=True):
        write_image(tmp_path / "Masks" / f"{name}.png", view.silhouette)
    read = open_scene(tmp_path)
    assert read.notes["masks"] == "8 of 8 views, Masks"
    if form not in ("neus", "metashape"):
        assert read.notes["bounds"].endswith(", found from the silhouettes of 8 views")
    assert (np.array(read.bounds.low) < np.array(scene.bounds.low) + 0.1 * scene.bounds.longest).all()
    assert (np.array(read.bounds.high) > np.array(scene.bounds.high) - 0.1 * scene.bounds.longest).all()


# transforms.json


def write_changed(scene: Scene, folder: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    write_photographs(scene, folder / "images")
    content = transforms(scene)
    change(content)
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


def test_names_may_be_written_as_on_windows_without_ending_or_absolutely(scene: Scene, tmp_path: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        forms = [r"images\view01.png", "./images/view02", r"C:\shots\images\view03.png", "/home/me/images/VIEW04.PNG"]
        for frame, form in zip(content["frames"], forms, strict=False):
            frame["file_path"] = form

    read = open_scene(write_changed(scene, tmp_path, change), bounds=scene.bounds, silhouettes="none")
    assert farthest_apart(read, scene) < 1e-6
    assert [view.name for view in read.views] == [view.name for view in scene.views]


def test_frames_without_photographs_are_named_and_left_out(scene: Scene, tmp_path: Path) -> None:
    write_changed(scene, tmp_path, lambda content: content["frames"][2].update(file_path="images/gone.png"))
    with pytest.warns(
        UserWarning, match=r"transforms\.json: left out, their photographs are missing: images/gone\.png"
    ):
        read = open_scene(tmp_path, bounds=scene.bounds, silhouettes="none")
    assert "view03.png" not in [view.name for view in read.views]
    assert len(read.views) == 7


def test_a_field_of_view_is_enough_and_the_principal_point_is_then_the_middle(scene: Scene, tmp_path: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        content["camera_angle_x"] = 2 * float(np.arctan(80 / 376))
        for frame in content["frames"]:
            for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
                del frame[key]

    read = open_scene(write_changed(scene, tmp_path, change), bounds=scene.bounds, silhouettes="none")
    np.testing.assert_allclose(read.views[0].K, [[376, 0, 79.5], [0, 376, 59.5], [0, 0, 1]], rtol=0, atol=1e-9)


def test_what_was_applied_to_the_world_is_undone(scene: Scene, tmp_path: Path) -> None:
    applied = np.array([[0.0, 0, 1, 0.5], [1, 0, 0, -1], [0, 1, 0, 2], [0, 0, 0, 1]])

    def change(content: dict[str, Any]) -> None:
        content["applied_transform"] = applied[:3].tolist()
        content["applied_scale"] = 4.0
        for frame in content["frames"]:
            matrix = applied @ np.array(frame["transform_matrix"])
            matrix[:3, 3] *= 4.0
            frame["transform_matrix"] = matrix.tolist()

    read = open_scene(write_changed(scene, tmp_path, change), bounds=scene.bounds, silhouettes="none")
    assert farthest_apart(read, scene) < 1e-6


def test_a_scaled_pose_of_blender_is_a_rotation(scene: Scene, tmp_path: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        for frame in content["frames"]:
            matrix = np.array(frame["transform_matrix"])
            matrix[:3, :3] *= 2.5
            frame["transform_matrix"] = matrix.tolist()

    read = open_scene(write_changed(scene, tmp_path, change), bounds=scene.bounds, silhouettes="none")
    assert farthest_apart(read, scene) < 1e-6


def test_distortion_is_kept_in_opencvs_order_and_a_frames_own_comes_first(scene: Scene, tmp_path: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        content.update(k1=-0.1, k2=0.02, k3=0.003, p1=0.0004, p2=-0.0005)
        content["frames"][1]["k1"] = 0.3

    read = open_scene(write_changed(scene, tmp_path, change), bounds=scene.bounds, silhouettes="none")
    assert read.views[0].calibration.distortion == (-0.1, 0.02, 0.0004, -0.0005, 0.003)
    assert read.views[1].calibration.distortion[0] == 0.3


def test_masks_that_frames_name_are_used(scene: Scene, tmp_path: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        for frame in content["frames"][:6]:
            frame["mask_path"] = "keep/" + frame["file_path"].removeprefix("images/")

    write_changed(scene, tmp_path, change)
    write_masks(scene, tmp_path / "keep", "{name}")
    read = open_scene(tmp_path)
    assert read.notes["masks"] == "6 of 8 views, named by the format"
    np.testing.assert_array_equal(read.views[0].silhouette, scene.views[0].silhouette)
    assert [view.has_silhouette for view in read.views] == [True] * 6 + [False] * 2


def test_blenders_splits_are_read_together_and_opacity_is_the_mask(scene: Scene, tmp_path: Path) -> None:
    for split, views in (("train", scene.views[:5]), ("test", scene.views[4:])):
        (tmp_path / split).mkdir()
        for view in views:
            assert view.silhouette is not None
            opaque = np.dstack([view.image[..., ::-1], 255 * view.silhouette.astype(np.uint8)])
            assert cv2.imwrite(str(tmp_path / split / view.name), opaque)
        content = transforms(replace(scene, views=views), f"./{split}/{{stem}}")
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps(content))
    (tmp_path / "transforms_test.json").write_text(
        json.dumps(transforms(replace(scene, views=scene.views[5:]), "./test/{stem}"))
    )
    read = open_scene(tmp_path)
    assert [view.name for view in read.views][:5] == [f"train/view0{n}.png" for n in range(1, 6)]
    assert [view.name for view in read.views][5:] == [f"test/view0{n}.png" for n in range(6, 9)]
    assert farthest_apart(read, scene) < 1e-6
    assert read.notes["masks"] == "8 of 8 views, the photographs' opacity"
    for view, ours in zip(read.views, scene.views, strict=True):
        np.testing.assert_array_equal(view.silhouette, ours.silhouette)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(frames=3), "expected a list 'frames'"),
        (
            lambda c: c["frames"][0].pop("transform_matrix"),
            r"frame 0 \(images/view01\.png\), transform_matrix: expected 12",
        ),
        (lambda c: c["frames"][0].update(transform_matrix=np.diag([1, 2, 3, 1.0]).tolist()), "expected a rotation"),
        (lambda c: c["frames"][1].update(fl_x="a"), r"frame 1 .*fl_x: expected 1 numbers"),
        (lambda c: c["frames"][1].update(fl_x=0, fl_y=0), r"frame 1 .*expected fl_x, or camera_angle_x"),
        (lambda c: c.update(camera_model="OPENCV_FISHEYE"), "OPENCV_FISHEYE cannot be undone"),
        (lambda c: c.update(k4=0.1), "the distortion k4 cannot be undone"),
        (lambda c: [frame.update(file_path="no.png") for frame in c["frames"]], "none of its 8 photographs is there"),
        (lambda c: c["frames"][0].update(mask_path="no.png"), r"frame 0: its mask no\.png is not there"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*photographs are missing")
def test_malformed_transforms_are_refused(
    scene: Scene, tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    with pytest.raises(DataError, match=message):
        open_scene(write_changed(scene, tmp_path, change))


def test_a_file_that_is_no_json_is_a_data_error(tmp_path: Path) -> None:
    (tmp_path / "transforms.json").write_text("{")
    with pytest.raises(DataError, match=r"transforms\.json: not readable as JSON"):
        open_scene(tmp_path)


# IDR, NeuS


def test_masks_of_other_numbers_of_digits_belong_to_the_same_views(scene: Scene, tmp_path: Path) -> None:
    write_neus(scene, tmp_path)
    for n, view in enumerate(scene.views):
        assert view.silhouette is not None
        write_image(
            tmp_path / "mask" / f"{n:03d}.png", np.repeat(255 * view.silhouette[..., None].astype(np.uint8), 3, 2)
        )
    for view, ours in zip(open_scene(tmp_path).views, scene.views, strict=True):
        np.testing.assert_array_equal(view.silhouette, ours.silhouette)


def test_a_world_of_hundreds_is_taken_for_millimetres(scene: Scene, tmp_path: Path) -> None:
    write_neus(scene, tmp_path)
    assert open_scene(tmp_path, silhouettes="none").mm_per_unit is None
    with np.load(tmp_path / "cameras_sphere.npz") as held:
        matrices = dict(held)
    for name in matrices:
        into = np.diag([1000.0, 1000, 1000, 1])
        matrices[name] = into @ matrices[name] if "scale" in name else matrices[name] @ np.linalg.inv(into)
    np.savez(tmp_path / "cameras_sphere.npz", **matrices)
    read = open_scene(tmp_path, silhouettes="none")
    assert read.mm_per_unit == 1
    np.testing.assert_allclose(read.bounds.extent, 1000 * scene.bounds.longest)


def test_pickles_in_an_npz_are_not_loaded(scene: Scene, tmp_path: Path) -> None:
    write_neus(scene, tmp_path)
    np.savez(tmp_path / "cameras_sphere.npz", world_mat_0=np.array([{"a": 1}], object))
    with pytest.raises(DataError, match=r"cameras_sphere\.npz: not readable as NPZ"):
        open_scene(tmp_path)
    (tmp_path / "cameras_sphere.npz").write_bytes(b"no zip")
    with pytest.raises(DataError, match=r"cameras_sphere\.npz: not readable as NPZ"):
        open_scene(tmp_path)


def test_photographs_that_do_not_go_with_the_matrices_are_refused(scene: Scene, tmp_path: Path) -> None:
    write_neus(scene, tmp_path)
    for n, file in enumerate(sorted((tmp_path / "image").iterdir())):
        file.rename(file.with_name(f"shot{n + 70}.png"))
    assert (
        farthest_apart(
            replace(scene, views=open_scene(tmp_path).views),
            replace(scene, views=tuple(replace(view, name=f"shot{n + 70}") for n, view in enumerate(scene.views))),
        )
        < 1e-6
    )  # by order
    (tmp_path / "image/shot70.png").unlink()
    with pytest.raises(DataError, match=r"expected a photograph for each of 8 cameras.*found 7"):
        open_scene(tmp_path)


# MVSNet


def test_intrinsics_of_a_quarter_of_the_size_are_scaled_with_a_word(scene: Scene, tmp_path: Path) -> None:
    write_mvsnet(scene, tmp_path)
    for n, view in enumerate(scene.views):
        K = view.calibration.at(0.25).K
        file = tmp_path / f"cams/{n:08d}_cam.txt"
        head = file.read_text().partition("intrinsic")[0]
        rows = "\n".join(" ".join(map(repr, row)) for row in K.tolist())
        file.write_text(f"{head}intrinsic\n{rows}\n\n0.5 0.01\n")
    with pytest.warns(UserWarning, match="K is of 1/4 of the photographs' size"):
        read = open_scene(tmp_path, bounds=scene.bounds, silhouettes="none")
    np.testing.assert_allclose(read.views[0].K, scene.views[0].K, rtol=0, atol=1e-9)


def test_a_malformed_camera_of_mvsnet_is_named(scene: Scene, tmp_path: Path) -> None:
    write_mvsnet(scene, tmp_path)
    (tmp_path / "cams/00000003_cam.txt").write_text("extrinsic\n1 0 0 0\n")
    with pytest.raises(DataError, match=r"00000003_cam\.txt: expected the words extrinsic and intrinsic"):
        open_scene(tmp_path)
    (tmp_path / "cams/00000003_cam.txt").write_text("extrinsic\n1 0 0 0\nintrinsic 1 2 3")
    with pytest.raises(DataError, match=r"00000003_cam\.txt: extrinsic: expected 16"):
        open_scene(tmp_path)


# Metashape


def test_metashapes_lens_and_unaligned_cameras(temple: BuiltInScene, tmp_path: Path) -> None:
    scene = temple.scene  # has skew
    write_photographs(scene, tmp_path)
    (tmp_path / "cameras.xml").write_text(metashape(scene, chunk=CHUNK, skip="view06.png"))
    read = open_scene(tmp_path, silhouettes="none")
    assert farthest_apart(read, replace(scene, views=scene.views[:5] + scene.views[6:])) < 1e-6
    assert read.notes["left out"] == "1 cameras that are not aligned or not enabled: view06"
    # x' += P1 (r2 + 2 x2) + 2 P2 xy, where OpenCV has 2 p1 xy + p2 (r2 + 2 x2).
    assert read.views[0].calibration.distortion == (-0.1, 0.02, -0.0005, 0.0004, 0.003)
    # The region is turned and moved with the chunk and so is the scene's own box again.
    np.testing.assert_allclose(read.bounds.low, scene.bounds.low, rtol=0, atol=1e-9)
    np.testing.assert_allclose(read.bounds.high, scene.bounds.high, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</document>", "", "not readable as XML"),
        ("<document", '<!DOCTYPE d [<!ENTITY a "b">]><document', "without a document type of its own"),
        ('type="frame"', 'type="fisheye"', "a fisheye camera cannot be undone"),
        ("<p1>", "<k4>0.1</k4><p1>", "the distortion k4 cannot be undone"),
        ("<f>", "<f>a", r"calibration, f: expected 1 numbers"),
        ("<transform>", "<gone>", "expected a chunk with aligned cameras"),
        ('sensor_id="0"', 'sensor_id="77"', "expected a sensor '77'"),
    ],
)
def test_malformed_metashape_files_are_refused(scene: Scene, tmp_path: Path, old: str, new: str, message: str) -> None:
    write_metashape(scene, tmp_path)
    text = (tmp_path / "cameras.xml").read_text().replace(old, new)
    (tmp_path / "cameras.xml").write_text(text.replace("</transform>", "</gone>") if new == "<gone>" else text)
    with pytest.raises(DataError, match=message):
        open_scene(tmp_path)


# Open3D


def test_a_trajectory_needs_as_many_photographs(scene: Scene, tmp_path: Path) -> None:
    write_trajectory(scene, tmp_path)
    (tmp_path / "color/9.png").unlink()
    with pytest.raises(DataError, match=r"trajectory\.json: expected a photograph for each of 8 cameras.*found 7"):
        open_scene(tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"parameters": 3}, "expected a list 'parameters'"),
        ({"parameters": [{}] * 8}, "camera 0: expected an object 'intrinsic'"),
        (
            {"parameters": [{"intrinsic": {"intrinsic_matrix": [1, 2]}}] * 8},
            "intrinsic_matrix: expected 9 finite numbers",
        ),
    ],
)
def test_a_malformed_trajectory_is_refused(scene: Scene, tmp_path: Path, content: dict[str, Any], message: str) -> None:
    write_trajectory(scene, tmp_path)
    (tmp_path / "trajectory.json").write_text(json.dumps({"class_name": "PinholeCameraTrajectory", **content}))
    with pytest.raises(DataError, match=message):
        open_scene(tmp_path)


# OpenCV


def test_opencvs_distortion_is_kept(scene: Scene, tmp_path: Path) -> None:
    write_photographs(scene, tmp_path)
    write_opencv(scene, tmp_path / "calib.yml", distortion=(-0.1, 0.02, 0.0004, -0.0005, 0.003))
    read = open_scene(tmp_path, bounds=scene.bounds, silhouettes="none")
    assert read.views[0].calibration.distortion == (-0.1, 0.02, 0.0004, -0.0005, 0.003)


def test_the_samples_table_of_poses_is_read_in_the_photographs_order(scene: Scene, tmp_path: Path) -> None:
    write_photographs(scene, tmp_path)
    storage = cv2.FileStorage(str(tmp_path / "out_camera_data.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", scene.views[0].width)
    storage.write("image_height", scene.views[0].height)
    storage.write("camera_matrix", scene.views[0].K)
    poses = [np.r_[cv2.Rodrigues(v.cam_from_world[:3, :3])[0].ravel(), v.cam_from_world[:3, 3]] for v in scene.views]
    storage.write("extrinsic_parameters", np.array(poses))
    storage.release()
    assert farthest_apart(open_scene(tmp_path, bounds=scene.bounds, silhouettes="none"), scene) < 1e-6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 3\n", r"calib\.yml"),
        (
            "%YAML:1.0\n---\na: !!opencv-matrix\n   rows: 1\n   cols: 1\n   dt: d\n   data: [ 1. ]\n",
            "expected a 3x3 camera",
        ),
        ("%YAML:1.0\n---\n{{{ !!opencv-matrix", r"calib\.yml: not readable as FileStorage|expected a 3x3 camera"),
    ],
)
def test_a_malformed_storage_is_refused(scene: Scene, tmp_path: Path, text: str, message: str) -> None:
    write_photographs(scene, tmp_path)
    (tmp_path / "calib.yml").write_text(text)
    with pytest.raises(DataError, match=message):
        open_scene(tmp_path)


def test_a_storage_without_poses_says_which_names_are_expected(scene: Scene, tmp_path: Path) -> None:
    write_photographs(scene, tmp_path)
    write_opencv(replace(scene, views=scene.views[:1]), tmp_path / "calib.yml", form="{word}gone")
    with pytest.raises(DataError, match="expected rvec and tvec of each image, as rvec_view01 and tvec_view01; found"):
        open_scene(tmp_path)


# Shared cases


@pytest.mark.parametrize(
    ("case", "views", "apart"),
    [
        ("37-masks-0-1", 8, 1e-9),
        ("39-masks-named-openmvs", 8, 1e-9),
        ("41-rgba-transparent", 8, 1e-9),
        ("43-masks-half-size", 8, 1e-9),
        ("53-colmap-bin", 8, 0.1),  # the format has no skew
        ("57-metashape-xml", 7, 1e-6),
        ("61-opencv-yaml", 8, 1e-6),
    ],
)
def test_a_scene_as_people_bring_it_is_that_which_it_was_made_of(
    real_data: Path, case: str, views: int, apart: float
) -> None:
    base = open_scene(real_data / "cases/00-base/scene")
    read = open_scene(real_data / "cases" / case / "scene")
    assert len(read.views) == views
    stems = [Path(view.name).stem for view in read.views]
    kept = tuple(view for view in base.views if Path(view.name).stem in stems)
    assert farthest_apart(read, replace(base, views=kept)) < apart
    for view, ours in zip(read.views, kept, strict=True):
        assert view.silhouette is not None
        assert np.mean(view.silhouette != ours.silhouette) < 0.01
    np.testing.assert_allclose(read.bounds.low, base.bounds.low, rtol=0, atol=0.003)


def test_a_distorted_scene_from_windows(real_data: Path) -> None:
    with pytest.warns(UserWarning, match="photographs are missing: .*view09"):
        read = open_scene(real_data / "cases/55-transforms-windows-distorted/scene")
    assert farthest_apart(read, open_scene(real_data / "cases/00-base/scene")) < 0.1
    assert {view.calibration.distortion[0] for view in read.views} == {-0.2}


def test_an_object_that_fills_the_frame(real_data: Path) -> None:
    read = open_scene(real_data / "cases/63-object-fills-frame/scene")
    assert [(view.width, view.height) for view in read.views] == [(60, 78)] * 8


def test_dtus_scan_in_idrs_layout(real_data: Path) -> None:
    scene = open_scene(real_data / "dtu_scan24")
    assert scene.mm_per_unit == 1
    assert sum(view.has_silhouette for view in scene.views) == len(scene.views) == 24
    np.testing.assert_allclose(scene.bounds.extent, 462.1, atol=0.1)
    # 98% of the object's points lie in here on each axis.
    assert (np.array(scene.bounds.low) < [-176, -191, 506]).all()
    assert (np.array(scene.bounds.high) > [78, 124, 792]).all()


def test_a_nerf_scene_has_its_opacity_for_masks_and_a_box_from_them(real_data: Path) -> None:
    scene = open_scene(real_data / "nerf_lego")
    assert scene.notes["masks"] == "25 of 25 views, the photographs' opacity"
    assert scene.notes["bounds"].endswith(", found from the silhouettes of 25 views")
    assert (scene.bounds.extent < 3).all()
