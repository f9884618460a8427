from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, cameras, photographs, plain, plain_view

from recon3d.datasets.synthetic import BuiltInScene
from recon3d.errors import DataError, SceneError
from recon3d.io import open_scene
from recon3d.io.files import write_image
from recon3d.io.middlebury import is_middlebury, read_angles, read_bounds, write_middlebury
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene

README = """toy data set -- 3 views

The (tight) bounding box for the toy model is
{low}
{high}

*_par.txt: camera parameters (3 of them) for each image.
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A set as the benchmark ships it, by hand: par file with a count line, README, angles, photographs."""
    scene = photographs(ball_mesh(), plain, cameras(3))
    lines = ["3"]
    for n, view in enumerate(scene.views):
        numbers = [*view.K.ravel(), *view.cam_from_world[:3, :3].ravel(), *view.cam_from_world[:3, 3]]
        lines.append(f"toy{n}.png " + " ".join(f"{number:.17g}" for number in numbers))
        write_image(tmp_path / f"toy{n}.png", view.image)
    (tmp_path / "toy_par.txt").write_text("\n".join(lines) + "\n")
    (tmp_path / "README.txt").write_text(README.format(low="(-1.0 -1.05 -1.1)", high="(1.0 1.05 1.1)"))
    (tmp_path / "toy_ang.txt").write_text("".join(f"{17.0} {60 * n} toy{n}.png\n" for n in range(3)))
    return tmp_path


def change_par(folder: Path, change: Callable[[list[list[str]]], None]) -> None:
    """Rewrite the par file, line by line, field by field."""
    path = folder / "toy_par.txt"
    lines = [line.split() for line in path.read_text().splitlines()]
    change(lines)
    path.write_text("\n".join(" ".join(line) for line in lines) + "\n")


def test_a_set_is_read_as_its_files_say(folder: Path) -> None:
    expected = photographs(ball_mesh(), plain, cameras(3))
    scene = open_scene(folder, silhouettes="none")
    assert scene.name == folder.name
    assert scene.mm_per_unit == 1000.0
    assert scene.notes == {"format": "Middlebury", "source": str(folder), "silhouettes from": "none"}
    assert [view.name for view in scene.views] == ["toy0.png", "toy1.png", "toy2.png"]
    for view, original in zip(scene.views, expected.views, strict=True):
        np.testing.assert_array_equal(view.K, original.K)
        np.testing.assert_array_equal(view.cam_from_world, original.cam_from_world)
        np.testing.assert_array_equal(view.image, original.image)
        assert view.silhouette is None


def test_the_readmes_box_is_padded_by_a_hundredth_of_its_longest_side(folder: Path) -> None:
    tight = read_bounds(folder)
    assert tight.low == (-1.0, -1.05, -1.1)
    assert tight.high == (1.0, 1.05, 1.1)
    padded = open_scene(folder).bounds
    np.testing.assert_allclose(padded.low, [-1.022, -1.072, -1.122], atol=1e-12)
    np.testing.assert_allclose(padded.high, [1.022, 1.072, 1.122], atol=1e-12)


def test_bounds_that_are_given_are_taken_as_they_are(folder: Path) -> None:
    (folder / "README.txt").unlink()
    bounds = Bounds([-1.1, -1.1, -1.1], [1.15, 1.1, 1.1])
    scene = open_scene(folder, bounds=bounds, mm_per_unit=10.0)
    assert scene.bounds == bounds
    assert scene.mm_per_unit == 10.0


def test_the_count_line_may_be_absent(folder: Path) -> None:
    change_par(folder, lambda lines: lines.pop(0) and None)
    assert len(open_scene(folder).views) == 3


def test_blank_lines_do_not_count(folder: Path) -> None:
    path = folder / "toy_par.txt"
    path.write_text("\n" + path.read_text().replace("\n", "\n\n"))
    assert len(open_scene(folder).views) == 3


