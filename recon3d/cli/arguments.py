"""What the commands share: reading arguments into values, progress bars, tables."""

from __future__ import annotations

import ast
import json
import math
import re
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

import typer

from recon3d.checks import shorten
from recon3d.errors import ArgumentError, DataError, SceneWarning

if TYPE_CHECKING:  # Open3D takes seconds to import, --help should not
    import open3d as o3d

    from recon3d.budget import Chosen
    from recon3d.calibration import Calibration
    from recon3d.carving import Method
    from recon3d.consistency.base import ConsistencyTest
    from recon3d.datasets.synthetic import BuiltInScene
    from recon3d.diagnosis import Finding
    from recon3d.pipeline import Progress
    from recon3d.result import Reconstruction
    from recon3d.scene.scene import Scene
    from recon3d.settings import Settings


def load(
    scene: str,
    bounds: str | None,
    silhouettes: str,
    mm_per_unit: float | None = None,
    images: Path | str | None = None,
) -> Scene:
    """Scene of a folder or of a built-in name."""
    from recon3d.datasets.synthetic import SCENES
    from recon3d.io import open_scene
    from recon3d.scene.bounds import Bounds
    from recon3d.scene.silhouettes import without_silhouettes

    if scene in SCENES and not Path(scene).exists():
        given = bounds is not None or silhouettes not in ("auto", "none") or mm_per_unit not in (None, 1000.0)
        if given or images is not None:
            raise ArgumentError(f"{scene} is built in: it has its own bounds, silhouettes, unit and images")
        built_in = photograph(scene).scene
        if silhouettes == "none":
            bare = without_silhouettes(built_in)
            return replace(bare, notes={**bare.notes, "silhouettes from": "none"})
        return built_in
    numbers = numbers_of("--bounds", bounds, "six numbers X0,Y0,Z0,X1,Y1,Z1")
    box = Bounds(numbers[:3], numbers[3:]) if numbers else None
    with progress() as report:
        report("reading", 0, 1)
        loaded = open_scene(scene, bounds=box, silhouettes=silhouettes, mm_per_unit=mm_per_unit, images=images)
        report("reading", 1, 1)
    return loaded


