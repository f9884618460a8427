"""Masks, boxes and words that are found where a scene does not say them."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from formats import farthest_apart, without_skew, write_colmap, write_masks, write_photographs
from numpy.typing import NDArray
from PIL import Image
from scenes import plain_view
from typer.testing import CliRunner

from recon3d.calibration import photographs
from recon3d.calibration.photographs import find_photographs
from recon3d.cli.entry import app
from recon3d.datasets.synthetic import BuiltInScene
from recon3d.errors import ArgumentError, DataError, SceneError
from recon3d.io import open_scene, write_middlebury
from recon3d.io.files import write_image
from recon3d.io.photographs import find_image
from recon3d.scene.bounds import Bounds
from recon3d.scene.enclosing import enclosing_box, looked_at, silhouettes_explained
from recon3d.scene.image_file import ImageFile, read_image
from recon3d.scene.not_seen import FLIP, why_not_seen
from recon3d.scene.scene import Scene
from recon3d.scene.view import View


@pytest.fixture
def bare(temple: BuiltInScene, tmp_path: Path) -> Path:
    """The temple as a Middlebury set without masks."""
    views = tuple(replace(view, mask=None) for view in temple.scene.views)
    return write_middlebury(replace(temple.scene, views=views), tmp_path / "set")


def with_t(pose: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
    changed = pose.copy()
    changed[:3, 3] = t
    return changed


def same_masks(read: Scene, expected: Scene) -> bool:
    return all(
        np.array_equal(view.silhouette, ours.silhouette)  # type: ignore[arg-type]
        for view, ours in zip(read.views, expected.views, strict=True)
    )


@pytest.mark.parametrize("folder", ["mask", "masks", "Silhouettes", "silhouette", "../masks"])
@pytest.mark.parametrize("form", ["{name}", "{stem}.pgm", "{name}.png", "{stem}.mask.png", "{stem}_mask.png"])
def test_masks_under_usual_names_are_found(temple: BuiltInScene, bare: Path, folder: str, form: str) -> None:
    write_masks(temple.scene, bare / folder, form)
    read = open_scene(bare)
    assert same_masks(read, temple.scene)
    assert read.notes["masks"].startswith("8 of 8 views, ")


def test_masks_among_the_photographs_are_found_where_they_say_so(temple: BuiltInScene, bare: Path) -> None:
    write_masks(temple.scene, bare, "{stem}_mask.png")
    assert same_masks(open_scene(bare), temple.scene)


@pytest.mark.parametrize(
    "stored",
    [
        lambda mask: mask.astype(np.uint8),
        lambda mask: mask.astype(np.uint16),
        lambda mask: mask.astype(np.uint16) * np.uint16(65535),
        lambda mask: mask.astype(np.uint8) * np.uint8(128),
        lambda mask: np.where(mask, 180, 60).astype(np.uint8),
        lambda mask: np.repeat(255 * mask[..., None].astype(np.uint8), 3, 2),
    ],
)
def test_whatever_values_masks_hold_half_of_white_divides_them(
    temple: BuiltInScene, bare: Path, stored: Callable[[NDArray[np.bool_]], NDArray[np.uint8]]
) -> None:
    (bare / "masks").mkdir()
    for view in temple.scene.views:
        assert view.silhouette is not None
        assert cv2.imwrite(str(bare / "masks" / view.name), stored(view.silhouette))
    assert same_masks(open_scene(bare), temple.scene)


@pytest.mark.parametrize("scale", [0.5, 2])
def test_masks_of_another_size_are_scaled(temple: BuiltInScene, bare: Path, scale: float) -> None:
    (bare / "masks").mkdir()
    for view in temple.scene.views:
        assert view.silhouette is not None
        mask = 255 * view.silhouette.astype(np.uint8)
        way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        assert cv2.imwrite(
            str(bare / "masks" / view.name), cv2.resize(mask, None, fx=scale, fy=scale, interpolation=way)
        )
    for view, ours in zip(open_scene(bare).views, temple.scene.views, strict=True):
        assert view.silhouette is not None
        assert np.mean(view.silhouette != ours.silhouette) < 0.01


def test_some_of_the_views_may_have_masks(temple: BuiltInScene, bare: Path) -> None:
    write_masks(replace(temple.scene, views=temple.scene.views[:3]), bare / "masks", "{name}")
    read = open_scene(bare)
    assert [view.has_silhouette for view in read.views] == [True] * 3 + [False] * 5
    assert read.notes["masks"] == "3 of 8 views, masks"


def test_masks_that_are_named_otherwise_are_told_of(temple: BuiltInScene, bare: Path) -> None:
    for n, view in enumerate(temple.scene.views):
        write_image(bare / "masks" / f"cut{n}.png", view.silhouette)  # type: ignore[arg-type]
    with pytest.warns(
        UserWarning, match=r"masks: none of its 8 images \(cut0\.png\) is named like a view \(view01\.png\)"
    ):
        assert "masks" not in open_scene(bare).notes


def test_masks_in_one_folder_belong_to_views_in_several(temple: BuiltInScene, tmp_path: Path) -> None:
    names = [f"{'ab'[n % 2]}/{view.name}" for n, view in enumerate(temple.scene.views)]
    write_photographs(temple.scene, tmp_path / "images", names)
    renamed = [replace(view, name=name) for view, name in zip(temple.scene.views, names, strict=True)]
    write_colmap(without_skew(replace(temple.scene, views=tuple(renamed))), tmp_path / "sparse")
    write_masks(temple.scene, tmp_path / "masks", "{name}.png")
    read = open_scene(tmp_path)
    assert read.notes["masks"] == "8 of 8 views, masks"
    for view in read.views:
        ours = next(ours for ours in temple.scene.views if ours.name == Path(view.name).name)
        np.testing.assert_array_equal(view.silhouette, ours.silhouette)


def test_a_readme_of_another_frame_gives_no_box(temple: BuiltInScene, tmp_path: Path) -> None:
    write_photographs(temple.scene, tmp_path / "images")
    write_masks(temple.scene, tmp_path / "masks", "{name}.png")
    write_colmap(without_skew(temple.scene), tmp_path / "sparse")
    (tmp_path / "README.txt").write_text("The box is (-0.05 -0.04 0) (0.05 0.04 0.12)\n")
    assert open_scene(tmp_path).notes["bounds"] == "those of the README"
    (tmp_path / "README.txt").write_text("The box is (3 3 3) (4 4 4)\n")
    assert open_scene(tmp_path).notes["bounds"].endswith("found from the silhouettes of 8 views")


def test_two_masks_of_a_view_are_refused(temple: BuiltInScene, bare: Path) -> None:
    write_masks(temple.scene, bare / "masks", "{name}")
    write_masks(temple.scene, bare / "masks", "{stem}.mask.png")
    with pytest.raises(DataError, match=r"one mask for view view01\.png, found 2: view01\.mask\.png, view01\.png"):
        open_scene(bare)


def write_opacity(scene: Scene, folder: Path, opacity: Callable[[View], NDArray[np.uint8]]) -> None:
    for view in scene.views:
        assert cv2.imwrite(str(folder / view.name), np.dstack([view.image[..., ::-1], opacity(view)]))


def test_opacity_is_the_mask_unless_all_is_opaque(temple: BuiltInScene, bare: Path) -> None:
    write_opacity(temple.scene, bare, lambda view: 255 * view.silhouette.astype(np.uint8))  # type: ignore[union-attr]
    read = open_scene(bare)
    assert same_masks(read, temple.scene)
    assert read.notes["masks"] == "8 of 8 views, the photographs' opacity"
    write_opacity(temple.scene, bare, lambda view: np.full((view.height, view.width), 255, np.uint8))
    assert "masks" not in open_scene(bare, silhouettes="auto").notes


def test_a_box_is_found_from_silhouettes(temple: BuiltInScene) -> None:
    box, how = enclosing_box(temple.scene.views)
    tight = temple.ground_truth.get_axis_aligned_bounding_box()
    assert how == "found from the silhouettes of 8 views"
    assert (np.array(box.low) <= tight.min_bound).all()
    assert (np.array(box.high) >= tight.max_bound).all()
    # The cameras look down by 20 degrees: the hull goes on below the temple, by tan(20 degrees) of half its length.
    assert (box.extent[:2] < 1.25 * tight.get_extent()[:2]).all()
    assert box.low[2] > -0.019 - 0.008  # padding and a cell
    assert box.high[2] < 0.124 + 0.008


def test_without_silhouettes_a_box_is_what_most_cameras_see(temple: BuiltInScene) -> None:
    box, how = enclosing_box([replace(view, mask=None) for view in temple.scene.views])
    assert how == "found from what most cameras see"
    assert (np.array(box.low) < temple.scene.bounds.low).all()
    assert (np.array(box.high) > temple.scene.bounds.high).all()
    centers = temple.scene.centers
    assert not ((centers > box.low) & (centers < box.high)).all(axis=1).any()


def test_cameras_that_look_away_or_in_one_direction_are_told_so(temple: BuiltInScene) -> None:
    middle = looked_at(temple.scene.views)
    np.testing.assert_allclose(middle, temple.scene.bounds.center, rtol=0, atol=0.01)
    away = []
    for view in temple.scene.views:
        pose = np.diag([1.0, -1, -1, 1]) @ view.cam_from_world  # OpenGL's axes
        away.append(View.from_matrices(view.K, pose, view.image, name=view.name))
    with pytest.raises(
        SceneError, match=r"behind most of them: are the matrices camera-to-world, or the axes not OpenCV's"
    ):
        enclosing_box(away)
    with pytest.raises(SceneError, match="look in one direction"):
        enclosing_box([plain_view(name=str(n), cam_from_world=np.eye(4)) for n in range(3)])


def test_a_scene_is_made_of_arrays(temple: BuiltInScene, tmp_path: Path) -> None:
    views = temple.scene.views
    images = [view.image for view in views]
    poses = np.array([view.cam_from_world for view in views])
    masks = [view.silhouette for view in views]
    made = Scene.from_arrays(images, views[0].K, poses[:, :3], bounds=temple.scene.bounds, silhouettes=masks)
    assert [view.name for view in made.views] == [f"view{n}" for n in range(1, 9)]
    assert (
        farthest_apart(
            made, replace(temple.scene, views=tuple(replace(v, name=f"view{n + 1}") for n, v in enumerate(views)))
        )
        == 0
    )
    assert same_masks(made, temple.scene)
    found = Scene.from_arrays(images, [view.K for view in views], poses, silhouettes=masks)
    assert found.notes["bounds"] == "found from the silhouettes of 8 views"
    write_photographs(temple.scene, tmp_path)
    named = Scene.from_arrays(sorted(tmp_path.iterdir()), views[0].K, poses, bounds=temple.scene.bounds)
    assert [view.name for view in named.views] == [view.name for view in views]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": np.zeros((3, 3, 3))}, "expected K for each of 8 images, got 3"),
        ({"cam_from_world": np.eye(4)}, r"a pose for each of 8 images, got cam_from_world of shape \(4, 4\)"),
        ({"names": ["a"]}, "expected names for each of 8 images, got 1"),
        ({"silhouettes": [None]}, "expected silhouettes for each of 8 images, got 1"),
    ],
)
def test_arrays_that_do_not_go_together_are_refused(
    temple: BuiltInScene, change: dict[str, object], message: str
) -> None:
    views = temple.scene.views
    given = {"K": views[0].K, "cam_from_world": np.array([view.cam_from_world for view in views]), **change}
    with pytest.raises(ArgumentError, match=message):
        Scene.from_arrays([view.image for view in views], bounds=temple.scene.bounds, **given)  # type: ignore[arg-type]


def test_a_view_is_made_of_a_projection_matrix(temple: BuiltInScene) -> None:
    view = temple.scene.views[3]
    made = View.from_projection(-2 * view.projection, view.image, seen=temple.scene.bounds.center)
    np.testing.assert_allclose(made.K, view.K, rtol=0, atol=1e-9)
    np.testing.assert_allclose(made.cam_from_world, view.cam_from_world, rtol=0, atol=1e-12)
    with pytest.raises(ArgumentError, match=r"view left: .*left-handed"):
        View.from_projection(view.projection @ np.diag([1, -1, 1, 1]), view.image, name="left")


def test_a_box_in_another_unit_and_cameras_inside_a_box_are_told(temple: BuiltInScene, bare: Path) -> None:
    large = Bounds(*(1000 * np.array(corner) for corner in (temple.scene.bounds.low, temple.scene.bounds.high)))
    with pytest.raises(SceneError, match=r"Multiplied by 0\.001 they are seen: the bounds, or the cameras, are in"):
        open_scene(bare, bounds=large)
    with pytest.raises(SceneError, match="8 of 8 cameras stand inside the bounding box"):
        open_scene(bare, bounds=Bounds([-1, -1, -1], [1, 1, 1]))


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (["a.jpg", "b.jpg"], ["It holds 2 images", "photographs without calibration"]),
        (["a.jpg", "scan.log"], ["1 images, 1 .log", "poses alone, no intrinsics"]),
        (["sub/shots.MP4"], ["1 .mp4", "a video has no calibration"]),
        (["a.png", "sfm_data.bin"], ["openMVG_main_ConvertSfM_DataFormat"]),
        ([], ["It holds nothing"]),
    ],
)
def test_a_folder_that_no_reader_knows_is_described(tmp_path: Path, files: list[str], words: list[str]) -> None:
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x")
    with pytest.raises(DataError) as caught:
        open_scene(tmp_path)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path}: not a known scene; expected a folder with a *_par.txt (Middlebury), ")
    assert all(word in message for word in words)
    assert "Scene.from_arrays(image_files, K, cam_from_world, bounds=(low, high))" in message


def test_the_command_line_prints_a_box_that_was_found(temple: BuiltInScene, bare: Path) -> None:
    (bare / "README.txt").unlink()
    write_masks(temple.scene, bare / "masks", "{name}")
    done = CliRunner().invoke(app, ["info", str(bare)])
    assert done.exit_code == 0
    numbers = re.search(r"bounds: +(.*), found from the silhouettes of 8 views", done.output)
    assert numbers is not None
    corners = [float(number) for number in numbers[1].split(",")]
    np.testing.assert_allclose(
        corners, [*enclosing_box(temple.scene.views)[0].low, *enclosing_box(temple.scene.views)[0].high], atol=1e-6
    )


def test_where_the_background_has_many_colors_and_the_box_was_found_there_are_no_silhouettes(
    temple: BuiltInScene, bare: Path
) -> None:
    (bare / "README.txt").unlink()
    for view in temple.scene.views:
        assert view.silhouette is not None
        image = np.where(view.silhouette[..., None], view.image, np.uint8(220))
        image[:, :40], image[:, 90:] = (220, 220, 30), (60, 90, 220)
        write_image(bare / view.name, image)
    points = np.random.default_rng(0).uniform(temple.scene.bounds.low, temple.scene.bounds.high, (300, 3))
    write_colmap(without_skew(temple.scene), bare / "sparse", points=points)
    (bare / "little-temple_par.txt").unlink()
    read = open_scene(bare)
    assert not any(view.has_silhouette for view in read.views)
    assert read.notes["no silhouettes"] == "the background has many colors"


def test_a_box_is_found_around_what_stands_out_from_a_dark_background(temple: BuiltInScene, bare: Path) -> None:
    (bare / "README.txt").unlink()
    read = open_scene(bare)
    assert "found from the silhouettes of 8 views" in read.notes["bounds"]
    assert all(view.has_silhouette for view in read.views)
    true = temple.scene.bounds
    assert (np.array(read.bounds.low) < np.array(true.low) + 0.02 * true.longest).all()
    assert (np.array(read.bounds.high) > np.array(true.high) - 0.02 * true.longest).all()
    assert read.bounds.longest < 1.5 * true.longest


@pytest.mark.parametrize(
    ("told", "change"),
    [
        ("look like camera-to-world: give their inverses", np.linalg.inv),
        ("axes look like OpenGL's", lambda pose: FLIP @ pose),
        ("camera-to-world with OpenGL's axes", lambda pose: np.linalg.inv(FLIP @ pose)),
        ("t looks like the camera's centre", lambda pose: with_t(pose, -pose[:3, :3].T @ pose[:3, 3])),
    ],
)
def test_the_mistake_that_hides_the_box_is_named(
    temple: BuiltInScene, told: str, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> None:
    """No matches are needed: the box is in the middle of the images where the mistake is undone."""
    views = [View.from_matrices(v.K, change(v.cam_from_world), v.photograph, name=v.name) for v in temple.scene.views]
    assert told in str(why_not_seen(views, temple.scene.bounds))


def test_inverted_masks_are_recognised_and_said(temple: BuiltInScene, bare: Path, tmp_path: Path) -> None:
    for folder in (bare / "masks", tmp_path / "elsewhere"):
        for view in temple.scene.views:
            assert view.silhouette is not None
            write_image(folder / view.name, ~view.silhouette)
    with pytest.warns(UserWarning, match="masks are white all around and black in the middle: black is taken"):
        assert same_masks(open_scene(bare), temple.scene)
    with pytest.warns(UserWarning, match="elsewhere: its masks are white all around"):
        assert same_masks(open_scene(bare, silhouettes=tmp_path / "elsewhere"), temple.scene)


def test_masks_of_an_object_that_fills_the_frame_are_not_inverted(temple: BuiltInScene, bare: Path) -> None:
    for view in temple.scene.views:
        mask = np.ones((view.height, view.width), np.bool_)
        mask[:20] = False
        write_image(bare / "masks" / view.name, mask)
    for view in open_scene(bare).views:
        assert view.silhouette is not None
        assert view.silhouette[40, 60]
        assert not view.silhouette[10, 60]


def test_a_named_folder_may_hold_masks_of_some_views_which_is_said(temple: BuiltInScene, bare: Path) -> None:
    write_masks(temple.scene, bare / "few")
    for n in (2, 5):
        (bare / "few" / f"{temple.scene.views[n].name}.png").unlink()
    missing = ", ".join(temple.scene.views[n].name for n in (2, 5))
    with pytest.warns(UserWarning, match=rf"few: 2 of 8 views have no mask and exclude nothing: {missing}$"):
        read = open_scene(bare, silhouettes=bare / "few")
    assert [view.has_silhouette for view in read.views] == [n not in (2, 5) for n in range(8)]


def test_cameras_in_another_order_than_photographs_are_warned_of(temple: BuiltInScene, tmp_path: Path) -> None:
    views = temple.scene.views
    order = [3 * n % 8 for n in range(8)]
    shuffled = tuple(replace(view, calibration=views[n].calibration) for view, n in zip(views, order, strict=True))
    folder = write_middlebury(replace(temple.scene, views=shuffled), tmp_path / "set")
    with pytest.warns(UserWarning, match=r"silhouettes contradict.* in the same order"):
        open_scene(folder)
    shares = silhouettes_explained(views, temple.scene.bounds)
    assert shares.shape == (8,)
    assert shares.min() > 0.99


def test_photographs_of_another_size_than_k_are_told(temple: BuiltInScene, bare: Path) -> None:
    def scaled(factor: float) -> None:
        for view in temple.scene.views:
            write_image(bare / view.name, cv2.resize(view.image, None, fx=factor, fy=factor))

    scaled(0.5)
    with pytest.raises(SceneError, match=r"K looks like that of photographs 2 times as large\. Give those, or scale K"):
        open_scene(bare)
    scaled(2)
    with pytest.warns(UserWarning, match="K looks like that of photographs 1/2 as large"):
        open_scene(bare, silhouettes="none")


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_photographs_of_fewer_bits_in_sixteen_are_read_as_bright_as_they_are(
    temple: BuiltInScene, bare: Path, bits: int
) -> None:
    white = 2**bits - 1
    for view in temple.scene.views:
        deep = np.round(view.image[..., ::-1] * (white / max(v.image.max() for v in temple.scene.views)))
        assert cv2.imwrite(str(bare / view.name), deep.astype(np.uint16))
    read = open_scene(bare)
    assert read.notes.get("values") == (None if bits == 16 else f"{bits} bits in 16: {white} is white")
    brightest = max(view.image.max() for view in temple.scene.views)
    for view, ours in zip(read.views, temple.scene.views, strict=True):
        np.testing.assert_allclose(view.image, ours.image * (255 / brightest), atol=1.01)
    assert read.fingerprint() == open_scene(bare).fingerprint()


def test_twelve_bits_in_sixteen_are_not_read_as_black_where_no_set_tells(tmp_path: Path) -> None:
    file = tmp_path / "a.png"
    assert cv2.imwrite(str(file), np.full((20, 30, 3), 4000, np.uint16))
    with pytest.raises(DataError, match=r"a\.png: its 16 bits hold values up to 4000 only, as of a camera of 12 bits"):
        read_image(file)
    assert (ImageFile(file, white=4095).decode() == 249).all()
    with pytest.raises(DataError, match=r"expected values up to 1023, .*got 4000"):
        ImageFile(file, white=1023).decode()


def test_image_kinds_are_read_right_or_refused_with_the_reason(tmp_path: Path) -> None:
    color = np.zeros((20, 30, 3), np.uint8)
    color[:, :15], color[:, 15:] = (200, 100, 40), (30, 180, 220)
    picture = Image.fromarray(color)
    kinds = {"png": "RGB", "jpg": "CMYK", "tif": "CMYK", "webp": "RGBA", "bmp": "RGB"}
    for suffix, mode in kinds.items():
        picture.convert(mode).save(tmp_path / f"a.{suffix}", quality=98)
        inside = read_image(tmp_path / f"a.{suffix}")[8:12, [4, 26]]
        np.testing.assert_allclose(inside[0], color[8, [4, 26]], atol=3)
    picture.convert("L").save(tmp_path / "grey.png")
    grey = read_image(tmp_path / "grey.png")
    assert (grey == np.asarray(picture.convert("L"))[..., None]).all()
    picture.convert("LAB").save(tmp_path / "lab.tif")
    with pytest.raises(DataError, match=r"lab\.tif: expected RGB, CMYK or grey, got the colour space LAB"):
        read_image(tmp_path / "lab.tif")
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x18ftypheic")
    with pytest.raises(
        DataError, match=r"a\.heic: a HEIC photograph; pip install 'recon3d\[heic\]' reads it; or convert it"
    ):
        read_image(tmp_path / "a.heic")


def test_heic_is_read_where_its_package_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package is stood in for: Pillow tells a file's kind by its content, and this one's is PNG."""
    image = np.random.default_rng(0).integers(0, 255, (6, 9, 3), dtype=np.uint8)
    write_image(tmp_path / "one.png", image).rename(tmp_path / "one.HEIC")
    monkeypatch.setitem(sys.modules, "pi_heif", None)
    monkeypatch.setattr(photographs, "reads_heic", lambda: False)
    with pytest.raises(DataError, match=r"found none; one\.HEIC: .*pip install 'recon3d\[heic\]'"):
        find_photographs(tmp_path)
    registered: list[str] = []
    package = SimpleNamespace(register_heif_opener=lambda: registered.append("opener"))
    monkeypatch.setitem(sys.modules, "pi_heif", package)
    monkeypatch.setattr(photographs, "reads_heic", lambda: True)
    (photograph,) = find_photographs(tmp_path)
    assert (photograph.width, photograph.height, bool(registered)) == (9, 6, True)
    np.testing.assert_array_equal(read_image(photograph.path), image)
    assert ImageFile(photograph.path).decode(grey=True).shape == (6, 9)


