"""Scenes as the commands open them, and what is doubtful about them."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

from recon3d.cli.arguments import bytes_of, numbers_of
from recon3d.cli.console import progress, say
from recon3d.errors import ArgumentError, SceneWarning

if TYPE_CHECKING:  # Open3D takes seconds to import, --help should not
    from recon3d.budget import Chosen
    from recon3d.calibration import Calibration
    from recon3d.datasets.synthetic import BuiltInScene
    from recon3d.diagnosis import Finding
    from recon3d.scene.scene import Scene
    from recon3d.settings import Settings


def load(
    scene: str,
    bounds: str | None,
    silhouettes: str,
    mm_per_unit: float | None = None,
    images: Path | str | None = None,
    *,
    object_alone: bool = False,
) -> Scene:
    """Scene of a folder or of a built-in name."""
    from recon3d.datasets.synthetic import SCENES
    from recon3d.io import open_scene
    from recon3d.scene.bounds import Bounds
    from recon3d.scene.silhouettes import without_silhouettes

    if scene in SCENES and not Path(scene).exists():
        given = bounds is not None or silhouettes not in ("auto", "none") or mm_per_unit not in (None, 1000.0)
        if given or images is not None or object_alone:
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
        loaded = open_scene(
            scene,
            bounds=box,
            silhouettes=silhouettes,
            mm_per_unit=mm_per_unit,
            images=images,
            object_alone=object_alone,
        )
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


def plain_photographs(scene: str) -> Path | None:
    """The folder of photographs that a path names, itself or its only sub folder, if nothing tells their cameras."""
    from recon3d.datasets.synthetic import SCENES
    from recon3d.io.opening import format_of
    from recon3d.io.photographs import image_files

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
    *,
    object_alone: bool = False,
) -> Calibration:
    """Cameras of plain photographs, by a printed board or a turntable where one is told; writes the scene."""
    from recon3d.calibration import Board, Turntable, calibrate, cameras_from_board, cameras_from_turntable

    given = [name for name, value in (("--board", board), ("--turntable", turntable), ("--masks", masks)) if value]
    if len(given) > 1:
        raise ArgumentError(f"expected one of {' and '.join(given)}: each is another way to find the cameras")
    if known_distance is not None and (board is not None or turntable is not None):
        raise ArgumentError("--known-distance: the scale is known by --board or --turntable already")
    if object_alone and (board is not None or turntable is not None):
        raise ArgumentError("--object: expected photographs alone; with --board the bounds are above the board already")
    with progress() as report:
        if board is not None:
            return cameras_from_board(photographs, Board.parse(board), output=output, progress=report)
        if turntable is not None:
            return cameras_from_turntable(photographs, Turntable.parse(turntable), output=output, progress=report)
        return calibrate(
            photographs,
            output,
            masks=masks,
            known_distance=known_distance,
            object_alone=object_alone,
            progress=report,
        )


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

    Silhouettes that are made of the photographs are made for it.

    Parameters
    ----------
    doubted : what was left in doubt when the scene was opened.
    """
    from recon3d.diagnosis import check_scene
    from recon3d.scene.mask import ComputedMask

    made = [view for view in scene.views if isinstance(view.mask, ComputedMask)]
    with progress() as report, doubts() as of_silhouettes:
        for n, view in enumerate(made):
            report("silhouettes", n, len(made))
            _ = view.silhouette
        report("checking", 0, 1)
        findings = check_scene(scene)
        report("checking", 1, 1)
    warn_of_doubts([*doubted, *of_silhouettes], findings)
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