@pytest.mark.parametrize("name", ["toy_par.txt", "README.txt", "toy_ang.txt"])
def test_windows_line_ends_are_read(folder: Path, name: str) -> None:
    before = open_scene(folder)
    path = folder / name
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    after = open_scene(folder)
    assert [view.name for view in after.views] == [view.name for view in before.views]
    assert after.bounds == before.bounds
    assert read_angles(folder)["toy2.png"] == (17.0, 120.0)


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ("( -1.0 -1.05 -1.1 )", "( 1.0 1.05 1.1 )"),
        ("(-1.0, -1.05, -1.1)", "(1.0, 1.05, 1.1)"),
        ("(-1 -105e-2 -1.1E+0)", "(+1. 1.05 1.1)"),
        ("(1.0 1.05 1.1)", "(-1.0 -1.05 -1.1)"),
        ("(-1.0 -1.05 -1.1)\r", "\t(1.0 1.05 1.1)"),
    ],
)
def test_a_box_is_found_however_it_is_written(folder: Path, low: str, high: str) -> None:
    (folder / "README.txt").write_text(README.format(low=low, high=high))
    np.testing.assert_allclose(read_bounds(folder).low, [-1, -1.05, -1.1])
    np.testing.assert_allclose(read_bounds(folder).high, [1, 1.05, 1.1])


def test_a_readme_in_another_case_is_found(folder: Path) -> None:
    (folder / "README.txt").rename(folder / "readme")
    assert read_bounds(folder).high == (1.0, 1.05, 1.1)


def test_angles_are_read_and_optional(folder: Path) -> None:
    assert read_angles(folder) == {"toy0.png": (17.0, 0.0), "toy1.png": (17.0, 60.0), "toy2.png": (17.0, 120.0)}
    (folder / "toy_ang.txt").unlink()
    assert read_angles(folder) == {}
    assert len(open_scene(folder).views) == 3


@pytest.mark.parametrize("line", ["17.0 x toy1.png", "17.0 60"])
def test_a_malformed_line_of_angles_is_named(folder: Path, line: str) -> None:
    (folder / "toy_ang.txt").write_text(f"17.0 0 toy0.png\n\n{line}\n")
    with pytest.raises(DataError, match=rf"toy_ang\.txt:3: expected 'latitude longitude image', got '{line}'"):
        read_angles(folder)


def test_silhouettes_are_made_from_the_dark_background(folder: Path) -> None:
    original = photographs(ball_mesh(), plain, cameras(3))
    for view, exact in zip(open_scene(folder).views, original.views, strict=True):
        assert view.silhouette is not None
        assert exact.silhouette is not None
        assert view.silhouette[exact.silhouette].all()
        assert not view.silhouette.all()


def test_only_good_images_get_a_silhouette(folder: Path) -> None:
    (folder / "toy_good_silhouette_images.txt").write_text("toy2.png\r\n\r\ntoy0.png\r\n")
    known = [view.has_silhouette for view in open_scene(folder).views]
    assert known == [True, False, True]


def test_an_unknown_good_image_is_named(folder: Path) -> None:
    (folder / "toy_good_silhouette_images.txt").write_text("toy2.png\ntoy9.png\n")
    with pytest.raises(DataError, match=r"toy_good_silhouette_images\.txt:2: toy9\.png is not in the par file"):
        open_scene(folder)


def test_a_folder_of_masks_is_used_when_it_lies_beside_or_is_named(folder: Path) -> None:
    rng = np.random.default_rng(0)
    masks = {}
    for where in ("silhouettes", "others"):
        for n in range(3):
            masks[where, n] = rng.random((36, 48)) < 0.5
            write_image(folder / where / f"toy{n}.png", masks[where, n])
    choices: dict[str, dict[str, str | Path]] = {"silhouettes": {}, "others": {"silhouettes": folder / "others"}}
    for where, options in choices.items():
        for n, view in enumerate(open_scene(folder, **options).views):  # type: ignore[arg-type]
            np.testing.assert_array_equal(view.silhouette, masks[where, n])
    background = open_scene(folder, silhouettes="threshold").views[0].silhouette
    assert background is not None
    assert (background != masks["silhouettes", 0]).any()


