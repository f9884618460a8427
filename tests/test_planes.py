"""Slanted windows: the kernels against slow, obvious twins, and that threads do not matter."""

from __future__ import annotations

from collections.abc import Iterator

import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, cameras, cropped, grain, photographs
from scipy.ndimage import gaussian_filter

from recon3d.kernels.fusion import Agreement, Means, PlaneMap, PlaneView, add_agreeing, finish_means, start_means
from recon3d.kernels.patch_match import NOTHING, HalfSweep, Planes, Search, WeightedWindow, match_planes
from recon3d.kernels.surface_visibility import Surface, find_visible
from recon3d.kernels.types import Compared
from recon3d.rendering.renderer import Renderer
from recon3d.scene.scene import Scene
from recon3d.stereo.patch_match import plane_normals

STRIDE = 2


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Four views of a ball, the last a little smaller."""
    whole = photographs(ball_mesh(), grain, cameras(4, arc=60))
    return Scene((*whole.views[:3], cropped(whole.views[3], 44, 33)), whole.bounds)


@pytest.fixture(scope="module")
def guides(scene: Scene) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth, 0 beside the ball, and normals at strided pixels of all views."""
    depths, normals = np.zeros((4, 36, 48), np.float32), np.zeros((4, 18, 24, 3), np.float32)
    for n, view in enumerate(scene.views):
        rendering = Renderer(ball_mesh()).render_view(view)
        depths[n, : view.height, : view.width] = np.where(rendering.hit, rendering.depth, 0)
        strided = rendering.normals[::STRIDE, ::STRIDE]
        normals[n, : strided.shape[0], : strided.shape[1]] = strided
    return depths, normals


@pytest.fixture
def threads() -> Iterator[None]:
    """Restores the number of threads."""
    before = numba.get_num_threads()
    yield
    numba.set_num_threads(before)


def visible_twin(
    scene: Scene, depths: NDArray[np.float32], normals: NDArray[np.float32], tolerance: float, min_cosine: float
) -> NDArray[np.uint32]:
    """What ``find_visible`` finds for the first view."""
    view, others = scene.views[0], scene.views[1:]
    visible = np.zeros((18, 24), np.uint32)
    for row, column in np.argwhere(depths[0, ::STRIDE, ::STRIDE] > 0):
        v, u = STRIDE * row, STRIDE * column
        in_camera = depths[0, v, u] * np.linalg.inv(view.K) @ [u, v, 1]
        point = np.linalg.inv(view.cam_from_world) @ [*in_camera, 1]
        for j, other in enumerate(others):
            sight = other.center - point[:3]
            pixel, far = other.project(point[None, :3])
            s, t = np.floor(pixel[0] + 0.5).astype(int)
            inside = 1 <= s < other.width - 1 and 1 <= t < other.height - 1
            if normals[0, row, column] @ sight < min_cosine * np.linalg.norm(sight) or not inside:
                continue
            around = depths[j + 1, t - 1 : t + 2, s - 1 : s + 2]
            if ((around > 0) & (np.abs(around - far[0]) <= tolerance)).any():
                visible[row, column] |= np.uint32(1 << j)
    return visible


def found_visible(
    scene: Scene, depths: NDArray[np.float32], normals: NDArray[np.float32], others: list[int], tolerance: float
) -> NDArray[np.uint32]:
    views = scene.packed.cameras
    visible = np.full((18, 24), 77, np.uint32)
    surface = Surface(views.at(0), depths[0], normals[0], STRIDE)
    find_visible(surface, views.part(others), depths[others], tolerance, 0.15, visible)
    return visible


@pytest.mark.parametrize("tolerance", [0.05, 0.5])
def test_visible_is_what_faces_a_view_and_lies_at_its_depth(
    scene: Scene, guides: tuple[NDArray[np.float32], NDArray[np.float32]], tolerance: float
) -> None:
    depths, normals = guides
    occluded = depths.copy()
    occluded[2, 14:22, 18:30] -= 1.0  # something stands before the ball
    visible = found_visible(scene, occluded, normals, [1, 2, 3], tolerance)
    np.testing.assert_array_equal(visible, visible_twin(scene, occluded, normals, tolerance, 0.15))
    for bit in range(3):  # each decides somewhere
        assert 0 < ((visible >> bit) & 1).sum() < (depths[0, ::STRIDE, ::STRIDE] > 0).sum()


