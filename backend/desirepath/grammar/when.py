"""What `when` may say, and whether an answer fits. Which items are asked after which answers is `skipping.py`'s."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any

from pydantic import Field, model_validator

from desirepath.grammar.parts import Part, Slug, Value, an_example

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
