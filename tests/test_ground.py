"""Tables that objects stand on, among sparse points of any world."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import plain_view, rotation

from recon3d.calibration.object_alone import with_object_alone
from recon3d.calibration.result import CalibratedCamera, Calibration, Observations
from recon3d.datasets.synthetic import look_at
from recon3d.io.files import write_image
from recon3d.scene.enclosing import enclosing_box, found_table
from recon3d.scene.similarity import Similarity
from recon3d.scene.view import View

NOISE = 0.003  # of the table's half side


def views_of(azimuths: NDArray[np.float64], elevation: float, *, roll: float = 0.0) -> list[View]:
    """Cameras at a distance of 4 that look at the middle of what stands on the origin; rolled, degrees."""
    K = np.array([[150.0, 0, 79.5], [0, 150.0, 59.5], [0, 0, 1]])
    rise, turned = np.radians(elevation), np.radians(roll)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]]
    views = []
    for n, angle in enumerate(np.radians(azimuths)):
        away = np.array([np.cos(rise) * np.cos(angle), np.cos(rise) * np.sin(angle), np.sin(rise)])
        middle = np.array([0, 0, 0.3])
        pose = turn @ look_at(middle + 4 * away, middle, np.array([0.0, 0, 1]))
        views.append(plain_view(K, pose, width=160, height=120, name=f"{n}"))
    return views


def thing(random: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Points (n, 3) on a drum of height 0.7 and radius 0.3, its top included, with a ball of radius 0.1 on it."""
    angle, part = random.uniform(0, 2 * np.pi, n), random.uniform(size=n)
    radius = np.where(part < 0.7, 0.3, 0.3 * np.sqrt(random.uniform(size=n)))
    drum = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.where(part < 0.7, part, 0.7)])
    ball = random.normal(size=(n, 3))
    ball *= 0.1 / np.linalg.norm(ball, axis=1)[:, None]
    return np.where((part > 0.9)[:, None], ball + np.array([0, 0, 0.8]), drum)


def table(random: np.random.Generator, n: int, half: float = 1.0, level: float = 0.0) -> NDArray[np.float64]:
    """Points (n, 3) of a square in a plane of constant z, none where the drum stands."""
    flat = random.uniform(-half, half, (4 * n, 2))
    flat = flat[np.linalg.norm(flat, axis=1) > 0.3][:n]
    return np.column_stack([flat, np.full(len(flat), level)])


def measured(random: np.random.Generator, *parts: NDArray[np.float64]) -> NDArray[np.float64]:
    points = np.concatenate(parts)
    return points + random.normal(0, NOISE, points.shape)


def moved(views: list[View], world: Similarity) -> list[View]:
    return [
        plain_view(view.K, world.camera(view.cam_from_world), width=160, height=120, name=view.name) for view in views
    ]


def turned(random: np.random.Generator) -> NDArray[np.float64]:
    """(3, 3) random rotation."""
    Q, R = np.linalg.qr(random.normal(size=(3, 3)))
    Q *= np.sign(np.diag(R))
    return np.asarray(Q * np.sign(np.linalg.det(Q)))


AROUND = np.arange(0, 360, 30.0)
FRONT = np.arange(-50, 51, 20.0)


@pytest.mark.parametrize(("scale", "of_table"), [(1.0, 150), (1e-3, 500), (1e4, 2500)])
@pytest.mark.parametrize("azimuths", [AROUND, FRONT], ids=["around", "front"])
def test_the_table_is_found_in_any_world(azimuths: NDArray[np.float64], scale: float, of_table: int) -> None:
    random = np.random.default_rng(of_table)
    points = measured(random, thing(random, 700), table(random, of_table))
    world = Similarity(scale, turned(random), 50 * scale * random.normal(size=3))
    found = found_table(moved(views_of(azimuths, 30), world), world(points))
    assert found is not None
    assert found.normal @ world.R[:, 2] > 0.9998
    assert abs(found.heights(world(np.zeros((1, 3))))[0]) < 0.01 * scale
    assert found.points[700:].mean() > 0.97
    assert not found.points[:700][points[:700, 2] > 0.05].any()
    np.testing.assert_allclose(found.heights(found.feet(world(points))), 0, atol=1e-9 * 50 * scale)


@pytest.mark.parametrize("roll", [0, 90])
@pytest.mark.parametrize("elevation", [8, 65])
def test_photographs_from_low_and_high_and_on_their_side_show_it(elevation: float, roll: float) -> None:
    random = np.random.default_rng(3)
    points = measured(random, thing(random, 700), table(random, 400))
    found = found_table(views_of(AROUND, elevation, roll=roll), points)
    assert found is not None
    assert found.normal[2] > 0.9998


