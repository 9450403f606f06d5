"""`python -m desirepath.cli.ends_with_parent serve ...`: a `desirepath` command that ends with who started it.

Also where that one is killed with no time for anything: the pipe that it holds to this process's standard input closes.
`--memory=BYTES` before the command bounds its address space.
"""

from __future__ import annotations

import os
import resource
import runpy
import signal
import sys
import threading
import time

GRACE_S = 15.0  # to stop in order; then everything of this session is killed


def _watch() -> None:
    os.read(sys.stdin.fileno(), 1)  # returns when the other end is closed: nobody writes anything
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(GRACE_S)
    os.killpg(os.getpgid(0), signal.SIGKILL)


if __name__ == "__main__":
    if sys.argv[1:2] and sys.argv[1].startswith("--memory="):
        most = int(sys.argv.pop(1).removeprefix("--memory="))
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    threading.Thread(target=_watch, daemon=True).start()
    runpy.run_module("desirepath", run_name="__main__", alter_sys=True)
