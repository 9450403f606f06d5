"""What a protocol may say about a block: its conditions, its queries and probes, how drives may be watched."""

from __future__ import annotations

from itertools import product
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from backend.study.grammar.parts import FileName, Part, Slug
from backend.study.grammar.words import VIEWS, View

Levels = Annotated[list[Slug], Field(min_length=2, max_length=8)]


def _as_factors(given: object) -> object:
    return {"view": given} if isinstance(given, list) else given


Factors = Annotated[dict[Slug, Levels], BeforeValidator(_as_factors), Field(min_length=1, max_length=3)]
"""factor -> its levels; a plain list stands for {view: list}. `view` is a view, every other factor a word of the
protocol's own that names of texts may hold in braces."""


class Stopping(Part):
    """End the queries early once little is left to learn: when the best next answer promised less than `below_bits` of
    information for `in_a_row` queries, and at least `at_least` were answered.
    """

    below_bits: float = Field(0.1, gt=0, le=1)  # as in backend/learning/queries/choosing.py
    in_a_row: int = Field(3, ge=1, le=20)
    at_least: int = Field(8, ge=2, le=200)


class Probes(Part):
    """Asked to measure consistency (spec 07), beside the regular queries: `repeat` queries again as they were, `swap`
    with the sides changed. `transitivity`: so many scenes of which three drives are compared in all three pairs; the
    query set needs scenes with three drives or more.
    """

    repeat: int = Field(0, ge=0, le=50)
    swap: int = Field(0, ge=0, le=50)
    transitivity: int = Field(0, ge=0, le=20)

    @property
    def trials(self) -> int:
        """How many trials they are."""
        return self.repeat + self.swap + 3 * self.transitivity


class Queries(Part):
    """`count` queries of the query set. `learning` ones are marked and never analysed (spec 07).

    choose: `random` draws them before the session; `disagreement` and `information` choose each next one by the
    participant's own answers so far (spec 06).
    """

    count: int = Field(ge=1, le=200)
    role: Literal["learning", "regular"] = "regular"
    choose: Literal["random", "disagreement", "information"] = "random"
    stop: Stopping | None = Field(None, description="default: all queries are asked")
    probes: Probes = Probes()


class Trials(Part):
    """One entry of a block's `trials`."""

    queries: Queries


class Viewing(Part):
    """How a pair may be watched. The defaults are spec 07's: each drive once, to its end, before the choice.

    replays: how often both drives may be watched again before choosing. early_choice: the choice is possible once B
    has begun. choice_limit_s: time for the choice; after it the trial counts as not answered.
    """

    replays: int = Field(0, ge=0, le=5)
    early_choice: bool = False
    choice_limit_s: int | None = Field(None, ge=3, le=600)


class BlockText(Part):
    """A page of text in a block; `text` may hold the block's factors in braces: `texts/instruction_{view}.md`."""

    text: FileName


class BlockQuestionnaire(Part):
    """A questionnaire in a block, asked once per condition."""

    use: Slug
    time_limit_s: int | None = Field(None, ge=10, le=7200)


class BlockBreak(Part):
    """A rest; it can be ended after `at_least_s` seconds."""

    text: FileName
    at_least_s: int = Field(0, ge=0, le=1800)


BLOCK_PARTS = {"instruction": BlockText, "questionnaire": BlockQuestionnaire, "break": BlockBreak}


class BlockEntry(Part):
    """One entry of a block's `before`, `after` or `between`: exactly one of these keys."""

    instruction: BlockText | None = None
    questionnaire: BlockQuestionnaire | None = None
    break_: BlockBreak | None = Field(None, alias="break")

    @model_validator(mode="after")
    def _exactly_one(self) -> BlockEntry:
        if len([kind for kind in BLOCK_PARTS if self._of(kind)]) != 1:
            raise ValueError(f"must be exactly one of {', '.join(BLOCK_PARTS)}")
        return self

    def _of(self, kind: str) -> BlockText | BlockQuestionnaire | BlockBreak | None:
        found: BlockText | BlockQuestionnaire | BlockBreak | None = getattr(self, kind + "_" * (kind == "break"))
        return found

    @property
    def kind(self) -> str:
        return next(kind for kind in BLOCK_PARTS if self._of(kind))

    @property
    def part(self) -> BlockText | BlockQuestionnaire | BlockBreak:
        found = self._of(self.kind)
        assert found is not None  # noqa: S101  exactly one is given
        return found


