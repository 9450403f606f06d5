"""Skip logic on answers: which items of a questionnaire are asked, and what is wrong with a condition (`when.py`).

Whose answers these are is `study/kind.py`'s; the page decides the same way while it is filled in (`questions.js`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from desirepath.grammar.error_words import meant
from desirepath.grammar.questionnaires import Item, Questionnaire
from desirepath.grammar.source import Path, Problem, Source
from desirepath.grammar.when import Earlier, Fitting, ItemWhen


def may_ask(item: Item, earlier: Earlier | None) -> bool:
    """Whether the answers to earlier questionnaires let the item be asked; None: nobody has answered yet, it may be."""
    if earlier is None:
        return True
    return all(
        condition.fits((earlier(condition.questionnaire) or {}).get(condition.item))
        for condition in item.when
        if condition.questionnaire
    )


def is_asked(item: Item, answers: Mapping[str, Any], earlier: Earlier | None) -> bool:
    """Whether the item is asked, given the answers to the items before it."""
    here = (condition for condition in item.when if condition.questionnaire is None)
    return may_ask(item, earlier) and all(condition.fits(answers.get(condition.item)) for condition in here)


def asks_anything(questionnaire: Questionnaire, earlier: Earlier) -> bool:
    """Whether anything of it may be asked of this participant."""
    return any(may_ask(item, earlier) for item in questionnaire.items)


def may_ask_something(questionnaire: Questionnaire, earlier: Earlier) -> bool:
    """The same of a later condition: what depends on a questionnaire that was not answered yet may still be asked."""
    needed = {condition.questionnaire for item in questionnaire.items for condition in item.when}
    return any(earlier(name) is None for name in needed if name is not None) or asks_anything(questionnaire, earlier)


# ---- what is wrong with a condition ----------------------------------------------------------------------------------


def problems_with(when: Fitting, name: str, items: Sequence[Item], here: Path, source: Source) -> Iterator[Problem]:
    """Why no answer to the questionnaire `name` with these items can ever fit, or be asked about."""
    known = {item.key: item for item in items}
    item = known.get(when.item)
    if item is None:
        message = f"is no item of {name}; items: {', '.join(known)}{meant(when.item, list(known))}"
        yield source.problem((*here, "item"), message)
        return
    if item.type in ("text", "ranking"):
        yield source.problem((*here, "item"), f"is a {item.type}; only choices, scales and numbers can be asked about")
        return
    if item.type == "choice" and (when.at_least is not None or when.at_most is not None):
        yield source.problem(here, "at_least and at_most need a scale or a number; use is, is_not or one_of")
    allowed = _possible(item)
    given: dict[str, list[str | None]] = {"is": [when.is_], "is_not": [when.is_not], "one_of": [*(when.one_of or [])]}
    for key, values in given.items():
        for value in values:
            if value is not None and allowed is not None and value not in allowed:
                message = f"can never be answered to {item.key}; answers: {', '.join(allowed)}{meant(value, allowed)}"
                yield source.problem((*here, key), message)


def _possible(item: Item) -> list[str] | None:
    """The answers of an item as texts, None where they are numbers without a list."""
    if item.type == "choice":
        return [option.value for option in item.options]
    return [str(n) for n in range(1, item.points + 1)] if item.type == "scale" else None


def problems_within(name: str, questionnaire: Questionnaire, source: Source) -> Iterator[Problem]:
    """What is wrong with the conditions of a questionnaire's items and screens that are about itself."""
    before: list[Item] = []
    for b, block in enumerate(questionnaire.blocks):
        if block.when is not None:
            yield from _within(block.when, name, before, ("blocks", b, "when"), source)
        for i, item in enumerate(block.items):
            own = item.when[1:] if block.when is not None else item.when  # the screen's stands first
            for one in own:
                yield from _within(one, name, before, ("blocks", b, "items", i, "when"), source)
            before.append(item)


def _within(when: ItemWhen, name: str, before: Sequence[Item], here: Path, source: Source) -> Iterator[Problem]:
    if when.questionnaire == name:
        message = "is this questionnaire itself; leave it out to ask about an item before this one"
        yield source.problem((*here, "questionnaire"), message)
    elif when.questionnaire is None and when.item not in [item.key for item in before]:
        allowed = ", ".join(item.key for item in before) or "none"
        yield source.problem((*here, "item"), f"does not stand before this in the questionnaire; before it: {allowed}")
    elif when.questionnaire is None:
        yield from problems_with(when, name, before, here, source)