@pytest.mark.parametrize("color", [(30, 60, 200), (245, 245, 245), (0, 177, 64), (120, 120, 120)])
def test_objects_before_a_background_of_any_one_color_are_cut_out(
    temple: BuiltInScene, tmp_path: Path, color: tuple[int, int, int]
) -> None:
    rng = np.random.default_rng(0)
    views = []
    for view in temple.scene.views:
        noise = rng.integers(-3, 4, view.image.shape)
        behind = np.clip(np.array(color) + noise, 0, 255).astype(np.uint8)
        assert view.silhouette is not None
        views.append(replace(view, photograph=np.where(view.silhouette[..., None], view.image, behind), mask=None))
    read = open_scene(write_middlebury(replace(temple.scene, views=tuple(views)), tmp_path / "set"))
    for view, true in zip(read.views, temple.scene.views, strict=True):
        assert view.silhouette is not None
        assert true.silhouette is not None
        shared = (view.silhouette & true.silhouette).sum()
        assert shared > 0.995 * true.silhouette.sum()
        assert shared > 0.95 * view.silhouette.sum()  # small holes are filled, as shadows


def test_before_a_background_of_many_colors_no_silhouettes_are_made(temple: BuiltInScene, tmp_path: Path) -> None:
    views = []
    for view in temple.scene.views:
        assert view.silhouette is not None
        behind = np.zeros_like(view.image)
        behind[:, ::2], behind[:, 1::2] = (200, 40, 30), (30, 60, 200)
        views.append(replace(view, photograph=np.where(view.silhouette[..., None], view.image, behind), mask=None))
    folder = write_middlebury(replace(temple.scene, views=tuple(views)), tmp_path / "set")
    assert not any(view.has_silhouette for view in open_scene(folder).views)
    with pytest.raises(SceneError, match=r"not dark, nor of one color\? For that give silhouettes"):
        open_scene(folder, silhouettes="segmented")


