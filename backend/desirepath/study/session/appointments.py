"""Several appointments of one participant: where each ends in the plan they share, and when one is open.

All appointments share one plan; each session begins where the one before ended. The next link is made from the link of
now, so that nothing is stored but its hash, and the page can show it again; making it is `kinds/appointment.py`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from desirepath.store.models import Session, utc_now
from desirepath.study.kind import kind_of
from desirepath.study.steps import Step


def end_of(plan: Sequence[Step], appointment: int | None) -> int:
    """Index after the last step of an appointment, the first unless given."""
    ends = [i + 1 for i, step in enumerate(plan) if kind_of(step).ends_appointment]
    own = appointment or 1
    return ends[own - 1] if own <= len(ends) else len(plan)


def is_open(session: Session, now: datetime | None = None) -> bool:
    """Whether the appointment has begun; bots need not wait."""
    return session.opens_at is None or session.simulated or (now or utc_now()) >= session.opens_at
