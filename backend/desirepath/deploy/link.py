"""A robot's line to the server of its study: its policy, what it is to do, where it is. Standard library alone.

`Link` waits for orders and says where the robot is in two threads of its own; whoever drives looks at `orders` and
calls `say` as often as it likes, and is never held up. A lost connection is tried again until the link is closed.
"""

from __future__ import annotations

import http.client
import json
import math
import ssl
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote, urlsplit

from desirepath.deploy.inputs import Odometry, Person, Scan, place_laser

WAIT_S = 20.0  # how long the server may hold a question for orders
PATIENCE_S = 10.0  # beyond that, of any request
SAY_EVERY_S = 0.2
AGAIN_AFTER_S = (0.1, 5.0)  # a lost connection, first and at most
LARGEST_BUNDLE = 64 * 2**20  # bytes
LARGEST_REPLY = 2**20
MOST_SEEN, MOST_PEOPLE, MOST_PLANNED = 120, 20, 40  # of what is said at once
Place = tuple[float, float]


class LinkError(Exception):
    """The server said no, or nothing that is understood. status: HTTP's, 0 where there was no connection."""

    def __init__(self, status: int, message: str) -> None:
        self.status = status
        super().__init__(message)


@dataclass(frozen=True)
class Orders:
    """What the robot is to do. run: what it stands ready for, None: nothing; drive: whether it drives it now;
    participant: whose it is, None: the lab's; goal, person: m in the run's frame (`Frame`); weights: objective ->
    weight, None: the policy's own."""

    number: int = -1
    run: str | None = None
    drive: bool = False
    participant: str | None = None
    setup: str | None = None
    goal: Place | None = None
    person: Place | None = None
    weights: Mapping[str, float] | None = None

    @classmethod
    def read(cls, told: Mapping[str, Any]) -> Orders:
        """From the server's JSON. Raises LinkError for what is none."""
        try:
            weights = told.get("weights")
            return cls(
                number=int(told["number"]),
                run=_text(told.get("run")),
                drive=told["drive"] is True,
                participant=_text(told.get("participant")),
                setup=_text(told.get("setup")),
                goal=_place(told.get("goal")),
                person=_place(told.get("person")),
                weights=None if weights is None else {str(name): float(weight) for name, weight in weights.items()},
            )
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as wrong:
            raise LinkError(0, f"the server's orders cannot be read ({wrong!r})") from None


def _text(value: object) -> str | None:
    return None if value is None else str(value)


def _place(value: Any) -> Place | None:
    if value is None:
        return None
    x, y = float(value[0]), float(value[1])
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError("a place that is not finite")
    return x, y