@pytest.mark.parametrize("name", ["../secret.png", "a/../../secret.png", r"..\secret.png", "../elsewhere/secret.png"])
def test_a_photograph_outside_its_scene_is_not_opened_by_its_name(tmp_path: Path, name: str) -> None:
    outside, scene = tmp_path / "secret.png", tmp_path / "scene"
    scene.mkdir()
    for path in (outside, tmp_path / "elsewhere" / "secret.png"):
        write_image(path, np.zeros((2, 2, 3), np.uint8))
    for written in (name, str(outside)):
        assert find_image(scene, written) is None
    # One of that name in the scene is taken, as of a path on another computer.
    write_image(scene / "secret.png", np.zeros((2, 2, 3), np.uint8))
    for written in (name, str(outside)):
        assert find_image(scene, written) == scene / "secret.png"


def test_the_command_line_leaves_the_table_out(temple: BuiltInScene, bare: Path) -> None:
    (bare / "README.txt").unlink()
    random = np.random.default_rng(0)
    box = temple.scene.bounds
    ground = np.column_stack([random.uniform(-0.15, 0.15, (1500, 2)), np.full(1500, box.low[2])])
    standing = random.uniform(np.add(box.low, (0, 0, 0.01)), box.high, (600, 3))
    write_colmap(without_skew(temple.scene), bare / "sparse", points=np.concatenate([standing, ground]))
    (bare / "little-temple_par.txt").unlink()
    done = CliRunner().invoke(app, ["info", str(bare), "--object", "--silhouettes", "none"])
    assert done.exit_code == 0
    assert re.search(r"bounds: .*table left out: plane at \S+, its normal \S+,1, \d+ of 2100 points", done.output)
    assert "The bounds hold only" not in done.output
    found = open_scene(bare, object_alone=True, silhouettes="none").bounds
    assert box.low[2] < found.low[2] < box.low[2] + 0.01
    assert found.extent[0] < 0.7 * open_scene(bare, silhouettes="none").bounds.extent[0]
    for command in ("info", "reconstruct"):
        done = CliRunner().invoke(app, [command, str(bare), "--object", "--bounds", "0,0,0,1,1,1"])
        assert isinstance(done.exception, ArgumentError)
        assert "no table can be left out of them" in str(done.exception)
    told = open_scene(write_middlebury(temple.scene, bare.parent / "boxed"), object_alone=True).notes["bounds"]
    assert told.endswith("; no table was looked for")


