"""A printed board that gives the cameras, the scale, up and the bounds of what stands on it, whatever its texture.

References
----------
G. An, S. Lee, M.-W. Seo, K. Yun, W.-S. Cheong, S.-J. Kang, "Charuco board-based omnidirectional camera calibration
method", Electronics 7(12), 2018.
Z. Zhang, "A flexible new technique for camera calibration", PAMI 22(11), 2000.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.calibration.photographs import PhotoFile, duplicates, find_photographs
from recon3d.calibration.result import CalibratedCamera, Calibration, Observations
from recon3d.calibration.writing import check_output, write_calibration
from recon3d.errors import ArgumentError, CalibrationError
from recon3d.io.calibration_record import CALIBRATION_FILE
from recon3d.io.files import atomic_path
from recon3d.scene.bounds import Bounds
from recon3d.scene.image_file import read_image
from recon3d.tasks import StageProgress

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPERS_MM = {"A4": (297.0, 210.0), "Letter": (279.4, 215.9)}
"""Width and height of the sheets, lying."""

_DICTIONARY = cv2.aruco.DICT_5X5_100
_MARKER = 0.7  # of a square: 7 modules of a tenth
_CELLS = 20  # a square's side in half modules
_RULER_MM = 100.0
_MARGIN_MM = 5.0  # that printers leave white
_RULER_HEIGHT_MM = 12.0
_MIN_CORNERS = 8
_PRINCIPAL_POINT_FROM = 10  # photographs
_GAIN = 0.99  # of the mean squared residual: what a coefficient of distortion must bring to be kept
_FIXED = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_USE_INTRINSIC_GUESS
_DISTORTIONS = (cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2, cv2.CALIB_FIX_K2, 0)


@dataclass(frozen=True)
class Board:
    """A chessboard with a marker in each white square (ChArUco).

    Its world is in metres: origin in the middle of the board, x to the right and y upwards on the sheet, z out of it.
    """

    columns: int = 10
    """Squares in a row."""
    rows: int = 7
    square_mm: float = 25.0
    """Side of a printed square. If the ruler on the print measures L mm instead of 100, L / 100 times the nominal."""

    def __post_init__(self) -> None:
        if self.columns < 3 or self.rows < 3 or self.columns * self.rows > 200:
            raise ArgumentError(f"expected 3x3 to 200 squares, got {self.columns}x{self.rows}")
        if not 0 < self.square_mm < np.inf:
            raise ArgumentError(f"expected a square of more than 0 mm, got {self.square_mm}")

    @classmethod
    def parse(cls, text: str) -> Board:
        """The board of a text like ``charuco-10x7:25mm``.

        Raises
        ------
        ArgumentError : another text.
        """
        found = re.fullmatch(r"charuco-(\d+)x(\d+):(\d+(?:\.\d+)?)mm", text)
        if not found:
            raise ArgumentError(f"expected a board like charuco-10x7:25mm, got {text!r}")
        return cls(int(found[1]), int(found[2]), float(found[3]))

    def __str__(self) -> str:
        return f"charuco-{self.columns}x{self.rows}:{self.square_mm:g}mm"

    @property
    def size(self) -> NDArray[np.float64]:
        """(2,) width and height, metres."""
        return np.array([self.columns, self.rows]) * self.square_mm / 1000

    @property
    def corners(self) -> NDArray[np.float64]:
        """(n, 3) inner corners in the world, metres, row by row from the upper left."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        plane = np.column_stack([x.ravel() - self.columns / 2, self.rows / 2 - y.ravel(), np.zeros(x.size)])
        return np.asarray(plane * self.square_mm / 1000)

    def picture(self, pixels_per_square: int = 4 * _CELLS) -> NDArray[np.uint8]:
        """Grey picture (rows, columns) of the board, without a margin."""
        size = (self.columns * pixels_per_square, self.rows * pixels_per_square)
        return np.asarray(_charuco(self).generateImage(size), np.uint8)


class _Seen(NamedTuple):
    """A photograph and the board's corners in it."""

    photograph: PhotoFile
    corners: NDArray[np.int64]
    pixels: NDArray[np.float64]


def write_board_pdf(path: Path | str, board: Board | None = None, *, paper: str = "A4") -> Path:
    """Write a board as a page to print at 100%, true to scale, with a ruler to check the print; returns the path.

    Raises
    ------
    ArgumentError : the paper is not known, or the board does not fit on it.
    """
    board = board or Board()
    figure = board_figure(board, paper=paper)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="pdf", metadata={"Title": f"recon3d {board}"})
    return Path(path)


