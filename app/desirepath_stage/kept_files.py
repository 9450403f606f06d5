"""Files that were drawn, kept for who asks next: so many bytes of them, whatever labs bring."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

P = ParamSpec("P")
MIB = 1024**2


def kept(most_bytes: int) -> Callable[[Callable[P, bytes]], Callable[P, bytes]]:
    """Keep what a function of hashable arguments draws; what was asked for longest ago goes first. The newest stays,
    however large."""

    def keeping(draw: Callable[P, bytes]) -> Callable[P, bytes]:
        files: OrderedDict[object, bytes] = OrderedDict()
        lock = threading.Lock()

        @wraps(draw)
        def file(*args: P.args, **named: P.kwargs) -> bytes:
            key = (args, tuple(sorted(named.items())))
            with lock:
                if key in files:
                    files.move_to_end(key)
                    return files[key]
            drawn = draw(*args, **named)
            with lock:
                files[key] = drawn
                while len(files) > 1 and sum(map(len, files.values())) > most_bytes:
                    files.popitem(last=False)
            return drawn

        return file

    return keeping
