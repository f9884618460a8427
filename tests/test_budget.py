"""Levels of detail, and what a run needs of each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import psutil
import pytest
from scenes import ball_mesh, cameras, grain, photographs

from recon3d import Bounds, Camera, Scene, Settings, View, VisualHull
from recon3d.budget import SCALES, advised_voxel_size, at_detail, needs
from recon3d.cli.arguments import bytes_of
from recon3d.errors import ArgumentError, NoRoomError
from recon3d.io.files import write_image
from recon3d.scene.segmentation import with_segmented_silhouettes
from recon3d.scene.silhouettes import with_threshold_silhouettes, without_silhouettes


@pytest.fixture(scope="module")
def scene() -> Scene:
    return photographs(ball_mesh(), grain, cameras(6))


def large(n_views: int, width: int, height: int) -> Scene:
    """Views of files that are not there: nothing but their sizes is asked for."""
    views = tuple(
        View(camera.calibration.scaled(width, height), np.broadcast_to(np.uint8(0), (height, width, 3)), None, f"{n}")
        for n, camera in enumerate(photographs(ball_mesh(), grain, cameras(n_views, width=40, height=30)).views)
    )
    return Scene(views, Bounds([-1] * 3, [1] * 3))


def test_a_shrunk_scene_shows_every_point_where_the_photographs_do(scene: Scene) -> None:
    half = scene.shrunk(0.5)
    points = np.random.default_rng(0).uniform(-0.7, 0.7, (50, 3))
    for view, small in zip(scene.views, half.views, strict=True):
        assert (small.width, small.height) == (round(view.width / 2), round(view.height / 2))
        pixels, depth = view.project(points)
        found, same = small.project(points)
        # A pixel's middle is half a pixel from its corner, whatever its size.
        np.testing.assert_allclose(found + 0.5, (pixels + 0.5) / 2, atol=1e-9)
        np.testing.assert_allclose(same, depth)
        np.testing.assert_array_equal(small.image, view.image_at(0.5))
    assert half.pixel_footprint == pytest.approx(2 * scene.pixel_footprint)
    assert scene.shrunk(1.0) is scene


def test_voxels_finer_than_a_pixel_are_not_advised(scene: Scene) -> None:
    """Of 48x36 pixels a million voxels would be finer; of photographs ten times as large they are not."""
    assert advised_voxel_size(scene) == pytest.approx(scene.pixel_footprint)
    fine = large(6, 480, 360)
    advised = advised_voxel_size(fine)
    assert advised > fine.pixel_footprint
    assert fine.bounds.extent.prod() / advised**3 == pytest.approx(1e6, rel=0.03)


def test_masks_shrink_with_the_photographs(scene: Scene, tmp_path: Path) -> None:
    given = scene.views[0].silhouette
    assert given is not None
    first = scene.views[0]
    file = write_image(tmp_path / "mask.png", 255 * given.view(np.uint8))
    for kept in (first, View(first.calibration, first.photograph, file)):
        view = kept.shrunk(0.5)
        found = view.silhouette
        assert found is not None
        share = cv2.resize(given.astype(np.float32), (view.width, view.height), interpolation=cv2.INTER_AREA)
        sure = np.abs(share - 0.5) > 0.01
        np.testing.assert_array_equal(found[sure], share[sure] > 0.5)


@pytest.mark.parametrize("make", [with_segmented_silhouettes, with_threshold_silhouettes])
def test_masks_that_are_made_are_made_of_the_shrunk_photographs(scene: Scene, make) -> None:  # type: ignore[no-untyped-def]
    bare = without_silhouettes(scene)
    for a, b in zip(make(bare).shrunk(0.5).views, make(bare.shrunk(0.5)).views, strict=True):
        np.testing.assert_array_equal(a.silhouette, b.silhouette)
        assert a.fingerprint() == b.fingerprint()


def test_distortion_is_undone_at_every_scale() -> None:
    rows, columns = np.mgrid[:60, :80]
    image = np.repeat((128 + 60 * np.sin(rows / 7) * np.cos(columns / 9))[..., None], 3, axis=2).astype(np.uint8)
    camera = Camera([[80, 0, 39.5], [0, 80, 29.5], [0, 0, 1]], np.eye(4), 80, 60, (-0.2, 0.05, 0, 0))
    view = View(camera, image)
    inner = np.s_[4:-4, 4:-4]
    difference = view.shrunk(0.5).image[inner].astype(int) - view.image_at(0.5)[inner]
    assert np.abs(difference).max() <= 2


def test_auto_takes_the_finest_that_fits() -> None:
    small, large_ones = large(8, 640, 480), large(60, 4000, 3000)
    assert at_detail(small, memory=4 * 2**30).scene is small
    chosen = at_detail(large_ones, memory=4 * 2**30)
    level = chosen.scene.notes["detail"]
    assert level in ("half", "quarter")
    assert chosen.told.startswith(f"{level}, ")
    assert "full would take" in chosen.told
    assert chosen.scene.views[0].width == round(4000 * SCALES[level])
    assert chosen.needs.memory <= 4 * 2**30


def test_what_takes_more_than_the_memory_given_is_refused_with_what_would_fit() -> None:
    views = large(60, 4000, 3000)
    least = needs(views.shrunk(0.25)).memory
    with pytest.raises(NoRoomError, match=r"at full detail, and .* GiB may be taken; --detail quarter would fit"):
        at_detail(views, "full", memory=1.05 * least)
    assert at_detail(views, "auto", memory=1.05 * least).scene.notes["detail"] == "quarter"
    with pytest.raises(NoRoomError, match="use fewer views"):
        at_detail(views, "auto", memory=0.5 * least)
    with pytest.raises(ArgumentError, match="expected detail auto, full, half, quarter, got 'eighth'"):
        at_detail(views, "eighth")  # type: ignore[arg-type]


def test_without_a_limit_auto_keeps_within_half_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    views = large(20, 1600, 1200)
    total = 2 * needs(views.shrunk(0.5)).memory
    monkeypatch.setattr(psutil, "virtual_memory", lambda: type("Memory", (), {"total": 1.02 * total}))
    assert at_detail(views).scene.notes["detail"] == "half"


def test_needs_grow_with_pixels_and_views() -> None:
    one, twice_the_views, finer = large(12, 1600, 1200), large(24, 1600, 1200), large(12, 3200, 2400)
    matching = [needs(views).seconds - needs(views, Settings(matching=None)).seconds for views in (one, finer)]
    assert matching[1] == pytest.approx(4 * matching[0], rel=0.35)  # cells of the octree are halved at most
    assert needs(twice_the_views).temporary == pytest.approx(2 * needs(one).temporary)
    assert needs(one).memory < needs(twice_the_views).memory < needs(finer).memory
    hull = replace(Settings(), carving=VisualHull(), n_voxels=2_000_000)
    assert needs(one, hull).memory > needs(one, replace(hull, n_voxels=1_000_000)).memory
    assert needs(twice_the_views, Settings(max_views=12)).temporary == needs(one).temporary


@pytest.mark.parametrize(
    ("text", "size"), [("4GiB", 4 * 2**30), ("800MB", 8e8), ("1.5 G", 1.5 * 2**30), ("2TB", 2e12), ("64MiB", 2**26)]
)
def test_sizes_are_read(text: str, size: float) -> None:
    assert bytes_of(text) == size


@pytest.mark.parametrize("text", ["", "4", "GiB", "0GiB", "-1GB", "4 GiBs", "4 XB"])
def test_what_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(ArgumentError, match="--memory: expected a size such as 4GiB"):
        bytes_of(text)
