"""How the trajectories of a trial are watched: start, seen, interrupted, watched again. The server's clock decides.

Only a session that was created as simulated may be faster. What is answered then is `machine.py`'s.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy.orm import Session as DatabaseSession

from desirepath.grammar.words import PLAYING, TOLERANCE_S
from desirepath.store.events import log_event
from desirepath.store.models import Session, Trial
from desirepath.store.sides import Side
from desirepath.study.clock import elapsed_s
from desirepath.study.kind import kind_of
from desirepath.study.kinds.trial import Viewing, viewing_in
from desirepath.study.session.devices import headset_required
from desirepath.study.session.states import set_phase
from desirepath.study.session.view import (
    Playback,
    current_trial,
    duration_s,
    label_s,
    playback_id,
    playing,
    refusal,
    shows_one,
    step_of,
    trial_of,
)


def viewing_of(session: Session) -> Viewing:
    """The view rules of the current step."""
    return viewing_in(step_of(session))


def start_trial(
    s: DatabaseSession, session: Session, step_key: str, *, request_id: str | None, now: datetime
) -> Playback | None:
    """Play the next unseen trajectory: A, or B where only B was interrupted. None: it plays already (double click)."""
    trial = current_trial(s, session, step_key, now)
    if trial.phase in PLAYING:
        return None
    if trial.phase != "ready":
        raise refusal(session, 409, "not_ready", "Both were shown already.", trial, phase=trial.phase)
    set_phase(s, trial, "go_on" if trial.a_seen_at is not None else "start", "participant", now)
    log_event(s, "trial_started", session_id=session.id, trial_id=trial.id, phase=trial.phase, request=request_id)
    return playing(trial)


def watch_again(s: DatabaseSession, session: Session, step_key: str, *, now: datetime) -> Playback | None:
    """Play both once more, where the protocol allows it. Before the choice, as often as `viewing.replays`."""
    trial = current_trial(s, session, step_key, now)
    allowed = viewing_of(session).replays
    if trial.phase != "choosing" or trial.replays >= allowed:
        message = "This pair cannot be watched again."
        raise refusal(
            session, 409, "no_replay", message, trial, phase=trial.phase, replays=trial.replays, allowed=allowed
        )
    trial.replays += 1
    trial.a_seen_at = trial.b_seen_at = None
    set_phase(s, trial, "watch_again", "participant", now)
    log_event(s, "watched_again", session_id=session.id, trial_id=trial.id, replays=trial.replays)
    return playing(trial)


def trajectory_seen(
    s: DatabaseSession,
    session: Session,
    step_key: str,
    side: Side,
    playback: str | None,
    *,
    headset: dict[str, Any] | None = None,
    now: datetime,
) -> Playback | None:
    """A trajectory was watched to its end, by the server's clock too. After A this plays B; None: nothing more.

    headset: with what it was watched in the immersive view, None: in the window.
    """
    trial = current_trial(s, session, step_key, now)
    if (trial.a_seen_at if side == "a" else trial.b_seen_at) is not None:
        return None  # reported twice
    if trial.phase != f"playing_{side}":
        raise refusal(session, 409, "not_playing", f"{side.upper()} is not playing.", trial, phase=trial.phase)
    if playback != playback_id(trial, side) and not (session.simulated and playback is None):
        raise refusal(session, 409, "other_playback", "This is not what is being shown.", trial, side=side)
    _check_watched(s, session, trial, side, now)
    worn = headset if trial.view == "immersive" else None
    _note_headset(s, session, trial, side, worn)
    if side == "a":
        trial.a_seen_at = now
        set_phase(s, trial, "seen_alone" if shows_one(trial) else "seen", "participant", now)
    else:
        trial.b_seen_at = now
        set_phase(s, trial, "seen", "participant", now)
    log_event(s, "trajectory_seen", session_id=session.id, trial_id=trial.id, side=side)
    return playing(trial)


def _is_worn(s: DatabaseSession, session: Session) -> bool | None:
    """Whether what is shown must be watched with a headset (true) or in the window (false), None: as one likes."""
    if session.simulated:
        return None
    if (worn := step_of(session).worn) is not None:
        return worn
    return headset_required(s, session) or None


def chosen_early(s: DatabaseSession, session: Session, trial: Trial, *, hmd: bool) -> None:
    """The choice comes while B plays, which was watched with a headset so far, or was not. Raises Refused."""
    worn: dict[str, Any] | None = (
        {"pointing": []} if hmd and trial.view == "immersive" else None
    )  # its report comes with the end
    _note_headset(s, session, trial, "b", worn)


def answered_in_room(s: DatabaseSession, session: Session, headset: dict[str, Any] | None) -> dict[str, Any]:
    """What is stored with an answer beside the immersive view. headset: with what it is given. Raises Refused."""
    _check_worn(s, session, headset)
    return {"hmd": headset is not None, "headset": headset}


def _note_headset(s: DatabaseSession, session: Session, trial: Trial, side: Side, worn: dict[str, Any] | None) -> None:
    if trial.view == "immersive":
        _check_worn(s, session, worn, trial, side=side)
    trial.headset = {**(trial.headset or {}), side: worn}
    trial.hmd = all(trial.headset.values())


def _check_worn(
    s: DatabaseSession, session: Session, worn: dict[str, Any] | None, trial: Trial | None = None, **details: Any
) -> None:
    wanted = _is_worn(s, session)
    if wanted and worn is None:
        raise refusal(session, 409, "headset_required", "This is to be seen with a headset.", trial, **details)
    if wanted is False and worn is not None:
        raise refusal(session, 409, "window_required", "This is to be seen in the window.", trial, **details)


def _check_watched(s: DatabaseSession, session: Session, trial: Trial, side: Side, now: datetime) -> None:
    """Raise Refused if the label and the trajectory cannot have been seen yet. Simulated sessions need not watch."""
    if session.simulated:
        return
    assert trial.phase_since is not None  # noqa: S101  set with every phase
    elapsed = elapsed_s(trial.phase_since, now)
    needed = label_s(trial) + duration_s(s, trial, side)
    if elapsed is not None and elapsed < needed - TOLERANCE_S:
        raise refusal(
            session,
            409,
            "too_early",
            f"{side.upper()} takes {needed:.1f} s and began {elapsed:.1f} s ago.",
            trial,
            side=side,
            elapsed_s=round(elapsed, 2),
            needed_s=round(needed, 2),
        )


def restart_trajectory(s: DatabaseSession, session: Session, *, reason: str, now: datetime) -> bool:
    """The trajectory that plays was not seen to its end (hidden tab): it has to be started again; A stays seen.

    Returns whether anything was playing.
    """
    return _interrupt(s, session, reason, now, keep_seen=True)


def interrupt(s: DatabaseSession, session: Session, *, reason: str, now: datetime) -> bool:
    """The checkpoint rule: an unfinished trial whose trajectories were not both seen starts over, every time.

    For reloads, lost connections, another tab, a server that came back. In the phase `choosing` both were seen
    to the end; nothing is repeated then, so that a reload is no second look, save where the page that saw it is gone
    (`unseen`) and with it what was said meanwhile.
    """
    return _interrupt(s, session, reason, now, keep_seen=False)


def _interrupt(s: DatabaseSession, session: Session, reason: str, now: datetime, *, keep_seen: bool) -> bool:
    step = step_of(session)
    cut = kind_of(step).interrupt(step, s, session, reason)
    if cut is not None:
        return cut
    trial = trial_of(s, session) if kind_of(step).shows == "trajectories" else None
    if trial is None or session.state not in ("active", "paused"):
        return False
    half_seen = trial.phase == "ready" and trial.a_seen_at is not None and not keep_seen
    lost = trial.phase == "choosing" and reason == "unseen" and kind_of(step).says_while_shown
    if trial.phase not in PLAYING and not half_seen and not lost:
        return False
    before = trial.phase
    if not keep_seen:
        trial.a_seen_at = None
    trial.restarts += 1
    set_phase(s, trial, "interrupt", "study", now)
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
