"""Folders of results, and what is recorded in them."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from recon3d.cli.console import progress
from recon3d.cli.scenes import load
from recon3d.errors import ArgumentError, DataError

try:
    import fcntl
except ImportError:  # Windows, whose folders cannot be locked so
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:  # Open3D takes seconds to import, --help should not
    from recon3d.io.run_record import RunRecord
    from recon3d.result import Reconstruction
    from recon3d.scene.scene import Scene
    from recon3d.settings import Settings
    from recon3d.surface.texture import TexturedMesh

_locked: set[Path] = set()  # folders that are this process's


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


def save_texture(textured: TexturedMesh, folder: Path) -> dict[str, Path]:
    """Write a textured mesh for other programs, as GLB and as OBJ."""
    glb, obj = (textured.write(folder / f"textured.{kind}") for kind in ("glb", "obj"))
    return {"textured mesh (glb)": glb[0], "textured mesh (obj)": obj[0]}


def mesh_of(result: Path) -> Path:
    """The mesh file of a result folder, or the file itself."""
    from recon3d.io.geometry import MESH_SUFFIXES
    from recon3d.io.printing import PRINT_SUFFIXES

    kept = [suffix for suffix in MESH_SUFFIXES if suffix not in PRINT_SUFFIXES]  # those in the world's frame
    found = [result / f"mesh{suffix}" for suffix in kept if (result / f"mesh{suffix}").is_file()]
    if result.is_dir() and not found:
        raise DataError(f"{result}: expected the folder of a result, with a mesh in it")
    return found[0] if result.is_dir() else result


def record_of(result: Path) -> RunRecord | None:
    """What is recorded of a result's folder or file, of the scene and what was done; None without a record."""
    from recon3d.io.run_record import RECORD_FILE, read_run_record

    file = (result if result.is_dir() else result.parent) / RECORD_FILE
    return read_run_record(file) if file.exists() else None


def recorded_scene(
    result: Path,
    record: RunRecord | None,
    *,
    silhouettes: str = "none",
    hint: str = "",
    whole_photographs: bool = False,
) -> Scene:
    """The scene that a result was made of, with the views that were used.

    Parameters
    ----------
    hint : ends the error that no scene is known.
    whole_photographs : at full size even if smaller ones were used, unless the cameras were adjusted for these.
    """
    from recon3d.budget import SCALES
    from recon3d.datasets.synthetic import SCENES
    from recon3d.io.refined_cameras import REFINED_FILE, with_refined_cameras

    source = record.scene.source if record is not None else None
    if record is None or source is None:
        raise DataError(f"{result}: no record says which scene this was made of{hint}")
    told = record.scene
    box = None if source in SCENES else ",".join(str(x) for corner in told.bounds for x in corner)
    given = load(source, box, silhouettes, told.mm_per_unit, told.images)
    folder = result if result.is_dir() else result.parent
    if not whole_photographs or (folder / REFINED_FILE).is_file():
        given = given.shrunk(SCALES[told.detail])
    scene = with_refined_cameras(folder, given, of_views=False) or given
    return scene.subset(told.views)


def recorded_settings(result: Path, record: RunRecord | None, test: str | None) -> Settings:
    """The settings that a result was made with, a user's own test among them only where its name is given."""
    from recon3d.settings import Settings

    if not result.exists() or record is None or record.settings is None:
        raise DataError(f"{result}: expected the folder of a result, with a record.json that tells the settings")
    try:
        return Settings.from_record(record.settings, test=test)
    except (ArgumentError, DataError) as error:
        raise DataError(f"{result}: the recorded settings cannot be used again: {error}") from None


def writable(folder: Path) -> Path:
    """The folder, made if need be, and for this process alone until it ends.

    Raises
    ------
    ArgumentError : nothing can be written to it, or another command writes into it now.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ArgumentError(f"--output {folder}: expected a folder that can be written ({error.strerror})") from None
    _lock(folder)
    return folder


def _lock(folder: Path) -> None:
    """Lock a folder until the process ends, however it does; no file is left behind."""
    if fcntl is None or folder.resolve() in _locked:
        return
    handle = os.open(folder, os.O_RDONLY)  # never closed: that would unlock the folder
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ArgumentError(
            f"--output {folder}: another command writes into it now; wait until that has ended, or name another folder"
        ) from None
    except OSError:  # a file system without locks
        return
    _locked.add(folder.resolve())


def beside(result: Path, name: str) -> Path:
    """Folder for what is made from a result: inside its folder, or beside its file."""
    return (result if result.is_dir() else result.parent) / name
