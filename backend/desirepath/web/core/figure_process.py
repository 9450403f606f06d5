"""A process of its own that draws figures for the pages, so that no participant's request waits for matplotlib.

It starts with the first figure, draws one after the other at low priority, goes when it has nothing to do for a while,
and ends by itself when the server is gone. What it draws is decided in `backend/desirepath/explain`.

Orders and answers are lines of JSON, files in base64. Figures are kept in memory only: what was drawn from somebody's
answers lies in no file that an erasure would have to find.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import subprocess
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from desirepath.explain.sketches import Sketch, shipped_sketches

if TYPE_CHECKING:
    from desirepath.explain.flow_files import FigureFiles

Made = TypeVar("Made")

MOST_KEPT = 24  # figures; about one MB each
MOST_SKETCHES = 1000  # some kB each
IDLE_S = 300.0  # after that the process gives its memory back (about 300 MB)
LONGEST_S = 120.0  # a figure takes about three; longer than this and something is wrong
MOST_WAITING = 4
MOST_SKETCHES_WAITING = 8  # a browser asks for six at a time
NICENESS = 5  # an analyst waits for it, so before analysts' trainings, but after everything of participants


class FigureError(RuntimeError):
    """A figure that could not be drawn. busy: too many are wanted just now; asking again later helps."""

    def __init__(self, problem: str, *, busy: bool = False) -> None:
        self.busy = busy
        super().__init__(problem)


@dataclass(frozen=True)
class FlowOrder:
    """A flow field of one policy, or of two. policies: (name, file of the policy) each; words: texts by name."""

    policies: tuple[tuple[str, bytes], ...]
    scene_seed: int
    cell_m: float
    words: tuple[tuple[str, str], ...]

    def as_line(self) -> bytes:
        asked = {
            "policies": [[name, base64.b64encode(content).decode()] for name, content in self.policies],
            "scene_seed": self.scene_seed,
            "cell_m": self.cell_m,
            "words": dict(self.words),
        }
        return json.dumps(asked, sort_keys=True).encode() + b"\n"


@dataclass(frozen=True)
class ExplanationOrder:
    """What moved one policy in one scene (`policies explain`). words: texts by name, `things` among them by kind."""

    name: str
    policy: bytes
    scene_seed: int
    method: str
    command: str
    at_s: float | None
    words: Mapping[str, Any]

    def as_line(self) -> bytes:
        asked = {**asdict(self), "explains": True, "policy": base64.b64encode(self.policy).decode()}
        return json.dumps(asked, sort_keys=True).encode() + b"\n"


@dataclass(frozen=True)
class SketchOrder:
    """A policy at a glance. policy: its file."""

    policy: bytes

    def as_line(self) -> bytes:
        return json.dumps({"sketches": True, "policy": base64.b64encode(self.policy).decode()}).encode() + b"\n"


class _Kept(Generic[Made]):
    """The latest of what was drawn, by a mark; one is drawn after the other, and few wait for it."""

    def __init__(self, noun: str, most: int, most_waiting: int, turn: threading.Lock) -> None:
        self._noun, self._most, self._most_waiting, self._turn = noun, most, most_waiting, turn
        self._waiting = threading.BoundedSemaphore(most_waiting)
        self._found: OrderedDict[str, Made] = OrderedDict()

    def find(self, mark: str) -> Made | None:
        return self._found.get(mark)

    def make(self, mark: str, draw: Callable[[], Made]) -> Made:
        """Drawn in its turn, unless somebody before had it drawn. Raises FigureError."""
        if not self._waiting.acquire(blocking=False):
            raise FigureError(f"{self._most_waiting} {self._noun} are being drawn already", busy=True)
        try:
            with self._turn:
                found = self._found.get(mark)
                if found is None:
                    found = draw()
                self._found[mark] = found
                while len(self._found) > self._most:
                    self._found.popitem(last=False)
        finally:
            self._waiting.release()
        return found


class FigureProcess:
    """Draws figures on order and keeps the latest. Methods may be called from any thread and wait for the figure."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._figures: _Kept[FigureFiles] = _Kept("figures", MOST_KEPT, MOST_WAITING, self._turn)
        self._sketches: _Kept[Sketch] = _Kept("sketches", MOST_SKETCHES, MOST_SKETCHES_WAITING, self._turn)
        self.child: subprocess.Popen[bytes] | None = None
        self._idle: threading.Timer | None = None

    def draw(self, order: FlowOrder | ExplanationOrder) -> tuple[str, FigureFiles]:
        """The figure's files and their mark (changes with their content). Raises FigureError."""
        line = order.as_line()
        mark = hashlib.sha256(line).hexdigest()
        return mark, self._figures.find(mark) or self._figures.make(mark, lambda: self._drawn(line))

    def sketch(self, artefact_id: str, read: Callable[[], bytes]) -> Sketch:
        """A policy at a glance, drawn once; read: gives its file, where it has to be. Raises FigureError."""

        def draw() -> Sketch:
            return Sketch.from_json(self._drawn(SketchOrder(read()).as_line()).files["sketch.json"])

        found = shipped_sketches().get(artefact_id) or self._sketches.find(artefact_id)
        return found or self._sketches.make(artefact_id, draw)

    def close(self) -> None:
        """End the process; the next figure starts another."""
        with self._turn:
            self._end()

    def _drawn(self, line: bytes) -> FigureFiles:
        # Imported here, because the process itself begins with this module and needs neither jobs nor database.
        from desirepath.explain.flow_files import FigureFiles
        from desirepath.jobs.process import ONE_THREAD

        if self._idle is not None:
            self._idle.cancel()
        if self.child is None or self.child.poll() is not None:
            self.child = subprocess.Popen(
                [sys.executable, "-m", "desirepath.web.core.figure_process"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, **ONE_THREAD},
            )
        child = self.child
        assert child.stdin is not None  # noqa: S101 - pipes were asked for
        assert child.stdout is not None  # noqa: S101
        watchdog = threading.Timer(LONGEST_S, child.kill)
        watchdog.daemon = True
        watchdog.start()
        try:
            child.stdin.write(line)
            child.stdin.flush()
            answer = child.stdout.readline()
        except OSError:
            answer = b""
        finally:
            watchdog.cancel()
        if not answer.endswith(b"\n"):
            self._end()
            raise FigureError("the drawing process ended without an answer; its reason is in the server's log")
        self._idle = threading.Timer(IDLE_S, self.close)
        self._idle.daemon = True
        self._idle.start()
        answered = json.loads(answer)
        if "problem" in answered:
            raise FigureError(answered["problem"])
        return FigureFiles(
            {name: base64.b64decode(one) for name, one in answered["files"].items()}, answered["numbers"]
        )

    def _end(self) -> None:
        if self.child is not None:
            for pipe in (self.child.stdin, self.child.stdout):
                if pipe is not None:
                    pipe.close()
            self.child.kill()
            self.child.wait()
            self.child = None


