from __future__ import annotations

from math import ceil, floor

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, cameras, photographs
from scipy.ndimage import gaussian_filter, generate_binary_structure, label, map_coordinates

from recon3d.carving.hysteresis import neighbour_offsets
from recon3d.kernels.footprints import carve_background, footprint, free_pixels, gather, mark
from recon3d.kernels.lattice import grow_consistent
from recon3d.kernels.matching import Tried, Window, best_depths
from recon3d.kernels.ragged import decile_ratios, mean_colors
from recon3d.kernels.types import Compared, Footprints, Pixels
from recon3d.scene.packed import PackedViews
from recon3d.scene.view import View
from recon3d.volume.dense import CarvingVolume

LUMINANCE = np.array([299, 587, 114])


def ragged(seed: int, n_sets: int = 700, longest: int = 60) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Random pixel sets of one pixel or more, some of them almost uniform, some of them black."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, longest, n_sets)
    starts = np.concatenate([[0], np.cumsum(counts)])
    base = np.repeat(rng.integers(0, 256, (n_sets, 3)), counts, axis=0)
    spread = np.repeat(rng.choice([0, 2, 20, 120], n_sets), counts)[:, None]
    colors = np.clip(base + spread * rng.standard_normal(base.shape), 0, 255).astype(np.uint8)
    colors[np.repeat(rng.random(n_sets) < 0.05, counts)] = 0
    return colors, starts


@pytest.mark.parametrize("seed", [0, 1])
def test_mean_colors_are_the_means_rounded_half_up(seed: int) -> None:
    colors, starts = ragged(seed)
    means = np.empty((len(starts) - 1, 3), np.uint8)
    mean_colors(colors, starts, means)
    for n, mean in enumerate(means):
        pixels = colors[starts[n] : starts[n + 1]].astype(np.int64)
        assert mean.tolist() == [floor(total / len(pixels) + 0.5) for total in pixels.sum(axis=0)]


@pytest.mark.parametrize("weights", [(299, 587, 114), (1000, 0, 0), (0, 0, 1000)])
@pytest.mark.parametrize("trim", [0.0, 0.1, 0.25])
def test_decile_ratios_are_numpys_quantiles_by_nearest_rank(weights: tuple[int, int, int], trim: float) -> None:
    colors, starts = ragged(3)
    ratios = np.ones(len(starts) - 1)
    decile_ratios(colors, starts, np.array(weights), trim, ratios)
    for n, ratio in enumerate(ratios):
        pixels = colors[starts[n] : starts[n + 1]].astype(np.int64)
        intensity = np.sort((pixels @ np.array(weights) + 500) // 1000)
        low = np.quantile(intensity, trim, method="inverted_cdf")
        # From the other end's rank, so that rounding of 1 - trim does not move it.
        high = intensity[max(ceil(round((1 - trim) * len(intensity), 9)), 1) - 1]
        assert ratio == (low / high if high else 1.0)


def test_one_and_two_pixels_keep_all_their_pixels() -> None:
    colors = np.array([[50] * 3, [100] * 3, [60] * 3], np.uint8)
    ratios = np.ones(2)
    decile_ratios(colors, np.array([0, 2, 3]), LUMINANCE, 0.1, ratios)
    assert ratios.tolist() == [0.5, 1.0]


@pytest.mark.parametrize(("n", "trimmed"), [(9, 0), (10, 0), (11, 1), (20, 1), (21, 2), (30, 2), (31, 3)])
def test_deciles_leave_out_whole_ranks(n: int, trimmed: int) -> None:
    # d1 has rank ceil(n / 10), so ceil(n / 10) - 1 pixels lie below it.
    values = np.arange(100, 100 + n)
    ratios = np.ones(1)
    decile_ratios(np.repeat(values, 3).reshape(-1, 3).astype(np.uint8), np.array([0, n]), LUMINANCE, 0.1, ratios)
    assert ratios[0] == values[trimmed] / values[ceil(9 * n / 10) - 1]


def test_decile_ratios_only_ever_lower_what_they_are_given() -> None:
    ratios = np.array([0.3, 1.0])
    decile_ratios(np.array([[90] * 3, [100] * 3] * 2, np.uint8), np.array([0, 2, 4]), LUMINANCE, 0.1, ratios)
    assert ratios.tolist() == [0.3, 0.9]


@pytest.mark.parametrize("connectivity", [6, 18, 26])
@pytest.mark.parametrize("density", [0.15, 0.3, 0.6])
def test_grow_consistent_keeps_the_components_that_hold_a_consistent_voxel(connectivity: int, density: float) -> None:
    rng = np.random.default_rng(connectivity)
    labels = np.zeros((12, 13, 14), np.uint8)
    labels[rng.random(labels.shape) < density] = 255
    labels[rng.random(labels.shape) < 0.02] = 4
    labels[rng.random(labels.shape) < 0.1] = 2
    structure = generate_binary_structure(3, {6: 1, 18: 2, 26: 3}[connectivity])
    # A consistent voxel joins candidates on either side of it, so it may count as one of them.
    component, _ = label((labels == 255) | (labels == 4), structure)
    kept = np.isin(component, component[labels == 4]) & (labels == 255)
    expected = np.where(kept, 4, labels)
    grown = labels.copy()
    grow_consistent(grown, np.argwhere(labels == 255), neighbour_offsets(connectivity), 255, 4)  # type: ignore[arg-type]
    np.testing.assert_array_equal(grown, expected)
    assert kept.any()
    assert (grown == 255).any() or density > 0.2


def test_grow_consistent_needs_no_candidates() -> None:
    labels = np.full((2, 2, 2), 4, np.uint8)
    grow_consistent(labels, np.empty((0, 3), np.int64), neighbour_offsets(26), 255, 4)
    assert (labels == 4).all()


def test_grow_consistent_walks_a_long_chain() -> None:
    labels = np.full((300, 1, 1), 255, np.uint8)
    labels[299] = 4
    grow_consistent(labels, np.argwhere(labels == 255), neighbour_offsets(6), 255, 4)
    assert (labels == 4).all()


def pixel_box(view: View, low: NDArray[np.float64], size: float) -> tuple[int, int, int, int]:
    """Obvious twin of the footprint of a voxel that lies well in front of the camera, not clipped to the image."""
    corners = low + size * np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), axis=-1).reshape(-1, 3)
    pixels, _ = view.project(corners)
    box = []
    for axis in range(2):
        first, last = ceil(pixels[:, axis].min()), floor(pixels[:, axis].max())
        if first > last:
            first = last = round((pixels[:, axis].min() + pixels[:, axis].max()) / 2)
        box += [first, last]
    return box[0], box[1], box[2], box[3]


