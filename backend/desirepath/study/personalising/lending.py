"""Whose policy a participant is lent for the comparison with another's: of those that are ready one that was lent to
nobody yet, so that people who finish together compare with different ones.

What is done with it is the alignment's job (`backend/desirepath/jobs`) and `alignment_jobs.py`'s.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from typing import Any

from sqlalchemy import Select, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.job_results import Learned
from desirepath.store.models import Artefact, Job, Participant, Session, Study
from desirepath.store.who_counts import not_left_out, same_kind
from desirepath.study.personalising.verdicts import verdict

Lent = dict[str, Any]
"""Parameters of the alignment's job: `other`, a policy's id, or `stand_in`, the number of one on the setup's card."""


def lend_policy(s: DatabaseSession, session: Session, *, setup: str, stand_ins: bool) -> Lent:
    """What the session is lent. {}: nobody's policy is ready, and there are no stand-ins.

    In this order: another participant's that was lent to nobody, the one that was ready last first; a stand-in that was
    lent to nobody; another participant's that was lent least. Which are lent is held for the transaction.
    """
    # Exclusive among who lends, but not against foreign keys: rows that name the study were written before this.
    s.get(Study, session.study_id, with_for_update={"key_share": True})
    ready = _ready(s, session)
    lent = _count_lent(s, session)
    times = [lent[policy_key(s, policy)] for policy in ready]
    free = next((policy for policy, count in zip(ready, times, strict=True) if not count), None)
    if free is not None:
        return {"other": free}
    if stand_ins:
        from desirepath.learning.policies.stand_ins import load_stand_ins, stand_in_name

        card = load_stand_ins(setup)
        for number in range(len(card.people) if card else 0):
            if not lent[stand_in_name(setup, number)]:
                return {"stand_in": number}
    return {"other": ready[times.index(min(times))]} if ready else {}


def policy_key(s: DatabaseSession, policy: str) -> str:
    """What two policies have in common that are one and the same: instant policies of people whose answers speak for
    the same weights drive alike, though each has an id of its own. Of others the id."""
    artefact = s.get(Artefact, policy)
    config = (artefact.card.get("config") or {}) if artefact is not None else {}
    if config.get("recipe") != "instant" or artefact is None:
        return policy
    key = json.dumps([artefact.setup, config["preference_weights"]], sort_keys=True)
    return f"weights {hashlib.sha256(key.encode()).hexdigest()[:16]}"


def _ready(s: DatabaseSession, session: Session) -> list[str]:
    """Policies of other participants of the study that may be shown, each participant's newest, newest first.

    People are compared with people's, a pilot's with the pilot's, simulated participants with simulated ones'. Who
    withdrew or was excluded lends nothing.
    """
    ready = _alignments_of_others(s, session).where(not_left_out(), Job.state == "succeeded")
    jobs = s.execute(ready.order_by(Job.finished_at.desc(), Job.id))
    of_participant: dict[str, str] = {}
    for job, participant in jobs:
        learned = job.result_as(Learned)
        if learned is not None and participant not in of_participant and verdict(job) == "shown":
            policy = learned.policy
            artefact = s.get(Artefact, policy)
            if artefact is not None and artefact.quarantined_at is None:
                of_participant[participant] = policy
    return list(of_participant.values())


def _alignments_of_others(s: DatabaseSession, session: Session) -> Select[Job, str]:
    """(alignment, whose) of the study's other participants of the same kind."""
    me = s.get_one(Participant, session.participant_id)
    return (
        select(Job, Session.participant_id)
        .join(Session, Session.id == Job.session_id)
        .join(Participant, Participant.id == Session.participant_id)
        .where(
            Session.study_id == session.study_id,
            Session.participant_id != session.participant_id,
            same_kind(simulated=me.simulated, pilot=me.pilot),
            Job.kind == "align",
        )
    )


def _count_lent(s: DatabaseSession, session: Session) -> Counter[str]:
    """How many other participants of the same kind each policy was lent to."""
    from desirepath.learning.policies.stand_ins import stand_in_name

    jobs = s.execute(_alignments_of_others(s, session))
    pairs = set()
    for job, participant in jobs:
        if job.params.get("other"):
            pairs.add((policy_key(s, job.params["other"]), participant))
        elif job.params.get("stand_in") is not None:
            pairs.add((stand_in_name(job.params["setup"], job.params["stand_in"]), participant))
    return Counter(key for key, _ in pairs)
