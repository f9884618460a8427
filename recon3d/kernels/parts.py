"""Kernels that run in several threads, a part of their work at a time."""

import functools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numba
import numpy as np

_PARTS = 4  # for each thread, since parts take unequally long


class Part(NamedTuple):
    """Which of how many equal shares of a loop."""

    number: int
    of: int


def in_parts(compiled: Callable[..., Any]) -> Callable[..., None]:
    """Callable without the part, which it runs for each part; threads take the next part when they are done with one.

    The calling thread works too, and waits for no other thread to begin.
    """
    codes: dict[Any, Callable[..., Any]] = {}

    @functools.wraps(compiled)
    def run(*arguments: Any) -> None:
        kinds = _kind(arguments)
        code = codes.get(kinds) or codes.setdefault(kinds, _code(compiled, arguments))
        threads = numba.get_num_threads()
        count = _PARTS * threads if threads > 1 else 1
        numbers = iter(range(count))

        def work() -> None:
            for number in numbers:
                code(Part(number, count), *arguments)

        helpers = [_pool().submit(work) for _ in range(threads - 1)]
        try:
            work()
        finally:
            for _ in numbers:  # after an interrupt
                pass
            for helper in helpers:
                if not helper.cancel():
                    helper.result()

    return run


def _kind(value: Any) -> Any:
    """Equal for arguments of equal types. To find those in full takes numba as long as a small part takes."""
    if isinstance(value, np.ndarray):
        flags = value.flags
        return value.dtype, value.ndim, flags.c_contiguous, flags.f_contiguous, flags.writeable, flags.aligned
    return (type(value), *map(_kind, value)) if isinstance(value, tuple) else type(value)


def _code(compiled: Any, arguments: Sequence[Any]) -> Callable[..., Any]:
    """Machine code for a part and arguments of these types."""
    return compiled.compile((numba.typeof(Part(0, 1)), *map(compiled.typeof_pyval, arguments)))


@functools.cache
def _pool() -> ThreadPoolExecutor:
    """Threads that wait for work, all kernels' own."""
    return ThreadPoolExecutor(max(numba.config.NUMBA_NUM_THREADS - 1, 1), thread_name_prefix="recon3d")


# A forked process has none of its parent's threads.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
