"""Calls mapped over workers and kept by content."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recon3d import tasks
from recon3d.tasks import Arrays, Kept, content_key, threads


class Memory:
    """Checkpoints in a dict."""

    def __init__(self) -> None:
        self.kept: dict[str, tuple[str, Arrays]] = {}

    def read(self, name: str, key: str) -> Arrays | None:
        known, arrays = self.kept.get(name, ("", {}))
        return arrays if known == key else None

    def write(self, name: str, key: str, arrays: Arrays) -> None:
        self.kept[name] = key, arrays


def root(number: float, power: int = 2) -> float:
    if number < 0:
        raise ValueError(f"no root of {number}")
    return float(number ** (1 / power))


def kept_in(store: Memory | None, key: str = "key") -> Kept[float]:
    return Kept(store, key, lambda number: {"number": np.array(number)}, lambda arrays: float(arrays["number"]))


INPUTS = {str(n): (float(n * n),) for n in range(9)}


@pytest.fixture(params=["in turn", "threads", "processes"])
def executor(request: pytest.FixtureRequest) -> Iterator[Executor | None]:
    if request.param == "in turn":
        yield None
    elif request.param == "threads":
        with threads(3) as pool:
            yield pool
    else:
        with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
            yield processes


def test_results_come_in_the_inputs_order_and_are_kept(executor: Executor | None) -> None:
    store, told = Memory(), []
    store.write("4", "key", {"number": np.array(-4.0)})
    store.write("5", "old", {"number": np.array(-5.0)})
    results = tasks.map(
        root, INPUTS, kept=kept_in(store), executor=executor, progress=lambda *progress: told.append(progress)
    )
    assert results == [0, 1, 2, 3, -4, 5, 6, 7, 8]
    assert told == [(n, 9) for n in range(1, 10)]
    assert {name: float(arrays["number"]) for name, (_, arrays) in store.kept.items()} == dict(
        zip(INPUTS, results, strict=True)
    )


def test_what_was_finished_before_an_error_stays() -> None:
    store = Memory()
    with pytest.raises(ValueError, match=r"no root of -1\.0"):
        tasks.map(root, {"good": (4.0,), "bad": (-1.0,), "late": (9.0,)}, kept=kept_in(store))
    assert list(store.kept) == ["good"]


def test_an_error_comes_through_from_workers(executor: Executor | None) -> None:
    with pytest.raises(ValueError, match=r"no root of -1\.0"):
        tasks.map(root, {"bad": (-1.0,), "good": (4.0,)}, executor=executor)


def test_one_call_is_kept_likewise() -> None:
    store = Memory()
    assert tasks.once(root, "root", (27.0, 3), kept=kept_in(store)) == pytest.approx(3)
    assert tasks.once(root, "root", (-1.0,), kept=kept_in(store)) == pytest.approx(3)
    assert tasks.once(root, "root", (16.0,), kept=kept_in(store, "other")) == 4
    assert tasks.once(root, "root", (25.0,), kept=kept_in(None)) == 5


def test_at_least_one_thread_is_wanted() -> None:
    with pytest.raises(ValueError, match="expected at least one thread, got 0"):
        threads(0)


@dataclass(frozen=True)
class Point:
    x: float
    y: float


@dataclass(frozen=True)
class Size:
    x: float
    y: float


def test_a_key_tells_all_of_its_inputs(monkeypatch: pytest.MonkeyPatch) -> None:
    array = np.arange(6)
    different: list[tuple[Any, ...]] = [
        (), (None,), (0,), (False,), (0.0,), ("0",), (b"0",), ((),), ((0,),), ([0, 0],), ((0,), 0), ({},),
        ({"a": 0},), ({"a": 1},), ({"b": 0},), (array,), (array.reshape(2, 3),), (array.astype(np.int32),),
        (array.astype(float),), (Point(0, 1),), (Point(1, 0),), (Size(0, 1),), (Path("0"),), ("ab", "c"), ("a", "bc"),
    ]  # fmt: skip
    keys = [content_key(*inputs) for inputs in different]
    assert len(set(keys)) == len(keys)
    assert keys == [content_key(*inputs) for inputs in different]
    # What is equal has one key, however it came about.
    assert content_key(np.float64(0.5), {"a": 1, "b": 2}) == content_key(0.5, {"b": 2, "a": 1})
    assert content_key(array[::2]) == content_key(array[::2].copy())
    monkeypatch.setattr(tasks, "versions", lambda: {"open3d": "0.0"})
    assert content_key(0) != keys[2]
    monkeypatch.undo()
    monkeypatch.setattr(tasks, "code_fingerprint", lambda: "other code")
    assert content_key(0) != keys[2]


def test_what_cannot_be_told_is_refused() -> None:
    with pytest.raises(TypeError, match="expected an input whose content can be told, got object"):
        content_key([object()])


def test_versions_of_all_that_computes_are_known() -> None:
    assert set(tasks.versions()) == {"numpy", "numba", "scipy", "scikit-image", "opencv", "open3d"}
