"""What a study can tell somebody about themselves at its end: whether a robot learned from them, or why none did, how
often they chose it unseen, and whether they guessed right. Facts as they are stored; the words are the catalogues'.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import Response, Session, Trial
from desirepath.study.personalising.clicking import chosen_letters, position_bias

if TYPE_CHECKING:
    from desirepath.study.kinds.base import Moment


def about_person(moment: Moment) -> dict[str, Any] | None:
    """None where the study teaches no robot that its participants see. Else `outcome`, as `session.personalisation`,
    and `learns_from` (answers, paths), `answers`: how many taught; with outcome shown `compared`: [{against, own,
    pairs}], how often the own trajectory was chosen, and `guessed`: whether that was told right, None where nobody
    asked; with outcome one_sided `letter` and `times`. Of a study of methods `methods`: [{method, chosen, pairs}].
    """
    s, session, training = moment.s, moment.session, moment.frozen.training
    if training is None:
        methods = _methods(s, session)
        return {"methods": methods} if methods else None
    if session.personalisation is None:
        return None
    letters = chosen_letters(s, session)
    facts = {"outcome": session.personalisation, "learns_from": training.learns_from, "answers": len(letters)}
    if session.personalisation == "shown":
        return facts | {"compared": _compared(s, session), "guessed": _guessed(s, session)}
    if session.personalisation == "one_sided":
        bias = position_bias(letters)
        return facts | {"letter": bias.letter, "times": bias.times}
    return facts


def _compared(s: DatabaseSession, session: Session) -> list[dict[str, Any]]:
    pairs: Counter[str] = Counter()
    own: Counter[str] = Counter()
    for arms, value in s.execute(_answered(session, "comparison")):
        against = next((one for one in ("neutral", "other") if one in arms), "base")
        against = "stand_in" if arms.get("stand_in") else "dwa" if "dwa" in arms.values() else against
        pairs[against] += 1
        own[against] += value["choice"] == arms["own"]
    return [{"against": against, "own": own[against], "pairs": count} for against, count in pairs.items()]


def _guessed(s: DatabaseSession, session: Session) -> bool | None:
    given = select(Response.value).where(Response.session_id == session.id, Response.kind == "guess")
    return next((bool(value["right"]) for value in s.scalars(given) if "right" in value), None)


def _methods(s: DatabaseSession, session: Session) -> list[dict[str, Any]]:
    """The one chosen most often first."""
    pairs: Counter[str] = Counter()
    chosen: Counter[str] = Counter()
    for arms, value in s.execute(_answered(session, "method_comparison")):
        pairs.update((arms["a"], arms["b"]))
        chosen[arms[value["choice"]]] += 1
    return [
        {"method": method, "chosen": chosen[method], "pairs": pairs[method]}
        for method in sorted(pairs, key=lambda method: -chosen[method])
    ]


def _answered(session: Session, kind: str) -> Any:
    """(arms, value) of the session's answered trials of that kind, in their order."""
    return (
        select(Trial.arms, Response.value)
        .join(Response, Response.trial_id == Trial.id)
        .where(Trial.session_id == session.id, Trial.kind == kind)
        .order_by(Trial.index)
    )
