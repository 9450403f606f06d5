"""Keeps trajectories, models and snapshots as files named by the sha256 of their content, each with its row.

Here live the file store, saving and loading, and lineage. What a snapshot or a query set holds lives in the modules of
those names. Nothing here unpickles.
"""

from __future__ import annotations

import hashlib
import os
import re
import uuid
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from fsspec.implementations.local import LocalFileSystem
from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.simulation.trajectory import Trajectory
from desirepath.store.models import Artefact, ArtefactAnswer, ArtefactParent, Participant, Response, TrajectoryRow
from desirepath.store.models import Session as SessionRow
from desirepath.store.places import explain_errors, file_system_of

ARTEFACT_KINDS = (
    "policy",
    "conditioned_policy",
    "adaptable_policy",
    "attention_policy",
    "depth_controller",
    "reward_model",
    "query_set",
    "ranking_set",
    "snapshot",
    "demonstrations",
    "evaluation",
    "video",
)
SYNC_ALL_FROM = 8  # files; measured: about 20 ms a file one by one on a busy disk
MOST_ASKED = 500  # ids of one question to the database; SQLite and PostgreSQL take thousands
D = TypeVar("D")
SHA256 = re.compile(r"[0-9a-f]{64}")
QUARANTINED = "answers it was made from were erased or withdrawn; make it again from a new snapshot"


class ArtefactError(ValueError):
    """An artefact that is unknown, missing, damaged, quarantined or of the wrong kind."""


class ArtefactStore:
    """Content-addressed files below one fsspec URL (`file:///...`, `s3://...`): same bytes, same name, stored once.

    Nothing half-written can be read: on a local disk a file is written beside and renamed, an S3 store shows an object
    once all of it has arrived. Every method raises StorageError that names the store where that does not answer.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self._fs, root = file_system_of(url)
        self._is_local = isinstance(self._fs, LocalFileSystem)
        self._root = str(root).rstrip("/")
        self._derived: dict[type[Any], Any] = {}

    def derive(self, of: type[D]) -> D:
        """This store's one object of that class, which remembers in this process what was computed from its files."""
        if of not in self._derived:
            self._derived.setdefault(of, of())  # one, whichever thread was first
        derived: D = self._derived[of]
        return derived

    def put(self, content: bytes) -> str:
        """Store `content` and return its sha256. On a local disk it has reached the disk when this returns."""
        return self.put_all([content])[0]

    def put_all(self, contents: Iterable[bytes]) -> list[str]:
        """Store many at once, which on a local disk is far faster than one by one: it waits for the disk once."""
        named = [(hashlib.sha256(content).hexdigest(), content) for content in contents]
        with explain_errors(self.url):
            new = {
                self._path(sha): content
                for sha, content in named
                if not (self._fs.exists(self._path(sha)) and self._fs.size(self._path(sha)) == len(content))
            }
            if self._is_local:
                _write_durably({Path(path): content for path, content in new.items()})
            elif new:
                self._fs.pipe(new)
        return [sha for sha, _ in named]

    def get(self, sha: str) -> bytes:
        """The content of that name. Raises ArtefactError if it is not there or is not what its name says."""
        try:
            with explain_errors(self.url):
                content: bytes = self._fs.cat_file(self._path(sha))
        except FileNotFoundError:
            raise ArtefactError(f"file {sha} is not in the artefact store {self.url}") from None
        if hashlib.sha256(content).hexdigest() != sha:
            raise ArtefactError(f"file {sha} in the artefact store is damaged (its sha256 differs); restore a backup")
        return content

    def size(self, sha: str) -> int:
        """Bytes of the file. Raises ArtefactError if it is not there."""
        try:
            with explain_errors(self.url):
                return int(self._fs.size(self._path(sha)))
        except FileNotFoundError:
            raise ArtefactError(f"file {sha} is not in the artefact store {self.url}") from None

    def part(self, sha: str, first: int, end: int) -> bytes:
        """The bytes from `first` until before `end`, of a file too large to be read as a whole; not checked by its
        name. Raises ArtefactError if it is not there."""
        try:
            with explain_errors(self.url):
                content: bytes = self._fs.cat_file(self._path(sha), start=first, end=end)
        except FileNotFoundError:
            raise ArtefactError(f"file {sha} is not in the artefact store {self.url}") from None
        return content

    def exists(self, sha: str) -> bool:
        path = self._path(sha)
        if self._is_local:
            return os.path.exists(path)  # noqa: PTH110  of hundreds at a time; fsspec takes five times as long
        with explain_errors(self.url):
            return bool(self._fs.exists(path))

    def delete(self, sha: str) -> None:
        """Remove the file; nothing happens if there is none."""
        with explain_errors(self.url):
            if self._fs.exists(self._path(sha)):
                self._fs.rm_file(self._path(sha))

    def names(self) -> Iterator[str]:
        """The sha256 of every file, sorted."""
        with explain_errors(self.url):
            paths = self._fs.find(self._root) if self._fs.exists(self._root) else []
        names = (str(path).rsplit("/", 1)[-1] for path in paths)
        yield from sorted(name for name in names if SHA256.fullmatch(name))

    def age_s(self, sha: str, now: float) -> float:
        """Seconds from the file's last change to `now` (Unix time)."""
        with explain_errors(self.url):
            return now - float(self._fs.modified(self._path(sha)).timestamp())

    def link_to(self, sha: str, file_name: str, *, seconds: int) -> str | None:
        """A signed address at which anybody may fetch that file for so long, under that name; None for a local disk."""
        if self._is_local:
            return None
        with explain_errors(self.url):
            quoted = f'attachment; filename="{file_name}"'
            return str(self._fs.sign(self._path(sha), expiration=seconds, ResponseContentDisposition=quoted))

    def _path(self, sha: str) -> str:
        if not SHA256.fullmatch(sha):  # also keeps ids from requests out of path names
            raise ArtefactError(f"{sha!r} is no sha256 (64 characters of 0-9a-f)")
        return f"{self._root}/{sha[:2]}/{sha}"


