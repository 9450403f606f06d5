"""A server that has freed its memory does not keep it: many threads that compute now and then, as a server's do."""

from __future__ import annotations

import asyncio
import subprocess
import sys

import pytest

from desirepath import freed_memory
from desirepath.web import server

# Threads that each make, by turns, much that goes again and a little that stays, as answers to requests do: what stays
# lies between what was freed. Prints the megabytes that are held beyond what stays.
WORK = """
import platform, sys, threading
from desirepath import freed_memory
from desirepath_experiments.benchmarks.processes import resident_mb
import os
if platform.libc_ver()[0] != "glibc":
    sys.exit(77)
if "mended" in sys.argv:
    freed_memory.share_arenas()
kept = []
def work():
    passing = []
    for _ in range(400):
        passing.append(bytearray(100_000))
        kept.append(bytearray(2_000))
    going_on.wait()
going_on = threading.Barrier(17)
before = resident_mb(os.getpid())
threads = [threading.Thread(target=work) for _ in range(16)]
for thread in threads:
    thread.start()
going_on.wait()
for thread in threads:
    thread.join()
if "mended" in sys.argv:
    freed_memory.give_back()
print(resident_mb(os.getpid()) - before)
"""


def held_mb(*said: str) -> float:
    ended = subprocess.run([sys.executable, "-c", WORK, *said], capture_output=True, text=True, check=False)
    if ended.returncode == 77:
        pytest.skip("another C library than glibc")
    assert ended.returncode == 0, ended.stderr
    return float(ended.stdout)


def test_a_server_gives_back_now_and_then_until_it_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[int] = []
    monkeypatch.setattr(freed_memory, "EVERY_S", 0.001)

    async def serve() -> None:
        stopping = asyncio.Event()
        monkeypatch.setattr(freed_memory, "give_back", lambda: (given.append(1), len(given) > 3 and stopping.set()))
        await asyncio.wait_for(server._keep_giving_back(stopping), 10)

    asyncio.run(serve())
    assert len(given) >= 4


def test_what_many_threads_freed_is_given_back() -> None:
    assert held_mb() > 300, "without it the 640 MB that were freed stay for the most part"
    assert held_mb("mended") < 60