def test_neither_the_floor_below_nor_a_wall_is_taken_for_the_table() -> None:
    random = np.random.default_rng(4)
    floor = table(random, 900, half=4, level=-1.5)
    floor = floor[np.abs(floor[:, :2]).max(axis=1) > 1.3]  # the table hides the rest
    wall = np.column_stack([np.full(400, -1.4), random.uniform(-2, 2, 400), random.uniform(-1.5, 1.5, 400)])
    found = found_table(views_of(FRONT, 25), measured(random, thing(random, 700), table(random, 500), floor, wall))
    assert found is not None
    assert found.normal[2] > 0.9998
    assert abs(found.level) < 0.01


def test_the_box_is_of_what_stands_on_the_table() -> None:
    random = np.random.default_rng(5)
    points = measured(random, thing(random, 700), table(random, 1000))
    whole, _ = enclosing_box(views_of(AROUND, 30), points)
    box, how = enclosing_box(views_of(AROUND, 30), points, object_alone=True)
    assert (whole.extent[:2] > 1.9).all()
    assert how.startswith("found from 6")
    assert re.search(r" of 1700 points; table left out: plane at .*, its normal .*, 10\d\d of 1700 points$", how)
    assert 0 < box.low[2] < 0.02  # nothing of the table
    np.testing.assert_allclose(box.low[:2], -0.3 - 0.06 * 0.9, atol=0.02)
    np.testing.assert_allclose(box.high[:2], 0.3 + 0.06 * 0.9, atol=0.02)
    assert 0.87 < box.high[2] < 1.0
    # Where the table is slanted in the world, the box reaches down to it.
    world = Similarity(1.0, rotation(np.array([0.5, 0, 0])), np.zeros(3))
    slanted, how = enclosing_box(moved(views_of(AROUND, 30), world), world(points), object_alone=True)
    assert "table left out" in how
    standing = world(points[:700])
    inside = ((standing > slanted.low) & (standing < slanted.high)).all(axis=1)
    assert inside.mean() > 0.98
    assert slanted.longest < 1.2


@pytest.mark.parametrize("azimuths", [AROUND, FRONT], ids=["around", "front"])
def test_without_a_table_the_box_is_as_before_with_a_word(azimuths: NDArray[np.float64]) -> None:
    random = np.random.default_rng(6)
    points = measured(random, thing(random, 900))
    box, how = enclosing_box(views_of(azimuths, 30), points)
    alone, told = enclosing_box(views_of(azimuths, 30), points, object_alone=True)
    assert alone == box
    assert told == f"{how}; no table or ground was recognised to leave out"


def test_a_wall_behind_the_object_is_no_table() -> None:
    random = np.random.default_rng(7)
    wall = np.column_stack([np.full(900, -0.4), random.uniform(-1, 1, 900), random.uniform(0, 1.5, 900)])
    assert found_table(views_of(FRONT, 10), measured(random, thing(random, 700), wall)) is None


def test_too_few_points_tell_no_table() -> None:
    random = np.random.default_rng(8)
    views = views_of(AROUND[::4], 30)
    assert found_table(views, measured(random, thing(random, 20), table(random, 20))) is None
    _, how = enclosing_box(views, None, object_alone=True)
    assert how == "found from what most cameras see; no table or ground was recognised to leave out"


def calibration_of(views: list[View], points: NDArray[np.float64], folder: Path) -> Calibration:
    photograph = write_image(folder / "grey.png", np.full((120, 160, 3), 128, np.uint8))
    cameras = tuple(
        CalibratedCamera(view.name, photograph, 160, 120, np.array(view.K), np.zeros(5), view.cam_from_world)
        for view in views
    )
    nothing = Observations(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))
    return Calibration(cameras, points, np.zeros((len(points), 3), np.uint8), nothing, mm_per_unit=1000.0)


def test_a_calibration_is_turned_upright_by_the_table(tmp_path: Path) -> None:
    random = np.random.default_rng(9)
    points = measured(random, thing(random, 700), table(random, 600))
    tilted = Similarity(1.0, rotation(np.array([0.2, -0.3, 0.1])), np.array([3.0, 4, 5]))
    views = moved(views_of(AROUND, 30), tilted)
    found = with_object_alone(calibration_of(views, tilted(points), tmp_path))
    np.testing.assert_allclose(found.points[:, 2], points[:, 2], atol=0.02)
    assert found.mm_per_unit == 1000.0
    assert found.bounds is not None
    assert 0 < found.bounds.low[2] < 0.02
    assert found.bounds.longest < 1.1
    assert "table left out" in found.notes["bounds"]
    for camera, view in zip(found.cameras, views, strict=True):
        np.testing.assert_allclose(camera.project(found.points), view.project(tilted(points))[0], atol=1e-6)


def test_a_calibration_without_a_table_stays(tmp_path: Path) -> None:
    random = np.random.default_rng(10)
    given = calibration_of(views_of(AROUND, 30), measured(random, thing(random, 700)), tmp_path)
    found = with_object_alone(given)
    assert found.bounds is None
    assert found.points is given.points
    assert found.notes["bounds"] == "not known: no table or ground was recognised to leave out"
