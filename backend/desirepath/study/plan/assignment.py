"""Who holds which place in a study's counterbalancing: gives the next one out, and counts them for the lab.

The orders themselves are `counterbalancing.py`'s. A place is given inside the joining transaction, which has locked the
study, so two people who join at once never count each other wrongly.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from sqlalchemy import Row, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import Participant, Session, Study, utc_now
from desirepath.store.who_counts import left_out, same_kind
from desirepath.study.plan.counterbalancing import Assigning, Assignment, Place, design_of, next_row

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


class Places:
    """Gives a study's places out, one after the other within one transaction, in which the study must be locked.

    Who holds a place is counted once, whoever is given one in here beside it. People and simulated participants fill
    the orders each for themselves, pilots too.
    """

    def __init__(self, s: DatabaseSession, study: Study, protocol: Assigning, *, now: datetime) -> None:
        self._s, self._study, self._protocol, self._now = s, study, protocol, now
        self._design = design_of(protocol)
        self._held: dict[bool, list[int]] = {}
        self._taken: int | None = None

    @property
    def is_full(self) -> bool:
        """Whether as many people take part as the protocol asks for; bots take no place of a person."""
        most = self._protocol.participants
        if most is None:
            return False
        if self._taken is None:
            self._taken = people_taken(self._s, self._study, self._protocol)
        return self._taken >= most

    def next(self, *, seed: int, simulated: bool) -> tuple[Place, dict[str, Any]]:
        """The place for whoever comes now, and what the session keeps of it. seed: of the session, for scheme `random`.

        It is next until somebody takes it (`take`).
        """
        design = self._design
        if not design.rows:
            place = design.place_by_lot(np.random.default_rng([seed, 13]))
            return place, design.describe(place, None)
        if simulated not in self._held:
            self._held[simulated] = self._count(simulated=simulated)
        row = next_row(self._held[simulated], self._study.seed)
        return design.rows[row], design.describe(design.rows[row], row)

    def take(self, assignment: dict[str, Any], *, simulated: bool) -> None:
        """Count who got the place that `next` told."""
        if self._taken is not None and not simulated:
            self._taken += 1
        if assignment["row"] is not None:
            self._held[simulated][assignment["row"]] += 1

    def _count(self, *, simulated: bool) -> list[int]:
        """How many hold each row."""
        held = [0] * len(self._design.rows)
        stored = Session.assignment["design"].as_string(), Session.assignment["row"].as_integer()
        columns = (
            stored[0].label("design"),
            stored[1].label("row"),
        )  # of a hundred people, not a hundred whole objects
        for person in _people(self._s, self._study, *columns, simulated=simulated, pilot=self._study.pilot):
            standing = _standing(person, self._protocol.assignment, self._now)
            if person.design == self._design.digest and _holds(standing, self._protocol):
                held[person.row] += 1
        return held


def assignment_table(
    s: DatabaseSession, study: Study, protocol: Assigning, *, now: datetime, simulated: bool = False
) -> list[OrderLine]:
    """Every order with who got it and what became of them, the orders that nobody got yet too; [] without conditions.

    protocol: the newest of the study. Orders of an earlier design that the newest one does not have stand at the end.
    """
    design = design_of(protocol)
    if not design.blocks:
        return []
    lines: dict[tuple[Any, ...], Counter[str]] = {}
    for row, place in enumerate(design.rows):
        lines[_key(design.describe(place, row))] = Counter()
    for person in _people(s, study, Session.assignment, simulated=simulated, pilot=study.pilot):
        if person.assignment and person.assignment.get("blocks"):
            standing = _standing(person, protocol.assignment, now)
            lines.setdefault(_key(person.assignment), Counter())[standing] += 1
    return [_line(key, counts, protocol) for key, counts in lines.items()]


def places_held_by(s: DatabaseSession, study: Study, protocol: Assigning, *, simulated: bool, pilot: bool) -> set[str]:
    """Ids of the participants who hold a place now: completed or under way."""
    now = utc_now()
    return {
        person.id
        for person in _people(s, study, simulated=simulated, pilot=pilot)
        if _holds(_standing(person, protocol.assignment, now), protocol)
    }


def people_taken(s: DatabaseSession, study: Study, protocol: Assigning) -> int:
    """How many people count as taken in: done, or able to go on; not bots, a pilot's people only while it is one."""
    now = utc_now()
    people = _people(s, study, simulated=False, pilot=study.pilot)
    return sum(_standing(person, protocol.assignment, now) in ("completed", "active", "lapsed") for person in people)


def _key(assigned: dict[str, Any]) -> tuple[Any, ...]:
    order = tuple(name for names in assigned["blocks"].values() for name in names)
    return assigned["design"], assigned["row"], order, tuple(assigned["groups"].values())


def _line(key: tuple[Any, ...], counts: Counter[str], protocol: Assigning) -> OrderLine:
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


def _holds(standing: str, protocol: Assigning) -> bool:
    """Whether the place is taken. An exclusion frees one only where the protocol said so beforehand."""
    if standing == "excluded":
        return protocol.assignment.excluded == "keep_place"
    return standing in ("completed", "active")


def _people(s: DatabaseSession, study: Study, *columns: Any, simulated: bool, pilot: bool) -> list[Row[Any]]:
    """Participants with their newest appointment, in the order in which they joined; columns: what else of them."""
    people = s.execute(
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
    return list({person.id: person for person in people}.values())


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
