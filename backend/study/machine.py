"""The state machine of a session: the only writer of its position, of trials' phases and of answers.

Every function runs inside a writing transaction with the session locked (`sessions.acting`) and checks what it changes
with a compare-and-set, so that two servers cannot both advance a session. The server's clock decides; only a session
that was created as simulated may be faster. Pages, stage and HTTP live above.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal, cast

from sqlalchemy import CursorResult, select, update
from sqlalchemy.orm import Session as DatabaseSession
from sqlalchemy.orm.attributes import set_committed_value

from backend.store.artefacts import ArtefactStore
from backend.store.events import log_event
from backend.store.models import Participant, ProblemReport, Response, Session, Study, TrajectoryRow, Trial
from backend.store.outbox import ENDED, cancel_job
from backend.store.snapshots import set_aside_snapshots
from backend.study import asking, personalisation
from backend.study.answers import checked_value
from backend.study.pages import payload_of, trial_payload
from backend.study.planning import Step
from backend.study.protocol import thaw
from backend.study.refusals import Refused
from backend.study.sessions import find_session
from backend.study.words import LABEL_S, PLAYING, TOLERANCE_S, TRIAL_KINDS

__all__ = [
    "Playback",
    "Refused",
    "StepView",
    "Submitted",
    "current",
    "drive_seen",
    "find_session",
    "interrupted",
    "pause",
    "report_problem",
    "restart_drive",
    "resume",
    "settle",
    "start_trial",
    "submit",
    "withdraw",
]

Drive = Literal["a", "b"]
LONGEST_PROBLEM = 4000  # characters of a problem report; ours


@dataclass(frozen=True)
class StepView:
    """What a page shows now. `index` counts from 0; `trial`: phase, durations, playback, None where there is none."""

    kind: str
    key: str
    index: int
    total: int
    payload: dict[str, Any] = field(default_factory=dict)
    trial: dict[str, Any] | None = None

    def as_dict(self) -> dict[str, Any]:
        """The step as the API tells it: without texts."""
        return {"key": self.key, "kind": self.kind, "index": self.index, "total": self.total, "trial": self.trial}


@dataclass(frozen=True)
class Playback:
    """A drive that has to be played now."""

    trajectory: str
    label: str
    view: str
    playback_id: str


@dataclass(frozen=True)
class Submitted:
    """What became of an answer. `duplicate`: it was stored before, by the same request."""

    response_id: str
    duplicate: bool


# ---- reading ---------------------------------------------------------------------------------------------------------


def step_of(session: Session) -> Step:
    """The plan's current step."""
    step: Step = session.plan[session.position]
    return step


def trial_of(s: DatabaseSession, session: Session, step_key: str | None = None) -> Trial | None:
    """The trial of a step, of the current one unless told. Asked for once in a transaction: its session is locked."""
    known: dict[tuple[str, str], Trial] = s.info.setdefault("trials", {})
    key = (session.id, step_key or step_of(session)["key"])
    if key not in known:
        found = s.scalars(select(Trial).where(Trial.session_id == key[0], Trial.step_key == key[1])).first()
        if found is None:
            return None
        known[key] = found
    return known[key]


def playback_id(trial: Trial, drive: Drive) -> str:
    """Names one showing of one drive; another one after every restart. Says nothing about who watches what."""
    return hashlib.sha256(f"{trial.id}:{trial.restarts}:{drive}".encode()).hexdigest()[:24]


def playing(trial: Trial | None) -> Playback | None:
    """What the stage plays in this trial now, None if nothing."""
    if trial is None or trial.phase not in PLAYING:
        return None
    drive: Drive = "a" if trial.phase == "playing_a" else "b"
    trajectory = trial.trajectory_a if drive == "a" else trial.trajectory_b
    return Playback(trajectory, drive.upper(), trial.view, playback_id(trial, drive))


def current(s: DatabaseSession, session: Session) -> StepView:
    """Where the session stands, with the texts of its language. Changes nothing."""
    total = len(session.plan)
    if session.state in ("paused", "withdrawn", "expired"):
        return StepView(session.state, session.state, session.position, total)
    step = step_of(session)
    if step["kind"] in TRIAL_KINDS:
        trial, payload = trial_of(s, session), trial_payload(step)
    else:
        frozen = thaw(s.get_one(Study, session.study_id))
        trial, payload = None, payload_of(frozen, step, session.language, completion_code=session.completion_code)
    return StepView(
        kind=step["kind"],
        key=step["key"],
        index=session.position,
        total=total,
        payload=payload,
        trial=_trial_state(s, trial) if trial is not None else None,
    )


