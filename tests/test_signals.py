"""What wakes a process that looks after others, and that no signal is missed."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

WAKES = """
import subprocess, sys
from desirepath.collecting import wake_on_signals
with wake_on_signals() as sleep:
    print("ready", flush=True)
    {}
"""


def told(block: str, number: signal.Signals | None = None) -> list[str]:
    """What a process prints that sleeps in the block, given that signal once it is ready."""
    code = WAKES.format(block)
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    if number is not None:
        process.send_signal(number)
    return process.communicate(timeout=60)[0].split()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_ends_is_heeded_however_early_it_comes(number: signal.Signals) -> None:
    assert told("print(sleep(None))", number) == ["True"]
    assert told("import time; time.sleep(1); print(sleep(None))", number) == ["True"]


def test_a_child_that_ends_wakes_and_time_does() -> None:
    block = "child = subprocess.Popen(['true']); print(sleep(None), child.poll(), sleep(0.01))"
    assert told(block) == ["False", "0", "False"]


def test_a_sleep_is_not_ended_by_nothing() -> None:
    began = time.monotonic()
    assert told("print(sleep(0.5))") == ["False"]
    assert time.monotonic() - began >= 0.5
