from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray
from scenes import grain

from recon3d.calibration.board import PAPERS_MM, Board, board_figure, cameras_from_board, write_board_pdf
from recon3d.calibration.result import Calibration
from recon3d.datasets.synthetic import Camera, photograph
from recon3d.errors import CalibrationError, DataError
from recon3d.io import open_scene
from recon3d.io.files import write_image
from recon3d.rendering.orbit import look_at
from recon3d.scene.view import View

BOARD = Board()
SIZE = (480, 360)
K = np.array([[615.0, 0, 239.5], [0, 615.0, 179.5], [0, 0, 1]])
DISTORTION = np.array([-0.12, 0.05, 0, 0, 0])


def world() -> o3d.geometry.TriangleMesh:
    """The sheet, 5 mm wider than the board, and a box on it."""
    width, depth = BOARD.size + 0.01
    sheet = o3d.geometry.TriangleMesh.create_box(width, depth, 0.001).translate((-width / 2, -depth / 2, -0.001))
    return sheet + o3d.geometry.TriangleMesh.create_box(0.06, 0.04, 0.05).translate((-0.03, -0.02, 0.0))


def paint(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The board printed on the sheet, and a grain on the box."""
    picture = BOARD.picture(80) / 255.0
    cell = BOARD.square_mm / 1000 / 80
    column = np.floor((points[:, 0] + BOARD.size[0] / 2) / cell).astype(int)
    row = np.floor((BOARD.size[1] / 2 - points[:, 1]) / cell).astype(int)
    printed = (row >= 0) & (row < picture.shape[0]) & (column >= 0) & (column < picture.shape[1])
    paper = np.where(printed, picture[row.clip(0, picture.shape[0] - 1), column.clip(0, picture.shape[1] - 1)], 1.0)
    albedo = 0.05 + 0.9 * paper[:, None].repeat(3, axis=1)
    on_box = points[:, 2] > 1e-6
    albedo[on_box] = grain(points[on_box] * 40)
    return albedo


def taken() -> list[Camera]:
    """Ten cameras in two rings, looking down at the box by 35 and 60 degrees."""
    cameras = []
    for n in range(10):
        angle, rise = 2 * np.pi * n / 10, np.radians(35 if n % 2 else 60)
        eye = 0.42 * np.array([np.cos(rise) * np.cos(angle), np.cos(rise) * np.sin(angle), np.sin(rise)])
        target = np.array([0.01, -0.005, 0.01])
        cameras.append(Camera(K, look_at(eye + target, target, np.array([0.0, 0.0, 1.0])), *SIZE))
    return cameras


def spoiled(view: View, seed: int) -> NDArray[np.uint8]:
    """The photograph through a distorting lens, blurred by 0.7 pixels, with noise of 3 grey levels."""
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=np.float64), np.arange(SIZE[1], dtype=np.float64))
    pixels = np.column_stack([u.ravel(), v.ravel()])[:, None]
    ideal = cv2.undistortPoints(pixels, K, DISTORTION, P=K).reshape(SIZE[1], SIZE[0], 2).astype(np.float32)
    image = cv2.remap(view.image, ideal[..., 0], ideal[..., 1], cv2.INTER_CUBIC)
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    noise = 3 * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs of the board with the box, and one of nothing."""
    folder = tmp_path_factory.mktemp("board")
    for n, view in enumerate(photograph(world(), paint, taken(), supersampling=2).views):
        write_image(folder / f"photo{n:02d}.png", spoiled(view, n))
    write_image(folder / "wall.png", np.full((SIZE[1], SIZE[0], 3), 90, np.uint8))
    return folder


@pytest.fixture(scope="module")
def calibration(photographs: Path) -> Calibration:
    return cameras_from_board(photographs, BOARD)


def test_cameras_lie_where_they_were_in_metres_above_the_board(calibration: Calibration) -> None:
    assert [camera.name for camera in calibration.cameras] == [f"photo{n:02d}.png" for n in range(10)]
    assert calibration.mm_per_unit == 1000
    true = taken()
    centers = np.array([camera.center for camera in calibration.cameras])
    expected = np.array([-camera.cam_from_world[:3, :3].T @ camera.cam_from_world[:3, 3] for camera in true])
    assert np.linalg.norm(centers - expected, axis=1).max() < 0.002  # of 0.42 m
    for found, camera in zip(calibration.cameras, true, strict=True):
        turn = found.cam_from_world[:3, :3] @ camera.cam_from_world[:3, :3].T
        assert np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) < 0.2


def test_lengths_are_right_to_two_thousandths(calibration: Calibration) -> None:
    """Corners of the box, triangulated from where the true cameras show them, have its size."""
    corners = np.array([[x, y, 0.05] for x in (-0.03, 0.03) for y in (-0.02, 0.02)])
    found = []
    for corner in corners:
        rows = []
        for camera, true in zip(calibration.cameras, taken(), strict=True):
            seen = true.K @ (true.cam_from_world[:3, :3] @ corner + true.cam_from_world[:3, 3])
            distorted = cv2.projectPoints((np.linalg.inv(K) @ seen)[None], np.zeros(3), np.zeros(3), K, DISTORTION)[
                0
            ].reshape(1, 1, 2)
            x, y = cv2.undistortPoints(distorted, camera.K, camera.distortion).ravel()
            P = camera.cam_from_world[:3]
            rows += [x * P[2] - P[0], y * P[2] - P[1]]
        point = np.linalg.svd(np.array(rows))[2][-1]
        found.append(point[:3] / point[3])
    sides = [np.linalg.norm(found[a] - found[b]) / true for a, b, true in ((0, 2, 0.06), (0, 1, 0.04), (1, 3, 0.06))]
    assert np.abs(np.array(sides) - 1).max() < 0.002
    assert np.abs(np.array(found) - corners).max() < 0.0003