def _trial_state(s: DatabaseSession, trial: Trial) -> dict[str, Any]:
    shown = playing(trial)
    return {
        "phase": trial.phase,
        "duration_a_s": _duration_s(s, trial, "a"),
        "duration_b_s": _duration_s(s, trial, "b"),
        "label_s": LABEL_S,
        "restarts": trial.restarts,
        "next_drive": "b" if trial.a_seen_at is not None else "a",
        "playback_id": shown.playback_id if shown else None,
    }


def _duration_s(s: DatabaseSession, trial: Trial, drive: Drive) -> float:
    trajectory = trial.trajectory_a if drive == "a" else trial.trajectory_b
    if trajectory not in _durations_s:
        _durations_s[trajectory] = s.get_one(TrajectoryRow, trajectory).duration_s
    return _durations_s[trajectory]


_durations_s: dict[str, float] = {}  # by the trajectory's sha256, so never stale; one number per trajectory shown


# ---- trials ----------------------------------------------------------------------------------------------------------


def start_trial(
    s: DatabaseSession, session: Session, step_key: str, *, request_id: str | None, now: datetime
) -> Playback | None:
    """Play the next unseen drive: A, or B where only B was interrupted. None: it plays already (a double click)."""
    trial = _current_trial(s, session, step_key)
    if trial.phase in PLAYING:
        return None
    if trial.phase != "ready":
        raise _refused(session, 409, "not_ready", "Both drives were shown already.", trial, phase=trial.phase)
    _set_phase(s, trial, "ready", "playing_b" if trial.a_seen_at is not None else "playing_a", now)
    log_event(s, "trial_started", session_id=session.id, trial_id=trial.id, phase=trial.phase, request=request_id)
    return playing(trial)


def drive_seen(
    s: DatabaseSession, session: Session, step_key: str, drive: Drive, playback: str | None, *, now: datetime
) -> Playback | None:
    """A drive was watched to its end, by the server's clock too. After A this plays B; None: nothing more to play."""
    trial = _current_trial(s, session, step_key)
    if (trial.a_seen_at if drive == "a" else trial.b_seen_at) is not None:
        return None  # told twice
    if trial.phase != f"playing_{drive}":
        raise _refused(session, 409, "not_playing", f"Drive {drive.upper()} is not playing.", trial, phase=trial.phase)
    if playback != playback_id(trial, drive) and not (session.simulated and playback is None):
        raise _refused(session, 409, "other_playback", "This is not the drive that is being shown.", trial, drive=drive)
    _check_watched(s, session, trial, drive, now)
    if drive == "a":
        trial.a_seen_at = now
        _set_phase(s, trial, "playing_a", "playing_b", now)
    else:
        trial.b_seen_at = now
        _set_phase(s, trial, "playing_b", "choosing", now)
    log_event(s, "drive_seen", session_id=session.id, trial_id=trial.id, drive=drive)
    return playing(trial)


def _check_watched(s: DatabaseSession, session: Session, trial: Trial, drive: Drive, now: datetime) -> None:
    """Raise Refused if the label and the drive cannot have been seen yet. Simulated sessions need not watch."""
    if session.simulated:
        return
    assert trial.phase_since is not None  # noqa: S101  set with every phase
    elapsed = (now - trial.phase_since).total_seconds()
    needed = LABEL_S + _duration_s(s, trial, drive)
    if elapsed < needed - TOLERANCE_S:
        raise _refused(
            session,
            409,
            "too_early",
            f"Drive {drive.upper()} takes {needed:.1f} s and began {elapsed:.1f} s ago.",
            trial,
            drive=drive,
            elapsed_s=round(elapsed, 2),
            needed_s=round(needed, 2),
        )


def restart_drive(s: DatabaseSession, session: Session, *, reason: str, now: datetime) -> bool:
    """The drive that plays was not seen to its end (hidden tab): it has to be started again; A stays seen.

    Returns whether anything was playing.
    """
    return _interrupt(s, session, reason, now, keep_seen=True)


def interrupted(s: DatabaseSession, session: Session, *, reason: str, now: datetime) -> bool:
    """The checkpoint rule: an unfinished trial whose drives were not both seen starts over, as often as it happens.

    For reloads, lost connections, another tab, a server that came back. In the phase `choosing` both drives were seen
    to the end; nothing is repeated then, so that a reload is no second look.
    """
    return _interrupt(s, session, reason, now, keep_seen=False)


