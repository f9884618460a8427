from __future__ import annotations

import os
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageOps

from recon3d.errors import DataError
from recon3d.io.files import write_image
from recon3d.scene.image_file import ImageFile, read_image
from recon3d.scene.mask import FileMask, Mask
from recon3d.scene.photograph import Photograph
from recon3d.scene.pixel_cache import PIXELS, PixelCache
from recon3d.scene.view import View


def noise(height: int = 24, width: int = 32, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_only_the_header_is_read_until_pixels_are_asked_for(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.png", noise())
    path.write_bytes(path.read_bytes()[:60])  # the header and no pixels
    photograph = Photograph(path)
    assert photograph.size == (32, 24)
    view = View.from_matrices(np.diag([30.0, 30, 1]), np.eye(4), photograph, name="a")
    assert (view.width, view.height, view.has_silhouette) == (32, 24, False)
    with pytest.raises(DataError, match=r"a\.png"):
        view.image  # noqa: B018


def test_pixels_are_those_of_the_file_and_cannot_be_written_to(tmp_path: Path) -> None:
    photograph = Photograph(write_image(tmp_path / "a.png", noise()))
    np.testing.assert_array_equal(photograph.read(), noise())
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), noise())
    assert photograph.read() is photograph.read()
    assert not photograph.read().flags.writeable
    np.testing.assert_array_equal(Photograph(noise()).read(), noise())
    assert not Photograph(noise()).read().flags.writeable