def test_an_object_before_many_colors_is_cut_out_around_sparse_points(temple: BuiltInScene, bare: Path) -> None:
    random = np.random.default_rng(1)
    views = temple.scene.views
    for view in views:
        assert view.silhouette is not None
        tiles = np.kron(random.integers(0, 2, (15, 20, 1)), np.ones((8, 8, 1)))
        image = np.where(tiles > 0, (30, 90, 170), (60, 150, 60)) + random.normal(0, 6, view.image.shape)
        image = np.where(view.silhouette[..., None], view.image, image.clip(0, 255))
        write_image(bare / view.name, image.astype(np.uint8))
    mesh = temple.ground_truth
    triangles = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    points = np.einsum("nk,nkd->nd", random.dirichlet((1, 1, 1), len(triangles)), triangles)[::3]
    around = random.uniform(-0.3, 0.3, (100, 3))
    write_colmap(without_skew(temple.scene), bare / "sparse", points=np.concatenate([points, around]))
    (bare / "little-temple_par.txt").unlink()
    read = open_scene(bare, silhouettes="segmented")
    assert re.search(r"around 1\d\d\d sparse points", read.notes["masks"])
    overlaps, kept = [], []
    for view, exact in zip(read.views, views, strict=True):
        assert view.silhouette is not None
        assert exact.silhouette is not None
        both = view.silhouette & exact.silhouette
        overlaps.append(both.sum() / (view.silhouette | exact.silhouette).sum())
        kept.append(both.sum() / exact.silhouette.sum())
    assert np.mean(overlaps) > 0.9  # a pixel all around is a tenth of so small an object
    assert min(kept) > 0.97
    assert read.fingerprint() == open_scene(bare, silhouettes="segmented").fingerprint()
    half = read.shrunk(0.5).views[0].silhouette
    assert half is not None
    assert half.shape == (60, 80)
    few = random.uniform(temple.scene.bounds.low, temple.scene.bounds.high, (60, 3))
    write_colmap(without_skew(temple.scene), bare / "sparse", points=few)
    with pytest.warns(UserWarning, match="give silhouettes as a folder of masks, or none"):
        open_scene(bare, silhouettes="segmented", bounds=temple.scene.bounds.padded(0.001))
