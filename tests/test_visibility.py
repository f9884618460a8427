from __future__ import annotations

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import plain_view, rotation
from scipy.optimize import linprog, minimize, nnls

from recon3d.carving.visibility import largest_admissible_views, require_sweep_direction, spread_views, sweep_direction
from recon3d.errors import VisibilityError
from recon3d.rendering.orbit import look_at
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene

BOUNDS = Bounds([-1.0, -0.7, -0.5], [0.9, 0.8, 0.6])
CORNERS = BOUNDS.corners
K = np.array([[30.0, 0, 19.5], [0, 30.0, 14.5], [0, 0, 1]])


def scene_from(centers: NDArray[np.float64]) -> Scene:
    """Cameras at the given places that look at the origin."""
    up = np.array([0.123, 0.31, 1.0])
    views = tuple(
        plain_view(K, look_at(center, np.zeros(3), up), name=f"v{n}") for n, center in enumerate(np.asarray(centers))
    )
    return Scene(views, BOUNDS)


def separable(centers: NDArray[np.float64], corners: NDArray[np.float64]) -> bool:
    """Oracle: a linear program for the largest gap g with d . (corner - centre) >= g and |d_i| <= 1."""
    differences = (corners[None] - centers[:, None]).reshape(-1, 3)
    answer = linprog(
        [0, 0, 0, -1],
        A_ub=np.column_stack([-differences, np.ones(len(differences))]),
        b_ub=np.zeros(len(differences)),
        bounds=[(-1, 1)] * 3 + [(None, None)],
    )
    assert answer.success
    return bool(-answer.fun > 1e-7)