def board_figure(board: Board, *, paper: str = "A4") -> Figure:
    """The page of a board as a matplotlib figure of the paper's size."""
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    if paper not in PAPERS_MM:
        raise ArgumentError(f"expected paper {' or '.join(PAPERS_MM)}, got {paper!r}")
    width, height = PAPERS_MM[paper]
    board_width, board_height = 1000 * board.size
    if board_width > width - 2 * _MARGIN_MM or board_height > height - 2 * _MARGIN_MM - _RULER_HEIGHT_MM:
        raise ArgumentError(
            f"{board}: {board_width:g}x{board_height:g} mm do not fit on {paper} with its margin and ruler; "
            "use smaller squares or fewer"
        )
    left, top = (width - board_width) / 2, height - _MARGIN_MM
    top -= (height - 2 * _MARGIN_MM - _RULER_HEIGHT_MM - board_height) / 2
    figure = Figure(figsize=(width / 25.4, height / 25.4))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)
    axes.axis("off")
    cell = board.square_mm / _CELLS
    outline = []
    for row, cells in enumerate(board.picture(_CELLS) < 128):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], cells, [False]]).astype(np.int8)))
        for begin, end in edges.reshape(-1, 2):
            x0, x1, y0, y1 = left + begin * cell, left + end * cell, top - row * cell, top - (row + 1) * cell
            outline += [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY] * (len(outline) // 5)
    # One path: the renderer leaves no seams between the cells.
    axes.add_patch(PathPatch(Outline(outline, codes), facecolor="black", edgecolor="none", linewidth=0))
    base = _MARGIN_MM + 5
    for mm in np.arange(0, _RULER_MM + 1, 5):
        axes.plot([left + mm] * 2, [base, base + (3 if mm % 10 == 0 else 1.5)], color="black", linewidth=0.4)
    axes.plot([left, left + _RULER_MM], [base] * 2, color="black", linewidth=0.4)
    axes.text(
        left + _RULER_MM + 4,
        base,
        f"recon3d {board}. Print at 100%; the ruler must measure {_RULER_MM:g} mm. Keep the sheet flat.",
        fontsize=7,
    )
    return figure


def cameras_from_board(
    photographs: Path | str | Iterable[Path | str],
    board: Board,
    *,
    output: Path | str | None = None,
    progress: StageProgress | None = None,
) -> Calibration:
    """Cameras of photographs that show a printed board, in the board's world: metres, z up.

    The bounds are the box above the board, as high as most photographs see it.

    Parameters
    ----------
    photographs : a folder of JPEG, PNG or TIFF files, or files. Orientation is taken from EXIF.
    board : as printed: measure its ruler.
    output : folder for the scene that ``calibrate_photographs`` writes too; None: nothing is written.

    Raises
    ------
    DataError : a photograph is missing or unreadable, or the output holds a scene of another origin.
    CalibrationError : fewer than three photographs show enough of the board.
    """
    found = find_photographs(photographs)
    unplaced = {name: f"the same file as {first}" for name, first in duplicates(found).items()}
    if output is not None:
        check_output(Path(output), (photograph.path for photograph in found), CALIBRATION_FILE)
    seen = []
    detector = cv2.aruco.CharucoDetector(_charuco(board))
    for n, photograph in enumerate(found):
        if progress is not None:
            progress("board", n, len(found))
        if photograph.name in unplaced:
            continue
        corners, pixels = _detect(detector, read_image(photograph.path))
        if _enough(corners, board):
            seen.append(_Seen(photograph, corners, pixels))
        else:
            unplaced[photograph.name] = (
                f"{len(corners)} of the board's {len(board.corners)} corners were found, {_MIN_CORNERS} in several "
                "rows are needed: is it sharp, lit and not hidden?"
            )
    if progress is not None:
        progress("board", len(found), len(found))
    if len(seen) < 3:
        listed = "".join(f"\n  {name}: {reason}" for name, reason in unplaced.items())
        raise CalibrationError(
            f"expected at least 3 photographs of the board {board}, got {len(seen)}. Is it this board?{listed}"
        )
    calibration = _calibration(seen, board, unplaced)
    if output is not None:
        write_calibration(calibration, output, progress)
    return calibration


def _charuco(board: Board) -> cv2.aruco.CharucoBoard:
    dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY)
    return cv2.aruco.CharucoBoard((board.columns, board.rows), 1.0, _MARKER, dictionary)


