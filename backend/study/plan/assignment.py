"""Who holds which place in a study's counterbalancing: gives the next one out, and counts them for the lab.

The orders themselves are `counterbalancing.py`'s. A place is given inside the joining transaction, which has locked the
study, so two people who join at once never count each other wrongly.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np
from sqlalchemy import Row, select
from sqlalchemy.orm import Session as DatabaseSession

from backend.store.models import Participant, Session, Study, utc_now
from backend.store.who_counts import left_out, same_kind
from backend.study.plan.counterbalancing import Place, design_of, next_row

if TYPE_CHECKING:
    from backend.study.protocol.schema import Assignment, Protocol

STANDINGS = ("completed", "active", "lapsed", "expired", "withdrawn", "screened_out", "excluded")
"""How somebody stands: done; under way; not heard of for longer than the lease; and the ways of being out."""


@dataclass(frozen=True)
class OrderLine:
    """One order of conditions with the people who got it. `counts`: by standing. `groups`: levels between participants.

    `held`: places that count when the next one is given. `attrition`: share that ended without completing, None if
    nobody has ended; who is under way or excluded counts on neither side.
    """

    row: int | None
    order: tuple[str, ...]
    groups: tuple[str, ...]
    counts: dict[str, int]
    held: int
    attrition: float | None


def assign(
    s: DatabaseSession, study: Study, protocol: Protocol, *, seed: int, simulated: bool, now: datetime
) -> tuple[Place, dict[str, Any]]:
    """A place for whoever joins now, and what their session keeps of it. The study must be locked.

    seed: of the session, for scheme `random`. People, pilots and simulated participants fill the orders each for
    themselves.
    """
    design = design_of(protocol)
    if not design.rows:
        place = design.place_by_lot(np.random.default_rng([seed, 13]))
        return place, design.described(place, None)
    held = [0] * len(design.rows)
    given = Session.assignment["design"].as_string(), Session.assignment["row"].as_integer()
    columns = (given[0].label("design"), given[1].label("row"))  # of a hundred people, not a hundred whole objects
    for person in _people(s, study, *columns, simulated=simulated, pilot=study.pilot):
        if person.design == design.digest and _holds(_standing(person, protocol.assignment, now), protocol):
            held[person.row] += 1
    row = next_row(held, study.seed)
    return design.rows[row], design.described(design.rows[row], row)


def assignment_table(
    s: DatabaseSession, study: Study, protocol: Protocol, *, now: datetime, simulated: bool = False
) -> list[OrderLine]:
    """Every order with who got it and what became of them, the orders that nobody got yet too; [] without conditions.

    protocol: the newest of the study. Orders of an earlier design that the newest one does not have stand at the end.
    """
    design = design_of(protocol)
    if not design.blocks:
        return []
    lines: dict[tuple[Any, ...], Counter[str]] = {}
    for row, place in enumerate(design.rows):
        lines[_key(design.described(place, row))] = Counter()
    for person in _people(s, study, Session.assignment, simulated=simulated, pilot=study.pilot):
        if person.assignment and person.assignment.get("blocks"):
            standing = _standing(person, protocol.assignment, now)
            lines.setdefault(_key(person.assignment), Counter())[standing] += 1
    return [_line(key, counts, protocol) for key, counts in lines.items()]


def places_held_by(
    s: DatabaseSession, study: Study, protocol: Protocol, *, simulated: bool, pilot: bool, now: datetime | None = None
) -> set[str]:
    """Ids of the participants who hold a place now: completed or under way."""
    at = now or utc_now()
    return {
        person.id
        for person in _people(s, study, simulated=simulated, pilot=pilot)
        if _holds(_standing(person, protocol.assignment, at), protocol)
    }


def people_taken(s: DatabaseSession, study: Study, protocol: Protocol) -> int:
    """How many people count as taken in: done, or able to go on; not bots, a pilot's people only while it is one."""
    now = utc_now()
    people = _people(s, study, simulated=False, pilot=study.pilot)
    return sum(_standing(one, protocol.assignment, now) in ("completed", "active", "lapsed") for one in people)


def _key(given: dict[str, Any]) -> tuple[Any, ...]:
    order = tuple(name for names in given["blocks"].values() for name in names)
    return given["design"], given["row"], order, tuple(given["groups"].values())


def _line(key: tuple[Any, ...], counts: Counter[str], protocol: Protocol) -> OrderLine:
    _, row, order, groups = key
    gone = counts["expired"] + counts["withdrawn"] + counts["lapsed"] + counts["screened_out"]
    ended = counts["completed"] + gone
    return OrderLine(
        row=row,
        order=order,
        groups=groups,
        counts={standing: counts[standing] for standing in STANDINGS},
        held=sum(count for standing, count in counts.items() if _holds(standing, protocol)),
        attrition=gone / ended if ended else None,
    )


def _holds(standing: str, protocol: Protocol) -> bool:
    """Whether the place is taken. An exclusion frees one only where the protocol said so beforehand."""
    if standing == "excluded":
        return protocol.assignment.excluded == "keep_place"
    return standing in ("completed", "active")


def _people(s: DatabaseSession, study: Study, *columns: Any, simulated: bool, pilot: bool) -> list[Row[Any]]:
    """Participants with their newest appointment, in the order in which they joined; columns: what else of them."""
    found = s.execute(
        select(
            Participant.id,
            Participant.withdrawn_at,
            Participant.excluded_at,
            Session.state,
            Session.last_seen_at,
            Session.expires_at,
            *columns,
        )
        .join(Session, Session.participant_id == Participant.id)
        .where(Participant.study_id == study.id, same_kind(simulated=simulated, pilot=pilot))
        .order_by(Participant.created_at, Participant.id, Session.appointment)
    )
    return list({person.id: person for person in found}.values())


def _standing(person: Row[Any], rules: Assignment, now: datetime) -> str:
    out = left_out(excluded=person.excluded_at is not None, withdrawn=person.withdrawn_at is not None)
    if out is not None:
        return out
    if person.state not in ("active", "paused"):
        return str(person.state)
    if now > person.expires_at:
        return "expired"
    lease = timedelta(hours=rules.lease_hours)
    # a later appointment that was not opened yet is waited for until its window ends
    return "active" if person.last_seen_at is None or now - person.last_seen_at <= lease else "lapsed"
