"""What a questionnaire may say: items, their types, validated scales by name. The scales: `analysis/scales.py`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, WithJsonSchema, field_validator, model_validator

from desirepath.grammar.error_words import parse
from desirepath.grammar.parts import Language, Localized, Part, Slug, Value, an_example
from desirepath.grammar.source import Source
from desirepath.grammar.when import ItemWhen

MARKS = ("timed_out", "passed")  # in a questionnaire's value beside the items' answers


class Option(Part):
    """One answer of a choice, or one thing to rank."""

    value: Value
    label: Localized


class Plate(Part):
    """A disc of dots with a digit that eyes without one kind of cone do not see; of a `control`, every eye does."""

    shows: Literal["2", "3", "5", "6", "8", "9"]
    of: Literal["control", "protan", "deutan"]


class Item(Part):
    """One question. scale: 1 to `points` with labelled ends; choice: one of `options`; ranking: all `options`, best
    first, no ties; number: whole; text.

    reversed: agreeing means less of what is measured; the answer is stored as given, scoring turns it round. correct:
    the right answer in a comprehension check. instructed: an attention check whose text says what to answer; a wrong
    answer is stored, marked, never refused. when: asked only where all of these fit; a file gives one. plate: of a
    choice, what is looked at for it.
    """

    model_config = an_example({"key": "pets", "type": "number", "text": {"en": "How many pets do you have?"}})

    key: Slug
    type: Literal["scale", "choice", "ranking", "number", "text"]
    text: Localized
    required: bool = True
    points: int = Field(7, ge=2, le=21)  # 21: the gradations of the raw TLX
    low: Localized | None = None
    high: Localized | None = None
    reversed: bool = False
    options: list[Option] = []
    min: int | None = None
    max: int | None = None
    max_length: int = Field(2000, ge=1, le=2000)
    correct: Value | None = None
    instructed: Value | None = None
    plate: Plate | None = None
    when: Annotated[list[ItemWhen], WithJsonSchema(ItemWhen.model_json_schema())] = []

    @field_validator("when", mode="before")
    @classmethod
    def _as_list(cls, given: Any) -> Any:
        return [given] if isinstance(given, dict) else given

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Item:
        if self.key in MARKS:
            raise ValueError(f"'key' = {self.key!r} is what answers are marked with; choose another")
        if self.type == "scale" and (self.low is None or self.high is None):
            raise ValueError("a scale needs 'low' and 'high', the labels of its ends")
        if self.type in ("choice", "ranking") and len(self.options) < 2:
            raise ValueError(f"a {self.type} needs at least two 'options'")
        values = [option.value for option in self.options]
        if len(set(values)) != len(values):
            raise ValueError(f"'options' has a value twice; every option needs its own, there are {', '.join(values)}")
        if self.reversed and self.type != "scale":
            raise ValueError(f"'reversed' is for scales; this is a {self.type}")
        if self.plate and (self.type != "choice" or self.plate.shows not in values):
            raise ValueError(f"'plate' shows {self.plate.shows}, which must be one of the 'options' of a choice")
        for name in ("correct", "instructed"):
            self._check_key(name, getattr(self, name), values)
        return self

    def _check_key(self, name: str, value: str | None, values: list[str]) -> None:
        if value is None:
            return
        allowed = values if self.type == "choice" else [str(n) for n in range(1, self.points + 1)]
        if self.type not in ("choice", "scale"):
            raise ValueError(f"'{name}' needs a choice or a scale; this is a {self.type}")
        if value not in allowed:
            raise ValueError(f"'{name}' = {value!r} is none of the answers: {', '.join(allowed)}")


class ItemBlock(Part):
    """Items that share a screen, or a validated scale by its name: then its items, verbatim, are what is asked.

    Whoever gives the items themselves beside `scale` must give them word by word (`protocol/reading.py` compares
    hashes). when: the screen is shown only where it fits; every item of it then carries the condition, before its own.
    """

    when: ItemWhen | None = None
    title: Localized | None = None
    scale: Slug | None = None
    items: list[Item] = []

    @model_validator(mode="after")
    def _asks_something(self) -> ItemBlock:
        if not self.items and self.scale is None:
            raise ValueError("needs 'items', or 'scale' with the name of a validated scale")
        return self

    def with_items(self, items: list[Item]) -> ItemBlock:
        """The screen with these items, each of which carries the screen's condition."""
        shared = [self.when] if self.when else []
        return self.model_copy(update={"items": [i.model_copy(update={"when": [*shared, *i.when]}) for i in items]})


class Instrument(Part):
    """What a questionnaire is known as and may be used for. `translations`: of each language, where its words are from;
    a language that a text is not in is shown the original, marked. `scales`: only of instruments that are shipped."""

    model_config = an_example({"names": ["My scale"], "measures": {"en": "ease"}, "source": "...", "licence": "..."})

    names: list[str] = Field(min_length=1, max_length=10)
    measures: Localized
    source: str = Field(max_length=2000)
    licence: str = Field(max_length=2000)
    translations: dict[Language, str] = {}
    scales: dict[Slug, dict[str, Any]] = {}


class Questionnaire(Part):
    """A questionnaire file; with `instrument`, one that others know, too."""

    instrument: Instrument | None = None
    title: Localized
    text: Localized | None = None
    blocks: list[ItemBlock] = Field(min_length=1)

    @property
    def items(self) -> list[Item]:
        return [item for block in self.blocks for item in block.items]


def frozen_questionnaire(file: str, content: str) -> Questionnaire:
    """A study's own copy of a questionnaire; the items of scales lie beside it. Raises ProtocolError."""
    return parse(Source(file, content), Questionnaire, strict=False)
