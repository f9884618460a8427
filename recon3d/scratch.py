"""Values whose arrays lie in a temporary file and are mapped into memory while they are used."""

from __future__ import annotations

import mmap
import tempfile
import weakref
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from threading import Lock
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import NoRoomError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")


class Scratch:
    """A temporary file for values that need not be in memory all at once.

    It lies where ``tempfile.gettempdir()`` says, and has no name, so that nothing is left of it however the process
    ends. Its room is free again once neither it nor a value in it is used any more.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 # closed on the next line
        weakref.finalize(self, self._file.close)
        self._end, self._lock = 0, Lock()

    def keep(self, value: T) -> Stored[T]:
        """Write the arrays of a dataclass to the file; what else it holds stays in memory.

        Raises
        ------
        NoRoomError : the file cannot grow.
        """
        arrays = {each.name: getattr(value, each.name) for each in fields(value)}
        places = {name: self.write(array) for name, array in arrays.items() if isinstance(array, np.ndarray)}
        return Stored(self, replace(value, **dict.fromkeys(places)), places)

    def write(self, array: NDArray[Any]) -> Place:
        """Append an array, of any shape."""
        content = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
        with self._lock:
            place = Place(self._end, array.shape, array.dtype)
            try:
                self._file.seek(place.start)
                written = 0
                while written < len(content):
                    written += self._file.write(content[written:])
            except OSError as error:
                raise NoRoomError(
                    f"{tempfile.gettempdir()}: {error.strerror} while {(self._end + array.nbytes) / 2**30:.1f} GiB of "
                    "temporary files were written; name a folder with more room in the environment's TMPDIR"
                ) from None
            self._end += -(-array.nbytes // mmap.ALLOCATIONGRANULARITY) * mmap.ALLOCATIONGRANULARITY
        return place

    def read(self, place: Place) -> NDArray[Any]:
        """Read-only array of a place, of any shape, mapped for as long as it is used."""
        size = int(np.prod(place.shape)) * place.kind.itemsize
        if not size:
            return np.empty(place.shape, place.kind)
        mapped = mmap.mmap(self._file.fileno(), size, access=mmap.ACCESS_READ, offset=place.start)
        return np.frombuffer(mapped, place.kind).reshape(place.shape)


class Place(NamedTuple):
    """Where in the file an array lies."""

    start: int
    """Byte."""
    shape: tuple[int, ...]
    kind: np.dtype[Any]


@dataclass(frozen=True, eq=False)
class Stored(Generic[T]):
    """A value in a scratch file; what is unpickled of it is the value itself, in memory."""

    _scratch: Scratch
    _rest: T
    _places: dict[str, Place]

    def read(self) -> T:
        """The value, whose arrays are read-only and mapped for as long as they are used."""
        return replace(self._rest, **{name: self._scratch.read(place) for name, place in self._places.items()})

    def with_changed(self, **arrays: NDArray[Any]) -> Stored[T]:
        """The value with other arrays of any shape, by the names of their fields; the rest is not written again."""
        places = {name: self._scratch.write(array) for name, array in arrays.items()}
        return replace(self, _places=self._places | places)

    def __reduce__(self) -> tuple[Callable[[T], T], tuple[T]]:
        return load, (self.read(),)


def load(value: T | Stored[T]) -> T:
    """A value in memory, or read from a scratch file."""
    return value.read() if isinstance(value, Stored) else value