def test_a_folder_without_a_par_file_is_no_set(tmp_path: Path) -> None:
    assert not is_middlebury(tmp_path)
    with pytest.raises(DataError, match=r"not a known scene; expected a folder with a \*_par\.txt \(Middlebury\)"):
        open_scene(tmp_path)
    with pytest.raises(DataError, match=r"nowhere: no such file or folder"):
        open_scene(tmp_path / "nowhere")


def test_a_set_is_recognised_by_its_par_file(folder: Path) -> None:
    assert is_middlebury(folder)
    assert is_middlebury(folder / "toy_par.txt")
    assert not is_middlebury(folder / "README.txt")


def test_two_par_files_are_an_error(folder: Path) -> None:
    (folder / "other_par.txt").write_text("")
    with pytest.raises(DataError, match="found 2"):
        open_scene(folder)


def test_missing_images_are_named_and_left_out(folder: Path) -> None:
    for name in ("toy1.png", "toy2.png"):
        (folder / name).unlink()
    with pytest.warns(UserWarning, match=r"toy_par\.txt: left out, .*missing: toy1\.png, toy2\.png$"):
        assert [view.name for view in open_scene(folder).views] == ["toy0.png"]
    (folder / "toy0.png").unlink()
    with pytest.raises(DataError, match=r"none of its 3 photographs is there: looked for toy0\.png in .*--images DIR"):
        open_scene(folder)


def test_an_unreadable_image_is_named(folder: Path) -> None:
    (folder / "toy1.png").write_text("no image")
    with pytest.raises(DataError, match=r"toy1\.png: not a readable image"):
        open_scene(folder)


def set_field(line: int, column: int, value: str) -> Callable[[list[list[str]]], None]:
    def change(lines: list[list[str]]) -> None:
        lines[line][column] = value

    return change


def mirror(lines: list[list[str]]) -> None:
    """Negate the last row of the second view's R."""
    lines[2][16:19] = [repr(-float(number)) for number in lines[2][16:19]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: lines[2].pop(), r"toy_par\.txt:3: expected an image name and 21 numbers .*, got 20$"),
        (
            lambda lines: lines[3].append("1"),
            r"toy_par\.txt:4: expected .* 21 numbers .*, got 22; 1 too many look like",
        ),
        (set_field(1, 5, "12,5"), r"toy_par\.txt:2: expected a number, got '12,5'"),
        (set_field(3, 20, "nan"), r"toy_par\.txt:4: R or t holds a number that is not finite"),
        (set_field(3, 1, "inf"), r"toy_par\.txt:4: K holds a number that is not finite"),
        (set_field(3, 1, "-72"), r"toy_par\.txt:4: expected positive focal lengths"),
        (set_field(1, 9, "2"), r"toy_par\.txt:2: expected K = \[\[fx"),
        (set_field(2, 10, "0.9"), r"toy_par\.txt:3: R is not a rotation: R R\^T differs from the identity by"),
        (mirror, r"toy_par\.txt:3: R is not a rotation: its determinant is -1 \(a reflection\)"),
        (set_field(0, 0, "4"), r"toy_par\.txt:1: the count line says 4 views, the file has 3"),
        (set_field(0, 0, "0"), r"toy_par\.txt:1: the count line says 0 views, the file has 3"),
        (lambda lines: lines.clear(), r"toy_par\.txt: expected at least one view"),
        (set_field(2, 0, "toy0.png"), r"toy_par\.txt:3: toy0\.png is the photograph of a line before"),
    ],
)
def test_a_malformed_par_file_is_refused_with_file_and_line(
    folder: Path, change: Callable[[list[list[str]]], None], message: str
) -> None:
    change_par(folder, change)
    with pytest.raises((DataError, SceneError), match=message):
        open_scene(folder)


def test_a_par_file_that_is_no_text_is_a_data_error(folder: Path) -> None:
    (folder / "toy_par.txt").write_bytes(b"3\ntoy\xff\xfe.png 1 2 3\n")
    with pytest.raises(DataError, match=r"toy_par\.txt"):
        open_scene(folder)


def test_images_of_different_sizes_are_refused_with_file_and_line(folder: Path) -> None:
    write_image(folder / "toy2.png", np.zeros((36, 50, 3), np.uint8))
    with pytest.raises(
        DataError,
        match=r"par\.txt:4: expected toy2\.png to have 48x36 pixels like toy0\.png, whose K is the same",
    ):
        open_scene(folder)


