"""Frozen values that hold arrays, and values that are made when first asked for."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import fields
from threading import Lock
from typing import Generic, TypeVar

import numpy as np

Value = TypeVar("Value")


class ByContent:
    """Base of frozen dataclasses (``eq=False``) whose fields may be arrays.

    Two are equal where all fields are, arrays by shape, type and elements, NaN being equal to NaN. Of an array only
    shape and type are hashed, so that a hash is quick and stays the same when elements are changed in place. Pickles
    hold the fields alone, not what a property has cached.
    """

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        if type(self) is not type(other):
            return NotImplemented
        return all(_same(getattr(self, name), getattr(other, name)) for name in _names(self))

    def __hash__(self) -> int:
        return hash((type(self), *(_hashable(getattr(self, name)) for name in _names(self))))

    def __getstate__(self) -> dict[str, object]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]


class Once(Generic[Value]):
    """A value that is made when first asked for, once, whichever thread asks; pickled with what was made."""

    def __init__(self) -> None:
        self._lock, self._made = Lock(), list[Value]()

    def get(self, make: Callable[[], Value]) -> Value:
        """The value, made now or before."""
        with self._lock:
            if not self._made:
                self._made.append(make())
            return self._made[0]

    @property
    def is_made(self) -> bool:
        """Whether anyone has asked for it."""
        return bool(self._made)

    def __getstate__(self) -> list[Value]:
        return self._made

    def __setstate__(self, made: list[Value]) -> None:
        self._lock, self._made = Lock(), made


def _names(value: object) -> list[str]:
    return [field.name for field in fields(value) if field.compare]  # type: ignore[arg-type]


def _same(a: object, b: object) -> bool:
    if not (isinstance(a, np.ndarray) and isinstance(b, np.ndarray)):
        return type(a) is type(b) and bool(a == b)
    return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")


def _hashable(value: object) -> Hashable:
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str
    if isinstance(value, Mapping):
        return frozenset(value.items())
    return value