def _interrupt(s: DatabaseSession, session: Session, reason: str, now: datetime, *, keep_seen: bool) -> bool:
    trial = trial_of(s, session) if step_of(session)["kind"] in TRIAL_KINDS else None
    if trial is None or session.state not in ("active", "paused"):
        return False
    half_seen = trial.phase == "ready" and trial.a_seen_at is not None and not keep_seen
    if trial.phase not in PLAYING and not half_seen:
        return False
    before = trial.phase
    if not keep_seen:
        trial.a_seen_at = None
    trial.restarts += 1
    _set_phase(s, trial, before, "ready", now)
    log_event(
        s,
        "trial_interrupted",
        session_id=session.id,
        trial_id=trial.id,
        reason=reason,
        phase=before,
        restarts=trial.restarts,
        goes_on_with="b" if trial.a_seen_at is not None else "a",
    )
    return True


# ---- answers ---------------------------------------------------------------------------------------------------------


def submit(
    s: DatabaseSession,
    files: ArtefactStore,
    session: Session,
    step_key: str,
    value: Mapping[str, Any],
    *,
    request_id: str,
    client_time: datetime | None,
    now: datetime,
) -> Submitted:
    """Store the answer to the current step and move on, in one transaction.

    The same request again is answered the same and counts once. Raises Refused for an answer that is too early, not to
    the current step, given already, or no answer to this step.
    """
    known = s.scalars(select(Response).where(Response.request_id == request_id)).first()
    if known is not None:
        if known.session_id != session.id or known.step_key != step_key:
            raise _refused(session, 409, "request_id_used", "This request id belongs to another answer.")
        log_event(s, "duplicate_request", session_id=session.id, trial_id=known.trial_id, step=step_key)
        return Submitted(known.id, duplicate=True)
    _require_active(session)
    step = step_of(session)
    if step["key"] != step_key:
        raise _not_current(s, session, step_key)
    study = s.get_one(Study, session.study_id)
    frozen = thaw(study)
    trial = trial_of(s, session) if step["kind"] in TRIAL_KINDS else None
    decision_s = None
    if trial is not None:
        if trial.phase != "choosing":
            raise _refused(
                session, 409, "too_early", "Please watch both drives first.", trial, phase=trial.phase, step=step_key
            )
        assert trial.phase_since is not None  # noqa: S101  set with every phase
        decision_s = round((now - trial.phase_since).total_seconds(), 3)
    elif step["kind"] == "wait":
        raise _refused(session, 409, "still_waiting", "This step goes on by itself.")
    elif step["kind"] == "debriefing":
        raise _refused(session, 409, "finished", "This session is finished.")
    try:
        stored = checked_value(frozen, step, value)
    except Refused as refused:
        refused.session_id, refused.study_id = session.id, session.study_id
        refused.details["step"] = step_key
        raise
    if step["kind"] == "consent":
        stored["text_hash"] = frozen.consent_hash(session.language)
    elif step["kind"] == "guess":
        stored |= _about_last_comparison(s, session, stored["choice"])
    kinds = {"trial": "preference"}
    response = Response(
        session_id=session.id,
        trial_id=trial.id if trial is not None else None,
        step_key=step_key,
        kind=kinds.get(step["kind"], step["kind"]),
        value=stored,
        request_id=request_id,
        client_time=client_time,
        decision_s=decision_s,
        created_at=now,
    )
    s.add(response)
    if trial is not None:
        _set_phase(s, trial, "choosing", "answered", now)
    s.flush()
    log_event(
        s,
        "answered",
        session_id=session.id,
        trial_id=response.trial_id,
        client_time=client_time,
        step=step_key,
        response=response.id,
    )
    session.started_at = session.started_at or now
    _move(s, files, session, _next(s, files, session), now)
    return Submitted(response.id, duplicate=False)


def _about_last_comparison(s: DatabaseSession, session: Session, choice: str) -> dict[str, Any]:
    """What a guess is about: the pair just seen, and whether the drive named came from the participant's answers."""
    last = s.scalars(
        select(Trial)
        .where(Trial.session_id == session.id, Trial.kind == "comparison")
        .order_by(Trial.index.desc())
        .limit(1)
    ).first()
    return {"about": last.step_key, "right": (last.arms or {})["own"] == choice} if last is not None else {}


