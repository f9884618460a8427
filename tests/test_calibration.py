from __future__ import annotations

import builtins
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageOps
from PIL.TiffImagePlugin import IFDRational
from scenes import plain
from sfm_world import FOCAL, HEIGHT, WIDTH, blocks, taken, world
from typer.testing import CliRunner

from recon3d.calibration import Calibration, CalibrationSettings, calibrate
from recon3d.calibration.epipolar import _without_bridges, firmly_joined
from recon3d.calibration.features import extract_features, match_features, matched_pairs
from recon3d.calibration.known_distance import KnownDistance, _triangulated, with_known_distance
from recon3d.calibration.photographs import PhotoFile, find_photographs
from recon3d.calibration.result import CalibratedCamera, Observations
from recon3d.calibration.structure_from_motion import WORK_FOLDER
from recon3d.calibration.writing import quaternion, undistort, undistorted
from recon3d.cli.entry import app
from recon3d.cli.results import record_of, recorded_scene
from recon3d.datasets.synthetic import Camera, photograph
from recon3d.errors import ArgumentError, CalibrationError, DataError, SceneError
from recon3d.io import open_scene
from recon3d.io.files import write_image
from recon3d.pipeline import reconstruct
from recon3d.scene.image_file import read_image
from recon3d.scene.scene import Scene
from recon3d.scene.similarity import Similarity

pycolmap = pytest.importorskip("pycolmap")

DISTORTION = np.array([-0.15, 0.0, 0.0, 0.0, 0.0])


