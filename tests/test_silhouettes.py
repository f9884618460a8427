from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, cameras, photographs, plain, plain_view
from scipy.ndimage import binary_dilation, binary_erosion

from recon3d.datasets.synthetic import BuiltInScene
from recon3d.errors import DataError
from recon3d.io.files import write_image
from recon3d.scene.background import Background, foreground
from recon3d.scene.bounds import Bounds
from recon3d.scene.image_file import ImageFile
from recon3d.scene.names import file_stems
from recon3d.scene.pixel_cache import PIXELS
from recon3d.scene.regions import bounds_mask
from recon3d.scene.scene import Scene
from recon3d.scene.segmentation import with_segmented_silhouettes
from recon3d.scene.silhouettes import (
    overlay,
    with_mask_files,
    with_threshold_silhouettes,
    without_silhouettes,
)
from recon3d.scene.view import View

WIDE = Bounds([-9, -9, -3], [9, 9, 3])  # fills the image of plain_view


def scene_with(image: NDArray[np.uint8]) -> Scene:
    """One view of the image, bounds that fill it."""
    view = plain_view(width=image.shape[1], height=image.shape[0], name="a.png")
    return Scene((replace(view, photograph=image),), WIDE)


def blob_image() -> NDArray[np.uint8]:
    """Black, with a bright rectangle, a hole in it and a bright speck away from it."""
    image = np.zeros((60, 80, 3), np.uint8)
    image[20:40, 25:55] = (90, 10, 10)
    image[28:31, 38:41] = 0
    image[8, 8] = 255
    return image


def silhouette_of(scene: Scene, **options: float) -> NDArray[np.bool_]:
    silhouette = with_threshold_silhouettes(scene, **options).views[0].silhouette  # type: ignore[arg-type]
    assert silhouette is not None
    return silhouette


def test_the_brightest_channel_decides_what_is_foreground() -> None:
    # 0.19 of white is 48.45.
    image = np.array([[[48, 0, 0], [0, 49, 0], [48, 48, 48], [0, 0, 255]]], np.uint8)
    assert foreground(image).tolist() == [[False, True, False, True]]
    assert foreground(image, 0.1).all()


def test_without_radii_the_silhouette_is_the_threshold() -> None:
    image = blob_image()
    np.testing.assert_array_equal(silhouette_of(scene_with(image), dilate=0, erode=0, fill=0), foreground(image))


@pytest.mark.parametrize(("dilate", "erode"), [(1, 0), (1, 1), (3, 1), (0, 1)])
def test_the_recipe_is_threshold_dilate_erode(dilate: int, erode: int) -> None:
    image = blob_image()
    # OpenCV's ellipse of radius one is a cross; more steps of it would be a diamond, so only radius three differs.
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.bool_)
    expected = foreground(image)
    if dilate == 3:
        v, u = np.mgrid[-3:4, -3:4]
        # Rows of the ellipse as OpenCV rasterises it.
        disc = np.abs(u) <= np.rint(3 * np.sqrt(1 - (v / 3) ** 2))
        expected = binary_dilation(expected, disc)
    elif dilate:
        expected = binary_dilation(expected, cross)
    if erode:
        expected = binary_erosion(expected, cross, border_value=True)
    np.testing.assert_array_equal(silhouette_of(scene_with(image), dilate=dilate, erode=erode, fill=0), expected)


def test_the_silhouette_keeps_a_margin_of_the_difference_of_the_radii() -> None:
    image = np.zeros((80, 100, 3), np.uint8)
    image[30:50, 35:65] = 200
    rows = np.flatnonzero(silhouette_of(scene_with(image)).any(axis=1))
    columns = np.flatnonzero(silhouette_of(scene_with(image)).any(axis=0))
    # Dilated by ten and eroded by seven.
    assert (rows[0], rows[-1], columns[0], columns[-1]) == (27, 52, 32, 67)


def test_a_dark_part_inside_the_object_is_closed() -> None:
    image = np.zeros((80, 100, 3), np.uint8)
    image[20:60, 20:80] = 200
    image[36:44, 45:53] = 0  # less than the ten pixels of dilation wide
    assert silhouette_of(scene_with(image), fill=0)[20:60, 20:80].all()