@pytest.mark.parametrize("in_memory", [True, False])
def test_a_pixel_of_a_smaller_photograph_is_the_mean_of_what_it_covers(tmp_path: Path, in_memory: bool) -> None:
    photograph = Photograph(noise() if in_memory else write_image(tmp_path / "a.png", noise()))
    means = noise().reshape(6, 4, 8, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(photograph.read(0.25), means, atol=0.51)
    assert photograph.read(0.25) is photograph.read(0.25)
    assert photograph.read(0.3).shape == (7, 10, 3)


@pytest.mark.parametrize("in_memory", [True, False])
def test_a_shrunk_photograph_has_the_pixels_of_a_smaller_scale(tmp_path: Path, in_memory: bool) -> None:
    photograph = Photograph(noise() if in_memory else write_image(tmp_path / "a.png", noise()))
    shrunk = photograph.shrunk(16, 12)
    assert shrunk.size == (16, 12)
    np.testing.assert_array_equal(shrunk.read(), photograph.read(0.5))
    np.testing.assert_allclose(shrunk.read(0.5), shrunk.shrunk(8, 6).read().astype(float), atol=1)  # rounded twice
    assert shrunk.read() is shrunk.read()
    assert len({photograph.fingerprint(), shrunk.fingerprint(), photograph.shrunk(8, 6).fingerprint()}) == 3
    assert pickle.loads(pickle.dumps(shrunk)) == shrunk != photograph  # noqa: S301 # our own


def test_a_file_that_is_written_again_is_read_again(tmp_path: Path) -> None:
    photograph = Photograph(write_image(tmp_path / "a.png", noise()))
    before = photograph.fingerprint()
    photograph.read()
    write_image(tmp_path / "a.png", noise(seed=1))
    os.utime(tmp_path / "a.png", ns=(1, 1))
    np.testing.assert_array_equal(photograph.read(), noise(seed=1))
    assert photograph.fingerprint() != before


def test_arrays_in_memory_are_told_apart_when_they_are_scaled() -> None:
    first, second = Photograph(noise()), Photograph(noise(seed=1))
    assert (first.read(0.5) != second.read(0.5)).any()
    copy = pickle.loads(pickle.dumps(first))  # noqa: S301
    assert first == copy != second
    np.testing.assert_array_equal(copy.read(0.5), first.read(0.5))


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_photographs_and_masks_are_set_upright(tmp_path: Path, orientation: int, suffix: str) -> None:
    stored = np.zeros((24, 32, 3), np.uint8)
    stored[:8, :16], stored[8:16, 8:] = 255, 200
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / f"a{suffix}"
    Image.fromarray(stored).save(path, exif=exif, **({"quality": 100} if suffix == ".jpg" else {}))
    with Image.open(path) as image:
        upright = np.asarray(ImageOps.exif_transpose(image))
    photograph = Photograph(path)
    assert photograph.size == (upright.shape[1], upright.shape[0])
    np.testing.assert_allclose(photograph.read().astype(int), upright.astype(int), atol=3)
    view = View.from_matrices(np.diag([30.0, 30, 1]), np.eye(4), path, silhouette=path)
    np.testing.assert_array_equal(view.silhouette, upright[..., 0] > 127)
    as_stored = Photograph(path, stored_orientation=True)
    assert as_stored.size == (32, 24)
    np.testing.assert_allclose(as_stored.read().astype(int), stored.astype(int), atol=3)


def test_a_turned_tiff_is_refused_and_an_upright_one_read(tmp_path: Path) -> None:
    path, exif = tmp_path / "a.tif", Image.Exif()
    for exif[0x0112] in (1, 6):
        Image.fromarray(noise()).save(path, exif=exif)
        if exif[0x0112] == 1:
            np.testing.assert_array_equal(Photograph(path).read(), noise())
    with pytest.raises(DataError, match=r"a\.tif: a TIFF that is stored turned is not supported; save it upright"):
        Photograph(path).read()


def test_a_missing_or_unreadable_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nothing\.png: no such image"):
        Photograph(tmp_path / "nothing.png").size  # noqa: B018
    (tmp_path / "text.png").write_text("no image")
    with pytest.raises(DataError, match=r"text\.png: not a readable image"):
        Photograph(tmp_path / "text.png").size  # noqa: B018


def test_photographs_and_masks_of_files_are_values_that_pickle_without_pixels(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.png", noise())
    for value in (Photograph(path), Mask.of(path)):
        value.fingerprint()
        pickled = pickle.dumps(value)
        assert pickle.loads(pickled) == value  # noqa: S301
        assert len(pickled) < 500
    assert len({Photograph(path), Photograph(str(path)), Photograph(path, stored_orientation=True)}) == 2
    assert isinstance(Mask.of(path), FileMask)


def test_fingerprints_tell_bytes_and_arrays_apart(tmp_path: Path) -> None:
    first, copy, other = (
        Photograph(write_image(tmp_path / name, noise(seed=seed)))
        for name, seed in (("a.png", 0), ("b.png", 0), ("c.png", 1))
    )
    assert first.fingerprint() == copy.fingerprint() != other.fingerprint()
    assert Photograph(noise()).fingerprint() == Photograph(noise()).fingerprint()
    assert Photograph(noise()).fingerprint() != Photograph(noise().reshape(32, 24, 3)).fingerprint()


def test_masks_in_memory_come_back_as_they_were() -> None:
    mask = np.random.default_rng(0).random((7, 13)) < 0.5
    held = Mask.of(mask)
    mask_again = pickle.loads(pickle.dumps(held))  # noqa: S301
    assert held == mask_again != Mask.of(~mask)
    view = View.from_matrices(np.diag([30.0, 30, 1]), np.eye(4), noise(7, 13), silhouette=held)
    np.testing.assert_array_equal(view.silhouette, mask)


def test_a_smaller_silhouette_holds_all_that_the_whole_one_holds() -> None:
    mask = np.zeros((24, 32), np.bool_)
    mask[5, 9] = True
    view = View.from_matrices(np.diag([30.0, 30, 1]), np.eye(4), noise(), silhouette=mask)
    found = view.silhouette_at(0.125)
    assert found is not None
    assert np.argwhere(found).tolist() == [[0, 1]]
    assert view.silhouette_at(1) is not None


def test_the_cache_keeps_what_was_asked_for_last_up_to_its_limit() -> None:
    cache = PixelCache(limit=250)
    made: list[int] = []

    def ask(n: int) -> NDArray[np.uint8]:
        def make() -> NDArray[np.uint8]:
            made.append(n)
            return np.full(100, n, np.uint8)

        return cache.get(n, make)

    for n in (1, 2, 1, 3, 1, 2):  # 3 takes the place of 2
        assert (ask(n) == n).all()
        assert cache.held <= 250
    assert made == [1, 2, 3, 2]
    cache.limit = 100
    assert cache.held == 100
    ask(2)
    assert made == [1, 2, 3, 2]
    cache.limit = 0
    assert cache.held == 0
    ask(2)
    assert cache.held == 0
    with pytest.raises(ValueError, match="expected a limit of 0 bytes or more, got -1"):
        cache.limit = -1


def test_an_array_that_was_not_to_be_kept_is_not() -> None:
    cache = PixelCache(limit=1000)
    cache.get("a", lambda: np.zeros(10, np.uint8), keep=False)
    assert cache.held == 0


def test_threads_may_share_the_cache() -> None:
    cache, barrier = PixelCache(limit=500), Barrier(8)

    def work(seed: int) -> bool:
        barrier.wait()
        keys = np.random.default_rng(seed).integers(0, 12, 2000)
        return all((cache.get(int(n), lambda n=n: np.full(100, n, np.uint8)) == n).all() for n in keys)  # type: ignore[misc]

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(work, range(8)))
    assert cache.held == 500


def test_the_process_keeps_a_share_of_its_memory() -> None:
    assert 0 < PIXELS.limit <= 4 * 2**30


def test_smaller_photographs_do_not_leave_the_whole_ones_in_the_cache(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.png", noise(240, 320))
    held = PIXELS.held
    Photograph(path).read(0.1)
    assert PIXELS.held == held + 24 * 32 * 3


def test_a_header_that_does_not_fit_the_pixels_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_image(tmp_path / "a.png", noise())
    file = ImageFile(path)
    assert file.size == (32, 24)
    monkeypatch.setattr(cv2, "imread", lambda *_: noise(25, 32))
    with pytest.raises(DataError, match=r"a\.png: the header says 32x24 pixels, 32x25 were read"):
        file.decode()