@pytest.mark.parametrize(
    ("readme", "reason"),
    [
        (None, "expected a README.txt with the bounding box; give bounds instead"),
        ("The box is (1 2 3) or so.\n", "README.txt: expected a bounding box '(x y z) (x y z)'; give bounds instead"),
    ],
)
def test_a_box_is_found_where_the_readme_has_none(folder: Path, readme: str | None, reason: str) -> None:
    (folder / "README.txt").unlink()
    if readme:
        (folder / "README.txt").write_text(readme)
    scene = open_scene(folder, silhouettes="none")
    assert ", found from what most cameras see (" in scene.notes["bounds"]
    assert scene.notes["bounds"].endswith(f"{reason})")
    # The cameras look at the origin.
    assert (np.array(scene.bounds.low) < 0).all()
    assert (np.array(scene.bounds.high) > 0).all()


def test_a_box_that_no_camera_sees_is_an_error(folder: Path) -> None:
    (folder / "README.txt").write_text(README.format(low="(90 90 90)", high="(91 91 91)"))
    with pytest.raises(SceneError, match="no camera sees the bounds"):
        open_scene(folder)


def test_a_box_that_leaves_most_images_is_an_error(folder: Path) -> None:
    # Its centre is in view, most of the rest is not.
    bounds = Bounds([-4, -4, -4], [4, 4, 4])
    with pytest.raises(SceneError, match="expected the bounding box in the middle of most images, or most of it"):
        open_scene(folder, bounds=bounds)


def test_a_box_that_cuts_the_object_off_is_refused_in_a_readme_and_warned_of_when_given(folder: Path) -> None:
    shifted = Bounds([0, 0, -0.5], [1, 1, 0.5])
    with pytest.warns(UserWarning, match=r"the bounding box holds .*% of what is bright"):
        open_scene(folder, bounds=shifted)
    (folder / "README.txt").write_text(README.format(low="(0 0 -0.5)", high="(1 1 0.5)"))
    with pytest.raises(SceneError, match=r"the bounding box holds .*% of what is bright"):
        open_scene(folder)


def assert_same_scene(a: Scene, b: Scene) -> None:
    np.testing.assert_allclose(a.bounds.low, b.bounds.low, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a.bounds.high, b.bounds.high, rtol=0, atol=1e-12)
    for view, other in zip(a.views, b.views, strict=True):
        assert view.name == other.name
        np.testing.assert_array_equal(view.K, other.K)
        np.testing.assert_array_equal(view.cam_from_world, other.cam_from_world)
        np.testing.assert_array_equal(view.image, other.image)
        if other.silhouette is None:
            assert view.silhouette is None
        else:
            np.testing.assert_array_equal(view.silhouette, other.silhouette)


def test_a_scene_makes_the_round_trip_exactly(temple: BuiltInScene, tmp_path: Path) -> None:
    written = write_middlebury(temple.scene, tmp_path / "set")
    assert written == tmp_path / "set"
    assert_same_scene(open_scene(written), temple.scene)


def test_a_scene_makes_the_round_trip_when_only_some_silhouettes_are_known(
    temple: BuiltInScene, tmp_path: Path
) -> None:
    views = list(temple.scene.views)
    views[2] = replace(views[2], mask=None)
    scene = replace(temple.scene, views=tuple(views))
    assert_same_scene(open_scene(write_middlebury(scene, tmp_path / "set")), scene)


def test_a_scene_makes_the_round_trip_when_a_views_name_holds_a_space(temple: BuiltInScene, tmp_path: Path) -> None:
    views = tuple(replace(view, name=f"my {view.name}") for view in temple.scene.views)
    read = open_scene(write_middlebury(replace(temple.scene, views=views), tmp_path / "set"))
    assert len(read.views) == len(views)