@pytest.mark.parametrize(("fill", "filled"), [(0, False), (2, False), (6, True)])
def test_enclosed_holes_smaller_than_a_disc_are_filled(fill: int, filled: bool) -> None:
    image = np.full((60, 80, 3), 200, np.uint8)
    image[25:34, 35:44] = 0  # 81 pixels, between the discs of radius 5 (78.5) and 6
    silhouette = silhouette_of(scene_with(image), dilate=0, erode=0, fill=fill)
    assert silhouette[25:34, 35:44].all() == filled
    assert silhouette[25:34, 35:44].any() == filled
    assert silhouette.sum() == 60 * 80 - (0 if filled else 81)


def test_a_hole_at_the_border_of_the_image_is_not_filled() -> None:
    image = np.full((60, 80, 3), 200, np.uint8)
    for rows, columns in ((slice(0, 3), slice(9, 12)), (slice(57, 60), slice(9, 12)), (slice(9, 12), slice(77, 80))):
        image[rows, columns] = 0
    silhouette = silhouette_of(scene_with(image), dilate=0, erode=0)
    assert (~silhouette).sum() == 27


@pytest.mark.parametrize("grey", [0, 200])
def test_an_image_of_background_or_object_alone_stays_so(grey: int) -> None:
    assert (silhouette_of(scene_with(np.full((30, 40, 3), grey, np.uint8))) == (grey > 0)).all()


def test_a_silhouette_that_touches_the_border_stays_attached() -> None:
    image = np.zeros((60, 80, 3), np.uint8)
    image[20:40, :30] = 200
    silhouette = silhouette_of(scene_with(image))
    assert silhouette[20:40, 0].all()
    assert not silhouette[:, 50:].any()


def test_only_the_named_views_get_a_silhouette() -> None:
    views = tuple(replace(plain_view(name=name), mask=np.ones((30, 40), np.bool_)) for name in "abc")
    treated = with_threshold_silhouettes(Scene(views, WIDE), only={"b"})
    assert [view.has_silhouette for view in treated.views] == [False, True, False]


def test_the_silhouette_is_cut_to_the_projected_bounds() -> None:
    image = np.full((60, 80, 3), 200, np.uint8)
    scene = replace(scene_with(image), bounds=Bounds([-1, -0.5, -0.1], [1, 0.5, 0.1]))
    silhouette = silhouette_of(scene)
    # The near face at depth 4.9 spans 50 / 4.9 = 10.2 pixels to each side of 39.5, and half of that up and down;
    # rounding outwards may add a pixel and a half.
    rows, columns = np.flatnonzero(silhouette.any(axis=1)), np.flatnonzero(silhouette.any(axis=0))
    np.testing.assert_allclose([columns[0], columns[-1]], [39.5 - 10.2, 39.5 + 10.2], atol=2)
    np.testing.assert_allclose([rows[0], rows[-1]], [29.5 - 5.1, 29.5 + 5.1], atol=2)
    np.testing.assert_array_equal(silhouette, bounds_mask(scene.bounds, scene.views[0]))


def test_every_point_of_the_bounds_projects_into_their_mask(temple: BuiltInScene) -> None:
    rng = np.random.default_rng(0)
    for low, high in ((0.1, 0.9), (0.35, 0.7), (0.0, 1.0)):
        whole = temple.scene.bounds
        corners = (np.add(whole.low, share * whole.extent) for share in (low, high))
        scene = replace(temple.scene, bounds=Bounds(*corners))
        for view in scene.views:
            points = rng.uniform(scene.bounds.low, scene.bounds.high, (20000, 3))
            # Half of them on a face, where the outline is.
            points[::2, 0] = scene.bounds.high[0]
            points[::4, 2] = scene.bounds.high[2]
            u, v = np.rint(view.project(points[view.sees(points)])[0]).astype(int).T
            assert bounds_mask(scene.bounds, view)[v, u].all()


def test_bounds_that_reach_behind_the_camera_fill_the_mask() -> None:
    scene = Scene((plain_view(),), Bounds([-1, -1, -20], [1, 1, 1]))
    assert bounds_mask(scene.bounds, scene.views[0]).all()


