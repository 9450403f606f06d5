"""Takes dataset snapshots: the answers that a job trains on, frozen, hashed, each traceable to its row.

Who counts is decided in `who_counts.py`; a session's own snapshot holds that session's answers, whoever it is. What is
learned from them lives in `learning`.
"""

from __future__ import annotations

import json
import random
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any, Literal, cast, get_args

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from desirepath.learning.preferences.marked_steps import marked_steps
from desirepath.simulation.setups import require_same
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore, load_artefact, save_artefact
from desirepath.store.marks import marks_in
from desirepath.store.models import (
    Artefact,
    ArtefactAnswer,
    Participant,
    Response,
    Study,
    TrajectoryRow,
    Trial,
    utc_now,
)
from desirepath.store.models import Session as SessionRow
from desirepath.store.sides import Side, chosen_and_rejected, is_answer_to_pair, is_answer_to_several
from desirepath.store.who_counts import PROBE_ROLES, Whose, is_practice, reason_not_to_learn

FORMAT = "desirepath-snapshot-2"
Asked = Whose | Literal["session"]
MIN_ANSWERS = 2  # one pair cannot say which of two reasons it was chosen for
WHOSE_WORDS = {
    "people": "people",
    "simulated": "simulated participants",
    "all": "people and simulated participants",
    "session": "a session",
}
# keys of a snapshot's bytes, so they keep their names; `learning` are practice trials
LEFT_OUT = ("pilot", "learning", "excluded", "withdrawn", "no_consent", "no_choice", "people", "simulated")
MOST_IMPLIED = 100  # choices that one person's ratings under one condition imply; ours
LONGEST_NAME = 160  # of an artefact


class SnapshotError(ValueError):
    """There is nothing to learn from; the message counts what was left out and why."""


class TooFewAnswers(SnapshotError):
    """Its parts beside the message, so that a page can say it in its own language. ask_for: whose answers there are."""

    def __init__(self, whose: str, usable: int, left_out: dict[str, int], probes: int) -> None:
        other = {"people": "simulated", "simulated": "people"}.get(whose, "")
        self.whose, self.usable, self.probes = whose, usable, probes
        self.left_out = {reason: count for reason, count in left_out.items() if count}
        self.ask_for = other if self.left_out.get(other) else ""
        reasons = ", ".join(f"{count} {reason}" for reason, count in self.left_out.items()) or "nothing"
        advice = f"; to learn from {WHOSE_WORDS[other]}, ask for {other} (--answers {other})" if self.ask_for else ""
        super().__init__(
            f"only {usable} usable answers of {WHOSE_WORDS[whose]}, at least {MIN_ANSWERS} are needed "
            f"(left out: {reasons}; probes: {probes}){advice}"
        )


@dataclass(frozen=True)
class Answer:
    """One usable answer. `source`: human or simulated. `probe`: asked again to measure consistency, not independent.
    degree, possible: how clear the choice was, among how many answers, where that was asked
    (`learning/preferences/evidence/graded_pair.py`)."""

    response: str
    trial: str
    participant: str  # pseudonymous code
    view: str
    query: str | None
    trajectory_a: str
    trajectory_b: str
    choice: Side
    source: str
    probe: bool
    degree: str | None = None
    possible: int = 2

    @property
    def chosen(self) -> str:
        return chosen_and_rejected(self.choice, self.trajectory_a, self.trajectory_b)[0]

    @property
    def rejected(self) -> str:
        return chosen_and_rejected(self.choice, self.trajectory_a, self.trajectory_b)[1]


@dataclass(frozen=True)
class NoDifference:
    """One usable answer that the two of a pair do not differ, of `possible` answers."""

    response: str
    trial: str
    participant: str
    view: str
    query: str | None
    trajectory_a: str
    trajectory_b: str
    possible: int
    source: str


@dataclass(frozen=True)
class RatedTrajectory:
    """One usable rating of a trajectory that was shown alone. rating: on the protocol's own scale, more is better. Or
    its place among several of one scene, block: the trial; the best one's is the highest, and of those without a place
    it is 0."""

    response: str
    trial: str
    participant: str
    view: str
    block: str | None
    trajectory: str
    rating: float
    source: str


@dataclass(frozen=True)
class MarkedMoment:
    """One moment of a trajectory that somebody marked. at_s: from the robot's first move to the tap; better: as good,
    else as not right."""

    response: str
    trial: str
    participant: str
    view: str
    trajectory: str
    at_s: float
    better: bool
    source: str


