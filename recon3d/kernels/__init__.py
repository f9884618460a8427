"""Compiled loops on bare arrays: no checks, no objects.

Each kernel is reached through one checked public function of the modules above.
"""

from collections.abc import Callable
from typing import Any

import numba

# Open3D loads an older TBB than numba asks for; naming the others first keeps numba from warning about it.
numba.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]


def kernel(*, parallel: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Compile to machine code that is cached on disk and releases the interpreter lock."""
    compiled: Callable[[Callable[..., Any]], Callable[..., Any]] = numba.njit(
        cache=True, nogil=True, parallel=parallel, error_model="numpy"
    )
    return compiled
