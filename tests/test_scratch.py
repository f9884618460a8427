"""Values in a temporary file: the same when read, gone with the process, whole when pickled."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from recon3d.errors import NoRoomError
from recon3d.scratch import Scratch, load


@dataclass(frozen=True)
class Sample:
    numbers: NDArray[np.float64]
    mask: NDArray[np.bool_]
    name: str = "sample"


@pytest.fixture
def samples() -> list[Sample]:
    rng = np.random.default_rng(0)
    shapes = [(3, 5), (1000, 7), (0, 4), (2, 3, 4)]
    return [Sample(rng.random(shape), rng.random(shape[::-1]) < 0.5, f"{shape}") for shape in shapes]


def assert_same(found: Sample, given: Sample) -> None:
    assert found.name == given.name
    for name in ("numbers", "mask"):
        a, b = getattr(found, name), getattr(given, name)
        assert (a.dtype, a.shape) == (b.dtype, b.shape)
        np.testing.assert_array_equal(a, b)


def test_values_are_read_as_they_were_kept(samples: list[Sample]) -> None:
    scratch = Scratch()
    stored = [scratch.keep(sample) for sample in samples]
    for each, given in zip(stored, samples, strict=True):
        assert_same(each.read(), given)
        assert_same(load(each), given)
        assert load(given) is given


def test_arrays_that_are_not_contiguous_are_kept(samples: list[Sample]) -> None:
    given = Sample(samples[1].numbers[::3, ::-2], samples[1].mask.T)
    assert_same(Scratch().keep(given).read(), given)


def test_what_was_read_outlives_the_scratch_file(samples: list[Sample]) -> None:
    found = Scratch().keep(samples[1]).read()
    assert_same(found, samples[1])
    with pytest.raises(ValueError, match="read-only"):
        found.numbers[0] = 0


def test_another_process_gets_the_value_itself(samples: list[Sample]) -> None:
    assert_same(pickle.loads(pickle.dumps(Scratch().keep(samples[1]))), samples[1])  # noqa: S301 # our own


def test_a_full_disk_is_told_with_the_way_out(samples: list[Sample], monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def seek(self, _place: int) -> None: ...

        def write(self, _content: memoryview) -> int:
            raise OSError(28, "No space left on device")

    scratch = Scratch()
    monkeypatch.setattr(scratch, "_file", Full())
    with pytest.raises(NoRoomError, match=r"No space left on device.*TMPDIR"):
        scratch.keep(samples[0])
