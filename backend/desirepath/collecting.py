"""While much is loaded that stays: Python's garbage collector would look at all of it again and again, and Ctrl-C would
be told as an error of whatever is just being loaded. And what else a process does about signals."""

from __future__ import annotations

import contextlib
import gc
import os
import select
import signal
import threading
from collections.abc import Callable, Iterator
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


@contextlib.contextmanager
def wake_on_signals() -> Iterator[Callable[[float | None], bool]]:
    """Yields a sleep, at most for so many seconds, which ends when a child of this process does or SIGINT or SIGTERM
    comes; returns whether one of these two has come."""
    ends = {signal.SIGINT, signal.SIGTERM}
    for number in (*ends, signal.SIGCHLD):
        signal.signal(number, lambda *_: None)
    heard, told = os.pipe()  # Python writes the number of each signal into it
    for end in (heard, told):
        os.set_blocking(end, False)
    signal.set_wakeup_fd(told, warn_on_full_buffer=False)

    def sleep(at_most_s: float | None) -> bool:
        woken = select.select([heard], [], [], at_most_s)[0]
        return bool(woken) and not ends.isdisjoint(os.read(heard, 4_096))

    try:
        yield sleep
    finally:
        signal.set_wakeup_fd(-1)
        os.close(heard)
        os.close(told)