def _write_durably(contents: dict[Path, bytes]) -> None:
    """Write to temporary names, sync, rename, sync the folders: a crash leaves a whole file or none."""
    temporary = {path: path.with_name(f".{path.name}.{uuid.uuid4().hex}") for path in contents}
    try:
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary[path].write_bytes(content)
        _sync(temporary.values())
        for path in contents:
            temporary[path].replace(path)
        _sync({path.parent for path in contents})
    finally:
        for left in temporary.values():
            left.unlink(missing_ok=True)


def _sync(paths: Collection[Path]) -> None:
    """Wait until these files or folders are on the disk; for many, one sync of everything is faster."""
    if len(paths) > SYNC_ALL_FROM:
        os.sync()
        return
    for path in paths:
        opened = os.open(path, os.O_RDONLY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


def save_trajectory(
    s: Session, files: ArtefactStore, trajectory: Trajectory, made_by: str | None = None
) -> TrajectoryRow:
    """Store a trajectory once; saving it again returns the row there is. made_by: artefact id of the policy."""
    return save_trajectories(s, files, [trajectory], made_by)[0]


def save_trajectories(
    s: Session, files: ArtefactStore, trajectories: Sequence[Trajectory], made_by: str | None = None
) -> list[TrajectoryRow]:
    """`save_trajectory` for many at once, faster; rows in the order given.

    Raises ArtefactError if the policy that made them was erased or quarantined meanwhile: they would be all that is
    left of somebody's answers.
    """
    if made_by is not None and SHA256.fullmatch(made_by):
        _require(s, made_by, f"policy {made_by} of {len(trajectories)} trajectories")  # before a file is written
    ids = files.put_all(t.to_bytes() for t in trajectories)
    there = _stored_trajectories(s, ids)
    rows: list[TrajectoryRow] = []
    for sha, trajectory in zip(ids, trajectories, strict=True):
        row = there.get(sha)
        if row is None:
            row = TrajectoryRow(
                id=sha,
                setup=trajectory.scene.setup,
                scene_hash=trajectory.scene.digest(),
                steps=len(trajectory.actions),
                duration_s=trajectory.duration_s,
                outcome=int(trajectory.outcome),
                made_by=trajectory.recorded.maker if trajectory.recorded else made_by,
            )
            s.add(row)
            there[sha] = row
        rows.append(row)
    s.flush()
    return rows


def _stored_trajectories(s: Session, ids: Sequence[str]) -> dict[str, TrajectoryRow]:
    """Those of these ids that there are, by id."""
    parts = (ids[first : first + MOST_ASKED] for first in range(0, len(ids), MOST_ASKED))
    asked = (select(TrajectoryRow).where(TrajectoryRow.id.in_(part)) for part in parts)
    return {row.id: row for several in asked for row in s.scalars(several)}


def query_entry(a: TrajectoryRow, b: TrajectoryRow) -> dict[str, Any]:
    """A query as cards have it: where its trajectories lie."""
    return {
        "id": hashlib.sha256(f"{a.id}{b.id}".encode()).hexdigest(),  # Query.digest(), without compressing again
        "setup": a.setup,
        "scene_hash": a.scene_hash,
        "trajectory_a": a.id,
        "trajectory_b": b.id,
        "duration_a_s": a.duration_s,
        "duration_b_s": b.duration_s,
    }


def load_trajectory(files: ArtefactStore, trajectory_id: str) -> Trajectory:
    """Read a stored trajectory. Raises ArtefactError if it is missing or damaged."""
    return Trajectory.from_bytes(files.get(trajectory_id))


def save_artefact(
    s: Session,
    files: ArtefactStore,
    *,
    kind: str,
    name: str,
    setup: str,
    content: bytes,
    card: dict[str, Any],
    parents: Iterable[tuple[str, str]] = (),
    answers: Iterable[str] = (),
    study_id: str | None = None,
    job_id: str | None = None,
    simulated: bool = False,
) -> Artefact:
    """Store content with its card and lineage; the same content again returns the row there is, lineage added up.

    parents: (artefact id, role) it was made from. answers: response ids it was made from. The mark `simulated` is
    inherited from both. Raises ArtefactError if the kind, a parent or an answer is unknown, or a parent is quarantined.
    """
    if kind not in ARTEFACT_KINDS:
        raise ArtefactError(f"artefact kind {kind!r} is unknown; known: {', '.join(ARTEFACT_KINDS)}")
    parents, answers = sorted(set(parents)), sorted(set(answers))
    sha = hashlib.sha256(content).hexdigest()
    for parent_id, role in parents:
        what = f"parent {parent_id} ({role}) of {kind} {name!r}"
        if parent_id == sha:
            raise ArtefactError(f"{what} is itself")
        simulated = _require(s, parent_id, what).simulated or simulated
    simulated = _check_answers(s, answers, f"{kind} {name!r}") or simulated
    artefact = s.get(Artefact, sha)
    if artefact is None:
        files.put(content)
        artefact = Artefact(
            id=sha, kind=kind, name=name, setup=setup, card=card, study_id=study_id, job_id=job_id, simulated=simulated
        )
        s.add(artefact)
    elif artefact.kind != kind:
        raise ArtefactError(f"{kind} {name!r}: the same content is stored as {artefact.kind} {artefact.name!r}")
    s.flush()
    for parent_id, role in parents:
        s.merge(ArtefactParent(artefact_id=sha, parent_id=parent_id, role=role))
    for response_id in answers:
        s.merge(ArtefactAnswer(artefact_id=sha, response_id=response_id))
    s.flush()
    return artefact


def load_artefact(
    s: Session, files: ArtefactStore, artefact_id: str, *, kind: str | None = None
) -> tuple[Artefact, bytes]:
    """An artefact's row and content. Raises ArtefactError if unknown, not of the kind asked for, or quarantined."""
    artefact = s.get(Artefact, artefact_id)
    if artefact is None:
        raise ArtefactError(f"no artefact with id {artefact_id!r}")
    if kind is not None and artefact.kind != kind:
        raise ArtefactError(f"artefact {artefact_id} ({artefact.name}) is a {artefact.kind}, not a {kind}")
    if artefact.quarantined_at is not None:
        raise ArtefactError(f"{artefact.kind} {artefact.name!r} is quarantined: {QUARANTINED}")
    return artefact, files.get(artefact_id)


@dataclass(frozen=True)
class Lineage:
    """An artefact and everything it was made from, down to the answers (response ids)."""

    artefact: Artefact
    role: str | None  # what it was for the one below it in the tree; None at the root
    parents: tuple[Lineage, ...]
    answers: tuple[str, ...]

    def all_answers(self) -> tuple[str, ...]:
        """The response ids of the whole tree, sorted."""
        answers = set(self.answers).union(*(parent.all_answers() for parent in self.parents))
        return tuple(sorted(answers))


def lineage(s: Session, artefact_id: str, role: str | None = None) -> Lineage:
    """The lineage of an artefact. Raises ArtefactError if there is none with that id."""
    artefact = s.get(Artefact, artefact_id)
    if artefact is None:
        raise ArtefactError(f"no artefact with id {artefact_id!r}")
    parents = s.execute(
        select(ArtefactParent.parent_id, ArtefactParent.role)
        .where(ArtefactParent.artefact_id == artefact_id)
        .order_by(ArtefactParent.role, ArtefactParent.parent_id)
    )
    answers = s.scalars(
        select(ArtefactAnswer.response_id)
        .where(ArtefactAnswer.artefact_id == artefact_id)
        .order_by(ArtefactAnswer.response_id)
    )
    return Lineage(
        artefact=artefact,
        role=role,
        parents=tuple(lineage(s, parent_id, parent_role) for parent_id, parent_role in parents.all()),
        answers=tuple(answers),
    )


def _require(s: Session, artefact_id: str, what: str) -> Artefact:
    """An artefact from which something may be made; it cannot be erased before this transaction ends."""
    artefact = s.get(Artefact, artefact_id, with_for_update={"read": True})
    if artefact is None:
        raise ArtefactError(f"{what} is not in the store; was it erased?")
    if artefact.quarantined_at is not None:
        raise ArtefactError(f"{what} is quarantined: {QUARANTINED}")
    return artefact


def _check_answers(s: Session, answers: Sequence[str], what: str) -> bool:
    """Whether any of the answers was simulated. Raises ArtefactError if one does not exist."""
    if not answers:
        return False
    rows = s.execute(
        select(Response.id, Participant.simulated)
        .join(SessionRow, SessionRow.id == Response.session_id)
        .join(Participant, Participant.id == SessionRow.participant_id)
        .where(Response.id.in_(answers))
    ).all()
    missing = set(answers) - {row.id for row in rows}
    if missing:
        raise ArtefactError(f"{what}: {len(missing)} of its answers do not exist (any more), e.g. {min(missing)}")
    return any(row.simulated for row in rows)
