"""Compiled kernels on disk: a file for each kernel, types of its arguments, and state of its source.

numba's own cache gives up where neither the package's folder nor the user's can be written, takes no notice of changes
to the kernels that a kernel calls, and two processes that write at once may mix up its index.
"""

import hashlib
import os
import pickle
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

_HERE = Path(__file__).parent
_VERSIONS = f"{sys.implementation.cache_tag} numba {numba.__version__}"


class CodeFiles(NullCache):  # type: ignore[misc]
    """What numba asks for a kernel's compiled code, and hands it to. Files that cannot be read or written are none."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    @property
    def cache_path(self) -> str | None:
        """Folder of the files."""
        folder = _folder()
        return None if folder is None else str(folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Compiled code for a signature, or None."""
        target_context.refresh()
        path = self._path(sig, target_context.codegen())
        if path is None:
            return None
        try:
            content = pickle.loads(path.read_bytes())  # noqa: S301 (the folder is the user's own)
        except Exception:  # a broken file may raise anything
            return None
        return CompileResult._rebuild(target_context, *content)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep compiled code, in place of what was compiled from another state of the source."""
        path = self._path(sig, data.codegen)
        if path is None:
            return
        with suppress(OSError):
            # Whole before it bears its name: other processes read and write the same files.
            with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
                file.write(dumps(data._reduce()))
            Path(file.name).replace(path)
            kernel, source, _ = path.name.split("-")
            for other in path.parent.glob(f"{kernel}-*.nbc"):
                if not other.name.startswith(f"{kernel}-{source}-"):
                    other.unlink(missing_ok=True)

    def _path(self, sig: Any, codegen: Any) -> Path | None:
        """File of a signature's code for this machine; None where there is no place for it."""
        folder, module = _folder(), Path(self._function.__code__.co_filename)
        try:
            source = _source_digest(module)
        except OSError:  # in an archive
            return None
        types = _digest(f"{sig} {codegen.magic_tuple()} {_VERSIONS}".encode())
        return None if folder is None else folder / f"{module.stem}.{self._function.__name__}-{source}-{types}.nbc"


def _digest(content: bytes) -> str:
    """Short name for a content."""
    return hashlib.sha256(content).hexdigest()[:16]


@cache
def _source_digest(module: Path) -> str:
    """Digest of a module's source, that of the kernels that it imports, and of how kernels are compiled."""
    source = module.read_text(encoding="utf-8")
    imported = [_HERE / f"{name}.py" for name in re.findall(r"from recon3d\.kernels\.(\w+) import", source)]
    digests = [_source_digest(other) for other in imported if module.parent == _HERE and module.stem != "__init__"]
    return _digest("".join([source, (_HERE / "__init__.py").read_text(encoding="utf-8"), *digests]).encode())


@cache
def _folder() -> Path | None:
    """First of the possible folders that can be written."""
    for folder in _folders():
        with suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            return folder
    return None


def _folders() -> Iterator[Path]:
    """Where compiled code may lie: where numba is told to put it, beside the source, or in a folder of the user's."""
    own = f"recon3d-{_digest(str(_HERE).encode())}"
    if os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(os.environ["NUMBA_CACHE_DIR"]).absolute() / own
    yield _HERE / "__pycache__"
    home = Path(os.path.expanduser("~"))  # noqa: PTH111 (Path.home raises where there is none)
    caches = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    if caches.is_absolute() and caches.parent != Path(home.anchor):  # HOME may be empty
        yield caches / own
    with suppress(OSError):
        temporary = Path(tempfile.gettempdir()) / f"{own}-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
        temporary.mkdir(mode=0o700, exist_ok=True)
        # Others may write to the folder above, and code that they put there must not run.
        if not hasattr(os, "getuid") or _is_private(temporary):
            yield temporary


def _is_private(folder: Path) -> bool:
    """Whether a folder is the user's, no link, and nobody else can write to it."""
    status = folder.lstat()
    return folder.is_dir() and not folder.is_symlink() and status.st_uid == os.getuid() and not status.st_mode & 0o022