def _draw(asked: dict[str, Any]) -> dict[str, Any]:
    """One order carried out, in the process."""
    made = _explained(asked) if asked.get("explains") else _sketched(asked) if asked.get("sketches") else _flow(asked)
    files = {name: base64.b64encode(content).decode() for name, content in made.files.items()}
    return {"files": files, "numbers": dict(made.numbers)}


def _flow(asked: dict[str, Any]) -> FigureFiles:
    from desirepath.explain.flow_files import flow_files
    from desirepath.explain.flow_words import Words
    from desirepath.learning.policies.policy import read_policy
    from desirepath.simulation.scenes import draw_scene
    from desirepath.simulation.setups import get_setup, require_same

    policies = [(name, read_policy(base64.b64decode(content)).driving()) for name, content in asked["policies"]]
    setup = require_same(**{name: policy.setup for name, policy in policies})
    scene = draw_scene(setup, asked["scene_seed"])
    return flow_files(
        [(name, policy.in_scene(scene).rollout_policy) for name, policy in policies],
        get_setup(setup),
        scene,
        cell_m=asked["cell_m"],
        words=Words(**asked["words"]),
    )


def _sketched(asked: dict[str, Any]) -> FigureFiles:
    from desirepath.explain.flow_files import FigureFiles
    from desirepath.explain.sketches import draw_sketch
    from desirepath.learning.policies.policy import read_policy
    from desirepath.study.personalising.live_rollouts import scenes_of

    policy = read_policy(base64.b64decode(asked["policy"])).driving()
    drawn = draw_sketch(policy.rollout_policy, scenes_of(policy.setup)[0])
    return FigureFiles({"sketch.json": drawn.as_json().encode()}, {})


def _explained(asked: dict[str, Any]) -> FigureFiles:
    from desirepath.explain.flow_words import ExplanationWords
    from desirepath.learning.policies.policy import read_policy
    from desirepath.simulation.scenes import draw_scene
    from desirepath.web.core.explained_policy import explain_policy

    policy = read_policy(base64.b64decode(asked["policy"])).driving()
    return explain_policy(
        policy,
        draw_scene(policy.setup, asked["scene_seed"]),
        name=asked["name"],
        method=asked["method"],
        command=asked["command"],
        at_s=asked["at_s"],
        words=ExplanationWords(**asked["words"]),
    )


def _serve() -> None:
    """Carry out the orders on stdin until it closes: that happens when the server ends, however it ends."""
    os.nice(NICENESS)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # whatever a library prints is no answer
    for line in sys.stdin.buffer:
        try:
            answer = _draw(json.loads(line))
        except ValueError as problem:  # errors meant for people: a bad seed or cell size, two setups
            answer = {"problem": str(problem)}
        answers.write(json.dumps(answer).encode() + b"\n")
        answers.flush()


if __name__ == "__main__":
    _serve()
