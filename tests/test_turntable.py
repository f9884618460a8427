from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import box_mesh, plain
from sfm_world import FOCAL, HEIGHT, WIDTH, blocks, world

from recon3d.calibration.turntable import Turntable, cameras_from_turntable, turntable_cameras
from recon3d.datasets.synthetic import photograph
from recon3d.errors import ArgumentError, CalibrationError
from recon3d.io.files import write_image
from recon3d.io.opening import read_calibrated
from recon3d.scene.camera import Camera

K = np.array([[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1]])
STEP, DISTANCE, RISE, TILT = 12.0, 4.0, 2.9, 36.0


def taken(step: float = STEP) -> list[Camera]:
    """Ten photographs, by a camera that is panned and rolled a little."""
    return turntable_cameras(K, step * np.arange(10), DISTANCE, RISE, TILT, pan=1.5, roll=-2.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("turntable")
    for n, view in enumerate(photograph(world(), blocks, taken(), supersampling=1).views):
        write_image(folder / f"t{n:02d}.png", view.image)
    return folder


def test_the_camera_goes_round_the_other_way_than_the_table() -> None:
    ahead, turned = turntable_cameras(K, [0, 90], 2.0, 1.0, 0.0)
    centers = [-camera.cam_from_world[:3, :3].T @ camera.cam_from_world[:3, 3] for camera in (ahead, turned)]
    assert np.allclose(centers, [[2, 0, 1], [0, -2, 1]])
    on_axis = ahead.K @ (ahead.cam_from_world[:3, :3] @ [0, 0, 1] + ahead.cam_from_world[:3, 3])
    assert np.allclose(on_axis[:2] / on_axis[2], K[:2, 2])
    assert (ahead.width, ahead.height) == (WIDTH, HEIGHT)
    lower = turntable_cameras(K, [0], 2.0, 1.0, np.degrees(np.arctan(0.5)))[0]  # looks down at the origin
    assert np.allclose(lower.cam_from_world[:2, 3], 0)
    right = turntable_cameras(K, [0], 2.0, 1.0, 0.0, pan=10)[0]  # its axis passes the origin on the right
    assert (right.cam_from_world @ [0, 0, 1, 1])[0] < 0
    clockwise = turntable_cameras(K, [0], 2.0, 1.0, 0.0, roll=90)[0]  # what was above is on the left
    assert (clockwise.cam_from_world @ [0, 0, 2, 1])[0] < 0


@pytest.mark.parametrize("told", [STEP, -STEP])
def test_pose_and_direction_are_found_from_matches(folder: Path, told: float) -> None:
    """The tilt is told wrong by four degrees, pan and roll not at all, and the direction perhaps."""
    turntable = Turntable(told, 1000 * DISTANCE, 1000 * RISE, TILT + 4, FOCAL)
    found = cameras_from_turntable(folder, turntable)
    for camera, true in zip(found.cameras, taken(), strict=True):
        center = -true.cam_from_world[:3, :3].T @ true.cam_from_world[:3, 3]
        assert np.allclose(camera.center, center)
        turn = camera.cam_from_world[:3, :3] @ true.cam_from_world[:3, :3].T
        assert np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) < 0.5
    assert found.mm_per_unit == 1000
    assert found.reprojection_error < 1
    assert ("the other way than told" in found.notes["turntable"]) == (told < 0)


def test_direction_and_pose_of_an_object_without_texture_are_found_from_silhouettes(tmp_path: Path) -> None:
    """Told the wrong way round, and the tilt by two degrees."""
    shape = box_mesh(1.2, 0.5, 0.4).translate((0.1, 0.1, 0.2)) + box_mesh(0.3, 0.3, 0.9).translate((-0.4, 0.2, 0.45))
    true = turntable_cameras(K, 60.0 * np.arange(6), DISTANCE, RISE, 34.0, pan=1.5)
    for n, view in enumerate(photograph(shape, plain, true, supersampling=1).views):
        write_image(tmp_path / "photographs" / f"t{n}.png", view.image)
    told = Turntable(-60.0, 1000 * DISTANCE, 1000 * RISE, 36.0, FOCAL)
    found = cameras_from_turntable(tmp_path / "photographs", told, output=tmp_path / "scene")
    assert "the other way than told" in found.notes["turntable"]
    assert "silhouettes" in found.notes["pose of the camera"]
    for camera, expected in zip(found.cameras, true, strict=True):
        axis, right = camera.cam_from_world[2, :3], expected.cam_from_world[2, :3]
        assert np.degrees(np.arccos(axis @ right)) < 0.7
    assert read_calibrated(tmp_path / "scene").mm_per_unit == 1000
    ramp = np.indices((HEIGHT, WIDTH)).sum(axis=0)[..., None].repeat(3, 2).astype(np.uint8)
    write_image(tmp_path / "photographs" / "t0.png", ramp)
    with pytest.raises(CalibrationError, match=r"matches were found .* background is not of one color"):
        cameras_from_turntable(tmp_path / "photographs", told)


def test_angles_that_are_not_those_of_the_photographs_are_refused(folder: Path) -> None:
    files = [folder / f"t{n:02d}.png" for n in (0, 3, 1, 4, 2)]
    for n, file in enumerate(files):
        (folder / "mixed").mkdir(exist_ok=True)
        (folder / "mixed" / f"{n}.png").write_bytes(file.read_bytes())
    with pytest.raises(CalibrationError, match=r"of .* matches agree with the angles"):
        cameras_from_turntable(folder / "mixed", Turntable(60.0, 4000, 2900, TILT, FOCAL))


def test_a_turntable_is_read_from_text() -> None:
    assert Turntable.parse("step=-10, distance=600,tilt=20") == Turntable(-10, 600, 0, 20)
    for text in (
        "step=10",
        "step=0,distance=3",
        "step=a,distance=3",
        "step=1,distance=2,speed=3",
        "step=1,distance=2,x",
        "10",
    ):
        with pytest.raises(ArgumentError, match="expected a"):
            Turntable.parse(text)