def implied_choices(ratings: Sequence[RatedTrajectory]) -> list[tuple[RatedTrajectory, RatedTrajectory]]:
    """(better, worse) of what one person rated differently under one condition: the choices that ratings imply.

    At most `MOST_IMPLIED` per person and condition, drawn with a fixed seed: pairs grow with the square of the ratings.
    """
    implied = []
    for rated in _group_ratings(ratings):
        pairs = [
            (first, second) if first.rating > second.rating else (second, first)
            for first, second in combinations(rated, 2)
            if first.rating != second.rating and first.trajectory != second.trajectory
        ]
        implied += pairs if len(pairs) <= MOST_IMPLIED else random.Random(0).sample(pairs, MOST_IMPLIED)
    return implied


def independent_choices(ratings: Sequence[RatedTrajectory]) -> list[tuple[RatedTrajectory, RatedTrajectory]]:
    """(better, worse) such that no rating is in two: of n ratings in their order the first against the one in the
    middle, the second against the next one, and so on. All of `implied_choices` are not independent, so whoever counts
    them is too sure."""
    chosen = []
    for rated in _group_ratings(ratings):
        order = sorted(rated, key=lambda rating: -rating.rating)
        half = (len(order) + 1) // 2
        pairs = zip(order[:half], order[half:], strict=False)
        chosen += [
            pair for pair in pairs if pair[0].rating > pair[1].rating and pair[0].trajectory != pair[1].trajectory
        ]
    return chosen


def _group_ratings(ratings: Sequence[RatedTrajectory]) -> list[list[RatedTrajectory]]:
    """Ratings of one person under one condition, each."""
    alike: dict[tuple[str, str, str | None], list[RatedTrajectory]] = {}
    for rating in ratings:
        alike.setdefault((rating.participant, rating.view, rating.block), []).append(rating)
    return list(alike.values())


Evidence = Answer | RatedTrajectory | NoDifference | MarkedMoment


@dataclass(frozen=True)
class Snapshot:
    """The content of a snapshot: answers of one setup in the order they were given, and what was left out.

    `whose`: people, simulated or all of the study; session where it holds one session's own.
    """

    setup: str
    study: str
    protocol_hash: str
    whose: str
    session: str | None
    answers: tuple[Answer, ...]
    left_out: dict[str, int]
    ratings: tuple[RatedTrajectory, ...] = ()
    ties: tuple[NoDifference, ...] = ()
    marks: tuple[MarkedMoment, ...] = ()

    @property
    def simulated(self) -> bool:
        """Whether any answer came from an oracle."""
        given: list[Evidence] = [*self.answers, *self.ratings, *self.ties, *self.marks]
        return any(answer.source == "simulated" for answer in given)

    def training_answers(self) -> tuple[Answer, ...]:
        """The answers that are independent: all but probes."""
        return tuple(answer for answer in self.answers if not answer.probe)

    def to_bytes(self) -> bytes:
        """Canonical JSON: the same answers always give the same bytes, so the same snapshot. What is more than choices
        of A or B only where there is some, so that snapshots of choices are what they always were.
        """
        data = {"format": FORMAT, **asdict(self)}
        for name in ("ratings", "ties", "marks"):
            if not data[name]:
                del data[name]
        for answer in data["answers"]:
            if answer["possible"] == 2:
                del answer["possible"], answer["degree"]
        return json.dumps(data, sort_keys=True, ensure_ascii=False, indent=1).encode()

    @classmethod
    def from_bytes(cls, content: bytes) -> Snapshot:
        """Read `to_bytes` back. Raises SnapshotError on anything else."""
        try:
            data = json.loads(content)
            if data.pop("format") != FORMAT:
                raise KeyError("format")
            ratings = tuple(RatedTrajectory(**rated) for rated in data.pop("ratings", ()))
            answers = tuple(Answer(**answer) for answer in data.pop("answers"))
            ties = tuple(NoDifference(**tie) for tie in data.pop("ties", ()))
            marks = tuple(MarkedMoment(**mark) for mark in data.pop("marks", ()))
            return cls(**data, answers=answers, ratings=ratings, ties=ties, marks=marks)
        except (ValueError, KeyError, TypeError) as problem:
            raise SnapshotError(f"not a snapshot of this version ({FORMAT}): {problem}") from None


def check_whose(whose: str) -> Whose:
    """What was typed as the choice of answers. Raises SnapshotError naming what there is to choose."""
    if whose not in get_args(Whose):
        raise SnapshotError(f"answers = {whose!r}: must be one of {', '.join(get_args(Whose))}")
    return cast(Whose, whose)


