"""`desirepath benchmark serve`: many participants at once against a server of our own, and every answer counted after.

Each participant is a real HTTP client with its event stream open, and a real websocket through the stage's door that
hears the drives it is to watch. What simulated participants answer lives in `backend/study/simulated/participant.py`.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import ssl
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from uuid import uuid4

import httpx
import msgspec
import numpy as np
import websockets
from sqlalchemy import select

from app import viser_hooks
from backend.commands.loopback import loopback_server
from backend.commands.serve import DEMO_PROTOCOL
from backend.settings import Settings
from backend.store.artefacts import ArtefactStore
from backend.store.database import Database
from backend.store.models import Job, Response, Session, Study
from backend.store.outbox import PARTICIPANT_WAITS, enqueue_job
from backend.store.shipped import register_shipped
from backend.store.snapshots import take_snapshot
from backend.study.links import token_hash
from backend.study.protocol.freezing import freeze
from backend.study.simulated.participant import BUSY_TRIES, any_answer, put_off_s
from backend.study.studies import create_study

MOST_ANSWERS = 15  # the quick protocol's practice pair and 14 more; the next one would start each session's alignment
LEAST_ALIGNED = 3  # one is a learning trial
PACE_S = 20.0  # ours: a person's pair. The shipped drives take 11 to 14 s a pair; starting, changing over and choosing
# take the rest.
AT_LEAST = 50  # ours: fewer participants than this answer so much faster that they are as much work as so many people
DECIDING = 0.5  # ours: share of the pace that lies between a pair's start and its answer
PATIENCE_S = 30.0  # how long the stage may take to tell of a drive
TRIES = 3  # of an answer whose connection broke, always with the same request id, as the page does it
ALIGNMENTS = 3  # queued one behind the other, so that one runs for as long as the participants answer
ALIGNMENT_BEGUN = 0.04  # progress past loading and fitting the reward model: the policy's training runs
ALIGNMENT_PATIENCE_S = 180.0
LOOK_S = 0.5
MIN_PACE_S, MAX_PACE_S = 0.1, 120.0
LOG_LINES = 12  # of the server's log, in an error

CAMERA = viser_hooks.CameraReport(
    wxyz=(1.0, 0.0, 0.0, 0.0),
    position=(0.0, 0.0, 1.0),
    fov=1.0,
    near=0.1,
    far=100.0,
    image_height=600,
    image_width=800,
    look_at=(0.0, 0.0, 0.0),
    up_direction=(0.0, 0.0, 1.0),
)


class ServeBenchmarkError(RuntimeError):
    """An answer was lost or counted twice, or a participant could not go on; says how many and what happened."""


@dataclass
class _Tally:
    """What the participants of one walk saw. `acknowledged`: request id -> (hash of the session's token, step)."""

    sent: int = 0
    acknowledged: dict[str, tuple[str, str]] = field(default_factory=dict)
    pairs: set[str] = field(default_factory=set)  # request ids of answers to pairs of drives
    ack_ms: list[float] = field(default_factory=list)
    stage_ms: list[float] = field(default_factory=list)
    stage_messages: int = 0
    stage_bytes: int = 0
    stream_events: int = 0
    errors: list[str] = field(default_factory=list)


class _Participant:
    """One simulated participant with everything a browser holds open."""

    def __init__(self, client: httpx.AsyncClient, number: int, tally: _Tally) -> None:
        self._client, self._tally = client, tally
        self._random = np.random.default_rng([number, 17])
        self._number = number
        self._token = ""
        self._heard = ""  # what the stage was last told that a page acts upon
        self._news = asyncio.Condition()

    async def walk(self, link: str, answers: int, ready: asyncio.Barrier, offset_s: float, pace_s: float) -> None:
        """Join, wait at the first pair for everybody else, then answer pairs at the pace."""
        told = {"name": "random", "noise": 0.0, "seed": 0, "number": self._number}
        joined = await self._post(f"/join/{link}", {"simulated": True, "language": "en", "oracle": told})
        self._token = joined["token"]
        await self._get(f"/p/{self._token}")  # brings the cookie that the stage's door wants
        state = (await self._get(self._api)).json()
        while not state["step"]["trial"]:
            state = await self._submit(state["step"], any_answer(state["step"], self._random), tell=False)
        async with self._stream(), self._stage(state["stage_url"]):
            await self._until('"type": "show"')
            await ready.wait()
            begin = time.monotonic() + offset_s
            for number in range(answers):
                await asyncio.sleep(max(0.0, begin + number * pace_s - time.monotonic()))
                state = await self._pair(state["step"], begin + (number + DECIDING) * pace_s)

    async def _pair(self, step: dict[str, Any], decide_at: float) -> dict[str, Any]:
        """The way a page goes: start, hear from the stage what plays, tell that it was seen, choose."""
        here = f"{self._api}/trials/{step['key']}"
        asked = time.perf_counter()
        state = await self._post(f"{here}/start", {"request_id": uuid4().hex})
        for drive in ("a", "b"):
            shown = state["step"]["trial"]["playback_id"]
            await self._until(shown)
            self._tally.stage_ms.append((time.perf_counter() - asked) * 1000)
            asked = time.perf_counter()
            state = await self._post(f"{here}/seen", {"drive": drive, "playback_id": shown})
        await asyncio.sleep(max(0.0, decide_at - time.monotonic()))
        answered = await self._submit(state["step"], {"choice": "ab"[int(self._random.integers(2))]}, tell=True)
        await self._get(f"/p/{self._token}/step")
        return answered

    async def _submit(self, step: dict[str, Any], value: dict[str, Any], *, tell: bool) -> dict[str, Any]:
        """Send an answer until it is acknowledged; `tell`: it counts in the figures."""
        request_id = uuid4().hex
        body = {"request_id": request_id, "value": value}
        if tell:
            self._tally.sent += 1
            self._tally.pairs.add(request_id)
        asked = time.perf_counter()
        for left in reversed(range(TRIES)):
            try:
                state = await self._post(f"{self._api}/steps/{step['key']}", body)
                break
            except httpx.TransportError as problem:
                self._tally.errors.append(f"{type(problem).__name__} at {step['key']}")
                if not left:
                    raise
        if tell:
            self._tally.ack_ms.append((time.perf_counter() - asked) * 1000)
        self._tally.acknowledged[request_id] = (token_hash(self._token), step["key"])
        return state

    @property
    def _api(self) -> str:
        return f"/api/session/{self._token}"

    # ---- what a browser holds open -----------------------------------------------------------------------------------

    @contextlib.asynccontextmanager
    async def _stage(self, stage_url: str) -> AsyncIterator[None]:
        origin, _, rest = stage_url.partition("/stage/")
        cookies = "; ".join(f"{cookie.name}={cookie.value}" for cookie in self._client.cookies.jar)
        async with websockets.connect(
            f"ws{origin.removeprefix('http')}/stage/{rest.rstrip('/')}",
            origin=websockets.Origin(origin),
            subprotocols=[websockets.Subprotocol(viser_hooks.SUBPROTOCOL)],
            additional_headers={"Cookie": cookies},
            compression=None,
            max_size=None,
        ) as socket:
            await socket.send(msgspec.msgpack.encode(CAMERA))
            async with _beside(self._hear(socket)):
                yield

    async def _hear(self, socket: websockets.ClientConnection) -> None:
        async for frame in socket:
            if not isinstance(frame, bytes):
                continue
            self._tally.stage_messages += 1
            self._tally.stage_bytes += len(frame)
            async with self._news:
                self._heard += viser_hooks.readable_part(frame).decode("utf-8", "replace")
                self._news.notify_all()

    async def _until(self, words: str) -> None:
        """Wait for the stage to be told that; what came before it is forgotten."""

        async def heard() -> None:
            async with self._news:
                await self._news.wait_for(lambda: words in self._heard)
                self._heard = self._heard.partition(words)[2]

        try:
            await asyncio.wait_for(heard(), PATIENCE_S)
        except TimeoutError:
            raise ServeBenchmarkError(f"the stage was not told {words!r} within {PATIENCE_S:.0f} s") from None

    @contextlib.asynccontextmanager
    async def _stream(self) -> AsyncIterator[None]:
        async with self._client.stream("GET", f"{self._api}/stream", timeout=None) as stream:

            async def read() -> None:
                async for line in stream.aiter_lines():
                    self._tally.stream_events += line.startswith("event:")

            async with _beside(read()):
                yield

    async def _get(self, path: str) -> httpx.Response:
        return await self._answered("GET", path)

    async def _post(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        state: dict[str, Any] = (await self._answered("POST", path, body)).json()
        return state

    async def _answered(self, method: str, path: str, body: dict[str, Any] | None = None) -> httpx.Response:
        """The answer to a request; one that a busy server put off is sent again, as the page does it."""
        response = await self._client.request(method, path, json=body)
        for _ in range(BUSY_TRIES):
            wait_s = put_off_s(response)
            if wait_s is None:
                break
            self._tally.errors.append("put off: the server was busy")
            await asyncio.sleep(wait_s)
            response = await self._client.request(method, path, json=body)
        return _checked(response)


@contextlib.asynccontextmanager
async def _beside(listening: Any) -> AsyncIterator[None]:
    task = asyncio.create_task(listening)
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError, httpx.TransportError, websockets.ConnectionClosed):
            await task


def _checked(response: httpx.Response) -> httpx.Response:
    if response.is_success:
        return response
    asked = response.request.url.path.rsplit("/", 1)[-1]  # the rest of the path holds a token
    raise ServeBenchmarkError(f"the server refused {asked!r} with {response.status_code}: {response.text[:200]}")


# ---- the whole benchmark ---------------------------------------------------------------------------------------------


def usual_pace_s(sessions: int) -> float:
    """Seconds between two answers of one participant, where none are asked for: a person's, or less where there are few
    participants, so that the server has as much to do as with AT_LEAST people."""
    return PACE_S * min(1.0, sessions / AT_LEAST)


def benchmark_serve(
    *, sessions: int = 20, answers: int = 2, pace_s: float | None = None, during_alignment: bool = False
) -> dict[str, Any]:
    """Let `sessions` participants answer `answers` pairs each, all at once, and compare what was stored.

    pace_s: between two answers of one participant; default `usual_pace_s`.

    Returns sessions, answers_sent, answers_acknowledged, answers_stored, p50_ack_ms and p95_ack_ms (from sending an
    answer to its acknowledgement, as the client measures it), p95_stage_ms (from asking for a drive to the stage's
    websocket hearing of it), rss_mb of the server process with everybody connected, rss_per_session_mb,
    server_ms_per_answer (processor time of everything that belongs to one, joining included), what came through the
    stages, and errors: what had to be tried again, connections that broke and requests that a busy server put off.
    during_alignment: the same again with fresh participants while alignments of one core run, under that key; only then
    does a worker run beside the server.
    Raises ServeBenchmarkError if an acknowledged answer is not stored exactly once or a participant could not go on,
    ValueError for numbers that the quick protocol has no room for.
    """
    if sessions < 1:
        raise ValueError(f"sessions = {sessions}: at least 1")
    if not 1 <= answers <= MOST_ANSWERS:
        raise ValueError(
            f"answers = {answers}: 1 to {MOST_ANSWERS}; with one more, every session would start an alignment"
        )
    if during_alignment and answers < LEAST_ALIGNED:
        raise ValueError(f"answers = {answers}: alignments learn from these answers and need at least {LEAST_ALIGNED}")
    pace = usual_pace_s(sessions) if pace_s is None else pace_s
    if not MIN_PACE_S <= pace <= MAX_PACE_S:
        raise ValueError(f"pace = {pace}: {MIN_PACE_S} to {MAX_PACE_S:.0f} s between two answers of one participant")
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="desirepath-benchmark-") as folder:
        # Named here, so that no setting of the surroundings leads to an installation that is in use.
        settings = Settings(data=Path(folder), database_url=None, artefacts_url=None)
        database, files = Database(settings.database), ArtefactStore(settings.artefacts)
        database.migrate()
        with database.transaction() as s:
            register_shipped(s, files)
            study = create_study(s, files, freeze(DEMO_PROTOCOL), name="benchmark serve", created_by=None)
        log = Path(folder) / "server.log"
        try:
            with loopback_server(settings, worker=during_alignment, log=log) as (url, server):
                result = {"sessions": sessions, **_walk(database, url, server.pid, study, sessions, answers, pace)}
                if during_alignment:
                    with _alignments(database, files, study) as running:
                        walked = _walk(database, url, server.pid, study, sessions, answers, pace, running)
                    result["during_alignment"] = walked
        except ServeBenchmarkError as problem:
            raise ServeBenchmarkError(f"{problem}\nThe server's log ends with:\n{_end_of_errors(log)}") from None
        database.close()
    return {**result, "pace_s": pace, "cores": os.cpu_count(), "seconds": round(time.monotonic() - began, 1)}


