"""A network of others, read and run in a process of its own that may use little memory, time and nothing else.

That process is given what to open it by, a description and the file, then batches of inputs, over its standard input,
and answers over its output. It ends with whoever started it.
"""

from __future__ import annotations

import contextlib
import resource
import struct
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import IO, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.foreign.onnx_bounds import ROWS

Floats = NDArray[np.float32]
Opener = Literal["reward", "policy", "policy_file"]
OPENERS: dict[str, str] = {
    "reward": "desirepath.learning.people.reward_networks:open_reward",
    "policy": "desirepath.learning.policies.foreign_files:open_policy",
    "policy_file": "desirepath.learning.policies.foreign_files:open_policy_file",
}
"""What opens a network there: (description, file) -> `Opened`. It raises ValueError for what it does not read."""
MEMORY_BYTES = 4 * 1024**3  # address space; the runtimes alone take two
CPU_S = 1800  # of all that is asked of one process
START_S = 120.0  # until the network is read, on a busy machine
ANSWER_S = 60.0  # for ROWS steps
PROBLEM, NUMBERS = b"!", b"="


@dataclass(frozen=True)
class Opened:
    """What was opened. told: to whoever asked; run: (n, width) -> (n,) or (n, outputs), None where nothing is run."""

    told: bytes = b""
    width: int = 0
    run: Callable[[Floats], Floats] | None = None


class LimitedNetwork:
    """What a network makes of rows, (n, inputs) -> (n, outputs), asked of a process of its own. told: what was said
    when it was opened. Raises LearningError where the network cannot be read, takes too long or too much memory."""

    def __init__(self, opener: Opener, description: bytes, network: bytes, named: str) -> None:
        self._named = named
        self._one_at_a_time = threading.Lock()
        self._folder = tempfile.TemporaryDirectory(prefix="desirepath-network-")  # empty: relative names lead nowhere
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _ENTRY, str(Path(__file__).resolve().parents[3])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=self._folder.name,
        )
        try:
            self.told = self._ask(opener.encode(), description, network, within_s=START_S)
        except LearningError:
            self.close()
            raise

    def __call__(self, values: Floats) -> Floats:
        if not len(values):
            return np.zeros((0, 1), dtype=np.float32)
        found = []
        for first in range(0, len(values), ROWS):
            rows = values[first : first + ROWS]
            padded = np.zeros((ROWS, values.shape[1]), dtype=np.float32)
            padded[: len(rows)] = rows
            answer = self._ask(padded.tobytes(), within_s=ANSWER_S)
            found.append(np.frombuffer(answer, dtype=np.float32).reshape(ROWS, -1)[: len(rows)])
        return np.concatenate(found)

    def __enter__(self) -> LimitedNetwork:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                cast(IO[bytes], pipe).close()
        self._process.wait()
        self._folder.cleanup()

    def __del__(self) -> None:
        with contextlib.suppress(Exception):
            self.close()

    def _ask(self, *messages: bytes, within_s: float) -> bytes:
        with self._one_at_a_time:
            return self._answer_to(messages, within_s)

    def _answer_to(self, messages: tuple[bytes, ...], within_s: float) -> bytes:
        late = threading.Event()

        def end() -> None:  # whoever waits for the process then meets closed pipes
            late.set()
            self._process.kill()

        timer = threading.Timer(within_s, end)
        timer.daemon = True
        timer.start()
        try:
            for message in messages:
                _send(cast(IO[bytes], self._process.stdin), message)
            answer = _read(self._process.stdout)
        except (OSError, EOFError):
            code = self._process.wait()
            if late.is_set():
                why = f"took longer than {within_s:g} s; give a smaller network"
            else:
                how = f"ended with {code}" if code >= 0 else f"was ended by signal {-code}"
                why = f"{how}; at most {MEMORY_BYTES // 1024**3} GB of memory and {CPU_S} s of a core are given"
            raise LearningError(f"{self._named}: the process that runs it {why}") from None
        finally:
            timer.cancel()
        if answer[:1] == PROBLEM:
            raise LearningError(answer[1:].decode("utf-8", "replace"))
        return answer[1:]


_ENTRY = "import sys; sys.path.insert(0, sys.argv[1]); from desirepath.learning.foreign.limited import main; main()"


def main() -> None:
    """The process: limits first, then what is given."""
    for limit, most in ((resource.RLIMIT_AS, MEMORY_BYTES), (resource.RLIMIT_CPU, CPU_S), (resource.RLIMIT_CORE, 0)):
        resource.setrlimit(limit, (most, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # it writes no file
    given, answers = sys.stdin.buffer, sys.stdout.buffer
    opener, description, content = (_read(given) for _ in range(3))
    try:
        opened: Opened = resolve_name(OPENERS[opener.decode()])(description, content)
    except ValueError as problem:
        _send(answers, PROBLEM + str(problem).encode("utf-8", "replace"))
        return
    except MemoryError:
        _send(answers, PROBLEM + b"the network takes more memory than it is given")
        return
    _send(answers, NUMBERS + opened.told)
    while opened.run is not None:
        try:
            values = np.frombuffer(_read(given), dtype=np.float32).reshape(-1, opened.width)
        except EOFError:
            return
        try:
            _send(answers, NUMBERS + np.asarray(opened.run(values), dtype=np.float32).tobytes())
        except Exception as problem:  # a runtime raises what it likes
            why = (str(problem) or type(problem).__name__).splitlines()[0][:200]
            _send(answers, PROBLEM + f"the network cannot be run: {why}".encode())


def _send(pipe: IO[bytes], message: bytes) -> None:
    pipe.write(struct.pack("<I", len(message)))
    pipe.write(message)
    pipe.flush()


def _read(pipe: Any) -> bytes:
    header = pipe.read(4)
    if len(header) < 4:
        raise EOFError
    (length,) = struct.unpack("<I", header)
    content = pipe.read(length)
    if len(content) < length:
        raise EOFError
    return bytes(content)
