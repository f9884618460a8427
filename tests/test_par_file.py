"""Par files as programs and people write them: the same scene, or an error that says what to do."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from formats import farthest_apart
from scenes import ball_mesh, cameras, photographs, plain

from recon3d.errors import ArgumentError, DataError
from recon3d.io import open_scene
from recon3d.io.files import write_image
from recon3d.io.middlebury import read_bounds
from recon3d.scene.scene import Scene

NUMBERS = list[list[float]]


@pytest.fixture(scope="module")
def ball() -> Scene:
    return photographs(ball_mesh(), plain, cameras(3))


@pytest.fixture
def folder(ball: Scene, tmp_path: Path) -> Path:
    """A set of three photographs; its par file is written by the tests."""
    folder = tmp_path / "set"
    for n, view in enumerate(ball.views):
        write_image(folder / f"view{n}.png", view.image)
    (folder / "README.txt").write_text("(-1.0 -1.05 -1.1)\n(1.0 1.05 1.1)\n")
    return folder


def krt(scene: Scene) -> NUMBERS:
    """21 numbers of each view."""
    return [
        [*map(float, [*view.K.ravel(), *view.cam_from_world[:3, :3].ravel(), *view.cam_from_world[:3, 3]])]
        for view in scene.views
    ]


def par(rows: NUMBERS, *, name: str = "view{n}.png", number: str = "{x!r}", between: str = " ") -> str:
    lines = [between.join([name.format(n=n), *(number.format(x=x) for x in numbers)]) for n, numbers in enumerate(rows)]
    return "\n".join([str(len(rows)), *lines]) + "\n"


def written(folder: Path, text: str | bytes, name: str = "toy_par.txt") -> Path:
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder


def assert_is_the_ball(path: Path, ball: Scene) -> Scene:
    read = open_scene(path, silhouettes="none")
    for n, (view, true) in enumerate(zip(read.views, ball.views, strict=True)):
        assert Path(view.name).stem.endswith(str(n))
        corners = ball.bounds.corners
        np.testing.assert_allclose(view.project(corners)[0], true.project(corners)[0], atol=1e-6)
        np.testing.assert_array_equal(view.image, true.image)
    return read


CHANGES: dict[str, Callable[[str], str | bytes]] = {
    "byte-order mark": lambda text: text.encode("utf-8-sig"),
    "UTF-16": lambda text: text.encode("utf-16"),
    "UTF-16, big end first": lambda text: b"\xfe\xff" + text.encode("utf-16-be"),
    "UTF-16 without mark": lambda text: text.encode("utf-16-le"),
    "carriage returns": lambda text: text.replace("\n", "\r"),
    "tabs, blanks at the end": lambda text: text.replace(" ", "\t").replace("\n", "  \n"),
    "comments": lambda text: "# by calib.py\n% name K R t\n" + text.replace("\n", "  # a view\n"),
    "headings": lambda text: "name k11 k12 k13 r11\nnumber of views: " + text,
    "no count line": lambda text: text.partition("\n")[2],
    "commas": lambda text: text.replace(" ", ", "),
    "semicolons": lambda text: text.replace(" ", ";"),
    "decimal commas": lambda text: re.sub(r"(?<=\d)\.(?=\d)", ",", text),
    "decimal commas between semicolons": lambda text: re.sub(r"(?<=\d)\.(?=\d)", ",", text).replace(" ", "; "),
    "brackets": lambda text: re.sub(r"png (.*)", r"png [[\1]]", text),
    "upper-case ending": lambda text: text.replace(".png", ".PNG"),
    "upper-case name": lambda text: text.replace("view", "VIEW"),
    "no ending": lambda text: text.replace(".png", ""),
    "./": lambda text: text.replace("view", "./view"),
    "backslashes": lambda text: text.replace("view", ".\\view"),
    "path of another computer": lambda text: text.replace("view", "C:\\Users\\me\\set\\view"),
    "quotes": lambda text: re.sub(r"(view\S+)", r'"\1"', text),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_however_it_is_written_the_set_is_the_same(
    folder: Path, ball: Scene, change: Callable[[str], str | bytes]
) -> None:
    assert_is_the_ball(written(folder, change(par(krt(ball)))), ball)


def test_fortrans_exponents_are_read(folder: Path, ball: Scene) -> None:
    text = par(krt(ball), number="{x:.16e}").replace("e+", "D+").replace("e-", "d-")
    assert_is_the_ball(written(folder, text), ball)


def test_views_are_called_as_the_files_are_without_a_dot_before(folder: Path, ball: Scene) -> None:
    read = assert_is_the_ball(written(folder, par(krt(ball), name="./view{n}.png")), ball)
    assert [view.name for view in read.views] == ["view0.png", "view1.png", "view2.png"]


@pytest.mark.parametrize("name", ["my view {n}.png", "Säule, {n}.png", "{n}"])
def test_names_may_hold_blanks_commas_and_letters_or_be_numbers(folder: Path, ball: Scene, name: str) -> None:
    for n in range(3):
        file = folder / (name.format(n=n) if "." in name else f"{n}.png")
        (folder / f"view{n}.png").rename(file)
    assert_is_the_ball(written(folder, par(krt(ball), name=name)), ball)
    assert_is_the_ball(written(folder, par(krt(ball), name=name).encode("cp1252")), ball)


@pytest.mark.parametrize("scale", [1.0, -2.5e-3])
@pytest.mark.parametrize("square", [False, True])
def test_projection_matrices_are_taken_apart(folder: Path, ball: Scene, scale: float, square: bool) -> None:
    last = [0.0, 0.0, 0.0, 1.0] if square else []
    rows = [[*(scale * view.projection).ravel().tolist(), *last] for view in ball.views]
    assert_is_the_ball(written(folder, par(rows)), ball)


def test_poses_may_be_written_row_by_row(folder: Path, ball: Scene) -> None:
    for size in (3, 4):
        rows = [[*view.K.ravel().tolist(), *view.cam_from_world[:size].ravel().tolist()] for view in ball.views]
        assert_is_the_ball(written(folder, par(rows)), ball)


def test_a_pose_without_k_is_refused(folder: Path, ball: Scene) -> None:
    rows = [view.cam_from_world[:3].ravel().tolist() for view in ball.views]
    with pytest.raises(DataError, match=r"toy_par\.txt:2: expected .*, got a pose \[R \| t\] without K"):
        open_scene(written(folder, par(rows)))


def test_distortion_is_not_taken_for_anything_else(folder: Path, ball: Scene) -> None:
    for extra in ([-0.2], [-0.2, 0.1], [-0.2, 0.1, 0.0, 0.0], [-0.2, 0.1, 0.0, 0.0, 0.01]):
        with pytest.raises(DataError, match=rf"got {21 + len(extra)}; {len(extra)} too many look like the distortion"):
            open_scene(written(folder, par([[*numbers, *extra] for numbers in krt(ball)])))


def test_a_left_handed_world_is_mirrored_and_said(folder: Path, ball: Scene) -> None:
    mirrored = [view.projection @ np.diag([1, 1, -1, 1]) for view in ball.views]
    rows = krt(ball)
    for numbers in rows:
        numbers[11], numbers[14], numbers[17] = -numbers[11], -numbers[14], -numbers[17]
    (folder / "README.txt").write_text("(-1.0 -1.05 -0.9)\n(1.0 1.05 1.1)\n")
    for text in (par([(-2 * P).ravel().tolist() for P in mirrored]), par(rows)):
        with pytest.warns(UserWarning, match="the world of these cameras is left-handed: it is mirrored"):
            read = assert_is_the_ball(written(folder, text), ball)
        np.testing.assert_allclose([read.bounds.low[2], read.bounds.high[2]], [-1.121, 0.921], atol=1e-3)


@pytest.mark.parametrize("name", ["TOY_PAR.TXT", "par.txt", "Toy_par.TXT"])
def test_the_par_file_is_found_in_any_case_and_may_be_given_itself(folder: Path, ball: Scene, name: str) -> None:
    (folder / "._toy_par.txt").write_bytes(b"\x00\x05\x16\x07 what macOS leaves")
    (folder / "._view0.png").write_bytes(b"\x00\x05\x16\x07")
    written(folder, par(krt(ball)), name)
    assert_is_the_ball(folder, ball)
    read = assert_is_the_ball(folder / name, ball)
    assert read.bounds == open_scene(folder, silhouettes="none").bounds


def test_photographs_are_found_in_a_folder_below_or_the_only_one_beside(folder: Path, ball: Scene) -> None:
    for place in (folder / "pictures of may", folder / "images", folder.parent / "set of may"):
        place.mkdir()
        for n in range(3):
            next(folder.parent.rglob(f"view{n}.png")).rename(place / f"view{n}.png")
        read = assert_is_the_ball(written(folder, par(krt(ball))), ball)
        assert read.notes.get("photographs") == (None if place.parent == folder else str(place))
    other = folder.parent / "set of june"
    for n in range(3):
        write_image(other / f"view{n}.png", ball.views[n].image)
    with pytest.raises(DataError, match=r"in .*set of june, .*set of may: say in which they are \(--images DIR"):
        open_scene(folder)
    assert len(open_scene(folder, images=other).views) == 3
    written(other, par(krt(ball)))  # the photographs of a set of its own
    assert assert_is_the_ball(folder, ball).notes["photographs"] == str(folder.parent / "set of may")


def test_a_folder_of_photographs_may_be_given(folder: Path, ball: Scene, tmp_path: Path) -> None:
    written(folder, par(krt(ball)))
    elsewhere = tmp_path / "far" / "away"
    elsewhere.mkdir(parents=True)
    for n in range(3):
        (folder / f"view{n}.png").rename(elsewhere / f"view{n}.png")
    read = open_scene(folder, images=elsewhere, silhouettes="none")
    assert farthest_apart(read, open_scene(folder / "toy_par.txt", images=str(elsewhere), silhouettes="none")) == 0
    assert read.notes["images from"] == str(elsewhere)
    with pytest.raises(DataError, match="nowhere: expected a folder of photographs"):
        open_scene(folder, images=tmp_path / "nowhere")
    (tmp_path / "transforms.json").write_text('{"frames": []}')
    with pytest.raises(ArgumentError, match=r"images in another folder can be given for .*, got transforms\.json"):
        open_scene(tmp_path / "transforms.json", images=elsewhere)


@pytest.mark.parametrize(
    "text",
    [
        "Bounding box\nmin: -1.0 -1.05 -1.1\nmax:  1.0 1.05 1.1\n",
        "minimum = (-1.0, -1.05, -1.1)\r\nmaximum = (1.0, 1.05, 1.1)\r\n",
        "[-1.0 -1.05 -1.1] - [1.0 1.05 1.1]",
        "(-1,0 -1,05 -1,1)\n(1,0 1,05 1,1)",
        "(-1,0; -1,05; -1,1), (1,0; 1,05; 1,1)",
        "3 views (minus one)\nminimal set\n\n(-1.0D0 -1.05 -1.1)\n(1.0 1.05 1.1)",
    ],
)
@pytest.mark.parametrize("coding", ["utf-8-sig", "utf-16"])
def test_a_readmes_box_is_found_however_it_is_written(folder: Path, text: str, coding: str) -> None:
    (folder / "README.txt").rename(folder / "ReadMe.md")
    (folder / "ReadMe.md").write_bytes(text.encode(coding))
    (folder / "._README.txt").write_bytes(b"\x00\x05\x16\x07")
    assert read_bounds(folder).low == (-1.0, -1.05, -1.1)
    assert read_bounds(folder).high == (1.0, 1.05, 1.1)