def test_views_whose_file_names_would_be_the_same_do_not_overwrite_each_other(tmp_path: Path) -> None:
    images: list[NDArray[np.uint8]] = [np.full((30, 40, 3), grey, np.uint8) for grey in (90, 200)]
    views = tuple(
        replace(plain_view(name=name), photograph=image) for name, image in zip(("a.jpg", "a.ppm"), images, strict=True)
    )
    scene = Scene(views, Bounds([-1, -1, -1], [1, 1, 1]))
    folder = write_middlebury(scene, tmp_path / "set")
    read = open_scene(folder, bounds=Bounds([-1.5, -1.2, -1], [1.5, 1.2, 1]), silhouettes="none")
    assert [view.image[0, 0, 0] for view in read.views] == [90, 200]


def test_views_in_folders_make_the_round_trip(temple: BuiltInScene, tmp_path: Path) -> None:
    names = [f"{folder}/{n}.png" for folder in ("a", "b") for n in range(4)]
    views = tuple(replace(view, name=name) for view, name in zip(temple.scene.views, names, strict=True))
    read = open_scene(write_middlebury(replace(temple.scene, views=views), tmp_path / "set"))
    assert [view.name for view in read.views] == [name.replace("/", "_") for name in names]
    for view, original in zip(read.views, temple.scene.views, strict=True):
        np.testing.assert_array_equal(view.image, original.image)
        np.testing.assert_array_equal(view.silhouette, original.silhouette)


@pytest.mark.parametrize(
    ("name", "n_views", "good"), [("templeSparseRing", 16, 16), ("dinoSparseRing", 16, 15), ("templeRing", 47, 47)]
)
def test_real_sets_are_read(real_data: Path, name: str, n_views: int, good: int) -> None:
    scene = open_scene(real_data / name)
    assert len(scene.views) == n_views
    assert scene.name == name
    assert all((view.width, view.height) == (640, 480) for view in scene.views)
    assert sum(view.has_silhouette for view in scene.views) == good
    assert len(read_angles(real_data / name)) == n_views
    # The dinosaur's box leaves some images.
    assert np.median(scene.corners_in_views()) >= 4
    # Published: the temple is 159.6 mm tall; a pixel covers a third of a millimetre or less.
    assert 0.1 < scene.pixel_footprint * scene.mm_per_unit < 0.5


def test_another_real_sets_box_is_refused_even_when_given(real_data: Path) -> None:
    with pytest.raises(SceneError, match="is this another set's box"):
        open_scene(real_data / "templeSparseRing", bounds=read_bounds(real_data / "templeRing"))
    with pytest.raises(SceneError, match="is this another set's box"):
        open_scene(real_data / "dinoSparseRing", bounds=Bounds([-0.4, -0.4, -0.4], [0.4, 0.4, 0.4]))


def test_half_of_a_real_sets_box_is_warned_of_when_given(real_data: Path) -> None:
    whole = read_bounds(real_data / "templeSparseRing")
    half = Bounds(whole.low, np.subtract(whole.high, [0, whole.extent[1] / 2, 0]))
    with pytest.warns(UserWarning, match=r"holds .*% of what is bright"):
        scene = open_scene(real_data / "templeSparseRing", bounds=half)
    assert scene.bounds == half


def test_one_real_set_with_another_ones_readme_is_refused(real_data: Path, tmp_path: Path) -> None:
    for path in (real_data / "templeSparseRing").iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "README.txt").unlink()
    (tmp_path / "README.txt").symlink_to(real_data / "templeRing" / "README.txt")
    with pytest.raises(SceneError, match="is this another set's box"):
        open_scene(tmp_path)


def test_a_bright_background_is_told_from_a_wrong_box(temple: BuiltInScene, tmp_path: Path) -> None:
    views = []
    for view in temple.scene.views:
        assert view.silhouette is not None
        image = np.where(view.silhouette[..., None], view.image, np.uint8(220))
        views.append(replace(view, photograph=image, mask=None))
    folder = write_middlebury(replace(temple.scene, views=tuple(views)), tmp_path / "bright")
    with pytest.raises(SceneError, match="a background that is not dark"):
        open_scene(folder, silhouettes="threshold")
    assert all(view.silhouette is None for view in open_scene(folder, silhouettes="none").views)
