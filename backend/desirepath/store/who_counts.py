"""Who counts: people and simulated participants, pilots, excluded, withdrawn; what they agreed to; which trials count.

The rules, each once, for rows that are loaded and for queries. Marks are set elsewhere (joining, leaving, the people's
page), and what becomes of those who are left out is the caller's.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, get_args

from sqlalchemy import ColumnElement, and_, true

from desirepath.store.models import Participant

Group = Literal["people", "pilot", "simulated"]
GROUPS: tuple[Group, ...] = get_args(Group)
Whose = Literal["people", "simulated", "all"]
"""Whose answers are asked for. A pilot's participants are nobody's: they count in no number of the study."""
LeftOut = Literal["excluded", "withdrawn"]

PRACTICE = "practice"  # role of trials that are stored and never analysed
PROBE_ROLES = ("repeat", "swap", "transitivity")  # asked again to measure consistency: no independent answers
FURTHER = "further"  # asked on, where the answers did not say enough: taught from, never analysed
TEACHING_ROLES = ("regular", FURTHER)  # of queries: what is believed of somebody is read from these
FINISHED = "completed"  # state of a session walked to its end; paused, expired, screened-out ones are not


# ---- which group somebody belongs to ---------------------------------------------------------------------------------


def group_of(*, simulated: bool, pilot: bool) -> Group:
    """Where somebody is listed: everybody is in one group. Simulated participants of a pilot are simulated."""
    return "simulated" if simulated else "pilot" if pilot else "people"


def in_group(group: Group) -> ColumnElement[bool]:
    """The same as a condition on `Participant`."""
    if group == "simulated":
        return Participant.simulated.is_(True)
    return and_(Participant.simulated.is_(False), Participant.pilot.is_(group == "pilot"))


def same_kind(*, simulated: bool, pilot: bool) -> ColumnElement[bool]:
    """Whom somebody is compared and counterbalanced with: people, pilots and simulated ones each among themselves."""
    return and_(Participant.simulated.is_(simulated), Participant.pilot.is_(pilot))


def is_asked_for(whose: Whose, *, simulated: bool) -> bool:
    """Whether somebody of that kind belongs to those who were asked for."""
    return whose == "all" or simulated == (whose == "simulated")


def participants_condition(whose: Whose) -> ColumnElement[bool]:
    """The same as a condition on `Participant`."""
    return true() if whose == "all" else Participant.simulated.is_(whose == "simulated")


# ---- who is left out, though they took part --------------------------------------------------------------------------


def left_out(*, excluded: bool, withdrawn: bool) -> LeftOut | None:
    """Why somebody's data count nowhere, None where they do. Both at once reads as excluded."""
    return "excluded" if excluded else "withdrawn" if withdrawn else None


def left_out_of_study(person: Participant) -> LeftOut | None:
    return left_out(excluded=person.excluded_at is not None, withdrawn=person.withdrawn_at is not None)


def not_withdrawn() -> ColumnElement[bool]:
    """A condition on `Participant`: whose data may still be shown and exported."""
    return Participant.withdrawn_at.is_(None)


def not_left_out() -> ColumnElement[bool]:
    """A condition on `Participant`: neither excluded nor withdrawn."""
    return and_(Participant.excluded_at.is_(None), not_withdrawn())


# ---- what they agreed to ---------------------------------------------------------------------------------------------


def lets_us_learn(person: Participant) -> bool:
    """Whether models may learn from their answers: who was not asked did not refuse."""
    return (person.consents or {}).get("training") is not False


def may_be_published(person: Participant, protocol: Mapping[str, Any]) -> bool:
    """Whether they agreed to that, or the study did not ask. Who has not consented to anything did not agree."""
    asks = any(
        "open_data" in ((entry.get("consent") or {}).get("purposes") or {}) for entry in protocol.get("stages", ())
    )
    return (person.consents or {}).get("open_data", not asks) is not False


def reason_not_to_learn(person: Participant, whose: Whose | Literal["session"]) -> str | None:
    """Why a snapshot leaves somebody out, None where it does not. `session`: of a session's own, for which it matters
    neither whether they are simulated nor whether they joined in a pilot."""
    if whose != "session":
        if not is_asked_for(whose, simulated=person.simulated):
            return "simulated" if person.simulated else "people"
        if person.pilot:
            return "pilot"
    return left_out_of_study(person) or (None if lets_us_learn(person) else "no_consent")


def learned_from(whose: Whose | Literal["session"]) -> ColumnElement[bool]:
    """The same as a condition on `Participant`, but for the consent."""
    return (
        not_left_out()
        if whose == "session"
        else and_(not_left_out(), Participant.pilot.is_(False), participants_condition(whose))
    )


# ---- which trials count ----------------------------------------------------------------------------------------------


def is_practice(role: str | None) -> bool:
    return role == PRACTICE