def test_lens_is_found(calibration: Calibration) -> None:
    camera = calibration.cameras[0]
    assert abs(camera.K[0, 0] / 615 - 1) < 0.004
    assert camera.distortion[0] == pytest.approx(-0.12, abs=0.04)
    assert calibration.reprojection_error < 0.3


def test_photograph_without_the_board_is_named(calibration: Calibration) -> None:
    assert list(calibration.unplaced) == ["wall.png"]
    assert "0 of the board's 54 corners" in calibration.unplaced["wall.png"]
    assert "10 of 11" in str(calibration.summary()["photographs placed"])


def test_bounds_hold_what_stands_on_the_sheet(calibration: Calibration) -> None:
    bounds = calibration.bounds
    assert bounds is not None
    assert bounds.low[2] == 0
    assert bounds.high[2] > 0.05
    assert np.allclose(bounds.extent[:2], BOARD.size)


def test_scene_is_written_without_distortion(photographs: Path, tmp_path: Path) -> None:
    calibration = cameras_from_board(photographs, BOARD, output=tmp_path / "scene")
    assert (tmp_path / "scene" / "sparse" / "0" / "cameras.txt").is_file()
    assert len(list((tmp_path / "scene" / "images").iterdir())) == 10
    scene = open_scene(tmp_path / "scene")
    assert scene.mm_per_unit == 1000
    assert scene.bounds == calibration.bounds
    again = cameras_from_board(tmp_path / "scene" / "images", BOARD)
    assert np.abs(again.cameras[0].distortion).max() < 0.03
    moved = [np.linalg.norm(a.center - b.center) for a, b in zip(calibration.cameras, again.cameras, strict=True)]
    assert max(moved) < 0.002


def test_too_few_photographs_of_the_board_end_in_words(photographs: Path) -> None:
    with pytest.raises(
        CalibrationError, match=r"at least 3 photographs of the board charuco-10x7:25mm, got 2.*\n.*wall"
    ):
        cameras_from_board([photographs / name for name in ("photo00.png", "photo01.png", "wall.png")], BOARD)
    with pytest.raises(DataError, match="no such photograph"):
        cameras_from_board([photographs / "nothing.png"], BOARD)


@pytest.mark.parametrize("paper", PAPERS_MM)
def test_page_is_true_to_scale(paper: str, tmp_path: Path) -> None:
    import matplotlib

    with matplotlib.rc_context({"pdf.compression": 0, "pdf.fonttype": 42}):
        text = write_board_pdf(tmp_path / "board.pdf", paper=paper).read_bytes().decode("latin-1")
    width, height = (side / 25.4 * 72 for side in PAPERS_MM[paper])
    box = re.search(r"/MediaBox \[\s*0 0 ([\d.]+) ([\d.]+)", text)
    assert box is not None
    assert (float(box[1]), float(box[2])) == pytest.approx((width, height), abs=0.01)
    points = np.array(re.findall(r"^([\d.]+) ([\d.]+) [ml]$", text, re.MULTILINE), float)
    points = points[(points[:, 0] > 1) & (points[:, 0] < width - 1)]  # the page itself is a white rectangle
    assert np.ptp(points[:, 0]) * 25.4 / 72 == pytest.approx(250, abs=0.01)  # the board; the ruler begins with it
    ruler = points[points[:, 1] < 40]
    assert np.ptp(ruler[:, 0]) * 25.4 / 72 == pytest.approx(100, abs=0.01)


def test_printed_page_shows_every_corner_of_the_board() -> None:
    figure = board_figure(BOARD)
    figure.set_dpi(100)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[..., 0]
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    board = cv2.aruco.CharucoBoard((10, 7), 25.0, 17.5, dictionary)
    pixels, corners, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(np.ascontiguousarray(image))
    assert len(corners) == 54
    mm = np.asarray(pixels).reshape(-1, 2) / 100 * 25.4
    expected = BOARD.corners[np.ravel(corners)][:, :2] * [1000, -1000]
    assert np.abs((mm - mm.mean(axis=0)) - (expected - expected.mean(axis=0))).max() < 0.05


@pytest.mark.parametrize("text", ["charuco-10x7", "chess-10x7:25mm", "charuco-10x7:25", "charuco-ax7:25mm"])
def test_other_text_is_no_board(text: str) -> None:
    with pytest.raises(ValueError, match="expected a board like"):
        Board.parse(text)


def test_board_text_is_read_back_and_large_boards_are_refused(tmp_path: Path) -> None:
    assert Board.parse(str(Board(8, 6, 24.5))) == Board(8, 6, 24.5)
    with pytest.raises(ValueError, match="do not fit on A4"):
        write_board_pdf(tmp_path / "board.pdf", Board(10, 7, 40))
    with pytest.raises(ValueError, match="expected paper A4 or Letter"):
        write_board_pdf(tmp_path / "board.pdf", paper="A5")
    with pytest.raises(ValueError, match="expected 3x3 to 200 squares"):
        Board(2, 7)
    assert not list(tmp_path.iterdir())