def distorted(image: NDArray[np.uint8], K: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The photograph as a lens with ``DISTORTION`` shows it."""
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float64), np.arange(HEIGHT, dtype=np.float64))
    ideal = cv2.undistortPoints(np.column_stack([u.ravel(), v.ravel()])[:, None], K, DISTORTION, P=K)
    maps = ideal.reshape(HEIGHT, WIDTH, 2).astype(np.float32)
    return np.asarray(cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_CUBIC), np.uint8)


@pytest.fixture(scope="module")
def folder(sfm_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve photographs, one that is far too blurred, one of noise and one that repeats another."""
    folder = tmp_path_factory.mktemp("photographs")
    for n, view in enumerate(sfm_scene.views):
        write_image(folder / f"p{n:02d}.png", distorted(view.image, view.K))
    write_image(folder / "q_blurred.png", cv2.GaussianBlur(read_image(folder / "p03.png"), (0, 0), 6))
    noise = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    write_image(folder / "q_other.png", noise)
    (folder / "q_same.png").write_bytes((folder / "p05.png").read_bytes())
    (folder / "notes.txt").write_text("not a photograph")
    return folder


class Stages(list[tuple[str, int, int]]):
    def __call__(self, stage: str, done: int, total: int) -> None:
        self.append((stage, done, total))

    @property
    def names(self) -> list[str]:
        return list(dict.fromkeys(stage for stage, _, _ in self))


@pytest.fixture(scope="module")
def calibrated(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Calibration, Path, Stages]:
    output, stages = tmp_path_factory.mktemp("scene") / "scene", Stages()
    return calibrate(folder, output, progress=stages), output, stages


def pose_errors(found: Sequence[CalibratedCamera], true: Sequence[Camera]) -> tuple[float, float]:
    """Largest distance of the centres, in orbit radii, and largest angle, degrees, after a similarity."""
    centers = np.array([camera.center for camera in found])
    expected = np.array([-camera.cam_from_world[:3, :3].T @ camera.cam_from_world[:3, 3] for camera in true])
    world = Similarity.between(centers, expected)
    distance = np.linalg.norm(world(centers) - expected, axis=1).max() / 5.0
    turns = [
        world.camera(found_camera.cam_from_world)[:3, :3] @ camera.cam_from_world[:3, :3].T
        for found_camera, camera in zip(found, true, strict=True)
    ]
    cosines = [np.clip((np.trace(turn) - 1) / 2, -1, 1) for turn in turns]
    return float(distance), float(np.degrees(np.arccos(cosines)).max())


def test_cameras_are_those_that_took_the_photographs(calibrated: tuple[Calibration, Path, Stages]) -> None:
    calibration = calibrated[0]
    assert [camera.name for camera in calibration.cameras] == [f"p{n:02d}.png" for n in range(12)]
    distance, angle = pose_errors(calibration.cameras, taken())
    assert distance < 0.01
    assert angle < 0.5
    camera = calibration.cameras[0]
    assert camera.K[0, 0] == pytest.approx(FOCAL, rel=0.02)
    assert camera.K[:2, 2].tolist() == [(WIDTH - 1) / 2, (HEIGHT - 1) / 2]  # too few views to tell another
    assert camera.distortion[0] == pytest.approx(DISTORTION[0], abs=0.03)
    assert calibration.reprojection_error < 0.5
    assert calibration.track_lengths.min() >= 2


def test_photographs_without_a_place_are_named_with_the_reason(calibrated: tuple[Calibration, Path, Stages]) -> None:
    calibration = calibrated[0]
    assert list(calibration.unplaced) == ["q_blurred.png", "q_other.png", "q_same.png"]
    assert "blurred" in calibration.unplaced["q_blurred.png"]
    assert "overlaps no other photograph" in calibration.unplaced["q_other.png"]
    assert calibration.unplaced["q_same.png"] == "the same file as p05.png"
    assert calibration.summary()["photographs placed"] == "12 of 15"
    assert "q_other.png" in repr(calibration)


def test_world_is_upright_and_of_unit_size(calibrated: tuple[Calibration, Path, Stages]) -> None:
    cameras_, points = calibrated[0].cameras, calibrated[0].points
    assert np.mean([-camera.cam_from_world[1, 2] for camera in cameras_]) > 0.75  # 35 degrees above: cos 35 = 0.82
    assert np.median([np.linalg.norm(camera.center) for camera in cameras_]) == pytest.approx(1, abs=1e-9)
    assert np.linalg.norm(np.median(points, axis=0)) < 0.1


def test_progress_is_told_stage_by_stage(calibrated: tuple[Calibration, Path, Stages]) -> None:
    stages = calibrated[2]
    assert stages.names[:3] == ["features", "matches", "mapping"]
    assert stages.names[-2:] == ["intrinsics", "undistortion"]
    assert all(0 <= done <= total for _, done, total in stages)
    assert {(stage, total) for stage, done, total in stages if done == total} >= {("features", 14), ("matches", 91)}


def test_written_model_reprojects_its_points_in_undistorted_photographs(
    calibrated: tuple[Calibration, Path, Stages],
) -> None:
    calibration, output, _ = calibrated
    model = pycolmap.Reconstruction(output / "sparse" / "0")
    assert model.num_reg_images() == 12
    assert model.num_points3D() == len(calibration.points)
    assert all(camera.model_name == "PINHOLE" for camera in model.cameras.values())
    model.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() == pytest.approx(calibration.reprojection_error, rel=0.2)
    for image in model.images.values():
        camera = model.cameras[image.camera_id]
        assert read_image(output / "images" / image.name).shape == (camera.height, camera.width, 3)
    frames = json.loads((output / "transforms.json").read_text())["frames"]
    assert [frame["file_path"] for frame in frames] == [f"images/{camera.name}" for camera in calibration.cameras]
    for frame, image in zip(frames, sorted(model.images.values(), key=lambda image: image.name), strict=True):
        camera = model.cameras[image.camera_id]
        assert [frame[key] for key in ("fl_x", "fl_y", "cx", "cy")] == pytest.approx(list(camera.params))
        cam_from_world = np.diag([1, -1, -1, 1]) @ np.linalg.inv(frame["transform_matrix"])
        assert np.abs(cam_from_world[:3] - image.cam_from_world().matrix()).max() < 1e-9


def test_what_was_calibrated_opens_as_a_scene_without_scale(calibrated: tuple[Calibration, Path, Stages]) -> None:
    calibration, output, _ = calibrated
    scene = open_scene(output)
    assert not any(view.has_silhouette for view in scene.views)  # the plate fills the image
    assert [view.name for view in scene.views] == [camera.name for camera in calibration.cameras]
    centers = np.array([camera.center for camera in calibration.cameras])
    assert np.abs(scene.centers - centers).max() < 1e-9
    assert scene.mm_per_unit is None
    assert str(scene.summary()["extent"]).endswith(" units (no scale)")
    assert "blurred" in scene.notes["not placed: q_blurred.png"]
    with pytest.raises(SceneError, match="no scale is known"):
        reconstruct(scene, ground_truth=world())
    assert open_scene(output, silhouettes="none", mm_per_unit=7.0).known_scale() == 7.0
    record = json.loads((output / "calibration.json").read_text())
    for wrong in ({**record, "bounds": [1, 2]}, {"cameras": []}, {**record, "summary": 3}):
        broken = Path(shutil.copytree(output, output.parent / "broken", dirs_exist_ok=True))
        (broken / "calibration.json").write_text(json.dumps(wrong))
        with pytest.raises(DataError, match=r"calibration\.json"):
            open_scene(broken)


def test_plain_photographs_are_calibrated_before_they_are_reconstructed(
    folder: Path, calibrated: tuple[Calibration, Path, Stages], tmp_path: Path
) -> None:
    shutil.copytree(calibrated[1], tmp_path / "scene")  # as if an earlier run had been interrupted there
    options = [
        "--voxels",
        "8000",
        "--method",
        "voxel-coloring",
        "--silhouettes",
        "none",
        "--no-pictures",
        "-o",
        str(tmp_path),
    ]
    told = CliRunner().invoke(app, ["reconstruct", str(folder), *options], catch_exceptions=False).output
    assert re.search(r"photographs placed: +12 of 15", told)
    assert re.search(r"not placed: q_other\.png: +overlaps no other", told)
    assert re.search(r"voxels: .* of \S+ units \(no scale\)", told)
    record = json.loads((tmp_path / "record.json").read_text())
    assert record["scene"]["mm_per_unit"] is None
    assert record["scene"]["source"] == str(tmp_path / "scene")
    known = record_of(tmp_path)
    assert known is not None
    assert np.shape(known.scene.bounds) == (2, 3)
    assert [view.name for view in recorded_scene(tmp_path, known).views] == record["scene"]["views"]
    with pytest.raises(ArgumentError, match="has its own cameras"):
        CliRunner().invoke(
            app, ["reconstruct", str(tmp_path / "scene"), "--board", "charuco-10x7:25mm"], catch_exceptions=False
        )


def test_a_known_distance_gives_the_scale(calibrated: tuple[Calibration, Path, Stages]) -> None:
    """Two edges of the box, 1.6 units or 800 mm apart, looked up in two photographs, and in one."""
    calibration = calibrated[0]
    lenses = [CalibratedCamera("", Path(), WIDTH, HEIGHT, c.K, DISTORTION, c.cam_from_world) for c in taken()]
    pixels = {(n, x): lenses[n].project(np.array([[x, 0.6, 0.6]]))[0] for n in (2, 8) for x in (-0.8, 0.8)}
    place = {key: f"p{key[0]:02d}.png:{u:.3f},{v:.3f}" for key, (u, v) in pixels.items()}
    ends = [f"{place[2, x]}+{place[8, x]}" for x in (-0.8, 0.8)]
    found = with_known_distance(calibration, KnownDistance.parse(f"{ends[0]} {ends[1]} = 800mm"))
    assert found.mm_per_unit == 1000

    def height(scaled: Calibration) -> float:
        """Length of an edge of one unit, half a metre, triangulated from where the true cameras show its ends."""
        low, high = (np.array([[0.8, 0.6, z]]) for z in (0.1, 1.1))
        places = [np.array([lens.project(end)[0] for lens in lenses]) for end in (low, high)]
        return float(np.linalg.norm(np.subtract(*(_triangulated(scaled.cameras, place) for place in places))))

    assert height(found) == pytest.approx(0.5, rel=0.01)
    rough = with_known_distance(calibration, KnownDistance.parse(f"{place[8, -0.8]} {place[8, 0.8]} = 800 mm"))
    assert height(rough) == pytest.approx(0.5, rel=0.1)
    assert rough.summary()["scale"] == "1000 mm a unit"
    with pytest.raises(ArgumentError, match="not of one place"):
        with_known_distance(calibration, KnownDistance.parse(f"{place[2, 0.8]}+p08.png:3,3 {ends[1]} = 800mm"))
    with pytest.raises(ArgumentError, match=r"q_blurred\.png has no camera: blurred"):
        with_known_distance(calibration, KnownDistance.parse(f"q_blurred.png:3,3 {ends[1]} = 800mm"))
    for text in (
        "p02.png:1,2 = 3mm",
        f"{ends[0]} {ends[1]} = 3",
        f"{ends[0]} {ends[1]} = 0mm",
        "a:1,2 b:1.2.3,4 = 5mm",
    ):
        with pytest.raises(ArgumentError, match="expected a distance like"):
            KnownDistance.parse(text)


def test_undistorted_photograph_is_what_a_pinhole_takes(sfm_scene: Scene, folder: Path) -> None:
    """Up to twice resampled texture."""
    view = sfm_scene.views[4]
    lens = CalibratedCamera("p04.png", folder / "p04.png", WIDTH, HEIGHT, view.K, DISTORTION, view.cam_from_world)
    seen = Observations(np.zeros(1, np.int64), np.zeros(1, np.int64), lens.project(np.zeros((1, 3))))
    straight = undistorted(Calibration((lens,), np.zeros((1, 3)), np.zeros((1, 3), np.uint8), seen))
    assert straight.reprojection_error < 1e-3
    camera = straight.cameras[0]
    image = undistort(read_image(lens.path), lens, camera)
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.linalg.inv(camera.K) @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    maps = (view.K @ rays)[:2].reshape(2, HEIGHT, WIDTH).astype(np.float32)
    expected = cv2.remap(view.image, maps[0], maps[1], cv2.INTER_CUBIC)
    difference = np.abs(image.astype(float) - expected)[2:-2, 2:-2].mean()
    without = np.abs(read_image(lens.path).astype(float) - view.image)[2:-2, 2:-2].mean()
    assert difference < 0.5 * without
    corners = undistort(np.full((HEIGHT, WIDTH, 3), 255, np.uint8), lens, camera)
    assert corners.min() == 255


def test_second_run_reuses_features_matches_and_model(
    folder: Path, calibrated: tuple[Calibration, Path, Stages]
) -> None:
    calibration, output, _ = calibrated
    work = output / WORK_FOLDER
    before = {path: path.stat().st_mtime_ns for path in work.rglob("*") if path.is_file()}
    stages = Stages()
    again = calibrate(folder, output, progress=stages)
    assert stages.names == ["features", "matches", "undistortion"]
    assert [(stage, done) for stage, done, _ in stages][:2] == [("features", 14), ("matches", 91)]
    assert {path: path.stat().st_mtime_ns for path in work.rglob("*.bin") if path.is_file()}.items() <= before.items()
    assert np.array_equal(again.points, calibration.points)
    assert not [path.name for path in output.iterdir() if path.name.startswith(".scene")]


def test_interrupted_run_resumes_and_photographs_can_be_added(folder: Path, tmp_path: Path) -> None:
    files = [folder / f"p{n:02d}.png" for n in range(6)]

    class StopError(Exception):
        pass

    def stop(stage: str, _done: int, _total: int) -> None:
        if stage == "mapping":
            raise StopError

    with pytest.raises(StopError):
        calibrate(files[:5], tmp_path, progress=stop)
    assert [path.name for path in tmp_path.iterdir()] == [WORK_FOLDER]
    stages = Stages()
    calibration = calibrate(files, tmp_path, progress=stages)
    assert [(done, total) for stage, done, total in stages if stage == "features"] == [(5, 6), (6, 6)]
    assert [(done, total) for stage, done, total in stages if stage == "matches"] == [(10, 15), (15, 15)]
    assert calibration.n_registered == 6
    assert pose_errors(calibration.cameras, taken()[:6])[0] < 0.02


def test_photograph_of_new_content_is_not_taken_for_the_old(folder: Path, tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    for n in range(4):
        (photos / f"{n}.png").write_bytes((folder / f"p{n:02d}.png").read_bytes())
    calibrate(photos, tmp_path / "scene")
    (photos / "0.png").write_bytes((folder / "p04.png").read_bytes())
    stages = Stages()
    calibration = calibrate(photos, tmp_path / "scene", progress=stages)
    assert ("features", 3, 4) in stages
    true = taken()
    assert pose_errors(calibration.cameras, [true[4], *true[1:4]])[0] < 0.02


def test_views_without_texture_end_in_advice(tmp_path: Path) -> None:
    for n, view in enumerate(photograph(world(), plain, taken(4), supersampling=1).views):
        write_image(tmp_path / f"{n}.png", view.image)
    with pytest.raises(CalibrationError, match=r"only 0 of 4 photographs could be placed.*texture.*\n  0\.png: "):
        calibrate(tmp_path, tmp_path / "scene")
    assert not (tmp_path / "scene" / "sparse").exists()


def test_photographs_from_one_spot_end_in_advice(tmp_path: Path) -> None:
    turned = []
    for n in range(4):
        camera = taken()[0]
        pose = camera.cam_from_world.copy()
        pose[:3] = cv2.Rodrigues(np.array([0.0, np.radians(4.0 * n - 6), 0.02 * n]))[0] @ pose[:3]
        turned.append(Camera(camera.K, pose, WIDTH, HEIGHT))
    for n, view in enumerate(photograph(world(), blocks, turned, supersampling=1).views):
        write_image(tmp_path / f"{n}.png", view.image)
    with pytest.raises(CalibrationError, match="taken from one spot"):
        calibrate(tmp_path, tmp_path / "scene")


def test_group_that_hangs_on_one_pair_is_not_kept() -> None:
    """Two triangles of nodes that one edge joins, and one node alone."""
    edges = [(0, 1), (1, 2), (0, 2), (2, 3), (3, 4), (4, 5), (3, 5)]
    parts = _without_bridges(7, edges)
    assert parts[0] == parts[1] == parts[2]
    assert parts[3] == parts[4] == parts[5]
    assert len({parts[0], parts[3], parts[6]}) == 3
    assert len(set(_without_bridges(6, [*edges, (0, 5)]))) == 1
    assert len(_without_bridges(0, [])) == 0


@pytest.fixture(scope="module")
def features(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[PhotoFile, ...]]:
    """Database of the features of the twelve good photographs, not matched."""
    found = find_photographs([folder / f"p{n:02d}.png" for n in range(12)])
    database = tmp_path_factory.mktemp("features") / "features.db"
    extract_features(database, found, CalibrationSettings(), Stages())
    return database, found


def test_photographs_that_contradict_their_matches_are_found(
    features: tuple[Path, tuple[PhotoFile, ...]], tmp_path: Path
) -> None:
    found = features[1]
    database = shutil.copy(features[0], tmp_path / "features.db")
    match_features(database, found, CalibrationSettings(), Stages())
    assert len(matched_pairs(database, [photo.digest for photo in found])) > 12
    model = pycolmap.Reconstruction()
    K = taken()[0].K
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(
            camera_id=1,
            model="SIMPLE_RADIAL",
            width=WIDTH,
            height=HEIGHT,
            params=[FOCAL, K[0, 2] + 0.5, K[1, 2] + 0.5, DISTORTION[0]],
        )
    )
    for n, (photo, camera) in enumerate(zip(found, taken(), strict=True), start=1):
        pose = camera.cam_from_world.copy()
        if n == 5:  # as if it stood elsewhere, looking at the object
            pose[:3, :3] = pose[:3, :3] @ cv2.Rodrigues(np.array([0.0, 0.0, 1.0]))[0]
        image = pycolmap.Image(name=f"{photo.digest}.png", camera_id=1, image_id=n)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    kept = firmly_joined(database, model)
    assert kept == {f"{photo.digest}.png" for n, photo in enumerate(found, start=1) if n != 5}


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_orientation_is_applied(suffix: str, tmp_path: Path) -> None:
    pixels = np.zeros((40, 64, 3), np.uint8)
    pixels[:20, :32], pixels[20:, :32], pixels[:20, 32:] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    for orientation in range(1, 9):
        picture, path = Image.fromarray(pixels), tmp_path / f"{orientation}.{suffix}"
        exif = picture.getexif()
        exif[0x0112] = orientation
        picture.save(path, exif=exif)
        with Image.open(path) as stored:
            expected = np.asarray(ImageOps.exif_transpose(stored).convert("RGB")).astype(int)
        image = read_image(path).astype(int)
        assert image.shape == expected.shape
        assert np.abs(image - expected).mean() < 5
        (found,) = find_photographs([path])
        assert (found.height, found.width) == expected.shape[:2]


def with_exif(path: Path, size: tuple[int, int], tags: dict[int, Any], ifd: dict[int, Any]) -> Path:
    picture = Image.fromarray(np.zeros((size[1], size[0], 3), np.uint8))
    exif = picture.getexif()
    exif.update(tags)
    exif.get_ifd(0x8769).update(ifd)
    picture.save(path, exif=exif)
    return path


def test_focal_length_comes_from_exif(tmp_path: Path) -> None:
    equivalent, focal, taken_width, taken_height, plane, unit = 0xA405, 0x920A, 0xA002, 0xA003, 0xA20E, 0xA210
    diagonal = np.hypot(36, 24)

    def focal_length(size: tuple[int, int], ifd: dict[int, Any], tags: dict[int, Any] | None = None) -> float | None:
        (found,) = find_photographs([with_exif(tmp_path / "photo.jpg", size, tags or {}, ifd)])
        return found.focal_length

    assert focal_length((640, 480), {}) is None
    assert focal_length((640, 480), {equivalent: 28}) == pytest.approx(28 * 800 / diagonal)
    on_side = focal_length((640, 480), {equivalent: 28}, {0x0112: 6})
    assert on_side == pytest.approx(28 * 800 / diagonal)
    smaller = {equivalent: 28, taken_width: 4032, taken_height: 3024}
    assert focal_length((320, 240), smaller) == pytest.approx(28 * 400 / diagonal)
    assert focal_length((320, 320), smaller) is None  # cropped
    of_sensor = {focal: 5.4, plane: 3000.0, unit: 2, taken_width: 640, taken_height: 480}
    assert focal_length((640, 480), of_sensor) == pytest.approx(5.4 * 3000 / 25.4)
    assert focal_length((320, 240), of_sensor) == pytest.approx(5.4 * 3000 / 25.4 / 2)
    known = {0x010F: "Canon", 0x0110: "Canon EOS 350D DIGITAL"}
    assert focal_length((640, 480), {focal: IFDRational(24)}, known) == pytest.approx(24.0 / 22.2 * 640, rel=0.02)


def test_one_camera_serves_each_size_and_lens(tmp_path: Path) -> None:
    wide, long = {0xA405: 28}, {0xA405: 80}
    paths = [
        with_exif(tmp_path / "a.jpg", (64, 48), {0x0110: "one"}, wide),
        with_exif(tmp_path / "b.jpg", (64, 48), {0x0110: "one"}, wide),
        with_exif(tmp_path / "c.jpg", (64, 48), {0x0110: "one"}, long),
        with_exif(tmp_path / "d.jpg", (64, 48), {0x0110: "two"}, wide),
        with_exif(tmp_path / "e.jpg", (64, 48), {0x0110: "one", 0x0112: 6}, wide),
    ]
    lenses = [found.lens for found in find_photographs(paths)]
    assert lenses[0] == lenses[1]
    assert len(set(lenses)) == 4


def test_photographs_that_cannot_be_used_are_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such folder"):
        calibrate(tmp_path / "nowhere", tmp_path / "scene")
    with pytest.raises(DataError, match="found none"):
        calibrate(tmp_path, tmp_path / "scene")
    with pytest.raises(CalibrationError, match="at least 3 different photographs, got 2"):
        calibrate([folder / "p05.png", folder / "q_same.png", folder / "p06.png"], tmp_path / "scene")
    (tmp_path / "broken.jpg").write_bytes(b"\xff\xd8\xff")
    with pytest.raises(DataError, match=r"broken\.jpg: not a readable image"):
        calibrate(tmp_path, tmp_path / "scene")
    (tmp_path / "one.heic").write_bytes(b"x")
    with pytest.raises(DataError, match=r"one\.heic.*convert"):
        calibrate([tmp_path / "one.heic"], tmp_path / "scene")
    (tmp_path / "broken.png").write_bytes(b"x")
    with pytest.raises(DataError, match="share the name broken"):
        calibrate(tmp_path, tmp_path / "scene")


def test_output_of_another_origin_is_left_alone(folder: Path, tmp_path: Path) -> None:
    own = tmp_path / "scene" / "images"
    own.mkdir(parents=True)
    for n in range(3):
        (own / f"{n}.png").write_bytes((folder / f"p{n:02d}.png").read_bytes())
    with pytest.raises(DataError, match="would replace"):
        calibrate(own, tmp_path / "scene")
    with pytest.raises(DataError, match="no calibration wrote"):
        calibrate(folder, tmp_path / "scene")
    assert len(list(own.iterdir())) == 3


def test_missing_pycolmap_is_told_in_one_line(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **named: Any) -> Any:
        if name == "pycolmap":
            raise ImportError("No module named 'pycolmap'")
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(CalibrationError, match=r"needs pycolmap") as error:
        calibrate(folder, tmp_path / "scene")
    assert "\n" not in str(error.value)


def test_pictures_can_be_written_after_pycolmap_was_loaded(tmp_path: Path) -> None:
    """In a process of its own: where pycolmap comes before Pillow, writing a PNG ends it."""
    code = (
        "from recon3d.calibration.colmap import load_pycolmap; load_pycolmap()\n"
        "import numpy as np; from PIL import Image\n"
        "pixels = np.random.default_rng(0).integers(0, 255, (400, 640, 3), dtype=np.uint8)\n"
        f"Image.fromarray(pixels).save({str(tmp_path / 'picture.png')!r})\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120, env=environment)
    assert (tmp_path / "picture.png").is_file()


@pytest.mark.parametrize("name", ["max_image_size", "max_features", "exhaustive_up_to", "min_registered"])
def test_settings_without_sense_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        CalibrationSettings(**{name: 0})


def test_many_photographs_are_matched_with_those_that_they_overlap(
    features: tuple[Path, tuple[PhotoFile, ...]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Few partners of each photograph, found by shared features whatever the order of the names."""
    monkeypatch.setattr("recon3d.calibration.features._WINDOW", 1)
    monkeypatch.setattr("recon3d.calibration.features._PARTNERS", 4)
    counts, shuffled = {}, [features[1][n] for n in np.random.default_rng(1).permutation(12)]
    for limit in (150, 2):
        database = shutil.copy(features[0], tmp_path / f"{limit}.db")
        match_features(database, shuffled, CalibrationSettings(exhaustive_up_to=limit), Stages())
        pairs = matched_pairs(database, [photo.digest for photo in shuffled])
        counts[limit] = {frozenset((pair.first, pair.second)): pair.inliers for pair in pairs}
    assert len(counts[2]) < 0.8 * len(counts[150])
    good = sorted(counts[150], key=lambda pair: -counts[150][pair])[:18]
    assert len(set(good) & set(counts[2])) >= 16


@pytest.mark.parametrize("axis_angle", [(0.1, 0.2, 0.3), (np.pi, 0, 0), (0, np.pi, 0), (0, 0, np.pi), (0, 0, 0)])
def test_quaternion_gives_the_rotation_back(axis_angle: tuple[float, float, float]) -> None:
    R = cv2.Rodrigues(np.array(axis_angle, float))[0]
    w, x, y, z = quaternion(R)
    assert np.allclose(pycolmap.Rotation3d(np.array([x, y, z, w])).matrix(), R)


def test_temple_is_placed_as_it_was_photographed(real_data: Path, tmp_path: Path) -> None:
    scene = open_scene(real_data / "templeSparseRing")
    calibration = calibrate(real_data / "templeSparseRing", tmp_path)
    assert calibration.n_registered == 16
    centers = np.array([camera.center for camera in calibration.cameras])
    expected = np.array([view.center for view in scene.views])
    errors = np.linalg.norm(Similarity.between(centers, expected)(centers) - expected, axis=1)
    assert np.median(errors) < 0.003  # of 0.56 m
    assert calibration.cameras[0].K[0, 0] == pytest.approx(1523, rel=0.02)


def test_dinosaur_ends_in_advice(real_data: Path, tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"of 16 photographs could be placed.*texture"):
        calibrate(real_data / "dinoSparseRing", tmp_path)