def take_snapshot(
    s: Session,
    files: ArtefactStore,
    *,
    session_id: str | None = None,
    study_id: str | None = None,
    participant_ids: Sequence[str] | None = None,
    whose: Whose = "people",
    view: str | None = None,
) -> Artefact:
    """Freeze the usable answers of a session, or of a study (or some of its participants) as a snapshot artefact.

    view: only what was answered in that view (ch. 7 learns from each by itself).
    whose: of a study's participants only people (default), only simulated ones, or all; pilot participants are left out
    of it. A session's own snapshot holds its answers, whoever gave them. Raises SnapshotError if fewer than two usable
    answers are left, LookupError if the session or study is unknown.
    """
    if (session_id is None) == (study_id is None):
        raise SnapshotError("take_snapshot: name either a session or a study")
    if session_id is not None:
        session = s.get(SessionRow, session_id)
        if session is None:
            raise LookupError(f"no session with id {session_id!r}")
        study_id = session.study_id
    study = s.get(Study, study_id)
    if study is None:
        raise LookupError(f"no study with id {study_id!r}")
    chosen = _answers_of(study.id)
    if session_id is not None:
        chosen = chosen.where(SessionRow.id == session_id)
    if participant_ids is not None:
        chosen = chosen.where(Participant.id.in_(participant_ids))
    if view is not None:
        chosen = chosen.where(Trial.view == view)
    return _freeze(s, files, study, s.execute(chosen).all(), "session" if session_id else whose, session_id, view)


def retake_snapshot(
    s: Session, files: ArtefactStore, study_id: str, response_ids: Collection[str], whose: Asked
) -> Artefact:
    """Freeze those of a former snapshot's answers that still count. Raises SnapshotError if fewer than two do."""
    study = s.get(Study, study_id)
    if study is None:
        raise LookupError(f"no study with id {study_id!r}")
    chosen = _answers_of(study.id).where(Response.id.in_(response_ids))
    return _freeze(s, files, study, s.execute(chosen).all(), whose, None)


def set_aside_snapshots(s: Session, participant_id: str) -> list[str]:
    """Quarantine every snapshot that holds answers or paths of a participant who withdraws, so that nothing more is
    learned from them. Returns the snapshots' ids; what was learned from them before stays.
    """
    held = (
        select(Artefact)
        .join(ArtefactAnswer, ArtefactAnswer.artefact_id == Artefact.id)
        .join(Response, Response.id == ArtefactAnswer.response_id)
        .join(SessionRow, SessionRow.id == Response.session_id)
        .where(
            SessionRow.participant_id == participant_id,
            Artefact.kind.in_(("snapshot", "demonstrations")),
            Artefact.quarantined_at.is_(None),
        )
    )
    snapshots = list(s.scalars(held).unique())
    for snapshot in snapshots:
        snapshot.quarantined_at = utc_now()
    return [snapshot.id for snapshot in snapshots]


def load_snapshot(s: Session, files: ArtefactStore, artefact_id: str) -> Snapshot:
    """Read a snapshot. Raises ArtefactError if it is unknown, no snapshot, or quarantined by an erasure."""
    _, content = load_artefact(s, files, artefact_id, kind="snapshot")
    return Snapshot.from_bytes(content)


def _answers_of(study_id: str) -> Select[Response, Trial, Participant, str]:
    return (
        select(Response, Trial, Participant, TrajectoryRow.setup)
        .join(Trial, Trial.id == Response.trial_id)
        .join(SessionRow, SessionRow.id == Response.session_id)
        .join(Participant, Participant.id == SessionRow.participant_id)
        .join(TrajectoryRow, TrajectoryRow.id == Trial.trajectory_a)
        .where(SessionRow.study_id == study_id, Trial.kind.in_(("query", "rating", "order", "mark")))
        .order_by(Participant.code, Response.created_at, Trial.index, Response.id)
    )


def _told_by(s: Session, marks: Sequence[MarkedMoment]) -> int:
    """How many independent choices marks imply: two taps about one moment, or of a short trajectory, say less."""
    of_trajectories = {mark.trajectory for mark in marks}
    rows = select(TrajectoryRow.id, TrajectoryRow.duration_s).where(TrajectoryRow.id.in_(of_trajectories))
    lasts = {row.id: row.duration_s for row in s.execute(rows)}
    alike: dict[tuple[str, str, bool], list[float]] = {}
    for mark in marks:
        alike.setdefault((mark.response, mark.trajectory, mark.better), []).append(mark.at_s)
    dt = Trajectory.dt
    told = [marked_steps(round(lasts[of] / dt), dt, taps_s) for (_, of, _), taps_s in alike.items()]
    return sum(min(len(marked), len(others)) for marked, others in told)


