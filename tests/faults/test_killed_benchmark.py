"""A command that brought a server of its own along and is killed takes the server, and its worker, with it."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

BRINGS_A_SERVER = """
    import sys, time
    from pathlib import Path
    from desirepath.cli.loopback import loopback_server
    from desirepath.settings import Settings

    settings = Settings(data=Path(sys.argv[1]), database_url=None, artefacts_url=None)
    with loopback_server(settings) as (url, server):
        print(server.pid, flush=True)
        time.sleep(600)
"""


def test_a_killed_command_leaves_no_server_and_no_worker_behind(tmp_path: Path) -> None:
    command = [sys.executable, "-c", textwrap.dedent(BRINGS_A_SERVER), str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as benchmark:
        assert benchmark.stdout is not None
        server = int(benchmark.stdout.readline())
        try:
            while not (worker := children(server)):  # pytest's timeout is the limit
                time.sleep(0.1)
            benchmark.send_signal(signal.SIGKILL)
            while any(alive(one) for one in (server, *worker)):
                time.sleep(0.1)
        finally:
            for one in (server, *children(server)):
                if alive(one):
                    subprocess.run(["kill", "-9", str(one)], check=False)


def children(pid: int) -> list[int]:
    found = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(one) for one in found.read_text().split()] if found.exists() else []


def alive(pid: int) -> bool:
    """Whether the process still runs; one that waits to be reaped does not."""
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"
