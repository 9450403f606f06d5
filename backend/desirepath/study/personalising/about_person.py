"""What a study can tell somebody about themselves at its end: whether a robot learned from them, or why none did, how
often they chose it unseen, and whether they guessed right. Facts as they are stored; the words are the catalogues'.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import Response, Session, Trial
from desirepath.study.personalising.clicking import find_letters, position_bias
from desirepath.study.personalising.method_robots import find_robots

if TYPE_CHECKING:
    from desirepath.study.kind import Moment

RANKED_BY_PREFERENCE = "preference"  # the item at which methods are ranked by which one they would rather use


def about_person(moment: Moment) -> dict[str, Any] | None:
    """None where the study teaches no robot that its participants see. Else `outcome`, as `session.personalisation`,
    and `learns_from` (answers, paths), `answers`: how many taught; with outcome shown `compared`: [{against, own,
    pairs}], how often the own trajectory was chosen, and `guessed`: whether that was told right, None where nobody
    asked; with outcome one_sided `letter` and `times`. Of a study of methods what `_methods` says.
    """
    s, session, training = moment.s, moment.session, moment.frozen.training
    if training is None:
        return _methods(moment)
    if session.personalisation is None:
        return None
    letters = find_letters(s, session)
    facts = {"outcome": session.personalisation, "learns_from": training.learns_from, "answers": len(letters)}
    if session.personalisation == "shown":
        return facts | {"compared": count_comparisons(s, session), "guessed": _find_guess(s, session)}
    if session.personalisation == "one_sided":
        bias = position_bias(letters)
        return facts | {"letter": bias.letter, "times": bias.times}
    return facts


def was_preferred(s: DatabaseSession, session: Session, times: int) -> bool:
    """Whether the own robot was chosen at least so often beside the usual one."""
    won = sum(int(of["own"]) for of in count_comparisons(s, session) if of["against"] == "base")
    return won >= times


def count_comparisons(s: DatabaseSession, session: Session) -> list[dict[str, Any]]:
    """[{against, own, pairs}], how often the own trajectory was chosen."""
    pairs: Counter[str] = Counter()
    own: Counter[str] = Counter()
    for arms, value in s.execute(_select_answered(session, "comparison")):
        against = next((opponent for opponent in ("neutral", "population", "other") if opponent in arms), "base")
        against = "stand_in" if arms.get("stand_in") else "dwa" if "dwa" in arms.values() else against
        pairs[against] += 1
        own[against] += value["choice"] == arms["own"]
    return [{"against": against, "own": own[against], "pairs": count} for against, count in pairs.items()]


def _find_guess(s: DatabaseSession, session: Session) -> bool | None:
    guesses = select(Response.value).where(Response.session_id == session.id, Response.kind == "guess")
    return next((bool(value["right"]) for value in s.scalars(guesses) if "right" in value), None)


def _methods(moment: Moment) -> dict[str, Any] | None:
    """methods: [{method, chosen, pairs, foremost}], the one chosen most often first; foremost: the objective that this
    robot went by most, None where its method taught nothing. met: [{a, b, choice, look_alike}], every pair with whose
    robots it showed. favourite: the one chosen more often than every other, None where two were as often; wanted: the
    way that this person said they would rather use, None where nobody asked. None where nothing was compared."""
    answered = list(moment.s.execute(_select_answered(moment.session, "method_comparison", Trial.block)))
    if not answered:
        return None
    weights = find_robots(moment, answered[0][2])["weights"]
    met = [arms | {"choice": value["choice"]} for arms, value, _ in answered]
    pairs = Counter(pair[side] for pair in met for side in "ab")
    chosen = Counter(pair[pair["choice"]] for pair in met)
    order = sorted(pairs, key=lambda method: -chosen[method])
    return {
        "methods": [
            {
                "method": method,
                "chosen": chosen[method],
                "pairs": pairs[method],
                "foremost": max(weights[method], key=weights[method].get, default=None),
            }
            for method in order
        ],
        "met": met,
        "favourite": order[0] if chosen[order[0]] > chosen[order[1]] else None,
        "wanted": _find_wanted(moment, set(order)),
    }


def _find_wanted(moment: Moment, methods: set[str]) -> str | None:
    """The first of them where they were ranked by preference."""
    answers = select(Response.value).where(Response.session_id == moment.session.id, Response.kind == "questionnaire")
    for value in moment.s.scalars(answers):
        ranked = value.get(RANKED_BY_PREFERENCE)
        if isinstance(ranked, list) and set(ranked) == methods:
            return str(ranked[0])
    return None


def _select_answered(session: Session, kind: str, *more: Any) -> Any:
    """(arms, value, more) of the session's answered trials of that kind, in their order."""
    return (
        select(Trial.arms, Response.value, *more)
        .join(Response, Response.trial_id == Trial.id)
        .where(Trial.session_id == session.id, Trial.kind == kind)
        .order_by(Trial.index)
    )