@pytest.mark.parametrize("level", [0.0, 1.0, -0.2, float("nan")])
def test_a_level_outside_zero_to_one_is_refused(level: float) -> None:
    with pytest.raises(ValueError, match="expected a level between 0 and 1"):
        with_threshold_silhouettes(scene_with(blob_image()), level=level)


@pytest.mark.parametrize("radii", [{"dilate": -1}, {"erode": -2}, {"fill": -1}])
def test_negative_radii_are_refused(radii: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="expected radii of 0 pixels or more"):
        with_threshold_silhouettes(scene_with(blob_image()), **radii)  # type: ignore[arg-type]


def test_silhouettes_can_be_dropped(temple: BuiltInScene) -> None:
    assert all(view.has_silhouette for view in temple.scene.views)
    assert all(view.silhouette is None for view in without_silhouettes(temple.scene).views)


@pytest.mark.parametrize("suffix", [".png", ".bmp"])
def test_mask_files_are_read_by_the_views_names(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(0)
    masks = {name: rng.random((30, 40)) < 0.5 for name in ("a", "b")}
    for name, mask in masks.items():
        write_image(tmp_path / f"{name}{suffix}", mask)
    scene = with_mask_files(Scene((plain_view(name="b.jpg"), plain_view(name="a.jpg")), WIDE), tmp_path)
    for view in scene.views:
        np.testing.assert_array_equal(view.silhouette, masks[view.name[0]])


def test_a_mask_is_white_above_the_middle_grey(tmp_path: Path) -> None:
    mask = np.full((30, 40), 127, np.uint8)
    mask[:, 20:] = 128
    write_image(tmp_path / "a.png", mask)
    silhouette = with_mask_files(Scene((plain_view(name="a.png"),), WIDE), str(tmp_path)).views[0].silhouette
    assert silhouette is not None
    assert not silhouette[:, :20].any()
    assert silhouette[:, 20:].all()


def one_view() -> Scene:
    return Scene((plain_view(name="a.png"),), WIDE)


def test_a_missing_mask_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="nowhere: expected a folder of mask images"):
        with_mask_files(one_view(), tmp_path / "nowhere")


def test_a_missing_mask_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"expected one mask named a\.\* for view a\.png, found 0"):
        with_mask_files(one_view(), tmp_path)


def test_two_masks_for_a_view_are_an_error(tmp_path: Path) -> None:
    for suffix in ("png", "bmp"):
        write_image(tmp_path / f"a.{suffix}", np.ones((30, 40), np.bool_))
    with pytest.raises(DataError, match="found 2"):
        with_mask_files(one_view(), tmp_path)


def test_an_unreadable_mask_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_text("no image")
    with pytest.raises(DataError, match=r"a\.png: not a readable image"):
        with_mask_files(one_view(), tmp_path)


def test_a_mask_of_another_size_is_an_error(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.ones((30, 41), np.bool_))
    with pytest.raises(
        DataError, match=r"a\.png: expected 40x30 pixels like view a\.png, or the same shape, got 41x30"
    ):
        with_mask_files(one_view(), tmp_path)


def test_the_overlay_tints_the_background_and_outlines_the_bounds() -> None:
    silhouette = np.zeros((60, 80), np.bool_)
    silhouette[:, :40] = True
    image = np.full((60, 80, 3), 100, np.uint8)
    view = replace(plain_view(width=80, height=60, name="a.png"), photograph=image, mask=silhouette)
    scene = Scene((view,), Bounds([-1, -1, -0.1], [1, 1, 0.1]))
    picture = overlay(scene, view)
    assert picture[5, 5].tolist() == [100, 100, 100]
    assert picture[5, 75].tolist() == [50, 70, 140]
    outline = (picture == (255, 220, 0)).all(axis=2)
    rows, columns = np.flatnonzero(outline.any(axis=1)), np.flatnonzero(outline.any(axis=0))
    # The near face spans 10.2 pixels to each side of (39.5, 29.5), and the outline is three pixels wide.
    np.testing.assert_allclose([columns[0], columns[-1], rows[0], rows[-1]], [29.3, 49.7, 19.3, 39.7], atol=3)
    assert not outline[28:32, 38:42].any()
    assert (view.image == 100).all()


