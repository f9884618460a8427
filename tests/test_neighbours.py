"""Which views are matched with which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from reference import matching_neighbours_twin
from scenes import box_mesh, plain_view, transformed

from recon3d.errors import SceneError
from recon3d.rendering.orbit import look_at
from recon3d.scene.bounds import Bounds
from recon3d.scene.neighbours import Overlap, matching_neighbours, overlapping_neighbours
from recon3d.scene.scene import Scene
from recon3d.stereo.sharing import surface_neighbours

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


@pytest.mark.parametrize(("n_views", "spread"), [(3, 0.5), (8, 3.0), (10, 0.4)])
@pytest.mark.parametrize("most", [1, 4, 9])
def test_neighbours_are_those_of_the_definition(n_views: int, spread: float, most: int) -> None:
    rng = np.random.default_rng(n_views)
    directions = [5.0, 0.0, 0.0] + spread * rng.standard_normal((n_views, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    scene = looking_from(MIDDLE + rng.uniform(3, 9, (n_views, 1)) * directions)
    places = scene.bounds.places(512)[::5]
    found = matching_neighbours(scene, most, Overlap.of(scene, places))
    assert found == matching_neighbours_twin(scene, places, most)
    assert 0 < max(len(others) for others in found) <= most


def test_neighbours_lie_5_to_60_degrees_away() -> None:
    assert matching_neighbours(on_an_arc([0, 4.9, 59.5, 67, 180])) == [[2], [2], [3, 1], [2], []]
    assert matching_neighbours(on_an_arc([0, 5.1, 62])) == [[1], [0, 2], [1]]


def test_the_nearest_come_first_and_at_most_so_many() -> None:
    scene = on_an_arc([0, 40, -30, 20, -10, 55])
    assert matching_neighbours(scene, 5)[0] == [4, 3, 2, 1, 5]
    assert matching_neighbours(scene)[0] == [4, 3, 2, 1]
    assert matching_neighbours(scene, 2)[0] == [4, 3]


def test_neighbours_that_are_close_together_count_as_one() -> None:
    # The nearer one is taken; the third is far enough from it, though not from the second.
    assert matching_neighbours(on_an_arc([0, 20, 23, 26]))[0] == [1, 3]


def test_unit_and_place_of_the_world_do_not_matter() -> None:
    scene = on_an_arc([0, 20, 33, 50, 75], [6.0, 5.0, 9.0, 6.0, 7.0])
    moved = transformed(scene, 0.01, np.array([7.0, -3.0, 100.0]))
    assert matching_neighbours(moved) == matching_neighbours(scene)
    assert overlapping_neighbours(moved).tolist() == overlapping_neighbours(scene).tolist()


def test_of_two_views_as_far_away_that_whose_pixels_are_as_large_comes_first() -> None:
    assert matching_neighbours(on_an_arc([0, 20, -22]))[0] == [1, 2]
    assert matching_neighbours(on_an_arc([0, 20, -22], [6.0, 18.0, 6.0]))[0] == [2, 1]
    assert matching_neighbours(on_an_arc([0, 20, -22], [6.0, 8.0, 6.0]))[0] == [1, 2]


def along_a_wall(places: ArrayLike, turned: ArrayLike = 0.0, width: int = 30) -> Scene:
    """Cameras 2 before a wall 20 long that look straight at it, or turned by degrees; each sees 1.2 of it."""
    at = np.asarray(places, np.float64)
    views = []
    for n, (x, angle) in enumerate(zip(at, np.radians(np.broadcast_to(turned, at.shape)), strict=True)):
        center = np.array([x, -2.0, 0.0])
        pose = look_at(center, center + np.array([np.sin(angle), np.cos(angle), 0]), np.array([0, 0, 1.0]))
        views.append(plain_view(cam_from_world=pose, width=width, height=20, name=f"{n}"))
    return Scene(tuple(views), Bounds((-10, -0.1, -0.4), (10, 0.1, 0.4)), "wall")


def test_along_a_wall_those_are_matched_that_see_the_same_part_of_it() -> None:
    # By the angle at the bounds' middle the nearest to the first is five views on, and the outermost are as one.
    scene = along_a_wall(np.linspace(-9, 9, 31))
    assert matching_neighbours(scene)[0] == [1]
    assert matching_neighbours(scene)[15] == [14, 16]
    assert set(overlapping_neighbours(scene)[15]) == {14, 16, -1}


def test_views_from_one_place_both_count_where_they_see_different_parts() -> None:
    nearest, *others = matching_neighbours(along_a_wall([0, -0.5, -0.5, -0.5], [0, 4.0, 6.0, 28.0]))[0]
    assert nearest == 3
    assert others in ([1], [2])  # these two see about the same


def test_a_duplicate_is_no_neighbour() -> None:
    scene = on_an_arc([0, 0, 20, 20, 40])
    assert matching_neighbours(scene)[0] == [2, 4]
    assert overlapping_neighbours(scene)[0].tolist() == [2, 3, 4, -1]


def test_another_order_of_the_views_names_the_same_neighbours() -> None:
    scene = on_an_arc([0, 21, 37, 58, 90, 131])
    order = np.array([4, 2, 5, 0, 3, 1])
    shuffled = replace(scene, views=tuple(scene.views[n] for n in order))
    found = matching_neighbours(shuffled)
    expected = matching_neighbours(scene)
    assert [[order[other] for other in others] for others in found] == [expected[n] for n in order]


@pytest.mark.parametrize("angles", [[0], [0, 0], [0, 4], [0, 90], [0, 180, 4, 184], [0, 120, 240]])
def test_views_of_which_no_two_can_be_matched_are_refused(angles: list[float]) -> None:
    with pytest.raises(SceneError, match="scene random: no two views lie 5 to 60 degrees apart"):
        matching_neighbours(on_an_arc(angles))


def test_a_camera_in_the_middle_of_the_bounds_is_matched_with_none_that_sees_it_from_outside() -> None:
    scene = on_an_arc([0, 20])
    pose = np.eye(4)
    pose[:3, 3] = -MIDDLE
    inside = plain_view(cam_from_world=pose, width=8, height=6, name="inside")
    scene = replace(scene, views=(*scene.views, inside))
    assert matching_neighbours(scene) == [[1], [0], []]


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


def test_views_of_both_sides_of_a_plate_are_not_matched_once_it_is_known() -> None:
    angles = np.radians([20, 50, -20, -50])
    away = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    poses = (look_at(4.0 * direction, np.zeros(3), np.array([0, 0, 1.0])) for direction in away)
    views = (plain_view(cam_from_world=pose, name=f"{n}") for n, pose in enumerate(poses))
    scene = Scene(tuple(views), Bounds((-0.5, -0.1, -0.4), (0.5, 0.1, 0.4)), "plate")
    plate = box_mesh(0.9, 0.1, 0.7)
    plate.compute_triangle_normals()
    plate.remove_triangles_by_mask(np.abs(np.asarray(plate.triangle_normals)[:, 1]) < 0.5)  # its narrow sides
    plate = plate.subdivide_midpoint(4)
    plate.compute_vertex_normals()
    assert matching_neighbours(scene) == [[1, 2], [0], [3, 0], [2]]
    assert surface_neighbours(scene, plate, 4, clearance=0.01) == [[1], [0], [3], [2]]


def test_views_that_share_nothing_of_the_surface_go_by_the_bounds() -> None:
    scene = on_an_arc([0, 20, 40])
    far = box_mesh(0.1, 0.1, 0.1).translate((50, 0, 0))
    far.compute_vertex_normals()
    assert surface_neighbours(scene, far, 4, clearance=0.01) == matching_neighbours(scene)