@pytest.mark.parametrize("size", [0.01, 0.05, 0.3])
def test_the_footprint_is_the_box_of_whole_pixels_around_the_corners(size: float) -> None:
    scene = photographs(ball_mesh())
    view, cameras_of = scene.views[1], scene.packed.cameras
    rng = np.random.default_rng(0)
    seen = clipped = 0
    for low in rng.uniform(-2.6, 2.6, (400, 3)):
        u0, u1, v0, v1 = pixel_box(view, low, size)
        got = footprint(cameras_of, 1, tuple(low), size)
        if u1 < 0 or v1 < 0 or u0 >= view.width or v0 >= view.height:
            assert got[0] > got[1] or got[2] > got[3]
            assert not got[4]
            continue
        whole = u0 >= 0 and v0 >= 0 and u1 < view.width and v1 < view.height
        seen += whole
        clipped += not whole
        assert got == (max(u0, 0), min(u1, view.width - 1), max(v0, 0), min(v1, view.height - 1), whole)
    assert seen > 50
    assert clipped > 0 or size < 0.05


def test_a_voxel_with_a_corner_behind_the_camera_has_no_footprint() -> None:
    scene = photographs(ball_mesh())
    u0, u1, v0, v1, whole = footprint(scene.packed.cameras, 0, tuple(scene.centers[0] - 0.05), 0.1)
    assert u0 > u1
    assert v0 > v1
    assert not whole


def small_volume(size: int = 7) -> tuple[CarvingVolume, PackedViews]:
    """A small volume, and three views with silhouettes."""
    scene = photographs(ball_mesh(0.7), taken_by=cameras(3))
    return CarvingVolume.enclosing(scene.bounds, voxel_size=2.2 / size), scene.packed


def test_carve_background_clears_exactly_the_voxels_whose_box_holds_background_alone() -> None:
    volume, views = small_volume()
    occupied = volume.occupied.copy()
    carve_background(occupied, volume.lattice.packed, views.cameras, views.integrals)
    for voxel in np.argwhere(volume.occupied):
        low = tuple(volume.origin + volume.voxel_size * voxel)
        expected = True
        for n, foreground in enumerate(views.foreground):
            u0, u1, v0, v1, whole = footprint(views.cameras, n, low, volume.voxel_size)
            expected &= not whole or foreground[v0 : v1 + 1, u0 : u1 + 1].any()
        assert occupied[tuple(voxel)] == expected
    assert 0 < occupied.sum() < occupied.size


