"""Which views are matched with which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from reference import matching_neighbours_twin
from scenes import plain_view, transformed

from recon3d.errors import SceneError
from recon3d.rendering.orbit import look_at
from recon3d.scene.bounds import Bounds
from recon3d.scene.neighbours import matching_neighbours, overlapping_neighbours
from recon3d.scene.scene import Scene

MIDDLE = np.array([0.3, -0.2, 0.5])
BOUNDS = Bounds(MIDDLE - 1, MIDDLE + 1)


def looking_from(centers: NDArray[np.float64]) -> Scene:
    """Cameras (n, 3) that look at the middle of the bounds."""
    views = (
        plain_view(cam_from_world=look_at(center, MIDDLE, np.array([0.1, 0.2, 1.0])), width=8, height=6, name=f"{n}")
        for n, center in enumerate(centers)
    )
    return Scene(tuple(views), BOUNDS, "random")


def on_an_arc(degrees: ArrayLike, distances: ArrayLike = 6.0) -> Scene:
    """Cameras in a plane through the middle, at angles from the first axis."""
    angles = np.radians(degrees)
    away = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    return looking_from(MIDDLE + np.broadcast_to(distances, len(away))[:, None] * away)


@pytest.mark.parametrize(("n_views", "spread"), [(3, 0.5), (12, 3.0), (40, 0.4), (60, 3.0)])
@pytest.mark.parametrize("most", [1, 4, 9])
def test_neighbours_are_those_of_the_definition(n_views: int, spread: float, most: int) -> None:
    rng = np.random.default_rng(n_views)
    directions = [5.0, 0.0, 0.0] + spread * rng.standard_normal((n_views, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    scene = looking_from(MIDDLE + rng.uniform(3, 9, (n_views, 1)) * directions)
    found = matching_neighbours(scene, most)
    assert found == matching_neighbours_twin(scene, most)
    assert 0 < max(len(others) for others in found) <= most


def test_neighbours_lie_5_to_60_degrees_away() -> None:
    assert matching_neighbours(on_an_arc([0, 4.99, 59.99, 65, 180])) == [[2], [2], [3, 1], [2], []]
    assert matching_neighbours(on_an_arc([0, 5.01, 60.01])) == [[1], [0, 2], [1]]


def test_the_nearest_come_first_and_at_most_so_many() -> None:
    scene = on_an_arc([0, 40, -30, 20, -10, 55])
    assert matching_neighbours(scene, 5)[0] == [4, 3, 2, 1, 5]
    assert matching_neighbours(scene)[0] == [4, 3, 2, 1]
    assert matching_neighbours(scene, 2)[0] == [4, 3]


def test_neighbours_that_are_close_together_count_as_one() -> None:
    # The nearer one is taken; the third is far enough from it, though not from the second.
    assert matching_neighbours(on_an_arc([0, 20, 23, 26]))[0] == [1, 3]


def test_only_the_direction_from_the_middle_counts() -> None:
    angles, rng = [0, 20, 33, 50, 75], np.random.default_rng(1)
    expected = matching_neighbours(on_an_arc(angles))
    assert matching_neighbours(on_an_arc(angles, rng.uniform(3, 30, 5))) == expected
    assert matching_neighbours(transformed(on_an_arc(angles), 0.01, np.array([7.0, -3.0, 100.0]))) == expected


def test_another_order_of_the_views_names_the_same_neighbours() -> None:
    scene = on_an_arc([0, 21, 37, 58, 90, 131])
    order = np.array([4, 2, 5, 0, 3, 1])
    shuffled = replace(scene, views=tuple(scene.views[n] for n in order))
    found = matching_neighbours(shuffled)
    expected = matching_neighbours(scene)
    assert [[order[other] for other in others] for others in found] == [expected[n] for n in order]


@pytest.mark.parametrize("angles", [[0], [0, 4], [0, 90], [0, 180, 4, 184], [0, 120, 240]])
def test_views_of_which_no_two_can_be_matched_are_refused(angles: list[float]) -> None:
    with pytest.raises(SceneError, match="scene random: no two views lie 5 to 60 degrees apart"):
        matching_neighbours(on_an_arc(angles))


def test_a_camera_in_the_middle_of_the_bounds_has_no_neighbours() -> None:
    scene = on_an_arc([0, 20])
    pose = np.eye(4)
    pose[:3, 3] = -MIDDLE
    inside = plain_view(cam_from_world=pose, width=8, height=6, name="inside")
    scene = replace(scene, views=(*scene.views, inside))
    assert matching_neighbours(scene) == [[1], [0], []]
    assert overlapping_neighbours(scene).tolist() == [[1], [0], [-1]]


def test_views_overlap_up_to_a_right_angle_and_the_nearest_come_first() -> None:
    scene = on_an_arc([0, 10, 30, 80, 89, 91, 180])
    assert overlapping_neighbours(scene)[0].tolist() == [1, 2, 3, 4, -1]
    assert overlapping_neighbours(scene)[6].tolist() == [5, -1, -1, -1, -1]
    assert overlapping_neighbours(on_an_arc([0, 120])).shape == (2, 0)


def test_of_many_that_overlap_some_from_near_to_far_are_asked() -> None:
    scene = on_an_arc(np.arange(120))
    asked = overlapping_neighbours(scene, most=10)
    assert asked.shape == (120, 10)
    assert asked[0].tolist() == [1, 11, 21, 31, 41, 50, 60, 70, 80, 90]
    assert all(len(set(row)) == 10 and n not in row for n, row in enumerate(asked.tolist()))