def test_thirty_two_views_fit_into_the_bits(
    scene: Scene, guides: tuple[NDArray[np.float32], NDArray[np.float32]]
) -> None:
    visible = found_visible(scene, *guides, [1] * 32, 0.1)
    assert set(np.unique(visible)) == {0, 2**32 - 1}


def bilinear(image: NDArray[np.float32], x: float, y: float) -> float:
    column, row = min(int(x), image.shape[1] - 2), min(int(y), image.shape[0] - 2)
    s, t = x - column, y - row
    patch = image[row : row + 2, column : column + 2].astype(float)
    return float(np.array([1 - t, t]) @ patch @ [1 - s, s])


def cost_twin(
    image: NDArray[np.float32],
    other: NDArray[np.float32],
    H: NDArray[np.float64],
    e: NDArray[np.float64],
    pixel: tuple[int, int],
    plane: NDArray[np.float32],
    *,
    radius: int,
    spacing: int,
    contrast: float,
    affine: bool,
    told: NDArray[np.float64] | float = 1.0,
) -> float:
    """1 - weighted NCC of a window and its image by the plane's homography, or by that one's affine part.

    Samples weigh besides as they are told, by (rows, columns).
    """
    u, v = pixel
    w, along_u, along_v = plane.astype(float)

    def warp(du: float, dv: float) -> NDArray[np.float64]:
        x, y, z = H @ [u + du, v + dv, 1] + (w + along_u * du + along_v * dv) * e
        return np.array([x / z, y / z])

    h = 1e-4
    middle, Ju, Jv = warp(0, 0), (warp(h, 0) - warp(-h, 0)) / (2 * h), (warp(0, h) - warp(0, -h)) / (2 * h)
    shares = np.broadcast_to(told, image.shape)
    half = radius // spacing
    steps = [(c, r) for r in range(-half, half + 1) for c in range(-half, half + 1)]
    weights, own, seen = [], [], []
    for c, r in steps:
        du, dv = spacing * c, spacing * r
        x, y = middle + du * Ju + dv * Jv if affine else warp(du, dv)
        own.append(float(image[v + dv, u + du]))
        seen.append(bilinear(other, x, y))
        weights.append(np.exp(-abs(own[-1] - image[v, u]) / contrast - (c * c + r * r) / (2 * half**2)))
        weights[-1] *= shares[v + dv, u + du]
    covariance = np.cov(own, seen, aweights=weights)
    return float(1 - covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]))


class World:
    """A smooth random image before two others, and the pixels' places in those as match_planes wants them."""

    def __init__(self, scene: Scene) -> None:
        views = scene.packed.cameras
        rng = np.random.default_rng(5)
        noise = [gaussian_filter(rng.standard_normal((36, 48)), 2.0) for _ in range(3)]
        self.grey = np.stack([128 + 40 * image / image.std() for image in noise]).astype(np.float32)
        self.camera, self.others = views.at(0), views.part([1, 2])
        self.others = self.others._replace(sizes=np.array([[48, 36]] * 2))
        distance = np.linalg.norm(self.camera.center)
        self.planes = np.empty((18, 24, 3), np.float32)
        self.planes[..., 0] = 1 / (distance + rng.uniform(-0.5, 0.5, (18, 24)))
        self.planes[..., 1:] = rng.uniform(-5e-4, 5e-4, (18, 24, 2))
        self.costs = np.full((18, 24), NOTHING, np.float32)
        self.nearest = np.full((18, 24), distance - 1, np.float32)
        self.farthest = np.full((18, 24), distance + 1, np.float32)
        self.guide = np.full((36, 48), 1 / distance, np.float32)
        self.tangents = np.zeros((18, 24, 3), np.float32)
        self.tangents[..., 0] = 1 / distance

    def compared(self) -> Compared:
        """The first image with the others."""
        return Compared.between(self.grey[0], self.camera, self.grey[1:], self.others)

    def match(
        self, *, visible: int = 3, radius: int = 4, spacing: int = 1, most: int = 2, trials: int = 0, parity: int = 0,
        edge: float = 0.1, steps: int = 0,
    ) -> World:  # fmt: skip
        """One half sweep."""
        ranges = np.array([[np.inf, 1e-4], [1e-3, 1e-4], [5e-4, 5e-5]])[:trials]
        seen = np.full((18, 24), visible, np.uint32)
        match_planes(
            self.compared(), WeightedWindow(radius, spacing, 20.0, 2.0),
            Search(seen, self.guide, self.tangents, edge, self.nearest, self.farthest, STRIDE, most),
            HalfSweep(parity, ranges, steps),
            Planes(self.planes, self.costs),
        )  # fmt: skip
        return self