def test_segmented_silhouettes_follow_the_outline_to_a_pixel() -> None:
    exact = photographs(ball_mesh(), plain, cameras(3, width=160, height=120), supersampling=2)
    found = with_segmented_silhouettes(without_silhouettes(exact))
    for view, truth in zip(found.views, exact.views, strict=True):
        assert view.silhouette is not None
        assert truth.silhouette is not None
        # One pixel to either side: the rim of a silhouette that holds every pixel touched is half dark.
        assert not (view.silhouette & ~binary_dilation(truth.silhouette)).any()
        assert not (~view.silhouette & binary_erosion(truth.silhouette, iterations=2)).any()


def test_a_dark_part_inside_the_object_stays_in_its_segment() -> None:
    scene = photographs(ball_mesh(), plain, cameras(1, width=160, height=120))
    image = scene.views[0].image.copy()
    image[58:62, 78:82] = 12
    segmented = with_segmented_silhouettes(replace(scene, views=(replace(scene.views[0], photograph=image),)))
    assert segmented.views[0].silhouette is not None
    assert segmented.views[0].silhouette[58:62, 78:82].all()


def test_only_the_named_views_are_segmented() -> None:
    scene = photographs(ball_mesh(), plain, cameras(3))
    treated = with_segmented_silhouettes(scene, only={"view02.png"})
    assert [view.has_silhouette for view in treated.views] == [False, True, False]