def _move(s: DatabaseSession, files: ArtefactStore, session: Session, to: int, now: datetime) -> None:
    """Advance to step `to` if nobody else has moved the session, and do what arriving there means."""
    passed = session.plan[session.position : to]
    _compare_and_set(
        s,
        session,
        update(Session).where(Session.id == session.id, Session.position == session.position).values(position=to),
    )
    set_committed_value(session, "position", to)
    step = step_of(session)
    log_event(s, "step_entered", session_id=session.id, step=step["key"])
    study = s.get_one(Study, session.study_id)
    protocol = thaw(study).protocol
    if step["kind"] == "trial":
        _make_trial(s, files, session, step, now)
    if any(one.get("then") == "train" for one in passed):
        personalisation.start_training(s, files, session, study, protocol)
    if step["kind"] == "wait":
        settle(s, files, session, now=now)
    elif step["kind"] == "debriefing":
        code = next(entry.debriefing.completion_code for entry in protocol.stages if entry.debriefing)
        # A code that is the same for everybody is worth money: a session that need not watch never gets it.
        session.completion_code = secrets.token_hex(4).upper() if code == "random" or session.simulated else code
        session.state, session.finished_at = "completed", now
        log_event(s, "session_completed", session_id=session.id)


def _make_trial(s: DatabaseSession, files: ArtefactStore, session: Session, step: Step, now: datetime) -> None:
    asked = asking.asked_in(s, files, session, step)
    trial = Trial(
        session_id=session.id,
        step_key=step["key"],
        index=session.position,
        block=step["block"],
        kind="query",
        role=step["role"],
        view=step["view"],
        query_id=asked.query,
        trajectory_a=asked.trajectory_a,
        trajectory_b=asked.trajectory_b,
        phase_since=now,
    )
    s.add(trial)
    s.flush()
    if asked.why is not None:
        log_event(s, "query_chosen", session_id=session.id, trial_id=trial.id, query=asked.query, **asked.why)


def settle(s: DatabaseSession, files: ArtefactStore, session: Session, *, now: datetime) -> bool:
    """Let a waiting session go on once its job has ended or is late. Returns whether it moved.

    Call it whenever somebody looks at a waiting session; between two such looks nothing needs to happen.
    """
    if session.state != "active" or step_of(session)["kind"] != "wait":
        return False
    protocol = thaw(s.get_one(Study, session.study_id)).protocol
    outcome = personalisation.outcome_of(s, session, protocol, now)
    if outcome is None:
        return False
    shown = personalisation.make_comparisons(s, session, now) if outcome == "shown" else 0
    session.personalisation = outcome
    log_event(s, "personalisation", session_id=session.id, outcome=outcome, comparisons=shown)
    _move(s, files, session, _after_wait(session, shown), now)
    return True


def _after_wait(session: Session, shown: int) -> int:
    """Where a waiting session goes: to the first comparison, past all of them and the guess if there is none."""
    past = ("comparison", "guess") if not shown else ()
    return next(i for i in range(session.position + 1, len(session.plan)) if session.plan[i]["kind"] not in past)


def _next(s: DatabaseSession, files: ArtefactStore, session: Session) -> int:
    """The step after the current one; passed over are comparisons that could not be made, queries after the stopping
    rule has ended them, and probes of these."""
    to = session.position + 1
    if session.plan[to].get("choose") and asking.little_left(s, files, session, session.plan[to]):
        log_event(s, "queries_ended", session_id=session.id, step=session.plan[to]["key"])
        while session.plan[to].get("choose") and "again" not in session.plan[to]:
            to += 1
    while not _can_be_asked(s, session, session.plan[to]):
        to += 1
    return to


def _can_be_asked(s: DatabaseSession, session: Session, step: Step) -> bool:
    """Comparisons need the trial that was made for them, probes of chosen queries the one that they repeat."""
    if step["kind"] == "comparison":
        return trial_of(s, session, step["key"]) is not None
    return "again" not in step or trial_of(s, session, step["again"]) is not None


# ---- pause, leave, tell ----------------------------------------------------------------------------------------------


def pause(s: DatabaseSession, session: Session, *, now: datetime) -> None:
    """Stop for now; an unfinished trial starts over afterwards. Pausing twice is pausing once."""
    if session.state == "paused":
        return
    _require_active(session)
    interrupted(s, session, reason="paused", now=now)
    session.state = "paused"
    log_event(s, "paused", session_id=session.id)


def resume(s: DatabaseSession, session: Session, *, now: datetime) -> None:
    """Go on after a pause."""
    if session.state == "active":
        return
    if session.state != "paused":
        _require_active(session)
    session.state = "active"
    log_event(s, "resumed", session_id=session.id)