@dataclass(frozen=True)
class Frame:
    """The run's frame in the odometry's: origin where the robot stood when the run began, x ahead."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    @classmethod
    def at(cls, odometry: Odometry) -> Frame:
        return cls(odometry.x, odometry.y, odometry.yaw)

    def into(self, x: float, y: float) -> Place:
        """A place of the odometry's frame, in this one."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return c * (x - self.x) + s * (y - self.y), -s * (x - self.x) + c * (y - self.y)

    def out_of(self, place: Place) -> Place:
        """A place of this frame, in the odometry's."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + c * place[0] - s * place[1], self.y + s * place[0] + c * place[1]


def describe(
    frame: Frame,
    state: str,
    odometry: Odometry,
    *,
    reason: str = "",
    scan: Scan | None = None,
    laser: tuple[float, float, float] = (0.0, 0.0, 0.0),
    goal: Place | None = None,
    people: Sequence[Person] = (),
    plan: Sequence[Place] = (),
    in_map: Frame | None = None,
    driven_by: tuple[Mapping[str, float], float] | None = None,
) -> dict[str, Any]:
    """What is said of a robot, places in the run's frame. state: off, armed, driving or stopped, and the `reason`;
    goal, people, plan (where it would go): in the odometry's frame; laser: x, y, yaw of the lidar in base; in_map:
    where the odometry's frame is in the map's, where that is known; driven_by: the weights of its last command, and for
    how many seconds it has commanded by them."""
    x, y = frame.into(odometry.x, odometry.y)
    yaw = math.remainder(odometry.yaw - frame.yaw, 2 * math.pi)
    said: dict[str, Any] = {
        "state": state,
        "reason": reason[:120],
        "pose": [round(x, 3), round(y, 3), round(yaw, 3)],
        "speed": [round(odometry.v, 3), round(odometry.w, 3)],
        "scan": [] if scan is None else _hits(scan, laser, (x, y, yaw)),
        "plan": [_rounded(frame.into(*place)) for place in plan[:MOST_PLANNED]],
        "people": [_rounded(frame.into(person.x, person.y)) for person in people[:MOST_PEOPLE]],
    }
    said |= {} if goal is None else {"goal": _rounded(frame.into(*goal))}
    if in_map is not None:
        at_x, at_y = in_map.out_of((frame.x, frame.y))
        said["in_map"] = [*_rounded((at_x, at_y)), round(math.remainder(in_map.yaw + frame.yaw, 2 * math.pi), 3)]
    if driven_by is not None:
        weights, since_s = driven_by
        said |= {"weights": {name: weight for name, weight in weights.items() if weight}, "since_s": round(since_s, 3)}
    return said


def _hits(scan: Scan, laser: tuple[float, float, float], pose: tuple[float, float, float]) -> list[list[float]]:
    """Where beams ended on something, m in the frame of the pose, the nearest of each of `MOST_SEEN` sectors."""
    x, y, yaw = place_laser(pose, laser)
    seen: dict[int, tuple[float, float]] = {}
    for k, reach in enumerate(scan.ranges):
        if math.isfinite(reach) and scan.range_min <= reach <= scan.range_max:
            angle = math.remainder(scan.angle_min + k * scan.angle_increment, 2 * math.pi)
            sector = int((angle + math.pi) / (2 * math.pi) * MOST_SEEN) % MOST_SEEN
            if sector not in seen or reach < seen[sector][0]:
                seen[sector] = float(reach), angle
    return [
        _rounded((x + reach * math.cos(yaw + angle), y + reach * math.sin(yaw + angle)))
        for reach, angle in seen.values()
    ]


def _rounded(place: Place) -> list[float]:
    return [round(place[0], 2), round(place[1], 2)]


@dataclass
class Link:
    """One robot's line. url: of the server's pages; token: as the lab's page *Robots* told it once."""

    url: str
    token: str = field(repr=False)
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        parts = urlsplit(self.url if "//" in self.url else f"https://{self.url}")
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise LinkError(0, f"url = {self.url!r}: must be http(s)://HOST, the address of the server's pages")
        self._secure, self._host, self._port = parts.scheme == "https", parts.hostname, parts.port
        self._base = parts.path.rstrip("/")
        self._lock = threading.Condition()
        self._orders = Orders()
        self._saying: dict[str, Any] | None = None
        self._closing = False
        self._heard: float | None = None
        self.refused: LinkError | None = None
        self._threads: list[threading.Thread] = []

    # ---- asked at once -----------------------------------------------------------------------------------------------

    def about(self) -> dict[str, Any]:
        """Which robot of which study this token is for. Raises LinkError."""
        return dict(json.loads(self._once("GET", "")))

    def bundle(self, participant: str | None = None) -> bytes:
        """The policy of a participant, by code; None: of the run that this robot stands ready for. Raises LinkError."""
        asked = f"?participant={quote(participant)}" if participant else ""
        return self._once("GET", f"/bundle{asked}", largest=LARGEST_BUNDLE)

    def over(
        self, run: str, *, driven_s: float, way_m: float, reached: bool, stops: Sequence[tuple[float, str]] = (),
        recording: bytes | None = None,
    ) -> str | None:  # fmt: skip
        """Say that a run is over and hand in its recording (MCAP); its sha256 as the server keeps it. stops: seconds
        since the run began, and why. Raises LinkError."""
        kept = None
        if recording is not None:
            told = self._once("POST", f"/recording?run={quote(run)}", recording, kind="application/octet-stream")
            kept = str(json.loads(told)["recording"])
        said = [{"at_s": round(max(0.0, at_s), 2), "reason": reason[:120]} for at_s, reason in stops[:200]]
        body = {"run": run, "driven_s": round(driven_s, 2), "way_m": round(way_m, 2), "reached": reached, "stops": said}
        self._once("POST", "/over", json.dumps(body).encode())
        return kept

    # ---- all the while -----------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Begin to listen and to say."""
        self._threads = [
            threading.Thread(target=work, daemon=True, name=f"link-{name}")
            for name, work in (("orders", self._listen), ("says", self._tell))
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop both."""
        with self._lock:
            self._closing = True
            self._lock.notify_all()
        for thread in self._threads:
            thread.join(0.5)  # one may still wait for the server; it ends with the process

    @property
    def orders(self) -> Orders:
        """The newest. Before the first there is no run."""
        return self._orders

    def wait(self, number: int, at_most_s: float) -> Orders:
        """The orders as soon as they have another number, after so many seconds at the latest."""
        with self._lock:
            self._lock.wait_for(lambda: self._closing or self._orders.number != number, at_most_s)
            return self._orders

    @property
    def silent_s(self) -> float:
        """Seconds since the server last answered anything; infinite before it did."""
        return math.inf if self._heard is None else self.clock() - self._heard

    def say(self, said: Mapping[str, Any]) -> None:
        """Where the robot is (`describe`): sent as soon as may be; of several only the newest."""
        with self._lock:
            self._saying = dict(said)
            self._lock.notify_all()

    def _listen(self) -> None:
        with _Line(self) as line:
            while not self._closing:
                asked = f"/orders?after={self._orders.number}&wait={WAIT_S:g}"
                told = self._patiently(lambda asked=asked: line.ask("GET", asked))  # type: ignore[misc]
                if told is None:
                    return
                try:
                    orders = Orders.read(json.loads(told))
                except (LinkError, ValueError) as wrong:
                    self.refused = wrong if isinstance(wrong, LinkError) else LinkError(0, "no JSON")
                    time.sleep(AGAIN_AFTER_S[1])
                    continue
                with self._lock:
                    self._orders = orders
                    self._lock.notify_all()

    def _tell(self) -> None:
        with _Line(self) as line:
            while True:
                with self._lock:
                    self._lock.wait_for(lambda: self._closing or self._saying is not None)
                    said, self._saying = self._saying, None
                if self._closing or said is None:
                    return
                began = self.clock()
                body = json.dumps({**said, "run": self._orders.run}).encode()
                self._patiently(lambda body=body: line.ask("POST", "/state", body), tries=1)  # type: ignore[misc]
                time.sleep(max(0.0, SAY_EVERY_S - (self.clock() - began)))

    def _patiently(self, ask: Callable[[], bytes], tries: int | None = None) -> bytes | None:
        """The answer, however often it takes; None once the link is closed, or after so many tries."""
        wait, most = AGAIN_AFTER_S
        while not self._closing:
            try:
                told = ask()
                self.refused = None
                return told
            except LinkError as problem:
                self.refused = problem
            if tries is not None and (tries := tries - 1) <= 0:
                return None
            time.sleep(wait)
            wait = min(2 * wait, most)
        return None

    def _once(
        self, method: str, path: str, body: bytes | None = None, *, kind: str = "application/json",
        largest: int = LARGEST_REPLY,
    ) -> bytes:  # fmt: skip
        with _Line(self) as line:
            return line.ask(method, path, body, kind=kind, largest=largest)


class _Line:
    """One connection, made again where it was lost."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._open: http.client.HTTPConnection | None = None

    def __enter__(self) -> _Line:
        return self

    def __exit__(self, *_: object) -> None:
        if self._open is not None:
            self._open.close()

    def ask(
        self, method: str, path: str, body: bytes | None = None, *, kind: str = "application/json",
        largest: int = LARGEST_REPLY,
    ) -> bytes:  # fmt: skip
        """The answer's body. Raises LinkError."""
        link = self._link
        kept = self._open is not None
        try:
            answer = self._asked(method, path, body, kind)
            content = answer.read(largest + 1)
        except (OSError, http.client.HTTPException) as lost:
            self.__exit__()
            self._open = None
            if kept and not isinstance(lost, TimeoutError):  # the server had closed what was kept open
                return self.ask(method, path, body, kind=kind, largest=largest)
            raise LinkError(0, f"{link.url} does not answer ({lost})") from None
        link._heard = link.clock()
        if len(content) > largest:
            self.__exit__()
            self._open = None
            raise LinkError(answer.status, f"{path} answers more than {largest} bytes")
        if answer.status >= 400:
            raise LinkError(answer.status, _told(content) or f"{method} {path}: refused ({answer.status})")
        return content

    def _asked(self, method: str, path: str, body: bytes | None, kind: str) -> http.client.HTTPResponse:
        link = self._link
        if self._open is None:
            patience = WAIT_S + PATIENCE_S
            self._open = (
                http.client.HTTPSConnection(
                    link._host, link._port, timeout=patience, context=ssl.create_default_context()
                )
                if link._secure
                else http.client.HTTPConnection(link._host, link._port, timeout=patience)
            )
        headers = {"Authorization": f"Bearer {link.token}"} | ({"Content-Type": kind} if body is not None else {})
        self._open.request(method, f"{link._base}/api/robot{path}", body, headers)
        return self._open.getresponse()


def _told(content: bytes) -> str:
    try:
        return str(json.loads(content)["error"]["message"])
    except (ValueError, KeyError, TypeError):
        return ""