def _freeze(
    s: Session,
    files: ArtefactStore,
    study: Study,
    rows: Sequence[Any],
    whose: Asked,
    session_id: str | None,
    view: str | None = None,
) -> Artefact:
    left_out = dict.fromkeys(LEFT_OUT, 0)
    answers: list[Answer] = []
    ratings: list[RatedTrajectory] = []
    ties: list[NoDifference] = []
    marks: list[MarkedMoment] = []
    orders = 0
    setups: dict[str, str] = {}
    for response, trial, participant, setup in rows:
        reason = _reason_to_leave_out(response, trial, participant, whose)
        if reason:
            left_out[reason] += 1
            continue
        setups[f"answer {response.id}"] = setup
        source = "simulated" if participant.simulated else "human"
        if trial.kind == "mark":
            marked = (response.id, trial.id, participant.code, trial.view, trial.trajectory_a)
            said = marks_in(response.value) or ()
            marks += [MarkedMoment(*marked, at_s=one.at_s, better=one.better, source=source) for one in said]
            continue
        if trial.kind == "rating":
            rated = (response.id, trial.id, participant.code, trial.view, trial.block, trial.trajectory_a)
            ratings.append(RatedTrajectory(*rated, rating=response.value["rating"], source=source))
            continue
        if trial.kind == "order":
            orders += 1
            ranked = (response.id, trial.id, participant.code, trial.view, trial.id)
            places = _places(trial, response.value)
            ratings += [RatedTrajectory(*ranked, of, rating=place, source=source) for of, place in places]
            continue
        about = {
            "response": response.id,
            "trial": trial.id,
            "participant": participant.code,
            "view": trial.view,
            "query": trial.query_id,
            "trajectory_a": trial.trajectory_a,
            "trajectory_b": trial.trajectory_b,
            "possible": response.value.get("possible", 2),
            "source": source,
        }
        if "choice" not in response.value:
            ties += [NoDifference(**about)] if trial.role not in PROBE_ROLES else []
            continue
        chosen = {"choice": response.value["choice"], "degree": response.value.get("degree")}
        answers.append(Answer(**about, **chosen, probe=trial.role in PROBE_ROLES))
    usable = [answer for answer in answers if not answer.probe]
    says = len(usable) + len(implied_choices(ratings)) + _told_by(s, marks)
    if says < MIN_ANSWERS:
        raise TooFewAnswers(whose, says, left_out, len(answers) - len(usable))
    snapshot = Snapshot(
        setup=require_same(**setups),
        study=study.id,
        protocol_hash=study.protocol_hash,
        whose=whose,
        session=session_id,
        answers=tuple(answers),
        left_out=left_out,
        ratings=tuple(ratings),
        ties=tuple(ties),
        marks=tuple(marks),
    )
    evidence: list[Evidence] = [*answers, *ratings, *ties, *marks]
    given = {answer.response: answer.source for answer in evidence}  # an order says something of each trajectory
    rated_alone = len({rating.response for rating in ratings}) - orders
    people = sorted({answer.participant for answer in evidence})
    # in lists, different people's models differ
    many = "participants" if whose == "all" else WHOSE_WORDS[whose]
    whom = people[0] if len(people) == 1 else f"{len(people)} {many}"
    ending = f", {len(given)} answers of {whom}{f' in {view}' if view else ''}"
    return save_artefact(
        s,
        files,
        kind="snapshot",
        name=study.name[: LONGEST_NAME - len(ending)] + ending,
        setup=snapshot.setup,
        content=snapshot.to_bytes(),
        card={
            "study": study.id,
            "whose": whose,
            "session": session_id,
            "protocol_hash": study.protocol_hash,
            "answers": len(answers),
            "probes": len(answers) - len(usable),
            **({"ratings": rated_alone} if rated_alone else {}),
            **({"orders": orders} if orders else {}),
            **({"ties": len(ties)} if ties else {}),
            **({"marks": len(marks)} if marks else {}),
            "participants": len({answer.participant for answer in evidence}),
            "human": sum(source == "human" for source in given.values()),
            "left_out": left_out,
        },
        answers=list(given),
        study_id=study.id,
        simulated=snapshot.simulated,
    )


def _places(trial: Trial, said: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Each of the several trajectories with its place, more is better."""
    if "groups" in said:
        return [(trial.shown[number - 1], float(k)) for k, pile in enumerate(said["groups"]) for number in pile]
    place = {number: float(len(trial.shown) - k) for k, number in enumerate(said["order"])}
    return [(of, place.get(number, 0.0)) for number, of in enumerate(trial.shown, 1)]


def _reason_to_leave_out(
    response: Response, trial: Trial, participant: Participant, whose: Whose | Literal["session"]
) -> str | None:
    reason = reason_not_to_learn(participant, whose)
    if reason is None and is_practice(trial.role):
        return "learning"
    said = response.value
    if trial.kind == "order":
        answered = is_answer_to_several(said, len(trial.shown))
    elif trial.kind == "mark":
        answered = marks_in(said) is not None  # none is an answer, too
    else:
        answered = "rating" in said or is_answer_to_pair(said)
    return reason or (None if answered else "no_choice")
