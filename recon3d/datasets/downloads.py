"""Data sets of the catalogue: downloaded into the user's cache, checked and unpacked."""

from __future__ import annotations

import errno
import json
import os
from dataclasses import dataclass
from pathlib import Path

from recon3d.datasets.archives import unpack
from recon3d.datasets.catalogue import DATASETS, Dataset
from recon3d.datasets.transfer import receive
from recon3d.errors import ArgumentError, DownloadError
from recon3d.io.files import atomic_folder, remove_leftovers, write_json, write_text
from recon3d.tasks import StageProgress

CACHE_VARIABLE = "RECON3D_CACHE"
"""Environment variable that names another folder for downloads."""

_RECORD = "download.json"  # in the folder of the photographs; there once all of them are


@dataclass(frozen=True)
class Download:
    """A data set that is there."""

    folder: Path
    """The photographs and cameras, for ``open_scene``."""
    sha256: str
    """Hexadecimal SHA-256 of the archive."""
    checked: bool
    """Whether the catalogue knows that SHA-256; else it was only compared with an earlier download."""
    new: bool
    """False where the folder had been there before."""


def download(name: str, folder: Path | str | None = None, *, progress: StageProgress | None = None) -> Path:
    """Folder of a public data set, such as templeSparseRing; downloaded unless it is there already.

    Parameters
    ----------
    name : one of ``DATASETS``.
    folder : new or empty folder for the photographs; in the cache when None. The cache is the system's folder for such
        things, or what the environment variable RECON3D_CACHE names.
    progress : called while the archive is downloaded (bytes) and unpacked (files).

    Raises
    ------
    ArgumentError : no such data set, or the folder holds something else.
    DownloadError : there is no connection or no such file, the archive is not what was expected, or the disk is full.
        What has arrived before a connection was cut is kept, and the next call resumes.
    """
    return obtain(name, folder, progress=progress).folder


def obtain(name: str, folder: Path | str | None = None, *, progress: StageProgress | None = None) -> Download:
    """Like ``download``; also tells what is known of the archive."""
    if name not in DATASETS:
        raise ArgumentError(f"expected one of {', '.join(DATASETS)}, got {name!r}")
    dataset, report = DATASETS[name], progress or (lambda _stage, _done, _total: None)
    target = cache_folder() / name if folder is None else Path(folder)
    present = _present(target, name, dataset)
    if present is not None:
        return present
    archive = cache_folder() / f"{name}.zip"
    try:
        sha256 = _fetch(dataset, archive, report)
        remove_leftovers(target.parent)
        with atomic_folder(target) as made:
            files = _unpacked(archive, made, report)
            record = {"name": name, "url": dataset.url, "sha256": sha256, "cite": dataset.citation, "files": files}
            write_json(made / _RECORD, record)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            advice = f"free space there, or name another folder by --output and by the variable {CACHE_VARIABLE}"
            raise DownloadError(f"{error.filename or archive.parent}: the disk is full; {advice}") from None
        raise DownloadError(f"{error.filename or target}: cannot be written ({error.strerror or error})") from None
    return Download(target, sha256, dataset.sha256 is not None, new=True)


def cache_folder() -> Path:
    """Folder that downloads are kept in."""
    import pooch

    named = os.environ.get(CACHE_VARIABLE)
    return Path(named).expanduser() if named else Path(pooch.os_cache("recon3d"))


def remembered_in(archive: Path) -> Path:
    """File beside an archive that holds its SHA-256, as ``sha256sum`` writes it."""
    return archive.with_name(f"{archive.name}.sha256")


def _present(folder: Path, name: str, dataset: Dataset) -> Download | None:
    """The data set that a folder holds already; None where the folder is new or empty."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return None
    try:
        record = json.loads((folder / _RECORD).read_text(encoding="utf-8"))
        known, sha256, files = record["name"], str(record["sha256"]), dict(record["files"])
    except (OSError, ValueError, KeyError, TypeError):
        known, sha256, files = None, "", {}
    if known != name or dataset.sha256 not in (None, sha256):
        raise ArgumentError(f"{folder}: expected a new or empty folder for {name}, this one holds something else")
    changed = [path for path, size in files.items() if not _has_size(folder / path, size)]
    if changed:
        told = f"{len(changed)} of its {len(files)} files are missing or changed, such as {changed[0]}"
        raise DownloadError(f"{folder}: {told}; delete the folder to have it unpacked again")
    return Download(folder, sha256, dataset.sha256 is not None, new=False)


def _has_size(path: Path, size: int) -> bool:
    return path.is_file() and path.stat().st_size == size


def _fetch(dataset: Dataset, archive: Path, report: StageProgress) -> str:
    """SHA-256 of a data set's archive in the cache, downloaded if need be, which is the expected one if any is."""
    import pooch

    remembered = remembered_in(archive)
    archive.parent.mkdir(parents=True, exist_ok=True)
    earlier = remembered.read_text(encoding="utf-8").split()[:1] if remembered.is_file() else []
    expected = dataset.sha256 or "".join(earlier) or None
    if archive.is_file():
        found = str(pooch.file_hash(archive))
        if found == (expected or found):
            write_text(remembered, f"{found}  {archive.name}\n")
            return found
        archive.unlink()
    part = archive.with_name(f"{archive.name}.part")
    try:
        receive(dataset.url, part, report)
    except DownloadError as error:
        if part.stat().st_size == 0:
            part.unlink()
        raise DownloadError(f"{error}. Or save {dataset.url} as {archive} by other means") from None
    found = str(pooch.file_hash(part))
    if found != (expected or found):
        part.unlink()
        told = f"{dataset.url}: expected SHA-256 {expected}, got {found}, which was not kept"
        if dataset.sha256:
            raise DownloadError(f"{told}: it was damaged on its way, or changed; type it again")
        raise DownloadError(f"{told}: not what was downloaded before; to take it, delete {remembered} first")
    write_text(remembered, f"{found}  {archive.name}\n")
    part.replace(archive)
    return found


def _unpacked(archive: Path, folder: Path, report: StageProgress) -> dict[str, int]:
    """Unpack an archive; one that cannot be is not kept, so that the next run downloads it anew."""
    try:
        return unpack(archive, folder, report)
    except DownloadError as error:
        archive.unlink(missing_ok=True)
        remembered_in(archive).unlink(missing_ok=True)
        raise DownloadError(f"{error}; the archive was removed") from None
