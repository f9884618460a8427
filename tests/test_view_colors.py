"""Kernels of views' colours and windows against slow, obvious twins."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, cameras, photographs, plain_view

from recon3d.carving.observations import UnclaimedPixels, judge
from recon3d.consistency.base import Patches, Verdict
from recon3d.consistency.histogram import Histogram
from recon3d.kernels.view_colors import cached_distances, largest_norms, shared_bins, view_sums
from recon3d.kernels.windows import sample_windows
from recon3d.scene.bounds import Bounds
from recon3d.scene.packed import PackedViews
from recon3d.scene.scene import Scene
from recon3d.scene.view import View
from recon3d.volume.dense import CarvingVolume


def ragged_views(seed: int, n_voxels: int = 300, n_views: int = 5) -> tuple[list[list[NDArray[np.int64]]], Patches]:
    """Random voxels as lists of views' pixels (n, 3), and as patches; every third view is empty or so."""
    rng = np.random.default_rng(seed)
    voxels = []
    for _ in range(n_voxels):
        counts = rng.integers(1, 9, n_views) * (rng.random(n_views) < 0.7)
        counts[rng.integers(n_views)] += 1
        base, spread = rng.integers(0, 256, 3), rng.choice([0, 5, 40])
        voxels.append([np.clip(base + rng.integers(-spread, spread + 1, (n, 3)), 0, 255) for n in counts])
    counts = np.array([[len(pixels) for pixels in views] for views in voxels])
    ends = np.cumsum(counts).reshape(counts.shape)
    view_starts = np.concatenate([ends[:, :1] - counts[:, :1], ends], axis=1)
    colors = np.vstack([pixels for views in voxels for pixels in views]).astype(np.uint8)
    directions = rng.standard_normal((n_voxels, n_views, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return voxels, Patches(colors, view_starts, directions.astype(np.float32))


def seeing(views: list[NDArray[np.int64]]) -> list[NDArray[np.int64]]:
    return [pixels for pixels in views if len(pixels)]


def test_view_sums_are_those_of_each_view() -> None:
    voxels, patches = ragged_views(0)
    sums, squares = np.empty((len(voxels), 5, 3), np.int64), np.empty((len(voxels), 5), np.int64)
    view_sums(patches.colors, patches.view_starts, sums, squares)
    for n, views in enumerate(voxels):
        assert sums[n].tolist() == [pixels.sum(axis=0).tolist() for pixels in views]
        assert squares[n].tolist() == [int((pixels**2).sum()) for pixels in views]


@pytest.mark.parametrize(("order", "norm"), [(1, 1), (2, 2), (0, np.inf)])
def test_largest_norms_are_numpys_over_all_pairs(order: int, norm: float) -> None:
    rng = np.random.default_rng(1)
    means, seen = rng.uniform(0, 255, (200, 6, 3)), rng.random((200, 6)) < 0.6
    norms = np.empty(200)
    largest_norms(means, seen, order, norms)
    for n in range(200):
        pairs = combinations(means[n][seen[n]], 2)
        expected = max((float(np.linalg.norm(a - b, norm)) for a, b in pairs), default=0.0)
        assert norms[n] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("bins", [1, 3, 8, 32])
@pytest.mark.parametrize("overlap", [0.0, 0.2, 0.9])
def test_histograms_intersect_where_two_pixels_lie_in_one_bin_of_every_channel(bins: int, overlap: float) -> None:
    voxels, patches = ragged_views(2, n_voxels=120)
    degree = Histogram(bins, overlap)(patches).degree
    lower = (np.arange(bins) - overlap / 2) * 256 / bins
    upper = (np.arange(bins) + 1 + overlap / 2) * 256 / bins

    def filled(pixels: NDArray[np.int64]) -> set[tuple[int, int, int]]:
        inside = (pixels[:, :, None] >= lower) & (pixels[:, :, None] < upper)
        return {tuple(index[1:]) for index in np.argwhere(inside[:, 0, :, None, None] & inside[:, 1, None, :, None]
                & inside[:, 2, None, None, :]).tolist()}  # fmt: skip

    for n, views in enumerate(voxels):
        pairs = list(combinations([filled(pixels) for pixels in seeing(views)], 2))
        assert degree[n] == (sum(bool(a & b) for a, b in pairs) / len(pairs) if pairs else 1.0)
    assert len(np.unique(degree)) > 1 or bins < 8


def test_bins_may_number_more_than_the_bits_of_a_word() -> None:
    colors = np.array([[250, 250, 250], [250, 250, 250], [10, 250, 250]], np.uint8)
    agreement = np.empty(1)
    table = np.arange(256) * 32 // 256
    shared_bins(colors, np.array([[0, 1, 2, 3]]), 32, table, table, agreement)
    assert agreement[0] == pytest.approx(1 / 3)


def test_cached_distances_are_the_largest_of_the_smallest() -> None:
    voxels, patches = ragged_views(3)
    assert patches.directions is not None
    of_all, of_neighbours = np.empty(len(voxels)), np.empty(len(voxels))
    cached_distances(patches.colors, patches.view_starts, patches.directions, of_all, of_neighbours)
    for n, views in enumerate(voxels):
        caches = {j: pixels for j, pixels in enumerate(views) if len(pixels)}
        distance = {
            (j, k): np.linalg.norm(caches[j][:, None] - caches[k], axis=-1).min() for j, k in combinations(caches, 2)
        }
        assert of_all[n] == pytest.approx(max(distance.values(), default=0))
        # Kruskal: the pairs by angle, as long as they join what is not joined yet.
        cosine = {(j, k): float(patches.directions[n, j] @ patches.directions[n, k]) for j, k in distance}
        group = {j: j for j in caches}
        kept = []
        for j, k in sorted(cosine, key=lambda pair: -cosine[pair]):
            if group[j] != group[k]:
                kept.append(distance[j, k])
                group = {view: group[j] if of == group[k] else of for view, of in group.items()}
        assert of_neighbours[n] == pytest.approx(max(kept, default=0))
    assert (of_neighbours < of_all).any()


def arc_scene() -> Scene:
    return photographs(ball_mesh(0.7), taken_by=cameras(3))


def luminance_at(view: View, point: NDArray[np.float64]) -> float:
    """Bilinear luminance of a view at a world point; NaN outside the image."""
    (u, v), depth = view.project(point[None])[0][0], view.project(point[None])[1][0]
    if depth <= 0 or not (0 <= u <= view.width - 1 and 0 <= v <= view.height - 1):
        return float("nan")
    grey = view.image @ np.array([0.299, 0.587, 0.114])
    u0, v0 = min(int(u), view.width - 2), min(int(v), view.height - 2)
    a, b = u - u0, v - v0
    rows = [(1 - a) * grey[v0 + row, u0] + a * grey[v0 + row, u0 + 1] for row in (0, 1)]
    return float((1 - b) * rows[0] + b * rows[1])


@pytest.mark.parametrize("voxel_size", [0.02, 0.9])
def test_windows_hold_what_the_views_show_on_a_plane_that_faces_them(voxel_size: float) -> None:
    scene, side = arc_scene(), 3
    arrays = scene.packed
    rng = np.random.default_rng(4)
    centers = rng.uniform(-1.4, 1.4, (60, 3))
    counts = rng.integers(0, 2, (60, 3))
    windows = np.empty((60, 3, side, side), np.float32)
    sample_windows(centers, voxel_size, counts, arrays.cameras, arrays.images, windows)
    compared = cut = 0
    for n in range(60):
        seen = [view for view, count in zip(scene.views, counts[n], strict=True) if count]
        assert np.isnan(windows[n][counts[n] == 0]).all()
        if not seen:
            continue
        toward = np.array([view.center - centers[n] for view in seen])
        distance = np.linalg.norm(toward, axis=1)
        normal = (toward / distance[:, None]).sum(axis=0)
        normal /= np.linalg.norm(normal)
        pixel = np.mean([d / np.sqrt(view.K[0, 0] * view.K[1, 1]) for d, view in zip(distance, seen, strict=True)])
        across = np.cross([0, 0, 1], normal)
        across *= max(pixel, voxel_size / side) / np.linalg.norm(across)
        down = np.cross(normal, across)
        points = [centers[n] + i * down + j * across for i in (-1, 0, 1) for j in (-1, 0, 1)]
        for j, view in enumerate(scene.views):
            if not counts[n, j]:
                continue
            expected = np.array([luminance_at(view, point) for point in points])
            if np.isnan(expected).any():
                assert np.isnan(windows[n, j]).all()
                cut += 1
            else:
                # float32 of up to 255
                np.testing.assert_allclose(windows[n, j].ravel(), expected, rtol=0, atol=1e-3)
                compared += 1
    assert compared > 20
    assert cut > 5 or voxel_size < 0.5


class Noting:
    """A test that asks for everything and keeps what it gets."""

    needs_directions = True
    window_side = 3

    def __init__(self) -> None:
        self.seen: list[Patches] = []

    def __call__(self, patches: Patches) -> Verdict:
        self.seen.append(patches)
        degree = patches.colors[patches.starts[:-1], 0] / 255
        return Verdict(degree, np.full(len(degree), 0.4), np.full(len(degree), 0.6))


def judged_batch() -> tuple[Patches, NDArray[np.float64], float, PackedViews]:
    scene = arc_scene()
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=300)
    views = scene.packed
    voxels = np.argwhere(volume.occupied)
    unclaimed = UnclaimedPixels(views, volume)
    boxes, counts, _ = unclaimed.footprints(voxels)
    visible = counts.any(axis=1)
    centers = volume.origin + volume.voxel_size * (voxels[visible] + 0.5)
    return unclaimed.patches(boxes[visible], counts[visible]), centers, volume.voxel_size, views


def test_directions_point_from_the_voxels_centre_to_the_cameras() -> None:
    patches, centers, size, views = judged_batch()
    test = Noting()
    judge(test, patches, centers, size, views)
    directions, windows = test.seen[0].directions, test.seen[0].windows
    assert directions is not None
    assert windows is not None
    toward = views.cameras.centers - centers[:, None]
    expected = toward / np.linalg.norm(toward, axis=-1, keepdims=True)
    np.testing.assert_allclose(directions, expected, atol=1e-6)  # float32
    assert directions.dtype == windows.dtype == np.float32
    assert np.isnan(windows[patches.counts == 0]).all()


def test_a_batch_judged_in_parts_gives_one_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    patches, centers, size, views = judged_batch()
    whole = judge(Noting(), patches, centers, size, views)
    monkeypatch.setattr("recon3d.carving.observations._NUMBERS", 7 * 36)
    test = Noting()
    parts = judge(test, patches, centers, size, views)
    assert [part.n_voxels for part in test.seen[:-1]] == [7] * (len(test.seen) - 1)
    assert len(test.seen) > 3
    for name in ("degree", "low", "high"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))


