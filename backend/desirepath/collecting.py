"""While much is loaded that stays: Python's garbage collector would look at all of it again and again, and Ctrl-C would
be told as an error of whatever is just being loaded."""

from __future__ import annotations

import contextlib
import gc
import signal
import threading
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def without_collecting() -> Iterator[None]:
    """Nothing is collected in the block (a quarter of what imports take); what is alive after it is never looked at
    again."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.freeze()
            gc.enable()


@contextlib.contextmanager
def ended_by_interrupt() -> Iterator[None]:
    """Ctrl-C ends the process in the block at once and silently: nothing has been begun that would want an end."""
    with _on_interrupt(signal.SIG_DFL):
        yield


@contextlib.contextmanager
def interrupt_raises() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt in the block, as Python begins with: what was begun is ended in order."""
    with _on_interrupt(signal.default_int_handler):
        yield


@contextlib.contextmanager
def _on_interrupt(handler: Any) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():  # where handlers cannot be set
        yield
        return
    before = signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