def test_pixels_are_counted_gathered_and_marked_as_slices_would() -> None:
    volume, views = small_volume()
    rng = np.random.default_rng(0)
    free = views.foreground & (rng.random(views.foreground.shape) < 0.7)
    voxels = np.argwhere(volume.occupied)
    boxes = np.empty((len(voxels), 3, 4), np.int32)
    counts = np.empty((len(voxels), 3), np.int64)
    in_frame = np.zeros(len(voxels), np.bool_)
    free_pixels(
        voxels, volume.lattice.packed, views.cameras, views.integrals, free, Footprints(boxes, counts, in_frame)
    )
    ends = np.cumsum(counts).reshape(counts.shape)
    view_starts = np.concatenate([ends[:, :1] - counts[:, :1], ends], axis=1)
    colors = np.zeros((int(counts.sum()), 3), np.uint8)
    gather(boxes, free, views.images, Pixels(colors, view_starts))
    for n in range(len(voxels)):
        any_foreground = False
        for view in range(3):
            u0, u1, v0, v1 = boxes[n, view]
            window = free[view, v0 : v1 + 1, u0 : u1 + 1]
            assert counts[n, view] == window.sum()
            own = colors[view_starts[n, view] : view_starts[n, view + 1]]
            np.testing.assert_array_equal(own, views.images[view, v0 : v1 + 1, u0 : u1 + 1][window])
            any_foreground |= bool(views.foreground[view, v0 : v1 + 1, u0 : u1 + 1].any())
        assert in_frame[n] == any_foreground
    assert counts.sum() > 500

    accepted = np.array([10, 60, 170])
    expected = free.copy()
    for n in accepted:
        for view in range(3):
            u0, u1, v0, v1 = boxes[n, view]
            expected[view, v0 : v1 + 1, u0 : u1 + 1] = False
    mark(boxes, accepted, free)
    np.testing.assert_array_equal(free, expected)


@pytest.mark.parametrize(("radius", "stride"), [(2, 1), (4, 2)])
def test_best_depths_are_those_of_the_largest_correlation_by_the_exact_homography(radius: int, stride: int) -> None:
    rng = np.random.default_rng(radius)
    image = gaussian_filter(rng.random((60, 80)), 2).astype(np.float32) * 2000
    # Tilted as by some tens of degrees between cameras of a few hundred pixels' focal length.
    homographies = np.array([[[1, 0.02, -1], [0.01, 1, 0], [5e-4, 0, 1]], [[0.98, 0, 1], [0, 1, 0.5], [0, -4e-4, 1]]])
    epipoles, truth = np.array([[8.0, 1, 0.01], [-1, 9, 0]]), 2.0
    # Other views show what the image does at the true depth.
    v, u = np.mgrid[:60, :80]
    others = []
    for H, e in zip(homographies, epipoles, strict=True):
        back = np.linalg.inv(H + np.outer(e, [0, 0, 1]) / truth)
        x, y, w = np.einsum("ij,jrc->irc", back, np.stack([u, v, np.ones_like(u)]))
        others.append(map_coordinates(image, [y / w, x / w], order=1, mode="nearest").astype(np.float32))
    pixels = np.array([[u, v] for u in range(20, 56, 5) for v in range(20, 40, 4)])
    depths, scores = np.zeros(len(pixels)), np.full(len(pixels), -1.0)
    nearest = np.full(len(pixels), 1.5)
    size = np.array([80, 60])
    compared = Compared(image, size, np.stack(others), np.stack([size, size]), homographies, epipoles)
    tried = Tried(nearest, nearest + 1, 0.05)
    best_depths(compared, Window(radius, stride, 1.0), pixels, tried, depths, scores)

    def correlation(pixel: NDArray[np.int64], z: float) -> float:
        dv, du = np.mgrid[-radius : radius + 1 : stride, -radius : radius + 1 : stride]
        u, v = pixel[0] + du.ravel(), pixel[1] + dv.ravel()
        correlations = []
        for H, e, other in zip(homographies, epipoles, others, strict=True):
            x, y, w = z * H @ np.stack([u, v, np.ones(len(u))]) + e[:, None]
            seen = map_coordinates(other, [y / w, x / w], order=1)
            correlations.append(np.corrcoef(image[v, u], seen)[0, 1])
        return float(np.mean(correlations))

    # Nothing behind the camera is seen, whichever view it would be seen by.
    behind, none = np.full(len(pixels), -1.0), np.zeros(len(pixels))
    best_depths(compared, Window(radius, stride, 1.0), pixels, Tried(-nearest - 1, -nearest, 0.05), none, behind)
    assert (behind == -1).all()
    tried = 1.5 + 0.05 * np.arange(21)
    for pixel, depth, score in zip(pixels, depths, scores, strict=True):
        expected = [correlation(pixel, z) for z in tried]
        assert score == pytest.approx(max(expected), abs=2e-3)
        assert abs(depth - tried[np.argmax(expected)]) <= 0.0501
    assert np.median(np.abs(depths - truth)) < 0.02