def test_a_black_image_has_an_empty_segment() -> None:
    scene = replace(scene_with(np.zeros((60, 80, 3), np.uint8)), bounds=Bounds([-1, -0.5, -0.1], [1, 0.5, 0.1]))
    (view,) = with_segmented_silhouettes(scene).views
    assert view.silhouette is not None
    assert not view.silhouette.any()


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files whose pixels are read, as they are; with nothing kept."""
    names: list[str] = []
    decode = ImageFile.decode

    def noted(file: ImageFile, **options: bool) -> NDArray[np.uint8]:
        names.append(file.path.name)
        return decode(file, **options)

    monkeypatch.setattr(ImageFile, "decode", noted)
    monkeypatch.setattr(PIXELS, "_limit", 0)
    return names


def in_files(scene: Scene, folder: Path) -> Scene:
    """The scene with its photographs in files, and without silhouettes."""
    views = (
        View(view.calibration, write_image(folder / view.name, view.image), None, view.name) for view in scene.views
    )
    return replace(scene, views=tuple(views))


@pytest.mark.parametrize("segmented", [True, False])
def test_silhouettes_are_computed_when_they_are_asked_for_and_once(
    tmp_path: Path, decoded: list[str], segmented: bool
) -> None:
    make = with_segmented_silhouettes if segmented else with_threshold_silhouettes
    in_memory = without_silhouettes(photographs(ball_mesh(), plain, cameras(3)))
    scene = make(in_files(in_memory, tmp_path))
    names = [view.name for view in scene.views]
    assert all(view.has_silhouette for view in scene.views)
    assert scene.summary()["silhouettes"] == 3
    assert decoded == []
    first = scene.views[0].silhouette
    # The level of the background is learnt of all views.
    assert sorted(decoded) == sorted([*names, names[0]] if segmented else names[:1])
    decoded.clear()
    again = scene.views[0].silhouette
    assert decoded == []
    np.testing.assert_array_equal(again, first)
    kept = pickle.loads(pickle.dumps(scene.views[0]))  # noqa: S301
    np.testing.assert_array_equal(kept.silhouette, first)
    assert decoded == []
    for view, expected in zip(scene.views, make(in_memory).views, strict=True):
        np.testing.assert_array_equal(view.silhouette, expected.silhouette)


def test_threads_that_ask_for_silhouettes_at_once_find_the_same(tmp_path: Path, decoded: list[str]) -> None:
    scene = in_files(photographs(ball_mesh(), plain, cameras(4)), tmp_path)
    one_by_one = [view.silhouette for view in with_segmented_silhouettes(scene).views]
    decoded.clear()
    shared = with_segmented_silhouettes(scene)
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda view: view.silhouette, [*shared.views, *shared.views]))
    for mask, expected in zip(found, one_by_one * 2, strict=True):
        np.testing.assert_array_equal(mask, expected)
    assert len(decoded) == 3 * 4  # for the level, for the mask, for the colors at what the masks disagree about


def test_a_computed_silhouette_stays_that_of_its_own_photograph() -> None:
    scene = with_segmented_silhouettes(photographs(ball_mesh(), plain, cameras(2)))
    dark = replace(scene.views[0], photograph=np.zeros((36, 48, 3), np.uint8))
    np.testing.assert_array_equal(dark.silhouette, scene.views[0].silhouette)


def test_computed_silhouettes_are_told_by_what_they_are_made_from(tmp_path: Path, decoded: list[str]) -> None:
    scene = in_files(photographs(ball_mesh(), plain, cameras(3)), tmp_path)
    darker = replace(scene, views=(*scene.views[:2], replace(scene.views[2], photograph=scene.views[2].image // 2)))
    decoded.clear()
    made = [
        scene, with_segmented_silhouettes(scene), with_threshold_silhouettes(scene),
        with_threshold_silhouettes(scene, level=0.3), with_segmented_silhouettes(replace(scene, bounds=WIDE)),
    ]  # fmt: skip
    assert len({one.fingerprint() for one in made}) == len(made)
    assert len(set(made)) == len(made)
    assert with_segmented_silhouettes(scene) == made[1]
    assert with_segmented_silhouettes(scene).fingerprint() == made[1].fingerprint()
    # The level of the background depends on the other views.
    first = with_segmented_silhouettes(darker).subset([scene.views[0].name])
    assert first.fingerprint() != made[1].subset([scene.views[0].name]).fingerprint()
    assert decoded == []


def test_the_level_of_the_background_is_the_percentile_of_all_its_pixels() -> None:
    rng = np.random.default_rng(0)
    box = Bounds([-1, -0.5, -0.1], [1, 0.5, 0.1])
    for brightest in (256, 30, 3):
        views = tuple(
            replace(plain_view(name=name), photograph=rng.integers(0, brightest, (30, 40, 3), dtype=np.uint8))
            for name in "abc"
        )
        background = Background(views, box)
        color = np.array(background.color, np.int64)
        assert (color.max() > 0) == (brightest == 256)
        beyond = np.concatenate([np.abs(view.image[~bounds_mask(box, view)] - color).max(axis=1) for view in views])
        assert background.level == pytest.approx(float(np.percentile(beyond, 99)) / 255, abs=1e-12)


def folders() -> Scene:
    names = ("a/001.png", "b/001.png", "B/001.JPG", "c 1/x.y.png", "b_001.png", "../001.png")
    return Scene(tuple(plain_view(name=name) for name in names), WIDE)


def test_files_of_views_bear_names_that_differ_in_any_case() -> None:
    stems = file_stems(folders())
    assert stems == {
        "a/001.png": "a_001", "b/001.png": "b_001", "B/001.JPG": "B_001-2", "c 1/x.y.png": "c_1_x.y",
        "b_001.png": "b_001-3", "../001.png": "001",
    }  # fmt: skip
    assert len({stem.casefold() for stem in stems.values()}) == len(stems)


@pytest.mark.parametrize("style", ["{name}.png", "{bare}.bmp", "flat"])
def test_masks_of_views_in_folders_are_found(tmp_path: Path, style: str) -> None:
    rng = np.random.default_rng(0)
    scene = folders()
    scene = replace(scene, views=scene.views[:2] + scene.views[3:4])
    for view in scene.views:
        own = style.format(name=view.name, bare=Path(view.name).with_suffix(""))
        own = f"{file_stems(scene)[view.name]}.png" if style == "flat" else own
        write_image(tmp_path / own, rng.random((30, 40)) < 0.5)
    rng = np.random.default_rng(0)
    for view in with_mask_files(scene, tmp_path).views:
        np.testing.assert_array_equal(view.silhouette, rng.random((30, 40)) < 0.5)


def test_a_turned_mask_is_told_why_it_does_not_fit(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.ones((40, 30), np.bool_))
    with pytest.raises(DataError, match="got 30x40; photographs are set upright as their EXIF says"):
        with_mask_files(one_view(), tmp_path)