def _detect(
    detector: cv2.aruco.CharucoDetector, image: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Indices (n,) and pixels (n, 2) of the board's corners in a photograph."""
    pixels, corners, _, _ = detector.detectBoard(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
    if corners is None or pixels is None:
        return np.zeros(0, np.int64), np.zeros((0, 2))
    return np.asarray(corners, np.int64).ravel(), np.asarray(pixels, np.float64).reshape(-1, 2)


def _enough(corners: NDArray[np.int64], board: Board) -> bool:
    """Whether corners fix a pose: enough of them, and not all on one line."""
    places = board.corners[corners]
    return len(corners) >= _MIN_CORNERS and int(np.linalg.matrix_rank(places[:, :2] - places[0, :2], tol=1e-9)) == 2


def _calibration(seen: Sequence[_Seen], board: Board, unplaced: Mapping[str, str]) -> Calibration:
    cameras: list[CalibratedCamera] = []
    views, points, pixels = [], [], []
    for lens in sorted({one.photograph.lens for one in seen}):
        mine = [one for one in seen if one.photograph.lens == lens]
        for one, camera in zip(*_calibrate_lens(mine, board), strict=True):
            cameras.append(camera)
            views.append(np.full(len(one.corners), len(cameras) - 1))
            points.append(one.corners)
            pixels.append(one.pixels)
    order = np.argsort([camera.name for camera in cameras], kind="stable")
    rank = np.argsort(order)
    shown, indices = np.unique(np.concatenate(points), return_inverse=True)
    observations = Observations(rank[np.concatenate(views)], indices.astype(np.int64), np.concatenate(pixels))
    cameras = [cameras[n] for n in order]
    return Calibration(
        tuple(cameras),
        board.corners[shown],
        np.full((len(shown), 3), 128, np.uint8),
        observations,
        dict(sorted(unplaced.items())),
        mm_per_unit=1000.0,
        bounds=_bounds(cameras, board),
    )


def _calibrate_lens(seen: Sequence[_Seen], board: Board) -> tuple[list[_Seen], list[CalibratedCamera]]:
    """Cameras of photographs that one lens took, and the corners that agree with them.

    A coefficient of distortion that lowers the mean squared residual by less than 1% is left out.
    """
    kept = list(seen)
    for _ in range(2):
        best: list[CalibratedCamera] = []
        least = np.inf
        for fixed in _DISTORTIONS:
            found = _solve(kept, board, fixed)
            residual = float(np.mean(np.concatenate(_residuals(kept, board, found)) ** 2))
            if residual < _GAIN * least:
                best, least = found, residual
        errors = _residuals(kept, board, best)
        limit = max(5 * float(np.median(np.concatenate(errors))), 0.5)
        good = [
            one._replace(corners=one.corners[e < limit], pixels=one.pixels[e < limit])
            for one, e in zip(kept, errors, strict=True)
        ]
        kept = [one if _enough(one.corners, board) else old for one, old in zip(good, kept, strict=True)]
    return kept, best


def _solve(seen: Sequence[_Seen], board: Board, fixed: int) -> list[CalibratedCamera]:
    """Zhang's calibration of one lens."""
    first = seen[0].photograph
    size = (first.width, first.height)
    places = [board.corners[one.corners].astype(np.float32) for one in seen]
    pixels = [one.pixels.astype(np.float32) for one in seen]
    guess = cv2.initCameraMatrix2D(places, pixels, size, 1.0)
    f = first.focal_length or float(guess[0, 0])
    K = np.array([[f, 0, (first.width - 1) / 2], [0, f, (first.height - 1) / 2], [0, 0, 1]])
    flags = _FIXED | fixed | (0 if len(seen) >= _PRINCIPAL_POINT_FROM else cv2.CALIB_FIX_PRINCIPAL_POINT)
    _, K, distortion, rotations, shifts = cv2.calibrateCamera(places, pixels, size, K, np.zeros(5), flags=flags)
    coefficients = np.array(distortion, np.float64).ravel()[:5]
    cameras = []
    for one, rotation, shift in zip(seen, rotations, shifts, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rotation)[0], shift.ravel()
        photograph = one.photograph
        cameras.append(
            CalibratedCamera(photograph.name, photograph.path, *size, np.array(K, np.float64), coefficients, pose)
        )
    return cameras


def _residuals(seen: Sequence[_Seen], board: Board, cameras: Sequence[CalibratedCamera]) -> list[NDArray[np.float64]]:
    """For each photograph, pixels between its corners and where they are projected."""
    return [
        np.linalg.norm(camera.project(board.corners[one.corners]) - one.pixels, axis=1)
        for one, camera in zip(seen, cameras, strict=True)
    ]


def _bounds(cameras: Sequence[CalibratedCamera], board: Board) -> Bounds:
    """The box above the board, up to where at least half of the cameras see the axis through its middle."""
    width, depth = board.size
    heights = np.linspace(0, 2 * max(width, depth), 101)
    axis = np.column_stack([np.zeros((len(heights), 2)), heights])
    shown = np.zeros(len(heights))
    for camera in cameras:
        pixels = camera.project(axis)
        in_front = axis @ camera.cam_from_world[2, :3] + camera.cam_from_world[2, 3] > 0
        inside = (pixels >= -0.5).all(axis=1) & (pixels < np.array([camera.width, camera.height]) - 0.5).all(axis=1)
        shown += in_front & inside
    seen_by_half = heights[shown >= len(cameras) / 2]
    top = float(seen_by_half.max()) if len(seen_by_half) else 0.0
    return Bounds((-width / 2, -depth / 2, 0.0), (width / 2, depth / 2, max(top, board.square_mm / 1000)))