def withdraw(s: DatabaseSession, session: Session, *, now: datetime) -> None:
    """Leave the study: the answers count nowhere from now on, a running alignment is cancelled, and nothing more is
    learned from snapshots that hold them.

    Possible also after the last step. Erasing what is stored is `store.erasure`'s.
    """
    if session.state == "withdrawn":
        return
    participant = s.get_one(Participant, session.participant_id)
    participant.withdrawn_at = now
    session.state = "withdrawn"
    for job in personalisation.jobs_of(s, session):
        if job.state not in (*ENDED, "cancelling"):
            cancel_job(s, job.id, by="withdrawal")
    set_aside_snapshots(s, participant.id)
    log_event(s, "withdrawn", session_id=session.id, step=step_of(session)["key"])


def change_language(s: DatabaseSession, session: Session, language: str) -> None:
    """Show the pages in another of the protocol's languages from now on; answers stay as they are.

    Not while a pair is on the stage: its page must not be loaded anew.
    """
    languages = thaw(s.get_one(Study, session.study_id)).protocol.languages
    if language not in languages:
        allowed = ", ".join(languages)
        raise _refused(session, 422, "bad_value", f"must be one of {allowed}", field="language", value=language[:20])
    step = step_of(session)
    if session.state == "active" and step["kind"] in TRIAL_KINDS:
        raise _refused(session, 409, "in_trial", "The language can be changed after this pair.", step=step["key"])
    if language == session.language:
        return
    log_event(s, "language_changed", session_id=session.id, step=step["key"], before=session.language, after=language)
    session.language = language


def report_problem(s: DatabaseSession, session: Session, text: str) -> None:
    """Keep what a participant wrote by `report a problem`."""
    text = text.strip()
    if not text or len(text) > LONGEST_PROBLEM:
        raise _refused(session, 422, "bad_value", f"Please write 1 to {LONGEST_PROBLEM} characters.", field="text")
    s.add(ProblemReport(session_id=session.id, text=text))
    log_event(s, "problem_reported", session_id=session.id, step=step_of(session)["key"])


# ---- checks ----------------------------------------------------------------------------------------------------------


def _require_active(session: Session) -> None:
    if session.state == "active":
        return
    told = {
        "paused": "The session is paused; go on first.",
        "completed": "This session is finished.",
        "withdrawn": "You have left this study.",
        "expired": "The time in which this session could be continued is over.",
    }[session.state]
    raise _refused(session, 409 if session.state == "paused" else 410, session.state, told)


def _current_trial(s: DatabaseSession, session: Session, step_key: str) -> Trial:
    _require_active(session)
    step = step_of(session)
    if step["key"] != step_key or step["kind"] not in TRIAL_KINDS:
        raise _not_current(s, session, step_key)
    trial = trial_of(s, session)
    assert trial is not None  # noqa: S101  made when the step was entered
    return trial


def _not_current(s: DatabaseSession, session: Session, step_key: str) -> Refused:
    answered = s.scalars(
        select(Response.id).where(Response.session_id == session.id, Response.step_key == step_key)
    ).first()
    if answered is not None:
        return _refused(session, 409, "already_answered", "This step was answered already.", step=step_key)
    if not any(step["key"] == step_key for step in session.plan):
        return _refused(session, 404, "unknown_step", "This session has no such step.", asked=step_key[:80])
    return _refused(session, 409, "not_current_step", "The session is at another step.", step=step_key)


def _set_phase(s: DatabaseSession, trial: Trial, before: str, after: str, now: datetime) -> None:
    s.flush()
    _compare_and_set(
        s,
        trial,
        update(Trial).where(Trial.id == trial.id, Trial.phase == before).values(phase=after, phase_since=now),
    )
    set_committed_value(trial, "phase", after)
    set_committed_value(trial, "phase_since", now)


def _compare_and_set(s: DatabaseSession, row: Session | Trial, statement: Any) -> None:
    changed = cast("CursorResult[Any]", s.execute(statement.execution_options(synchronize_session=False)))
    if changed.rowcount != 1:
        session_id = row.id if isinstance(row, Session) else row.session_id
        raise Refused(409, "moved", "The session went on in the meantime.", session_id=session_id)


def _refused(
    session: Session, status: int, code: str, message: str, trial: Trial | None = None, **details: Any
) -> Refused:
    return Refused(
        status,
        code,
        message,
        session_id=session.id,
        study_id=session.study_id,
        trial_id=trial.id if trial is not None else None,
        **details,
    )
