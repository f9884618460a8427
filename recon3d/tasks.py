"""Work in steps: mapped over views or trials, and kept by the content of its inputs, so that a run resumes."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import ArgumentError

Progress = Callable[[int, int], None]
"""Called with the steps that are done and how many there are."""

StageProgress = Callable[[str, int, int], None]
"""Called with a stage's name, the steps of it that are done, and how many there are."""


_COMPUTING = {
    "numpy": ("numpy",),
    "numba": ("numba",),
    "scipy": ("scipy",),
    "scikit-image": ("scikit-image",),
    "opencv": ("opencv-python-headless", "opencv-python"),
    "open3d": ("open3d-cpu", "open3d"),
}
"""Packages, and the names under which they may be installed."""


Arrays = Mapping[str, NDArray[Any]]
"""Arrays by name."""


_T = TypeVar("_T")


_H = TypeVar("_H")


class Store(Protocol):
    """Where results stay, such as ``recon3d.io.Checkpoints``."""

    def read(self, name: str, key: str) -> Arrays | None:
        """Arrays of that name, if they were written with that key; else None."""

    def write(self, name: str, key: str, arrays: Arrays) -> None:
        """Keep arrays under a name, instead of what was there."""


@dataclass(frozen=True)
class Kept(Generic[_T]):
    """How results of one kind are kept."""

    store: Store | None
    """None: nothing is kept."""
    key: str
    """``content_key`` of all that the results depend on."""
    pack: Callable[[_T], Arrays]
    """Arrays of a result."""
    restore: Callable[..., _T]
    """A result of its arrays."""

    def find(self, name: str) -> _T | None:
        """What is kept of a name."""
        found = None if self.store is None else self.store.read(name, self.key)
        return None if found is None else self.restore(found)

    def put(self, name: str, result: _T) -> None:
        """Keep a result."""
        if self.store is not None:
            self.store.write(name, self.key, self.pack(result))


def map(  # noqa: A001 # the package's one way to map
    function: Callable[..., _T],
    inputs: Mapping[str, tuple[Any, ...]],
    *,
    kept: Kept[_T] | None = None,
    held: Callable[[_T], _H] = lambda result: result,  # type: ignore[assignment,return-value]
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> list[_H]:
    """Results of a function of named inputs, in their order; those that are kept are not made again.

    Parameters
    ----------
    function : pure: it depends on its arguments alone and changes none of them. An executor of other processes wants
        it, its arguments and its results to pickle.
    inputs : arguments by the name that the result is kept under.
    held : makes of each result, once it is there, what is returned in its place, such as ``Scratch.keep``.
    executor : runs the calls: ``threads``, or any other with the interface of ``concurrent.futures``, such as Dask's
        ``Client.get_executor()``. The results are the same. In turn, in this thread, when None.
    progress : called after each result.
    """
    report = progress or (lambda _done, _total: None)
    results: dict[str, _H] = {}
    for name in inputs:
        if kept is not None and (found := kept.find(name)) is not None:
            results[name] = held(found)
    if results:
        report(len(results), len(inputs))
    missing = {name: given for name, given in inputs.items() if name not in results}
    for name, result in _computed(function, missing, executor):
        results[name] = held(result)
        if kept is not None:
            kept.put(name, result)
        report(len(results), len(inputs))
    return [results[name] for name in inputs]


def once(
    function: Callable[..., _T], name: str, arguments: tuple[Any, ...] = (), *, kept: Kept[_T] | None = None
) -> _T:
    """Result of one call, unless it is kept already."""
    return map(function, {name: arguments}, kept=kept)[0]


def _computed(
    function: Callable[..., _T], inputs: Mapping[str, tuple[Any, ...]], executor: Executor | None
) -> Iterable[tuple[str, _T]]:
    """Names and results as they are finished."""
    if executor is None:
        yield from ((name, function(*arguments)) for name, arguments in inputs.items())
        return
    futures: dict[Future[_T], str] = {executor.submit(function, *given): name for name, given in inputs.items()}
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:  # after an error or an interrupt the others need not begin
        for future in futures:
            future.cancel()


def threads(n: int) -> ThreadPoolExecutor:
    """Executor of n threads for ``map``, among which the cores for compiled loops are divided."""
    if n < 1:
        raise ArgumentError(f"expected at least one thread, got {n}")
    share = max(1, numba.get_num_threads() // n)
    return ThreadPoolExecutor(n, initializer=numba.set_num_threads, initargs=(share,))


def content_key(*inputs: object) -> str:
    """Text that differs where any of the inputs does, or what computes: the package's code, numba, NumPy and Open3D.

    Parameters
    ----------
    inputs : arrays, numbers, texts, None, dataclasses, objects with a ``fingerprint()``, and collections of these.

    Raises
    ------
    TypeError : the content of an input cannot be told.
    """
    digest = hashlib.sha256(repr((code_fingerprint(), sorted(versions().items()))).encode())
    for given in inputs:
        _feed(digest, given)
    return digest.hexdigest()


def _feed(digest: Any, given: Any) -> None:
    """Add the content of a value to a digest, each part with its kind and length."""
    if isinstance(given, np.generic):
        given = given.item()
    if given is None or isinstance(given, bool | int | float | str | bytes):
        digest.update(f"{type(given).__name__} {given!r};".encode())
    elif isinstance(given, os.PathLike):
        digest.update(f"path {os.fspath(given)!r};".encode())
    elif isinstance(given, np.ndarray):
        digest.update(f"array {given.dtype.str} {given.shape};".encode())
        digest.update(np.ascontiguousarray(given).data)
    elif isinstance(given, Mapping):
        digest.update(f"mapping {len(given)};".encode())
        for name in sorted(given):
            _feed(digest, name)
            _feed(digest, given[name])
    elif isinstance(given, list | tuple):
        digest.update(f"sequence {len(given)};".encode())
        for part in given:
            _feed(digest, part)
    elif hasattr(given, "fingerprint"):
        digest.update(f"{type(given).__qualname__} {given.fingerprint()};".encode())
    elif is_dataclass(given) and not isinstance(given, type):
        digest.update(f"{type(given).__qualname__};".encode())
        _feed(digest, {field.name: getattr(given, field.name) for field in fields(given)})
    else:
        raise TypeError(f"expected an input whose content can be told, got {type(given).__qualname__}")


@cache
def code_fingerprint() -> str:
    """Text that changes with the package's source: what other code has made is made again."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()


@cache
def versions() -> dict[str, str]:
    """Versions of the packages that compute."""
    found = {}
    for name, distributions in _COMPUTING.items():
        for distribution in distributions:
            try:
                found[name] = version(distribution)
                break
            except PackageNotFoundError:
                pass
    return found