@pytest.mark.parametrize(("radius", "spacing"), [(4, 1), (5, 2)])
@pytest.mark.parametrize("bit", [0, 1])
def test_a_planes_cost_is_one_less_the_correlation_under_its_homography(
    scene: Scene, radius: int, spacing: int, bit: int
) -> None:
    # Nothing is tried but the plane that is there, of every second pixel, in one of the two views.
    world = World(scene).match(visible=1 << bit, radius=radius, spacing=spacing)
    H, e = world.compared().homographies[bit], world.compared().epipoles[bit]
    compared = np.argwhere(world.costs < 1.999)
    assert len(compared) > 50
    assert (compared.sum(axis=1) % 2 == 0).all()
    exact, linear = (
        np.array([
            cost_twin(
                world.grey[0], world.grey[1 + bit], H, e, (STRIDE * column, STRIDE * row),
                world.planes[row, column], radius=radius, spacing=spacing, contrast=20.0, affine=affine,
            )
            for row, column in compared
        ])
        for affine in (False, True)
    )  # fmt: skip
    found = world.costs[tuple(compared.T)]
    np.testing.assert_allclose(found, linear, atol=1e-4)
    # At 72 pixels' focal length and 20 degrees between views, the affine part misplaces the samples at a window's edge,
    # 5 pixels from its middle, by 5^2 sin(20 degrees) / 72 = 0.12 pixels, of images that change by a third of their
    # deviation a pixel: 0.04 of a deviation there, less inside. NCC follows at most twice that.
    np.testing.assert_allclose(found, exact, atol=0.08)
    assert np.median(np.abs(found - exact)) < 0.01


def test_windows_keep_to_the_side_of_their_pixel(scene: Scene) -> None:
    world = World(scene)
    rng = np.random.default_rng(3)
    flat = world.guide[0, 0]
    world.guide += flat * gaussian_filter(rng.standard_normal((36, 48)), 2).astype(np.float32) * 0.02
    world.guide[:, 24:] *= 1.2  # another surface, nearer
    world.guide[:14] = 0  # and none
    world.tangents[..., 0] = world.guide[::STRIDE, ::STRIDE]
    world.match(visible=1, edge=0.05)
    H, e = world.compared().homographies[0], world.compared().epipoles[0]
    compared = np.argwhere((world.costs < 1.999) & (world.tangents[..., 0] > 0))
    assert len(compared) > 50
    twins = []
    for row, column in compared:
        leaves = world.guide - world.tangents[row, column, 0].astype(float)
        told = np.where(world.guide > 0, 1 - np.square(leaves / (0.05 * world.tangents[row, column, 0])), 0)
        twins.append(
            cost_twin(
                world.grey[0], world.grey[1], H, e, (STRIDE * column, STRIDE * row), world.planes[row, column],
                radius=4, spacing=1, contrast=20.0, affine=True,
                told=np.square(np.maximum(told, 0)),
            )
        )  # fmt: skip
    np.testing.assert_allclose(world.costs[tuple(compared.T)], twins, atol=1e-4)