class Condition(Part):
    """One cell of a block's crossing: what its trials are shown in. `name` is what trials carry as `block`."""

    name: str
    view: View
    levels: dict[str, str]

    def filled(self, text: str) -> str:
        """A text's name with this condition's levels in place of `{view}` and the block's other factors."""
        for factor, level in {"view": self.view, **self.levels}.items():
            text = text.replace(f"{{{factor}}}", level)
        return text


class BlockStage(Part):
    """Trials in one view, or the same trials once per condition.

    view: of a block without conditions. each: factors that every participant meets in all combinations, in the order of
    the assignment. one_of: factors of which each participant meets one combination (between participants), balanced by
    the assignment as well. same_queries: all conditions, and all blocks that say so, show the participant's own
    queries, the same ones, with the sides kept, in an order of each one's own. before, after: pages of every condition;
    between: pages between two conditions. attention_checks: so many pages among the regular trials of each condition
    that say which letter to press (a preference has no wrong answer).
    """

    view: View | None = None
    each: Factors | None = None
    one_of: Factors | None = None
    same_queries: bool = True
    before: list[BlockEntry] = []
    trials: list[Trials] = Field(min_length=1)
    after: list[BlockEntry] = []
    between: list[BlockEntry] = []
    viewing: Viewing = Viewing()
    attention_checks: int = Field(0, ge=0, le=10)

    @model_validator(mode="after")
    def _has_one_view_everywhere(self) -> BlockStage:
        given = [
            "view" if self.view else "",
            "each" if self._varies("each") else "",
            "one_of" if self._varies("one_of") else "",
        ]
        said = [name for name in given if name]
        if len(said) != 1:
            told = " and ".join(said) or "nothing"
            raise ValueError(f"must say the view once, as 'view', in 'each' or in 'one_of'; has {told}")
        twice = set(self.each or ()) & set(self.one_of or ())
        if twice:
            raise ValueError(f"has the factor {', '.join(sorted(twice))} in 'each' and in 'one_of'; keep one")
        for name, levels in [*(self.each or {}).items(), *(self.one_of or {}).items()]:
            if len(set(levels)) != len(levels):
                raise ValueError(f"the factor {name} has a level twice: {', '.join(levels)}")
            if name == "view" and (wrong := [level for level in levels if level not in VIEWS]):
                raise ValueError(f"{wrong[0]!r} is no view; views: {', '.join(VIEWS)}")
        if self.between and not self.each:
            raise ValueError("'between' stands between the conditions of 'each'; this block has one condition only")
        return self

    def _varies(self, where: Literal["each", "one_of"]) -> bool:
        return "view" in (getattr(self, where) or {})

    @property
    def groups(self) -> list[dict[str, str]]:
        """The combinations of `one_of`: a participant gets one of them. One empty one where there is none."""
        return _combinations(self.one_of)

    def conditions(self, group: int) -> list[Condition]:
        """What somebody of that group meets, in the order in which the protocol names them."""
        mine = self.groups[group]
        found = []
        for cell in _combinations(self.each):
            levels = {**cell, **mine}
            name = "-".join((cell or mine).values())
            view = levels.get("view") or self.view
            found.append(Condition(name=name, view=view, levels=levels))
        return found

    @property
    def sequence(self) -> list[BlockEntry]:
        """All its pages."""
        return [*self.before, *self.after, *self.between]


def _combinations(factors: dict[str, list[str]] | None) -> list[dict[str, str]]:
    if not factors:
        return [{}]
    return [dict(zip(factors, cell, strict=True)) for cell in product(*factors.values())]
