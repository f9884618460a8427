"""Memory that was freed, given back to the system."""

import ctypes


def give_back() -> None:
    """Give back what the allocator keeps of memory that was freed; does nothing where the C library cannot.

    Of millions of small pieces, as an octree's nodes, glibc keeps all; arrays of numpy would lie beside them.
    """
    try:
        ctypes.CDLL(None).malloc_trim(0)  # glibc
    except (AttributeError, TypeError, OSError):
        return