def test_steps_of_gauss_and_newton_find_a_plane_to_a_small_part_of_a_pixel(scene: Scene) -> None:
    # A pattern on a plane that stands parallel to the first image.
    def pattern(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float32]:
        waves = 40 * np.sin(0.7 * u + 0.3 * v) + 30 * np.sin(0.5 * v - 0.6 * u) + 20 * np.sin(0.9 * v)
        return (128 + waves).astype(np.float32)

    v, u = np.mgrid[:36, :48].astype(float)
    world = World(scene)
    exact = float(world.guide[0, 0])
    for j, (H, e) in enumerate(zip(world.compared().homographies, world.compared().epipoles, strict=True)):
        back = np.linalg.inv(H + exact * np.outer(e, [0, 0, 1]))
        x, y, z = np.tensordot(back, np.stack([u, v, np.ones_like(u)]), axes=1)
        world.grey[1 + j] = pattern(x / z, y / z)
    world.grey[0] = pattern(u, v)
    wrong = 0.02 * exact  # half a pixel in the nearer view
    world.planes[...] = [exact + wrong, 2e-4, -2e-4]
    started = World(scene)
    started.grey, started.planes[...] = world.grey, world.planes
    started.match(radius=3)
    world.match(radius=3, steps=5)
    compared = np.argwhere(started.costs < 1)
    assert len(compared) > 50
    planes, costs = world.planes[tuple(compared.T)], world.costs[tuple(compared.T)]
    assert (costs <= started.costs[tuple(compared.T)] + 1e-6).all()
    assert np.median(np.abs(planes[:, 0] - exact)) < 0.03 * wrong
    assert np.median(np.abs(planes[:, 1:])) < 0.2 * 2e-4


def test_the_two_best_views_count_and_one_alone_where_only_one_sees(scene: Scene) -> None:
    first, second, both, nearest = (
        World(scene).match(visible=visible, most=most).costs for visible, most in ((1, 2), (2, 2), (3, 2), (3, 1))
    )
    np.testing.assert_allclose(both, (first + second) / 2, atol=1e-6)
    np.testing.assert_array_equal(nearest, first)
    assert (World(scene).match(visible=0).costs == NOTHING).all()


def test_windows_without_contrast_are_left_alone(scene: Scene) -> None:
    world = World(scene)
    world.grey[0] = 100
    assert (world.match().costs == NOTHING).all()
    world = World(scene)
    world.grey[1:] = 0
    assert (world.match().costs == NOTHING).all()


def test_a_half_sweep_changes_one_colour_of_the_board_and_nothing_gets_worse(scene: Scene) -> None:
    world = World(scene).match(trials=3).match(trials=3, parity=1)
    planes, costs = world.planes.copy(), world.costs.copy()
    world.match(trials=3)
    odd = np.indices(costs.shape).sum(axis=0) % 2 == 1
    np.testing.assert_array_equal(world.planes[odd], planes[odd])
    np.testing.assert_array_equal(world.costs[odd], costs[odd])
    assert (world.costs <= costs + 1e-6).all()
    assert (world.costs[~odd] < costs[~odd]).mean() > 0.1
    depth = 1 / world.planes[..., 0]
    assert ((depth >= world.nearest - 1e-5) & (depth <= world.farthest + 1e-5)).all()


@pytest.mark.usefixtures("threads")
def test_sweeps_do_not_depend_on_the_number_of_threads(scene: Scene) -> None:
    results = []
    for count in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(count)
        world = World(scene)
        for sweep in range(4):
            world.match(trials=3, parity=sweep % 2)
        results.append((world.planes, world.costs))
    for one, two in zip(*results, strict=True):
        np.testing.assert_array_equal(one, two)


def average_twin(
    scene: Scene,
    planes: NDArray[np.float32],
    normals: NDArray[np.float32],
    weights: NDArray[np.float32],
    place: tuple[int, int, int],
    tolerance: float,
    min_cosine: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float, int, int]:
    """Point, normal, colour, support, and numbers of agreeing and contradicting views of a pixel's plane."""

    def point_of(n: int, r: int, c: int) -> NDArray[np.float64]:
        ray = np.linalg.inv(scene.views[n].K) @ [STRIDE * c, STRIDE * r, 1]
        return (np.linalg.inv(scene.views[n].cam_from_world) @ [*(ray / planes[n, r, c, 0]), 1])[:3]

    n, r, c = place
    point, normal = point_of(*place), normals[place].astype(float)
    parts = [(float(weights[place]), 0.0, normal, scene.views[n].image[STRIDE * r, STRIDE * c].astype(float))]
    contradicting = 0
    for j, other in enumerate(scene.views):
        pixel, depth = (answer[0] for answer in other.project(point[None]))
        column, row = np.floor(pixel / STRIDE + 0.5).astype(int)
        inside = 0 <= row < planes.shape[1] and 0 <= column < planes.shape[2]
        if j == n or not inside or weights[j, row, column] == 0:
            continue
        w, along_u, along_v = planes[j, row, column].astype(float)
        there = w + np.array([along_u, along_v]) @ (pixel - [STRIDE * column, STRIDE * row])
        height = normals[j, row, column] @ (point - point_of(j, row, column))
        if abs(height) <= tolerance and normal @ normals[j, row, column] >= min_cosine:
            s, t = np.clip(np.floor(pixel + 0.5).astype(int), 0, [other.width - 1, other.height - 1])
            parts.append((float(weights[j, row, column]), -height, normals[j, row, column], other.image[t, s]))
        elif 1 / there - depth > 3 * tolerance:
            contradicting += 1
    weight, offset, facing, color = (np.array(part) for part in zip(*parts, strict=True))
    mean = weight @ facing
    support = weight.sum()
    return (
        point + (weight @ offset) / support * normal,
        mean / np.linalg.norm(mean),
        weight @ color / support,
        support,
        len(parts) - 1,
        contradicting,
    )


