"""Memory that is free in this process, given back to the system.

The compiler and large arrays leave much that the allocator keeps for later. Long recordings need
it for themselves; within a solve it would be asked for again at once.
"""

import ctypes
from contextlib import suppress


def give_back() -> None:
    """Give it back, where the system's allocator can; some milliseconds."""
    # Other systems have no such function, or no library of that kind.
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
