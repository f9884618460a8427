"""Files from the network: limited in size, and resumed where the connection was cut."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import urlsplit

from recon3d.errors import DownloadError
from recon3d.tasks import StageProgress

MAX_DOWNLOAD = 1 << 30
"""Bytes that a file may have."""

ATTEMPTS = 4
"""How often a download that is cut is taken up again, in one call."""

PAUSE = 1.0
"""Seconds between them."""

_TIMEOUT = 30.0  # seconds without an answer, or without more data
_CHUNK = 1 << 16


def receive(url: str, part: Path, progress: StageProgress) -> None:
    """Download a file; what a cut connection or a killed run leaves of it is gone on from.

    Parameters
    ----------
    url : of HTTP or HTTPS.
    part : the file to write. Beside it, while it is not whole, ``part.version`` says which version of the file it is
        of, as the server names it: a part of another version is dropped.
    progress : called with the bytes that are there, and how many there will be where the server says so.

    Raises
    ------
    DownloadError : no connection, or it was cut again and again; the server has no such file or refuses it; the file is
        larger than ``MAX_DOWNLOAD``; another run writes the same file.
    """
    import pooch
    import requests

    host = urlsplit(url).hostname
    with part.open("ab") as file:
        _lock(file, part)
        arriving = _Arriving(file, part.with_name(f"{part.name}.version"), progress)
        for attempt in range(1, ATTEMPTS + 1):
            arriving.begun = False
            options: dict[str, Any] = {"headers": arriving.headers(), "hooks": {"response": arriving.begin}}
            try:
                pooch.HTTPDownloader(chunk_size=_CHUNK, timeout=_TIMEOUT, **options)(url, arriving, None)
                arriving.end()
                return
            except requests.HTTPError as error:
                raise DownloadError(f"{url}: {_answer(error.response.status_code)}") from None
            except (requests.ConnectionError, requests.Timeout, requests.exceptions.ChunkedEncodingError) as error:
                if not arriving.begun:
                    told = f"no connection to {host} ({type(error).__name__}); check the network and type it again"
                    raise DownloadError(told) from None
                if attempt == ATTEMPTS:
                    told = f"the connection to {host} was cut {ATTEMPTS} times, {arriving.size} bytes are there"
                    raise DownloadError(f"{told}; type it again to resume") from None
            except requests.RequestException as error:
                raise DownloadError(f"{url}: cannot be downloaded ({error})") from None
            finally:
                arriving.close()
            time.sleep(PAUSE)


def _answer(status: int) -> str:
    """What a server's refusal means, and what to do."""
    if status in (404, 410):
        return f"the server has no such file any more ({status}); look for it at the site's own pages"
    if status in (401, 403, 407):
        return f"the server or a proxy refuses it ({status}); see whether a browser may have it"
    return f"the server answers {status}; try again later"


def _lock(file: BinaryIO, part: Path) -> None:
    """Keep other runs from writing the same file, as long as it is open."""
    if sys.platform != "win32":
        import fcntl

        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise DownloadError(f"{part}: another run is downloading it; wait for that one") from None
        except OSError:  # a file system without locks
            pass


class _Arriving:
    """The file that is written while it arrives, with what is needed to resume."""

    def __init__(self, file: BinaryIO, version: Path, progress: StageProgress) -> None:
        self.begun = False
        """Whether the server has answered with data, this time."""
        self._file, self._version, self._progress = file, version, progress
        self._total: int | None = None
        self._answers: list[Any] = []

    @property
    def size(self) -> int:
        """Bytes that are there."""
        return self._file.tell()

    def headers(self) -> dict[str, str]:
        """What to ask the server for: the rest, if the file is still the one that the part is of."""
        known = self._version.read_text(encoding="utf-8") if self._version.is_file() else ""
        if not known:
            self._drop()
        asked = {"Range": f"bytes={self.size}-", "If-Range": known} if self.size else {}
        return {"Accept-Encoding": "identity", **asked}

    def begin(self, response: Any, *_given: Any, **_options: Any) -> None:
        """See from the head of an answer where its data belong."""
        import requests

        self.begun = True
        self._answers.append(response)
        if response.status_code == 416 or (response.status_code == 206 and not self._goes_on(response)):
            self._drop()
            raise requests.ConnectionError("the server cannot resume")
        if response.status_code not in (200, 206):
            return
        if response.status_code == 200:
            self._drop()
        tag = response.headers.get("ETag", "")
        known = response.headers.get("Last-Modified", "") if tag.startswith("W/") or not tag else tag
        self._version.write_text(known, encoding="utf-8")
        length = response.headers.get("Content-Length", "")
        self._total = self.size + int(length) if length.isdecimal() else None
        self._limit(self._total or 0)
        self._progress("downloading", self.size if self._total else 0, self._total or 1)

    def write(self, data: bytes) -> None:
        """Add data."""
        self._limit(self.size + len(data))
        self._file.write(data)
        if self._total:
            self._progress("downloading", self.size, self._total)

    def flush(self) -> None:
        """Hand what was written to the system, so that a killed run resumes."""
        self._file.flush()

    def end(self) -> None:
        """See that all has arrived."""
        import requests

        if self._total is not None and self.size < self._total:
            raise requests.ConnectionError("the connection was cut")
        self._version.unlink(missing_ok=True)
        self._progress("downloading", self.size, max(self.size, 2))

    def close(self) -> None:
        """Close the connections of all answers; one that was cut or refused would stay open."""
        while self._answers:
            self._answers.pop().close()

    def _goes_on(self, response: Any) -> bool:
        return bool(self.size) and response.headers.get("Content-Range", "").startswith(f"bytes {self.size}-")

    def _drop(self) -> None:
        self._version.unlink(missing_ok=True)
        self._file.truncate(0)
        self._file.seek(0)

    def _limit(self, size: int) -> None:
        if size > MAX_DOWNLOAD:
            self._drop()
            raise DownloadError(f"expected a file of at most {MAX_DOWNLOAD} bytes, the server sends more; not kept")
