"""Compiled loops on bare arrays: no checks, no objects.

Each kernel is reached through one checked public function of the modules above.
"""

from collections.abc import Callable
from typing import Any

import numba

from recon3d.kernels.compiled import CodeFiles
from recon3d.kernels.parts import Part, in_parts

# Open3D loads an older TBB than numba asks for; naming the others first keeps numba from warning about it.
numba.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

__all__ = ["Part", "kernel", "span"]


def kernel(*, parallel: bool = False, regrouped: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Compile to machine code that is kept on disk and releases the interpreter lock.

    A parallel kernel takes a ``Part`` of the work before the arguments that its callers give, and its outermost loop
    runs over the ``span`` of that part. It is called once for each of several parts, from as many threads as
    ``numba.get_num_threads()``: numba's own parallel loops take four times as long to compile, and run no faster.

    The sums of a regrouped kernel may be taken in any order, and its products and quotients be rounded together with
    what follows, so that the processor works on several terms at a time. It becomes part of each kernel that calls it:
    of two copies that were compiled with different sums, chance would say which one runs.
    """
    fast = {"reassoc", "contract", "arcp", "nsz"} if regrouped else False

    def compile_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
        compiled = numba.njit(nogil=True, error_model="numpy", fastmath=fast, forceinline=regrouped)(function)
        compiled._cache = CodeFiles(function)
        return in_parts(compiled) if parallel else compiled

    return compile_kernel


@kernel()
def span(part: Part, count: int) -> Any:
    """Range of those of so many passes through a loop that are a part's share."""
    return range(count * part.number // part.of, count * (part.number + 1) // part.of)