def _walk(
    database: Database,
    url: str,
    server_pid: int,
    study: Study,
    sessions: int,
    answers: int,
    pace_s: float,
    aligning: Callable[[], bool] | None = None,
) -> dict[str, Any]:
    """One walk of everybody, checked against the database."""
    tally = _Tally()
    memory_before = _resident_mb(server_pid)
    processor_before = _processor_s(server_pid)
    memory, looks, failed = asyncio.run(_walk_all(tally, url, server_pid, study, sessions, answers, pace_s, aligning))
    if failed:
        raise ServeBenchmarkError(f"{len(failed)} of {sessions} participants could not go on; the first: {failed[0]}")
    stored = _stored(database, tally)
    p50, p95 = np.percentile(tally.ack_ms, [50, 95])
    result: dict[str, Any] = {
        "answers_sent": tally.sent,
        "answers_acknowledged": len(tally.ack_ms),
        "answers_stored": stored,
        "p50_ack_ms": round(float(p50), 1),
        "p95_ack_ms": round(float(p95), 1),
        "max_ack_ms": round(max(tally.ack_ms), 1),
        "p95_stage_ms": round(float(np.percentile(tally.stage_ms, 95)), 1),
        "rss_mb": round(memory, 1),
        "rss_per_session_mb": round((memory - memory_before) / sessions, 2),
        "server_ms_per_answer": round((_processor_s(server_pid) - processor_before) * 1000 / tally.sent, 1),
        "stage_messages": tally.stage_messages,
        "stage_mb": round(tally.stage_bytes / 2**20, 2),
        "stream_events": tally.stream_events,
        "errors": tally.errors,
    }
    if aligning is not None:
        share = sum(looks) / len(looks)
        if not share:
            raise ServeBenchmarkError("no alignment was running while the participants answered; see the jobs' logs")
        result["alignment_ran_share"] = round(share, 2)
    return result