def test_planes_are_averaged_with_those_that_agree(
    scene: Scene, guides: tuple[NDArray[np.float32], NDArray[np.float32]]
) -> None:
    rng = np.random.default_rng(3)
    depths = guides[0][:, ::STRIDE, ::STRIDE]
    weights = np.where(depths > 0, rng.uniform(0.2, 1, depths.shape), 0).astype(np.float32)
    errors = rng.normal(0, 0.03, depths.shape) - 1.5 * (rng.random(depths.shape) < 0.1)  # a tenth far before the ball
    planes = np.zeros((*depths.shape, 3), np.float32)
    planes[..., 0] = np.divide(1, depths + errors, out=np.zeros(depths.shape), where=depths > 0)
    planes[..., 1:] = rng.normal(0, 1e-3, (*depths.shape, 2))
    normals = np.stack([plane_normals(view, each, STRIDE) for view, each in zip(scene.views, planes, strict=True)])
    for array in (planes, normals, weights):
        array.setflags(write=False)
    seen = [
        PlaneView(scene.cameras.at(n), view.image, PlaneMap(planes[n], normals[n], weights[n], STRIDE))
        for n, view in enumerate(scene.views)
    ]
    found = [Means.none(*depths.shape[1:]) for _ in seen]
    for own, asked, sums in zip(seen, [[1, 2, 3], [3, 2, 0], [0, 1, 3], [0, 1, 2]], found, strict=True):
        start_means(own, sums)
        for other in asked:
            add_agreeing(own, seen[other], Agreement(0.1, 0.8), sums)
        finish_means(own, sums)
    points, means, colors, support, _, agreeing, contradicting = map(np.stack, zip(*found, strict=True))
    for place in map(tuple, np.argwhere(weights > 0)):
        point, normal, color, weight, n_agreeing, n_contradicting = average_twin(
            scene, planes, normals, weights, place, 0.1, 0.8
        )
        assert (agreeing[place], contradicting[place]) == (n_agreeing, n_contradicting)
        np.testing.assert_allclose(points[place], point, atol=1e-5)
        np.testing.assert_allclose(means[place], normal, atol=1e-5)
        np.testing.assert_allclose(colors[place], color, atol=1e-3)
        assert support[place] == pytest.approx(weight, abs=1e-6)
    assert set(np.unique(agreeing)) == {0, 1, 2, 3}
    assert contradicting.max() >= 2
    assert (support[weights == 0] == 0).all()


def test_normals_of_planes_stand_on_the_planes_points(scene: Scene) -> None:
    planes = np.tile(np.array([0.17, 2e-3, -1e-3], np.float32), (4, 18, 24, 1))
    for n, view in enumerate(scene.views):
        normals = plane_normals(view, planes[n], STRIDE)
        u, v = 20, 16
        middle, right, below = (
            (np.linalg.inv(view.cam_from_world) @ [*(np.linalg.inv(view.K) @ [a, b, 1] / w), 1])[:3]
            for a, b, w in ((u, v, 0.17), (u + 1, v, 0.172), (u, v + 1, 0.169))
        )
        normal = normals[v // STRIDE, u // STRIDE]
        assert normal @ (right - middle) == pytest.approx(0, abs=1e-7)
        assert normal @ (below - middle) == pytest.approx(0, abs=1e-7)
        assert normal @ (view.center - middle) > 0
        assert np.linalg.norm(normal) == pytest.approx(1)
    assert (plane_normals(scene.views[0], np.zeros_like(planes[0]), STRIDE) == 0).all()
