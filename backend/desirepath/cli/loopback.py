"""A server of the command's own on loopback, for commands that walk the real HTTP path (bots, benchmarks)."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx

from desirepath.jobs.process import environment_of
from desirepath.settings import Settings

START_PATIENCE_S = 60.0


def free_port_pair() -> int:
    """A loopback port that is free together with the next one (the stage's)."""
    while True:
        with socket.socket() as first, socket.socket() as second:
            first.bind(("127.0.0.1", 0))
            port = int(first.getsockname()[1])
            try:
                second.bind(("127.0.0.1", port + 1))
            except (OSError, OverflowError):
                continue
            return port


@contextlib.contextmanager
def loopback_server(
    settings: Settings, *, worker: bool = True, log: Path | None = None, arguments: tuple[str, ...] = ()
) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Run `desirepath serve` on free ports over the given data folder; yields its URL and process, stops it after. It
    stops as well when this process is killed.

    Raises RuntimeError with the end of its log if it does not answer within a minute.
    """
    port = free_port_pair()
    environment = environment_of(settings) | {
        "DESIREPATH_WORKER": str(worker).lower(),
        "DESIREPATH_HOST": "127.0.0.1",
        "DESIREPATH_PORT": str(port),
    }
    settings.data.mkdir(mode=0o700, parents=True, exist_ok=True)
    log = log or settings.data / "loopback-server.log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "desirepath.cli.ends_with_parent", "serve", *arguments],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=out,
            stderr=out,
            start_new_session=True,
        )
        url = f"http://127.0.0.1:{port}"
        try:
            _await_answer(url, process, log)
            yield url, process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
                try:
                    process.wait(15)
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
            assert process.stdin is not None  # noqa: S101  a pipe, above
            process.stdin.close()


def _await_answer(url: str, process: subprocess.Popen[bytes], log: Path) -> None:
    deadline = time.monotonic() + START_PATIENCE_S
    with httpx.Client(base_url=url, timeout=2.0, verify=False) as client:  # noqa: S501  plain http on loopback
        while process.poll() is None:
            with contextlib.suppress(httpx.HTTPError):
                if client.get("/health").status_code == 200:
                    return
            if time.monotonic() > deadline:
                raise RuntimeError(
                    f"the server at {url} did not answer within {START_PATIENCE_S:.0f} s: {_end_of(log)}"
                )
            time.sleep(0.02)
    raise RuntimeError(f"the server did not start: {_end_of(log)}")


def _end_of(log: Path) -> str:
    return log.read_text(errors="replace")[-1500:]