async def _walk_all(
    tally: _Tally,
    url: str,
    server_pid: int,
    study: Study,
    sessions: int,
    answers: int,
    pace_s: float,
    aligning: Callable[[], bool] | None,
) -> tuple[float, list[bool], list[str]]:
    """Returns the server's memory with everybody connected (MB), looks at the alignments, and what went wrong."""
    ready = asyncio.Barrier(sessions)
    looks: list[bool] = []
    memory = 0.0
    trust = ssl.create_default_context()  # loading certificates once is enough; nothing here speaks TLS

    async def one(number: int) -> None:
        async with httpx.AsyncClient(base_url=url, timeout=60.0, verify=trust) as client:
            participant = _Participant(client, number, tally)
            try:
                await participant.walk(study.recruiting_token, answers, ready, pace_s * number / sessions, pace_s)
            except BaseException:
                await ready.abort()  # nobody waits for one who will not come
                raise

    async def look() -> None:
        nonlocal memory
        while True:
            if ready.n_waiting == 0 and tally.sent:
                memory = max(memory, _resident_mb(server_pid))
                if aligning is not None:
                    looks.append(await asyncio.to_thread(aligning))
            await asyncio.sleep(LOOK_S)

    async with _beside(look()):
        ended = await asyncio.gather(*(one(number) for number in range(sessions)), return_exceptions=True)
    problems = [problem for problem in ended if isinstance(problem, BaseException)]
    told = [problem for problem in problems if not isinstance(problem, asyncio.BrokenBarrierError)] or problems
    return memory, looks, [f"{type(problem).__name__}: {problem}" for problem in told]


