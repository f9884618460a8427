"""How much memory a piece of work takes."""

from __future__ import annotations

import gc
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from recon3d.heap import give_back

_SELF = Path("/proc/self")


@dataclass
class PeakMemory:
    """What a block of ``peak_memory`` needed."""

    mib: float | None = None
    """Known once the block has ended."""


@contextmanager
def peak_memory() -> Iterator[PeakMemory]:
    """Memory that a block adds to the process at its highest, in MiB; None where the system cannot say (not Linux).

    The kernel's own high-water mark of the resident set, put back to the present before the block: exact, however
    short the peak is and whoever allocates, numpy, numba or C++. What the allocator keeps of earlier work is
    given back first, or it would hide what the block takes of it; some fragments stay, so figures repeat to some
    10 MiB.
    """
    found = PeakMemory()
    try:
        before = _reset()
    except OSError:
        before = None
    try:
        yield found
    finally:
        if before is not None:
            found.mib = max(_status("VmHWM") - before, 0.0)


def _reset() -> float | None:
    """MiB that are resident now, from where the high-water mark starts anew."""
    if not sys.platform.startswith("linux"):
        return None
    gc.collect()
    give_back()
    (_SELF / "clear_refs").write_text("5")
    return _status("VmRSS")


def _status(name: str) -> float:
    """A size in /proc/self/status, MiB."""
    found = re.search(rf"^{name}:\s+(\d+) kB", (_SELF / "status").read_text(), re.MULTILINE)
    if not found:
        raise OSError(f"{_SELF / 'status'}: expected {name}")
    return int(found[1]) / 1024
