"""How somebody's head moves in a headset, on its way in: which parts a session takes. What one may be is
`store/head_poses.py`'s.

Only where the protocol asks for it, which its information names (`protocol/headset_words.py`), and after the consent.
Parts have numbers, so that one may come twice, late, or after others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.head_poses import samples_problem
from desirepath.store.models import HeadPose, Session, Trial
from desirepath.store.sides import SIDES, Side
from desirepath.study.kind import kind_of, read_step
from desirepath.study.refusals import Refused
from desirepath.study.session.versions import protocol_of
from desirepath.study.session.view import consent_in_force, playback_id, refusal

MOST_SAMPLES = 30 * 60 * 120  # of a session: two hours at 30 Hz (ours)
MOST_PARTS = 20_000  # of a session (ours)
TAKEN_IN = ("active", "paused", "completed")  # a part may come after the last step


@dataclass(frozen=True)
class Part:
    """A part as it came: shapes and meaning as `HeadPose` has them. playback: what was playing, by its id."""

    wearing: str
    part: int
    began_s: float
    playing_s: float | None
    playback: str | None
    times_s: list[float]
    poses: list[list[float]]


def keep_part(s: DatabaseSession, session: Session, step_key: str, sent: Part) -> bool:
    """Store a part; False: it was here before, and the first stays. Raises Refused for what this session does not take,
    or what no head can have done."""
    if not protocol_of(s, session).protocol.asked_of_devices.head_pose:
        raise refusal(session, 409, "not_asked", "This study stores no poses of heads.")
    if session.state not in TAKEN_IN or consent_in_force(s, session) is None:
        raise refusal(session, 409, "not_running", "Nothing is stored of this session.", state=session.state)
    met = (step for step in session.plan[: session.position + 1] if step["key"] == step_key)
    step = next((read_step(step) for step in met), None)
    if step is None or step.view != "immersive" or kind_of(step).shows == "page":
        raise refusal(session, 409, "no_such_room", "No headset is worn at that step.", asked=step_key[:80])
    mine = HeadPose.session_id == session.id
    parts, samples, known = s.execute(
        select(
            func.count(),
            func.coalesce(func.sum(HeadPose.samples), 0),
            func.max(HeadPose.id).filter(HeadPose.wearing == sent.wearing, HeadPose.part == sent.part),
        ).where(mine)
    ).one()
    if known is not None:
        return False
    problem = samples_problem(sent.times_s, sent.poses)
    if problem is not None:
        raise refusal(session, 422, "bad_value", problem, field="poses")
    if parts >= MOST_PARTS or samples + len(sent.times_s) > MOST_SAMPLES:
        raise refusal(session, 409, "enough", f"At most {MOST_SAMPLES} poses of a session are kept.")
    s.add(
        HeadPose(
            session_id=session.id,
            step_key=step_key,
            **_what_played(s, session, step_key, sent, shows_trial=kind_of(step).shows == "trajectories"),
            wearing=sent.wearing,
            part=sent.part,
            began_s=sent.began_s,
            playing_s=sent.playing_s if sent.playback is not None else None,
            samples=len(sent.times_s),
            recorded={"times_s": sent.times_s, "poses": sent.poses},
        )
    )
    return True


def _what_played(
    s: DatabaseSession, session: Session, step_key: str, sent: Part, *, shows_trial: bool
) -> dict[str, Any]:
    """Trial, side and showing of a playback of this session's step. Raises Refused where it had no such one."""
    if sent.playback is None or not shows_trial:
        return {}
    of_step = select(Trial).where(Trial.session_id == session.id, Trial.step_key == step_key)
    trial = s.scalars(of_step).first()
    found = _find_showing(trial, sent.playback) if trial is not None else None
    if trial is None or found is None:
        raise Refused(
            422,
            "bad_value",
            "names nothing that was shown at that step",
            session_id=session.id,
            study_id=session.study_id,
            field="playback_id",
        )
    return {"trial_id": trial.id, "side": found[0], "showing": found[1]}


def _find_showing(trial: Trial, playback: str) -> tuple[Side, int] | None:
    for restarts in range(trial.restarts + 1):
        for replays in range(trial.replays + 1):
            for side in SIDES:
                if playback_id(trial, side, restarts=restarts, replays=replays) == playback:
                    return side, restarts + replays
    return None