def at_detail(scene: Scene, detail: str, memory: str | None, settings: Settings | None = None) -> Chosen:
    """The scene at a level of detail, within a memory where one is given, and what to tell of it."""
    from recon3d import budget
    from recon3d.scene.pixel_cache import PIXELS

    if detail not in get_args(budget.Detail):
        raise ArgumentError(f"--detail: expected {', '.join(get_args(budget.Detail))}, got {detail!r}")
    limit = None if memory is None else bytes_of(memory)
    PIXELS.limit = min(PIXELS.limit, int(limit or budget.MOST_MEMORY) // 8)
    return budget.at_detail(scene, cast(budget.Detail, detail), settings=settings, memory=limit)


def bytes_of(text: str) -> float:
    """Bytes of a size such as 4GiB, 800 MB or 4G."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kMGT])(i?)B?\s*", text)
    if not found or not float(found[1]):
        raise ArgumentError(f"--memory: expected a size such as 4GiB or 800MB, got {text!r}")
    decimal = not found[3] and text.rstrip().endswith("B")
    base = 1000.0 if decimal else 1024.0
    return float(found[1]) * base ** (1 + "kMGT".index(found[2]))


def plain_photographs(scene: str) -> Path | None:
    """The folder of photographs that a path names, itself or its only sub folder, if nothing tells their cameras."""
    from recon3d.datasets.synthetic import SCENES
    from recon3d.io.opening import format_of
    from recon3d.io.reading import image_files

    path = Path(scene)
    if not path.is_dir() or (scene in SCENES and not image_files(path)) or format_of(path) is not None:
        return None
    inside = [entry for entry in path.iterdir() if entry.name[0] != "."]
    folder = inside[0] if len(inside) == 1 and inside[0].is_dir() else path
    return folder if image_files(folder) else None


def calibrated(
    photographs: Path,
    output: Path,
    board: str | None = None,
    turntable: str | None = None,
    masks: Path | None = None,
    known_distance: str | None = None,
) -> Calibration:
    """Cameras of plain photographs, by a printed board or a turntable where one is told; writes the scene."""
    from recon3d.calibration import Board, Turntable, calibrate, cameras_from_board, cameras_from_turntable

    given = [name for name, value in (("--board", board), ("--turntable", turntable), ("--masks", masks)) if value]
    if len(given) > 1:
        raise ArgumentError(f"expected one of {' and '.join(given)}: each is another way to find the cameras")
    if known_distance is not None and (board is not None or turntable is not None):
        raise ArgumentError("--known-distance: the scale is known by --board or --turntable already")
    with progress() as report:
        if board is not None:
            return cameras_from_board(photographs, Board.parse(board), output=output, progress=report)
        if turntable is not None:
            return cameras_from_turntable(photographs, Turntable.parse(turntable), output=output, progress=report)
        return calibrate(photographs, output, masks=masks, known_distance=known_distance, progress=report)


def with_adjusted_cameras(scene: Scene, folder: Path) -> Scene:
    """The scene with cameras that bundle adjustment has refined; kept in a folder for the next run."""
    from recon3d.calibration import refine_cameras
    from recon3d.io.refined_cameras import with_refined_cameras, write_refined_cameras

    kept = with_refined_cameras(folder, scene)
    if kept is not None:
        return kept
    with progress() as report:
        refined = refine_cameras(scene.views, progress=report)
    say(refined.summary())
    write_refined_cameras(folder, replace(scene, views=refined.views), scene)
    return replace(scene, views=refined.views)


@contextmanager
def doubts() -> Iterator[list[SceneWarning]]:
    """Keeps what the opening of a scene warns of, for ``warn_of_doubts``; other warnings are told when it has ended."""
    kept: list[SceneWarning] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        try:
            yield kept
            kept += [each.message for each in caught if isinstance(each.message, SceneWarning)]
        finally:
            told = [each.message for each in caught if each.message not in kept]
    for message in told:
        warnings.warn(message, stacklevel=3)


def warn_of_doubts(doubted: Iterable[SceneWarning], findings: Sequence[Finding]) -> None:
    """Warn of what the opening of a scene left in doubt, but for what findings tell."""
    for doubt in doubted:
        if not any(finding.covers(doubt.about) for finding in findings):
            warnings.warn(doubt, stacklevel=2)


def warn_of_findings(scene: Scene, doubted: Iterable[SceneWarning]) -> None:
    """Warn of what a quick check of a scene finds, before it is reconstructed, each thing once.

    Parameters
    ----------
    doubted : what was left in doubt when the scene was opened.
    """
    from recon3d.diagnosis import check_scene

    with progress() as report:
        report("checking", 0, 1)
        findings = check_scene(scene)
        report("checking", 1, 1)
    warn_of_doubts(doubted, findings)
    for finding in findings:
        warnings.warn(f"{scene.name}: {finding}", stacklevel=2)


def photograph(name: str, **options: Any) -> BuiltInScene:
    """Built-in scene of a name."""
    from recon3d.datasets.synthetic import SCENES

    with progress() as report:
        report("photographing", 0, 1)
        built_in = SCENES[name](**options)
        report("photographing", 1, 1)
    return built_in


def run(
    scene: Scene, settings: Settings, ground_truth: o3d.geometry.TriangleMesh | None, stages: Path | None = None
) -> Reconstruction:
    """Reconstruct under progress bars, keeping finished stages in a folder where one is given."""
    from recon3d.io.checkpoints import Checkpoints
    from recon3d.pipeline import reconstruct

    kept = None if stages is None else Checkpoints(stages)
    with progress() as report:
        return reconstruct(scene, settings, ground_truth=ground_truth, checkpoints=kept, progress=report)


def save(result: Reconstruction, folder: Path, formats: list[str], *, pictures: bool = True) -> dict[str, Path]:
    """Write a result and, where it was measured, its curves."""
    from recon3d.reporting.figures import save_evaluation
    from recon3d.reporting.saving import save as save_result

    with progress() as report:
        report("writing", 0, 1)
        written = save_result(result, folder, mesh_formats=formats, pictures=pictures)
        if result.evaluation:
            written |= save_evaluation(result.evaluation, folder)
        report("writing", 1, 1)
    return written


def make_test(name: str | None, options: list[str]) -> ConsistencyTest:
    """Photo-consistency test of a name, with NAME=VALUE options."""
    from recon3d.consistency import load_test

    values = keywords(options)
    try:
        return load_test(name or "fuzzy", **values)
    except ArgumentError as error:
        raise ArgumentError(f"{'--test-option' if values else '--test'}: {error}") from None


def make_method(name: str, options: list[str], test: str | None, test_options: list[str]) -> Method | None:
    """Carving method of a name, with NAME=VALUE options and a test; None where the scene is to decide."""
    from recon3d.carving import METHODS, JudgingMethod

    if name == "auto":
        if options:
            raise ArgumentError(f"--method-option: expected --method, too, got {', '.join(options)} alone")
        if test is None and not test_options:
            return None
        name = "generalized-voxel-coloring"
    if name not in METHODS:
        raise ArgumentError(f"--method: expected auto, {', '.join(METHODS)}, got {name!r}")
    kind, values = METHODS[name], keywords(options)
    if test is not None or test_options:
        if not issubclass(kind, JudgingMethod):
            raise ArgumentError(f"--test: {name} uses no photo-consistency test, got {test or 'fuzzy'}")
        values["test"] = make_test(test, test_options)
    known = [option.name for option in fields(kind)]
    unknown = [option for option in values if option not in known]
    if unknown:
        raise ArgumentError(f"--method-option: {name} has no {', '.join(unknown)}; it has {', '.join(known)}")
    return kind(**values)


def views_of(option: str) -> Any:
    """The settings' choice of views: "auto", "all" or a tuple of names."""
    return option if option in ("auto", "all") else names_of(option)


def names_of(option: str) -> tuple[str, ...]:
    """Names between commas."""
    return tuple(name.strip() for name in option.split(","))


# What literal_eval raises, down to text that is nested too deeply for it.
_NO_LITERAL = (ValueError, SyntaxError, TypeError, MemoryError, RecursionError)

_MOST_SWEPT = 10_000  # values; each is a whole carving


def keywords(options: list[str]) -> dict[str, Any]:
    """Keyword arguments of NAME=VALUE options; a value that is no Python literal is text."""
    values = {}
    for option in options:
        key, sign, text = option.partition("=")
        if not sign:
            raise ArgumentError(f"expected NAME=VALUE, got {option!r}")
        try:
            values[key] = ast.literal_eval(text)
        except _NO_LITERAL:
            values[key] = text
    return values


def sweep_of(option: str) -> tuple[str, list[float]]:
    """Parameter and values of NAME=LOW:HIGH:STEP, both ends included; whole numbers stay whole."""
    name, _, text = option.partition("=")
    try:
        low, high, step = (ast.literal_eval(number) for number in text.split(":"))
        count = math.floor((high - low) / step + 1e-9) + 1
        values = [round(low + n * step, 12) for n in range(min(count, _MOST_SWEPT))]
    except (*_NO_LITERAL, ArithmeticError):
        count, values = 0, []
    if not (name and values):
        raise ArgumentError(f"--sweep: expected NAME=LOW:HIGH:STEP, got {shorten(repr(option))}")
    if count > _MOST_SWEPT:
        raise ArgumentError(f"--sweep: expected at most {_MOST_SWEPT} values, got {count} by {option!r}")
    return name, values


def mesh_of(result: Path) -> Path:
    """The mesh file of a result folder, or the file itself."""
    from recon3d.io.geometry import MESH_SUFFIXES

    found = [result / f"mesh{suffix}" for suffix in MESH_SUFFIXES if (result / f"mesh{suffix}").is_file()]
    if result.is_dir() and not found:
        raise DataError(f"{result}: expected the folder of a result, with a mesh in it")
    return found[0] if result.is_dir() else result


def record_of(result: Path) -> dict[str, Any] | None:
    """What is recorded of the scene of a result's folder or file, and of what was done; None without a record."""
    file = (result if result.is_dir() else result.parent) / "record.json"
    if not file.is_file():
        return None
    try:
        record: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        scene = record["scene"]
        low, high = scene["bounds"]
        return {
            "views": [str(name) for name in scene["views"]],
            "bounds": [float(x) for corner in (low, high) for x in corner],
            "mm_per_unit": None if scene["mm_per_unit"] is None else float(scene["mm_per_unit"]),
            "source": None if scene.get("source") is None else str(scene["source"]),
            "silhouettes": str(scene.get("silhouettes from", "auto")),
            "images": scene.get("images from"),
            "detail": str(scene.get("detail", "full")),
            "settings": record.get("settings"),
            "voxels": dict(record.get("voxels") or {}),
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataError(f"{file}: expected the record of a run, got something else ({error!r})") from None


def recorded_scene(result: Path, record: dict[str, Any] | None, *, silhouettes: str = "none", hint: str = "") -> Scene:
    """The scene that a result was made of, with the views that were used; a hint ends the error that none is known."""
    from recon3d.budget import SCALES
    from recon3d.datasets.synthetic import SCENES
    from recon3d.io.refined_cameras import with_refined_cameras

    if record is None or record["source"] is None:
        raise DataError(f"{result}: no record says which scene this was made of{hint}")
    box = None if record["source"] in SCENES else ",".join(map(str, record["bounds"]))
    given = load(record["source"], box, silhouettes, record["mm_per_unit"], record["images"])
    given = given.shrunk(SCALES.get(record["detail"], 1.0))
    folder = result if result.is_dir() else result.parent
    scene = with_refined_cameras(folder, given, of_views=False) or given
    return scene.subset(record["views"])


def recorded_settings(result: Path, record: dict[str, Any] | None, test: str | None) -> Settings:
    """The settings that a result was made with, a user's own test among them only where its name is given."""
    from recon3d.settings import Settings

    if not result.exists() or record is None or record["settings"] is None:
        raise DataError(f"{result}: expected the folder of a result, with a record.json that tells the settings")
    try:
        return Settings.from_record(record["settings"], test=test)
    except (ArgumentError, DataError) as error:
        raise DataError(f"{result}: the recorded settings cannot be used again: {error}") from None


def numbers_of(option: str, text: str | None, form: str) -> list[float] | None:
    """Numbers of an option, as many as its form "three numbers X,Y,Z" has; None where it was not given."""
    if text is None:
        return None
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != form.count(",") + 1:
        raise ArgumentError(f"{option}: expected {form}, got {text!r}")
    return numbers


def pixel_of(text: str | None) -> tuple[str, float, float] | None:
    """View's name and pixel of an option like view01.png,80,60; None where it was not given."""
    if text is None:
        return None
    name, _, numbers = text.partition(",")
    place = numbers_of("--pixel", numbers, "a view's name and two numbers U,V") or []
    return name, place[0], place[1]


def writable(folder: Path) -> Path:
    """The folder, made if need be; an error before any work where nothing can be written to it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        raise ArgumentError(f"--output {folder}: expected a folder that can be written ({error.strerror})") from None


def beside(result: Path, name: str) -> Path:
    """Folder for what is made from a result: inside its folder, or beside its file."""
    return (result if result.is_dir() else result.parent) / name


def say(rows: dict[str, Any]) -> None:
    """Print a table to standard output."""
    for name, value in rows.items():
        typer.echo(f"{name + ':':32} {value}")


@contextmanager
def progress() -> Iterator[Progress]:
    """Bars on standard error, one a stage; nothing where that is not a terminal."""
    from rich.console import Console
    from rich.progress import Progress as Bars

    with Bars(console=Console(stderr=True), disable=not sys.stderr.isatty(), transient=True) as bars:
        tasks: dict[str, Any] = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=None if total == 1 else total)
            bars.update(tasks[stage], completed=done, total=None if total == 1 and done == 0 else total)

        yield report