def random_centers(rng: np.random.Generator, n: int, spread: float) -> NDArray[np.float64]:
    """Cameras at distances 2.5 to 5 in directions around a random one; a large spread makes them infeasible."""
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    directions = axis + spread * rng.standard_normal((n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions * rng.uniform(2.5, 5, (n, 1))


def test_a_sweep_direction_is_found_exactly_when_there_is_one() -> None:
    rng = np.random.default_rng(0)
    answers = []
    for _ in range(150):
        centers = random_centers(rng, int(rng.integers(1, 9)), rng.uniform(0.1, 1.5))
        found = sweep_direction(centers, CORNERS)
        assert (found is not None) == separable(centers, CORNERS)
        answers.append(found is not None)
        if found:
            gaps = (CORNERS[None] - centers[:, None]) @ found.direction
            assert np.linalg.norm(found.direction) == pytest.approx(1.0, abs=1e-12)
            assert gaps.min() == pytest.approx(found.margin, abs=1e-12)
            assert found.margin > 0
    # Both answers are met often.
    assert 30 < sum(answers) < 120


def test_the_margin_is_the_widest_one() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        centers = random_centers(rng, 4, 0.3)
        found = sweep_direction(centers, CORNERS)
        if found is None:
            continue
        differences = (CORNERS[None] - centers[:, None]).reshape(-1, 3)
        # Oracle: least distance x . difference >= 1 by another solver; the margin is 1 / |x|.
        answer = minimize(
            lambda x: x @ x,
            found.direction / found.margin * 1.3,
            jac=lambda x: 2 * x,
            constraints={"type": "ineq", "fun": lambda x, d=differences: d @ x - 1, "jac": lambda _, d=differences: d},
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 300},
        )
        assert found.margin == pytest.approx(1 / np.linalg.norm(answer.x), rel=1e-5)  # SLSQP's own accuracy


def test_the_direction_turns_with_the_world() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        centers = random_centers(rng, 5, 0.3)
        R, shift = rotation(rng.standard_normal(3)), rng.standard_normal(3)
        found = sweep_direction(centers, CORNERS)
        turned = sweep_direction(centers @ R.T + shift, CORNERS @ R.T + shift)
        assert (found is None) == (turned is None)
        if found and turned:
            np.testing.assert_allclose(turned.direction, R @ found.direction, atol=1e-9)
            assert turned.margin == pytest.approx(found.margin, abs=1e-9)


def test_the_direction_does_not_depend_on_the_world_unit() -> None:
    centers = random_centers(np.random.default_rng(3), 4, 0.2)
    metres, microns = sweep_direction(centers, CORNERS), sweep_direction(1e6 * centers, 1e6 * CORNERS)
    assert metres is not None
    assert microns is not None
    np.testing.assert_allclose(microns.direction, metres.direction, atol=1e-9)
    assert microns.margin == pytest.approx(1e6 * metres.margin, rel=1e-9)


def margin_of_all_pairs(centers: NDArray[np.float64], corners: NDArray[np.float64]) -> float | None:
    """Slow twin of sweep_direction: the least distance problem with every pair of camera and corner at once."""
    differences = (corners[None] - centers[:, None]).reshape(-1, 3)
    scale = np.abs(differences).max()
    system = np.vstack([differences.T / scale, np.ones(len(differences))])
    residual = system @ nnls(system, np.array([0.0, 0.0, 0.0, 1.0]))[0] - [0, 0, 0, 1]
    if -residual[3] < 1e-12:
        return None
    return float((differences @ residual[:3]).min() / np.linalg.norm(residual[:3]))


def test_few_pairs_of_camera_and_corner_decide_the_margin_of_all() -> None:
    rng = np.random.default_rng(4)
    lattice = np.stack(np.meshgrid(np.arange(-3, 4), np.arange(-3, 4)), axis=-1).reshape(-1, 2)
    wall = np.column_stack([lattice, np.full(len(lattice), 4.0)])
    worlds = [random_centers(rng, 200, spread) for spread in (0.1, 0.3, 0.4, 0.5, 5.0)]
    for centers in [*worlds, wall, np.repeat(wall[:3], 50, axis=0), wall[:1] * [0, 0, 1], CORNERS[:1], CORNERS[:2] * 3]:
        found, margin = sweep_direction(centers, CORNERS), margin_of_all_pairs(centers, CORNERS)
        assert (found is None) == (margin is None)
        if found:
            assert found.margin == pytest.approx(margin, rel=1e-9)


def test_a_camera_straight_before_a_face_sweeps_along_its_normal() -> None:
    found = sweep_direction(np.array([[0.0, 0.0, -4.0]]), CORNERS)
    assert found is not None
    np.testing.assert_allclose(found.direction, [0, 0, 1], atol=1e-12)
    assert found.margin == pytest.approx(3.5)


@pytest.mark.parametrize(
    "centers",
    [
        [[0.0, 0.0, 0.0]],
        [[4.0, 0.0, 0.0], [-4.0, 0.0, 0.0]],
        [[4.0, 0, 0], [-2, 3.5, 0], [-2, -3.5, 0]],
    ],
)
def test_cameras_inside_or_around_the_volume_have_no_direction(centers: list[list[float]]) -> None:
    assert sweep_direction(np.array(centers), CORNERS) is None


def best_subsets(centers: NDArray[np.float64]) -> tuple[int, float]:
    """Brute force: size of the largest admissible subset and the widest margin among those of that size."""
    for count in range(len(centers), 0, -1):
        margins = [
            found.margin
            for subset in combinations(range(len(centers)), count)
            if (found := sweep_direction(centers[list(subset)], CORNERS))
        ]
        if margins:
            return count, max(margins)
    return 0, 0.0


@pytest.mark.parametrize("spread", [0.6, 1.0, 5.0])
def test_the_largest_admissible_views_are_those_that_brute_force_finds(spread: float) -> None:
    rng = np.random.default_rng(int(10 * spread))
    smaller = 0
    for _ in range(12):
        centers = random_centers(rng, int(rng.integers(3, 9)), spread)
        scene = scene_from(centers)
        names = largest_admissible_views(scene)
        count, margin = best_subsets(scene.centers)
        chosen = sweep_direction(scene.subset(names).centers, CORNERS)
        assert chosen is not None
        # Cells narrower than the steps between candidate directions have margins of about 1e-4 times the distance.
        if margin > 1e-3:
            assert len(names) == count
            assert chosen.margin == pytest.approx(margin, rel=1e-6)
        assert names == sorted(names, key=lambda name: int(name[1:]))
        smaller += count < len(centers)
    assert smaller > 0


def test_on_a_ring_all_around_the_largest_arc_is_chosen() -> None:
    angles = np.radians(np.arange(0, 360, 30))
    centers = 4.1 * np.column_stack([np.cos(angles), np.sin(angles), 0.05 + 0 * angles])
    scene = scene_from(centers)
    names = largest_admissible_views(scene)
    count, margin = best_subsets_on_a_ring(scene.centers)
    found = sweep_direction(scene.subset(names).centers, CORNERS)
    assert found is not None
    assert len(names) == count
    assert found.margin == pytest.approx(margin, rel=1e-6)


def best_subsets_on_a_ring(centers: NDArray[np.float64]) -> tuple[int, float]:
    """Brute force over the arcs of consecutive cameras."""
    n = len(centers)
    for count in range(n, 0, -1):
        arcs = [[(start + step) % n for step in range(count)] for start in range(n)]
        margins = [found.margin for arc in arcs if (found := sweep_direction(centers[arc], CORNERS))]
        if margins:
            return count, max(margins)
    raise AssertionError


CUBE = Bounds([-1, -1, -1], [1, 1, 1])


def dome(rings: list[float], n: int, radius: float = 5.0) -> NDArray[np.float64]:
    """Rings of n cameras around the vertical axis at the given elevations, radians."""
    turns = 2 * np.pi * np.arange(n) / n
    return np.vstack(
        [
            radius * np.column_stack([np.cos(e) * np.cos(turns), np.cos(e) * np.sin(turns), np.full(n, np.sin(e))])
            for e in rings
        ]
    )


def awkward_scenes() -> dict[str, Scene]:
    """Cameras in general position, in exact symmetry, in one plane, in one place, inside the box, level with it."""
    rng = np.random.default_rng(8)
    anywhere = rng.standard_normal((20, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    aside = np.array([0, 0, 1e-13])  # look_at wants cameras outside the origin
    around_cube = {
        "a ring with exact ties": dome([0.0], 12),
        "a far ring": dome([0.0], 20, 400.0),
        "three rings": dome([0.1, 0.5, 0.9], 7),
        "a ring level with the top": dome([0.0], 16) + np.array([0, 0, 1]),
        "whole numbers": rng.integers(-3, 4, (20, 3)) + aside,
        "whole numbers near the box": rng.integers(-2, 3, (20, 3)) + aside,
        "whole numbers but for noise": rng.integers(-2, 3, (20, 3)) + 1e-9 * rng.standard_normal((20, 3)),
        "a tilted plane": rng.integers(-5, 6, (18, 2)) @ np.array([[1.0, 0, 1], [0, 1, 0]]) + aside,
        "a line": np.outer(rng.uniform(-5, 5, 15), [1, 0.3, 0.2]) + np.array([0, 3, 0.1]),
    }
    around = {
        "a sphere": 4 * anywhere,
        "a hemisphere": 4 * np.column_stack([anywhere[:, :2], abs(anywhere[:, 2])]),
        "all distances": anywhere * rng.uniform(0.3, 5, (20, 1)),
        "some inside": anywhere * rng.uniform(0.1, 2, (20, 1)),
        "the same place twice": np.tile(4 * anywhere[:10], (2, 1)),
        "nearly the same place": np.tile(4 * anywhere[:10], (2, 1)) + 1e-8 * rng.standard_normal((20, 3)),
        "one place": np.tile(4 * anywhere[:1], (6, 1)),
        "one wall": np.column_stack([rng.uniform(-3, 3, (20, 2)), np.full(20, 4.0)]),
    }
    scenes = {name: replace(scene_from(centers), bounds=CUBE) for name, centers in around_cube.items()}
    return scenes | {name: scene_from(centers) for name, centers in around.items()}


def best_of_all_crossings(scene: Scene) -> tuple[int, float]:
    """Slow twin: size and margin of the best of all subsets that directions beside crossings of two limits admit.

    Limits are the planes through the origin normal to corner - centre; eight directions are tried beside each crossing.
    """
    corners, centers = scene.bounds.corners, scene.centers
    limits = (corners[None] - centers[:, None]).reshape(-1, 3)
    limits = limits[(limits != 0).any(axis=1)]
    limits /= np.linalg.norm(limits, axis=1, keepdims=True)
    first, second = np.triu_indices(len(limits), 1)
    crossings = np.cross(limits[first], limits[second])
    length = np.linalg.norm(crossings, axis=1)
    real = length > 1e-9
    a, b, crossings = limits[first[real]], limits[second[real]], crossings[real] / length[real, None]
    admitted = {}
    for sign, s, t in product((1, -1), repeat=3):
        directions = np.vstack([limits, sign * crossings + 1e-5 * (s * a + t * b)])
        inside = directions @ centers.T < (directions @ corners.T).min(axis=1)[:, None]
        packed = np.packbits(inside, axis=1)
        admitted |= {row.tobytes(): subset for row, subset in zip(packed, inside, strict=True)}
    subsets = sorted(admitted.values(), key=lambda subset: -subset.sum())
    best, widest = 0, 0.0
    for subset in subsets:
        if subset.sum() < max(best, 1):
            break
        margin = margin_of_all_pairs(centers[subset], corners)
        if margin:
            best, widest = int(subset.sum()), max(widest, margin)
    return best, widest


@pytest.mark.parametrize("name", awkward_scenes())
def test_walking_along_the_edges_finds_what_all_crossings_of_limits_find(name: str) -> None:
    scene = awkward_scenes()[name]
    names = largest_admissible_views(scene)
    count, margin = best_of_all_crossings(scene)
    assert len(names) == count
    found = sweep_direction(scene.subset(names).centers, scene.bounds.corners)
    assert found is not None
    assert found.margin == pytest.approx(margin, rel=1e-9)


def test_of_equal_margins_the_earliest_views_win() -> None:
    around = np.array([[0.0, 0, 4], [4, 0, 0], [0, 0, -4], [-4, 0, 0]])
    for turn in range(4):
        scene = replace(scene_from(np.roll(around, turn, axis=0)), bounds=CUBE)
        assert largest_admissible_views(scene) == ["v0", "v1"]


def test_no_view_can_be_added_among_312_and_no_direction_of_many_admits_more() -> None:
    rng = np.random.default_rng(312)
    centers = random_centers(rng, 312, 5.0)
    scene = scene_from(centers)
    names = largest_admissible_views(scene)
    chosen = [view.name in names for view in scene.views]
    assert sweep_direction(scene.centers[chosen], CORNERS)
    for n in np.flatnonzero(~np.array(chosen)):
        assert sweep_direction(np.vstack([scene.centers[chosen], scene.centers[n]]), CORNERS) is None
    directions = rng.standard_normal((20_000, 3))
    admitted = directions @ scene.centers.T < (directions @ CORNERS.T).min(axis=1)[:, None]
    assert 100 < admitted.sum(axis=1).max() <= len(names) < 312


def test_a_limit_leaves_out_one_of_the_nearest_pair_first() -> None:
    scene = scene_from(np.array([[0.0, 0, 4], [0.01, 0, 4], [1.5, 0, 4], [-1.5, 0, 4]]))
    assert len(largest_admissible_views(scene)) == 4
    kept = [view.name for view in spread_views(scene, 3).views]
    assert kept in (["v0", "v2", "v3"], ["v1", "v2", "v3"])
    assert len(spread_views(scene, 1).views) == 1
    assert [view.name for view in spread_views(scene, 9).views] == ["v0", "v1", "v2", "v3"]


@pytest.mark.parametrize("name", awkward_scenes())
def test_the_views_that_are_left_spread_are_those_of_measuring_all_gaps_anew(name: str) -> None:
    scene = awkward_scenes()[name]
    views = list(scene.views)
    while len(views) > 1:
        assert [view.name for view in spread_views(scene, len(views)).views] == [view.name for view in views]
        centers = np.array([view.center for view in views])
        gaps = np.linalg.norm(centers[:, None] - centers, axis=2)
        gaps[np.diag_indices(len(views))] = np.inf
        views.pop(int(gaps.min(axis=1).argmin()))


def test_no_admissible_view_is_an_error() -> None:
    inside = scene_from(np.array([[0.1, 0.2, 0.3]]))
    with pytest.raises(VisibilityError, match="no single view satisfies"):
        largest_admissible_views(inside)


def test_the_error_names_the_views_to_leave_out() -> None:
    scene = scene_from(np.array([[4.0, 0, 0], [4.0, 0.8, 0], [-4.0, 0, 0], [4.0, -0.8, 0.1]]))
    with pytest.raises(VisibilityError, match=r"3 of 4 views can be used together; leave out v2,") as caught:
        require_sweep_direction(scene, scene.bounds)
    assert "v0" not in str(caught.value)
    usable = require_sweep_direction(scene.subset(["v0", "v1", "v3"]), scene.bounds)
    assert usable.direction[0] < -0.9
