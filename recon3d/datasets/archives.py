"""Unpacking of archives that others made: nothing lands outside the folder, and nothing grows without limit."""

from __future__ import annotations

import errno
import re
import shutil
import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from recon3d.errors import DownloadError
from recon3d.tasks import StageProgress

MAX_UNPACKED = 4 << 30
"""Bytes that the members of an archive may have together."""

MAX_MEMBERS = 20_000
"""Files and folders that an archive may hold."""

_CHUNK = 1 << 20
_DEVICE = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9¹²³]) *(\..*)?", re.IGNORECASE)
_ENCRYPTED = 0x1  # flag bit of a member


def unpack(archive: Path, folder: Path, progress: StageProgress) -> dict[str, int]:
    """Unpack a zip archive into an empty folder; one folder around everything in it is left out.

    Returns
    -------
    Size in bytes by the path of every file, relative to the folder, with ``/``.

    Raises
    ------
    DownloadError : it is not a zip archive, is damaged, holds a member that would land outside the folder or cannot be
        a file on every system, or exceeds ``MAX_UNPACKED`` or ``MAX_MEMBERS``.
    OSError : ENOSPC where it does not fit on the disk.
    """
    try:
        with zipfile.ZipFile(archive) as opened:
            members = _checked(opened, archive)
            wanted, free = sum(member.file_size for member in members.values()), shutil.disk_usage(folder).free
            if wanted > free:
                raise OSError(errno.ENOSPC, f"{wanted} bytes are to be unpacked, {free} are free", str(folder.parent))
            for done, (path, member) in enumerate(members.items()):
                progress("unpacking", done, len(members))
                target = folder / path
                target.parent.mkdir(parents=True, exist_ok=True)
                with opened.open(member) as source, target.open("xb") as file:
                    shutil.copyfileobj(source, file, _CHUNK)
            progress("unpacking", len(members), len(members))
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, UnicodeDecodeError) as error:
        raise DownloadError(
            f"{archive.name}: expected a zip archive that is whole, got another file ({error})"
        ) from None
    return {str(path): member.file_size for path, member in members.items()}


def _checked(opened: zipfile.ZipFile, archive: Path) -> dict[PurePosixPath, zipfile.ZipInfo]:
    """Files of an archive by the path where each belongs."""
    infos = opened.infolist()
    size = sum(info.file_size for info in infos)
    if len(infos) > MAX_MEMBERS or size > MAX_UNPACKED:
        raise DownloadError(
            f"{archive.name}: expected at most {MAX_MEMBERS} members and {MAX_UNPACKED} bytes unpacked, "
            f"got {len(infos)} and {size}"
        )
    files: list[tuple[PurePosixPath, zipfile.ZipInfo]] = []
    for info in infos:
        reason = _refused(info)
        if reason:
            raise DownloadError(f"{archive.name}: its member {info.orig_filename!r} {reason}; nothing was unpacked")
        path = PurePosixPath(_name(info))
        if _name(info).endswith("/") or path.parts[0] == "__MACOSX":  # what macOS adds beside the files
            continue
        files.append((path, info))
    _refuse_collisions([path for path, _ in files], archive)
    members = dict(files)
    if len({path.parts[0] for path in members}) == 1 and all(len(path.parts) > 1 for path in members):
        members = {path.relative_to(path.parts[0]): info for path, info in members.items()}
    if not members:
        raise DownloadError(f"{archive.name}: expected photographs, got an archive without files")
    return members


def _name(info: zipfile.ZipInfo) -> str:
    """Path of a member as the archive has it, whichever way its slashes lean."""
    return info.orig_filename.replace("\\", "/")


def _refused(info: zipfile.ZipInfo) -> str | None:
    """Why a member must not be unpacked, on whatever system."""
    name = _name(info)
    parts = name.removesuffix("/").split("/")
    kind = stat.S_IFMT(info.external_attr >> 16)
    if name.startswith("/") or re.match(r"[A-Za-z]:", name):
        return "has an absolute path"
    if ".." in parts:
        return "would land outside the folder"
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        return "is a link or a device, not a file"
    if any(_DEVICE.fullmatch(part) for part in parts):
        return "has the name of a device"
    if re.search(r"[\x00-\x1f\x7f:]", name) or any(part in ("", ".") or part[-1] in ". " for part in parts):
        return "has a name that not every system can store"
    if info.flag_bits & _ENCRYPTED or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        return "is encrypted, or compressed in a way that is not known here"
    return None


def _refuse_collisions(paths: list[PurePosixPath], archive: Path) -> None:
    """An error where two files would be one where case does not count, or a file would be a folder as well."""
    taken = {str(parent).casefold() for path in paths for parent in path.parents}
    for path in paths:
        if str(path).casefold() in taken:
            raise DownloadError(f"{archive.name}: holds {str(path)!r} twice; nothing was unpacked")
        taken.add(str(path).casefold())
