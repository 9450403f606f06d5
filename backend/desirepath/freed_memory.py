"""Memory that was freed and that the C library keeps all the same: for processes that serve for weeks, less of it.

glibc gives every few threads an arena of their own and gives nothing back that lies below something still in use. With
some forty threads that each compute now and then, every arena comes to its own peak sooner or later, and a server grows
for hours though nothing leaks.
"""

from __future__ import annotations

import ctypes
import functools
from typing import Any

ARENAS = 2  # ours: whoever computes in Python holds the interpreter's lock anyway, so that few ever wait for each other
EVERY_S = 30.0  # ours: some milliseconds each
_M_ARENA_MAX = -8  # as in malloc.h


def share_arenas() -> None:
    """All threads that begin from now on share `ARENAS` arenas. For the beginning of a process; elsewhere than on glibc
    nothing happens."""
    if hasattr(_c_library(), "mallopt"):
        _c_library().mallopt(_M_ARENA_MAX, ARENAS)


def give_back() -> None:
    """Give whole pages that nobody uses back to the system, also those below something in use."""
    if hasattr(_c_library(), "malloc_trim"):
        _c_library().malloc_trim(0)


@functools.cache
def _c_library() -> Any:
    return ctypes.CDLL(None)  # what this process runs with; a call lets other threads go on
