"""Skip logic on answers: what `when` may say, whether an answer fits, which items of a questionnaire are asked.

Whose answers these are is `kinds/base.py`'s; the page decides the same way while it is filled in (`questions.js`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, model_validator

from desirepath.grammar.error_words import meant
from desirepath.grammar.parts import Part, Slug, Value, an_example
from desirepath.grammar.source import Path, Problem, Source

if TYPE_CHECKING:
    from desirepath.grammar.questionnaires import Item, Questionnaire

Earlier = Callable[[str], Mapping[str, Any] | None]
"""The participant's newest answers to the questionnaire of that name, None where it was not answered."""


class Fitting(Part):
    """What the answer to `item` must be; all that is said must fit. One that was not answered fits `is_not` alone."""

    item: Slug
    is_: Value | None = Field(None, alias="is")
    is_not: Value | None = None
    one_of: Annotated[list[Value], Field(min_length=1)] | None = None
    at_least: int | None = None
    at_most: int | None = None

    @model_validator(mode="after")
    def _asks_something(self) -> Fitting:
        tests = (self.is_, self.is_not, self.one_of, self.at_least, self.at_most)
        if all(test is None for test in tests):
            raise ValueError("needs one of is, is_not, one_of, at_least, at_most")
        return self

    def fits(self, given: Any) -> bool:
        """Whether an answer fits. None: the item was not answered, or the questionnaire was not shown."""
        wanted = (self.is_, self.one_of, self.at_least, self.at_most)
        if given is None:
            return self.is_not is not None and all(test is None for test in wanted)
        word = str(given)
        number = given if isinstance(given, int) else None
        return (
            (self.is_ is None or word == self.is_)
            and (self.is_not is None or word != self.is_not)
            and (self.one_of is None or word in self.one_of)
            and (self.at_least is None or (number is not None and number >= self.at_least))
            and (self.at_most is None or (number is not None and number <= self.at_most))
        )


class When(Fitting):
    """Show a stage only to whom an earlier answer fits."""

    model_config = an_example({"questionnaire": "about_you", "item": "pets", "is": "yes"})

    questionnaire: Slug


class ItemWhen(Fitting):
    """Ask an item, or a screen of items, only where an answer fits: to an item before it in the same questionnaire, or
    to one of `questionnaire`, which was asked in an earlier stage."""

    model_config = an_example({"item": "pets", "is": "yes"})

    questionnaire: Slug | None = None


def may_ask(item: Item, earlier: Earlier | None) -> bool:
    """Whether the answers to earlier questionnaires let the item be asked; None: nobody has answered yet, it may be."""
    if earlier is None:
        return True
    return all(one.fits((earlier(one.questionnaire) or {}).get(one.item)) for one in item.when if one.questionnaire)


def is_asked(item: Item, answers: Mapping[str, Any], earlier: Earlier | None) -> bool:
    """Whether the item is asked, given the answers to the items before it."""
    here = (one for one in item.when if one.questionnaire is None)
    return may_ask(item, earlier) and all(one.fits(answers.get(one.item)) for one in here)


def asks_anything(questionnaire: Questionnaire, earlier: Earlier) -> bool:
    """Whether anything of it may be asked of this participant."""
    return any(may_ask(item, earlier) for item in questionnaire.items)


def may_ask_something(questionnaire: Questionnaire, earlier: Earlier) -> bool:
    """The same of a later one: what depends on a questionnaire that was not answered yet may still be asked."""
    needed = {one.questionnaire for item in questionnaire.items for one in item.when if one.questionnaire is not None}
    return any(earlier(name) is None for name in needed) or asks_anything(questionnaire, earlier)


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