def test_a_test_that_asks_for_nothing_gets_no_more_than_pixels() -> None:
    patches, centers, size, views = judged_batch()
    seen = []

    def plain(given: Patches) -> Verdict:
        seen.append(given)
        one = np.ones(given.n_voxels)
        return Verdict(one, one, one)

    judge(plain, patches, centers, size, views)
    assert seen[0].directions is None
    assert seen[0].windows is None


def test_cameras_opposite_each_other_still_get_windows() -> None:
    ahead = plain_view()
    pose = np.diag([-1.0, 1.0, -1.0, 1.0])
    pose[2, 3] = 5.0
    behind = plain_view(cam_from_world=pose, name="behind")
    scene = Scene((ahead, behind), Bounds([-1, -1, -1], [1, 1, 1]))
    arrays = scene.packed
    windows = np.empty((1, 2, 3, 3), np.float32)
    sample_windows(np.zeros((1, 3)), 0.1, np.ones((1, 2), np.int64), arrays.cameras, arrays.images, windows)
    np.testing.assert_allclose(windows, 128, atol=1e-3)


def test_extras_of_the_wrong_shape_are_refused() -> None:
    _, patches = ragged_views(0, n_voxels=4)
    with pytest.raises(ValueError, match=r"expected directions \(4, 5, 3\)"):
        Patches(patches.colors, patches.view_starts, np.zeros((4, 4, 3), np.float32))
    with pytest.raises(ValueError, match=r"expected windows \(4, 5, side \* side\)"):
        Patches(patches.colors, patches.view_starts, windows=np.zeros((4, 6, 25), np.float32))
