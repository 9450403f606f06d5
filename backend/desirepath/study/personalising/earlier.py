"""By the light of whose answers a participant's own may be read: earlier participants of the same study who consented
to training. Only the list is made here, anew each time; what is learned from it is the job's (`jobs`).
"""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import Artefact, Job, Participant, Session
from desirepath.store.who_counts import not_left_out, same_kind

MOST_EARLIER = 100  # people; more would hardly change what all weigh


def earlier_snapshots(s: DatabaseSession, session: Session) -> list[str]:
    """Snapshots of the newest answers of those who finished learning before, newest first, at most MOST_EARLIER.

    People learn from people, a pilot from its pilot, simulated participants from simulated ones. Never across groups:
    who was assigned to another group between participants, or met another version of the protocol, teaches nothing
    here, so that groups stay independent. Who did not consent to training, withdrew, was excluded or erased is not
    among them.
    """
    me = s.get_one(Participant, session.participant_id)
    rows = s.execute(
        select(Job, Session, Participant)
        .join(Session, Session.id == Job.session_id)
        .join(Participant, Participant.id == Session.participant_id)
        .where(
            Session.study_id == session.study_id,
            Session.participant_id != session.participant_id,
            Session.protocol_number == session.protocol_number,
            same_kind(simulated=me.simulated, pilot=me.pilot),
            not_left_out(),
            Job.kind == "align",
            Job.state == "succeeded",
        )
        .order_by(Job.finished_at.desc(), Job.id)
    )
    found: dict[str, str] = {}
    for job, other, person in rows:
        consented = (person.consents or {}).get("training") is True
        if person.id in found or not consented or _groups(other) != _groups(session):
            continue
        kept = s.get(Artefact, job.params["snapshot"])
        if kept is not None and kept.quarantined_at is None:
            found[person.id] = kept.id
        if len(found) == MOST_EARLIER:
            break
    return list(found.values())


def _groups(session: Session) -> dict[str, str]:
    return dict((session.assignment or {}).get("groups") or {})
