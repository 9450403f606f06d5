"""What a simulated session knows of its step beside what pages show: a program reads no pages and has to know what
about. Nobody else gets this: it names queries, right answers and conditions.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import Session, utc_now
from desirepath.study.kind import Moment, kind_of
from desirepath.study.session.versions import protocol_of
from desirepath.study.session.view import StepView


def tell_simulated(s: DatabaseSession, session: Session, view: StepView) -> dict[str, Any]:
    """What the current step is about: condition, view, and what its kind adds."""
    if session.state != "active":
        return {}
    moment = Moment(s, session, protocol_of(s, session), utc_now())
    step = moment.step
    where = {name: word for name in ("block", "view") if (word := getattr(step, name)) is not None}
    return where | kind_of(step).tell_simulated(step, moment, view.payload)
