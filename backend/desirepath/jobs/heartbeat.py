"""`python -m desirepath.jobs.heartbeat`: does a worker of this data folder live? Exit code 0 or 1, for containers.

The worker touches a file while its loop goes round; looking at it loads nothing else.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

FILE = "worker.heartbeat"
SILENT_S = 60.0  # ours: a worker may wait for the database for a while, its jobs have heartbeats of their own


def beat(data: Path) -> None:
    """Say that the worker lives; a full disk does not end it."""
    try:
        (data / FILE).touch()
    except OSError:
        return


def silent_s(data: Path) -> float | None:
    """Seconds since the last sign of a worker, None where there never was one."""
    try:
        return max(0.0, time.time() - (data / FILE).stat().st_mtime)
    except OSError:
        return None


if __name__ == "__main__":
    silent = silent_s(Path(os.environ.get("DESIREPATH_DATA", "data")))
    if silent is None or silent > SILENT_S:
        sys.exit("no worker" if silent is None else f"the worker has been silent for {silent:.0f} s")
