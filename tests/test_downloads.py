"""Data sets from a server that may cut, lie or refuse; archives that may be hostile."""

from __future__ import annotations

import errno
import hashlib
import io
import os
import socket
import stat
import sys
import zipfile
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from recon3d import cli
from recon3d.datasets import DATASETS, Dataset, archives, download, downloads, obtain, transfer
from recon3d.errors import ArgumentError, DownloadError
from recon3d.io.opening import FORMATS, format_of

CAMERA = "a.png 500 0 80 0 500 60 0 0 1 1 0 0 0 1 0 0 0 1 0 0 2\n"
FILES = {"toy/README.txt": b"A toy.", "toy/toy_par.txt": f"1\n{CAMERA}".encode(), "toy/a.png": os.urandom(300_000)}


def zipped(files: dict[str | zipfile.ZipInfo, bytes]) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return made.getvalue()


GOOD = zipped({**FILES})


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


class Server(ThreadingHTTPServer):
    """One file for every path that ends in .zip; ``cuts`` holds after how many bytes each next answer breaks off."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Answer)
        self.content = GOOD
        self.resumes = True
        self.told_length = True
        self.cuts: list[int] = []
        self.asked: list[str | None] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/toy.zip"


class Answer(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        server, wanted = self.server, self.headers.get("Range")
        server.asked.append(wanted)
        if not self.path.endswith(".zip"):
            self.send_error(404)
            return
        tag, start = f'"{sha256(server.content)}"', 0
        if wanted and server.resumes and self.headers.get("If-Range") == tag:
            start = int(wanted.removeprefix("bytes=").removesuffix("-"))
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{len(server.content) - 1}/{len(server.content)}")
        else:
            self.send_response(200)
        self.send_header("ETag", tag)
        if server.told_length:
            self.send_header("Content-Length", str(len(server.content) - start))
        self.end_headers()
        sent = server.content[start:]
        self.wfile.write(sent[: server.cuts.pop(0)] if server.cuts else sent)

    def log_message(self, *_given: object) -> None:
        pass


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Server]:
    """A server of the data set ``toy``, and a cache of its own."""
    monkeypatch.setenv("NO_PROXY", "*")
    monkeypatch.setenv("RECON3D_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(transfer, "PAUSE", 0.0)
    with Server() as started:
        monkeypatch.setitem(DATASETS, "toy", Dataset(started.url, "a toy", "Nobody", sha256(GOOD)))
        thread = Thread(target=started.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield started
        started.shutdown()
        thread.join()


def with_unknown_hash(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DATASETS, "toy", Dataset(server.url, "a toy", "Nobody"))


def in_cache(tmp_path: Path) -> set[str]:
    return {path.name for path in (tmp_path / "cache").iterdir()}


def test_a_data_set_is_downloaded_once_and_opens(server: Server, tmp_path: Path) -> None:
    seen: list[tuple[str, int, int]] = []
    folder = download("toy", progress=lambda *step: seen.append(step))
    assert folder == tmp_path / "cache" / "toy"
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "download.json"} == {
        name.removeprefix("toy/"): content for name, content in FILES.items()
    }
    assert format_of(folder) is FORMATS["middlebury"]
    assert ("downloading", len(GOOD), len(GOOD)) in seen
    assert seen[-1] == ("unpacking", 3, 3)
    again = obtain("toy")
    assert (again.folder, again.new, again.checked, again.sha256) == (folder, False, True, sha256(GOOD))
    assert len(server.asked) == 1
    assert in_cache(tmp_path) == {"toy", "toy.zip", "toy.zip.sha256"}


def test_a_folder_of_ones_own_is_filled_from_the_cache(server: Server, tmp_path: Path) -> None:
    assert download("toy", tmp_path / "here") == tmp_path / "here"
    assert (tmp_path / "here" / "a.png").is_file()
    download("toy", tmp_path / "there")
    assert len(server.asked) == 1
    (tmp_path / "there" / "a.png").unlink()
    with pytest.raises(DownloadError, match=r"1 of its 3 files .* such as a\.png; delete the folder"):
        download("toy", tmp_path / "there")


@pytest.mark.parametrize("other", ["notes.txt", "download.json"])
def test_a_folder_that_holds_something_else_is_left_alone(server: Server, tmp_path: Path, other: str) -> None:
    (tmp_path / other).write_text("[1]")
    with pytest.raises(ArgumentError, match="expected a new or empty folder"):
        download("toy", tmp_path)
    with pytest.raises(ArgumentError, match="expected a new or empty folder"):
        download("toy", tmp_path / other)
    assert not server.asked


def test_an_unknown_name_is_told_with_those_that_there_are() -> None:
    with pytest.raises(ArgumentError, match=r"templeSparseRing.*got 'temples'"):
        download("temples")


@pytest.mark.parametrize("resumes", [True, False])
def test_a_cut_download_is_taken_up_again(server: Server, resumes: bool) -> None:
    server.resumes, server.cuts = resumes, [100_000, 150_000]
    assert obtain("toy").sha256 == sha256(GOOD)
    assert server.asked[0] is None
    starts = [int(asked[6:-1]) for asked in server.asked[1:] if asked]
    assert len(starts) == 2
    assert 0 < starts[0] <= 100_000
    assert 0 < starts[1] <= starts[0] + 150_000


def test_the_next_run_resumes(server: Server, tmp_path: Path) -> None:
    server.cuts = [70_000] * transfer.ATTEMPTS
    with pytest.raises(DownloadError, match=r"was cut 4 times, \d+ bytes are there; type it again to resume"):
        download("toy")
    assert in_cache(tmp_path) == {"toy.zip.part", "toy.zip.part.version"}
    arrived = (tmp_path / "cache" / "toy.zip.part").stat().st_size
    assert arrived > 200_000
    download("toy")
    assert server.asked[-1] == f"bytes={arrived}-"
    assert in_cache(tmp_path) == {"toy", "toy.zip", "toy.zip.sha256"}


def test_a_part_of_another_version_is_dropped(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    with_unknown_hash(server, monkeypatch)
    server.cuts = [70_000] * transfer.ATTEMPTS
    with pytest.raises(DownloadError):
        download("toy")
    server.content = zipped({**FILES, "toy/more.txt": b"more"})
    assert obtain("toy").sha256 == sha256(server.content)


def test_a_second_run_does_not_write_into_the_same_part(server: Server, tmp_path: Path) -> None:
    if sys.platform == "win32":
        pytest.skip("no locks")
    (tmp_path / "cache").mkdir()
    with (tmp_path / "cache" / "toy.zip.part").open("ab") as file:
        transfer._lock(file, tmp_path)
        with pytest.raises(DownloadError, match="another run"):
            download("toy")
    assert not server.asked


def test_an_archive_that_is_not_the_known_one_is_not_kept(server: Server, tmp_path: Path) -> None:
    server.content = GOOD[:-30_000] + bytes(1) + GOOD[-29_999:]
    with pytest.raises(DownloadError, match=rf"expected SHA-256 {sha256(GOOD)}, got {sha256(server.content)}"):
        download("toy")
    assert in_cache(tmp_path) == set()
    server.content = GOOD
    assert download("toy").is_dir()


def test_a_change_of_an_archive_without_known_hash_is_noticed(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_unknown_hash(server, monkeypatch)
    assert not obtain("toy").checked
    archive, remembered = tmp_path / "cache" / "toy.zip", tmp_path / "cache" / "toy.zip.sha256"
    assert remembered.read_text() == f"{sha256(GOOD)}  toy.zip\n"
    archive.write_bytes(b"damaged on the disk")
    download("toy", tmp_path / "mended")
    assert archive.read_bytes() == GOOD
    archive.unlink()
    server.content = zipped({"toy/a.png": b"other"})
    with pytest.raises(DownloadError, match=r"not what was downloaded before; to take it, delete .*toy\.zip\.sha256"):
        download("toy", tmp_path / "changed")
    assert not (tmp_path / "changed").exists()
    remembered.unlink()
    assert obtain("toy", tmp_path / "changed").sha256 == sha256(server.content)


def test_an_archive_saved_by_hand_is_taken(server: Server, tmp_path: Path) -> None:
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "toy.zip").write_bytes(GOOD)
    assert obtain("toy").sha256 == sha256(GOOD)
    assert not server.asked


def test_no_file_and_no_network_are_told(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DATASETS, "toy", Dataset(f"{server.url}.gone", "a toy", "Nobody"))
    with pytest.raises(DownloadError, match=r"no such file any more \(404\).* Or save http.* as .*toy\.zip"):
        download("toy")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        nobody = f"http://127.0.0.1:{taken.getsockname()[1]}/toy.zip"
        monkeypatch.setitem(DATASETS, "toy", Dataset(nobody, "a toy", "Nobody"))
        with pytest.raises(DownloadError, match=r"no connection to 127\.0\.0\.1 .* check the network"):
            download("toy")
    assert in_cache(tmp_path) == set()


@pytest.mark.parametrize("told", [True, False])
def test_a_file_that_is_too_large_is_given_up(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told: bool
) -> None:
    server.told_length = told
    monkeypatch.setattr(transfer, "MAX_DOWNLOAD", 200_000)
    with pytest.raises(DownloadError, match="at most 200000 bytes"):
        download("toy")
    assert in_cache(tmp_path) == set()


@pytest.mark.usefixtures("server")
def test_a_full_disk_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = type(archives.shutil.disk_usage(tmp_path))
    monkeypatch.setattr(archives.shutil, "disk_usage", lambda _folder: usage(10, 9, 1))
    with pytest.raises(DownloadError, match=r"cache: the disk is full; free space there, or .* RECON3D_CACHE"):
        download("toy")
    assert in_cache(tmp_path) == {"toy.zip", "toy.zip.sha256"}

    def full(*_given: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(downloads, "receive", full)
    (tmp_path / "cache" / "toy.zip").unlink()
    with pytest.raises(DownloadError, match="the disk is full"):
        download("toy")


def test_what_is_no_archive_is_not_kept(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_unknown_hash(server, monkeypatch)
    for content in (b"<html>Sign in</html>", GOOD[:200_000], GOOD[:100_000] + bytes(9) + GOOD[100_009:]):
        server.content = content
        with pytest.raises(DownloadError, match=r"expected a zip archive that is whole.* was removed"):
            download("toy")
        assert in_cache(tmp_path) == set()
    server.content = GOOD
    assert download("toy").is_dir()


def link(name: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name)
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    return info


@pytest.mark.parametrize(
    ("member", "reason"),
    [
        ("/etc/passwd", "absolute"),
        ("C:/x", "absolute"),
        ("c:x", "absolute"),
        ("\\\\host\\share\\x", "absolute"),
        ("../x", "outside"),
        ("toy/../../x", "outside"),
        ("toy\\..\\..\\x", "outside"),
        (link("toy/x"), "link"),
        ("toy/NUL", "device"),
        ("toy/com1.txt", "device"),
        ("toy/aux .png", "device"),
        ("toy/x:stream", "store"),
        ("toy/x.", "store"),
        ("toy//x", "store"),
        ("toy/x\n", "store"),
        ("TOY/A.png", "twice"),
        ("toy/a.png/x", "twice"),
    ],
)
def test_no_member_lands_outside_or_on_another(tmp_path: Path, member: str | zipfile.ZipInfo, reason: str) -> None:
    (tmp_path / "toy.zip").write_bytes(zipped({**FILES, member: b"../outside"}))
    (tmp_path / "in" / "to").mkdir(parents=True)
    with pytest.raises(DownloadError, match=rf"toy\.zip: .*{reason}.*nothing was unpacked"):
        archives.unpack(tmp_path / "toy.zip", tmp_path / "in" / "to", lambda *_step: None)
    assert {path.name for path in tmp_path.rglob("*")} == {"toy.zip", "in", "to"}


@pytest.mark.parametrize(
    ("limit", "value"), [("MAX_UNPACKED", 1_000_000), ("MAX_MEMBERS", 2)], ids=["too large", "too many"]
)
def test_a_bomb_is_not_unpacked(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, value: int
) -> None:
    with_unknown_hash(server, monkeypatch)
    server.content = zipped({f"toy/{n}": bytes(400_000) for n in range(3)})
    assert len(server.content) < 3000
    monkeypatch.setattr(archives, limit, value)
    with pytest.raises(DownloadError, match="got 3 and 1200000"):
        download("toy")
    assert in_cache(tmp_path) == set()


def test_a_member_larger_than_it_says_is_noticed(tmp_path: Path) -> None:
    lying = bytearray(zipped({"toy/0": bytes(400_000)}))
    for at in range(len(lying) - 4):
        if lying[at : at + 4] == (400_000).to_bytes(4, "little"):
            lying[at : at + 4] = (10).to_bytes(4, "little")
    (tmp_path / "toy.zip").write_bytes(lying)
    (tmp_path / "to").mkdir()
    with pytest.raises(DownloadError, match="expected a zip archive that is whole"):
        archives.unpack(tmp_path / "toy.zip", tmp_path / "to", lambda *_step: None)
    assert all(path.stat().st_size <= 10 for path in (tmp_path / "to").rglob("*"))


def test_one_folder_around_all_is_left_out_and_what_macos_adds(tmp_path: Path) -> None:
    archive = tmp_path / "toy.zip"
    for name, files, wanted in [
        ("around", {"toy/": b"", "toy/a/x": b"1", "__MACOSX/toy/._x": b"2"}, {"a/x": 1}),
        ("bare", {"x": b"12", "toy/a": b"1"}, {"x": 2, "toy/a": 1}),
    ]:
        archive.write_bytes(zipped({**files}))
        (tmp_path / name).mkdir()
        assert archives.unpack(archive, tmp_path / name, lambda *_step: None) == wanted
        assert {path.relative_to(tmp_path / name).as_posix() for path in (tmp_path / name).rglob("*.*")} == set()
        assert all((tmp_path / name / path).stat().st_size == size for path, size in wanted.items())


def test_a_run_that_is_killed_while_it_unpacks_leaves_no_half_folder(server: Server, tmp_path: Path) -> None:
    def killed(stage: str, done: int, _total: int) -> None:
        if stage == "unpacking" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        download("toy", tmp_path / "here", progress=killed)
    assert {path.name for path in tmp_path.iterdir()} == {"cache"}
    # One that had no time to tidy up:
    left = tmp_path / ".here.unfinished-abc"
    (left / "toy").mkdir(parents=True)
    os.utime(left, (0, 0))
    download("toy", tmp_path / "here")
    assert {path.name for path in tmp_path.iterdir()} == {"cache", "here"}
    assert len(server.asked) == 1


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Types a command: its exit code, output and errors."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["recon3d", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        return int(ended.value.code or 0), said.out, said.err

    return run


def test_the_command_says_what_to_type_next(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, typed: Callable[..., tuple[int, str, str]]
) -> None:
    with_unknown_hash(server, monkeypatch)
    folder = tmp_path / "my photographs"
    code, text, errors = typed("download", "toy", "--output", folder)
    assert (code, errors) == (0, "")
    assert f"{sha256(GOOD)} (not checked: " in text
    assert f"Next: recon3d reconstruct '{folder}' --output out\n" in text
    assert "already" not in text
    assert "was there already" in typed("download", "toy", "-o", folder)[1]
    monkeypatch.setitem(DATASETS, "toy", Dataset(f"{server.url}.gone", "a toy", "Nobody"))
    (tmp_path / "cache" / "toy.zip").unlink()
    code, text, errors = typed("download", "toy")
    assert (code, text, errors.count("\n")) == (1, "", 1)
    assert errors.startswith("Error: http://")


def test_the_data_sets_are_listed(server: Server, typed: Callable[..., tuple[int, str, str]]) -> None:
    code, text, _ = typed("download")
    assert code == 0
    assert all(name in text for name in DATASETS)
    assert "Cite S. M. Seitz" in text
    assert typed("download", "--list")[1] == text
    assert typed("download", "toy", "--list")[0] == 1
    assert not server.asked