def _stored(database: Database, tally: _Tally) -> int:
    """How many answers to pairs are stored. Raises ServeBenchmarkError for a lost, doubled or misplaced one."""
    hashes = {session for session, _ in tally.acknowledged.values()}
    wanted = (
        select(Response.request_id, Session.token_hash, Response.step_key)
        .join(Session, Session.id == Response.session_id)
        .where(Session.token_hash.in_(hashes))
    )
    with database.session() as s:
        rows = [(request_id, (session, step)) for request_id, session, step in s.execute(wanted)]
    kept = dict(rows)
    lost = sum(kept.get(request_id) != place for request_id, place in tally.acknowledged.items())
    doubled = len(rows) - len({place for _, place in rows})
    foreign = sum(request_id not in tally.acknowledged for request_id in kept)
    if lost or doubled or foreign:
        raise ServeBenchmarkError(
            f"of {len(tally.acknowledged)} acknowledged answers {lost} are not stored where they belong, "
            f"{doubled} are stored twice, {foreign} were stored without being acknowledged"
        )
    return sum(request_id in tally.pairs for request_id in kept)


@contextlib.contextmanager
def _alignments(database: Database, files: ArtefactStore, study: Study) -> Iterator[Callable[[], bool]]:
    """Alignments on one session's answers, one after another; begins when the first one trains.

    Yields a function that says whether one is running. They end with the server.
    """
    with database.transaction() as s:
        session_id = s.scalars(select(Response.session_id).order_by(Response.created_at)).first()
        snapshot = take_snapshot(s, files, session_id=session_id)
        jobs = [
            enqueue_job(
                s,
                "align",
                {"snapshot": snapshot.id, "setup": snapshot.setup, "recipe": "refine", "seed": seed},
                priority=PARTICIPANT_WAITS,
                study_id=study.id,
                session_id=session_id,  # its process gets the priority of one that somebody waits for
                created_by="benchmark",
            ).id
            for seed in range(ALIGNMENTS)
        ]

    def rows() -> list[Job]:
        with database.session() as s:
            return list(s.scalars(select(Job).where(Job.id.in_(jobs))))

    deadline = time.monotonic() + ALIGNMENT_PATIENCE_S
    while not any(job.state == "running" and job.progress > ALIGNMENT_BEGUN for job in rows()):
        failed = [job.error for job in rows() if job.state == "failed"]
        if failed or time.monotonic() > deadline:
            raise ServeBenchmarkError(f"no alignment got going: {failed or 'none began in time'}")
        time.sleep(LOOK_S)
    yield lambda: any(job.state == "running" for job in rows())


def _end_of_errors(log: Path) -> str:
    """The last lines of a server's log that are not about a request that went well."""
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    return "\n".join([line for line in lines if "event='request'" not in line][-LOG_LINES:])


def _resident_mb(pid: int) -> float:
    """Resident memory of a process (Linux)."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    line = next(line for line in status.splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) / 1024


def _processor_s(pid: int) -> float:
    """Processor time that a process has used (Linux)."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
