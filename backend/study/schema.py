"""What a study protocol may say: every key, what it may hold, its default. Reading files and checks across keys live in
`protocol.py`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from backend.study.words import STAGE_KINDS, View

Localized = Annotated[dict[str, str], Field(min_length=1)]
"""A text in each of the protocol's languages: {en: ..., de: ...}."""
FileName = Annotated[str, Field(min_length=1, max_length=200)]
Version = Annotated[str, BeforeValidator(str), Field(min_length=1, max_length=40)]
PATTERNS = {
    r"^[a-z][a-z0-9_]*$": "must be lower-case letters, digits and _, beginning with a letter",
    r"^[A-Za-z0-9-]{4,40}$": "must be random, or 4 to 40 letters, digits and -",
    r"^https://\S+$": "must be an address that begins with https://",
    r"^[a-z]{2}$": "must be a language code of two lower-case letters, such as en",
}
"""Every pattern below, in words for the person who wrote the protocol."""
_SLUG, _CODE, _ADDRESS, _LANGUAGE = PATTERNS
Slug = Annotated[str, Field(pattern=_SLUG, max_length=60)]


class Part(BaseModel):
    """Base of everything in a protocol: an unknown key is an error, nothing changes once it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Assignment(Part):
    """How participants differ. `random`: each gets their own queries, order and sides, from `seed` and their code."""

    scheme: Literal["random"] = "random"
    seed: int = Field(0, ge=0)


class TextStage(Part):
    """A page of text; `text` names a markdown file with one variant per language (`information.en.md`)."""

    text: FileName


class ConsentStage(Part):
    """Consent. Lines `- [ ] ...` at the end of the text are points that are ticked one by one."""

    text: FileName
    version: Version


class QuestionnaireStage(Part):
    """`use` names a file in `questionnaires/`."""

    use: Slug


class Probes(Part):
    """Queries asked again to measure consistency (spec 07): `repeat` as they were, `swap` with the sides changed."""

    repeat: int = Field(0, ge=0, le=50)
    swap: int = Field(0, ge=0, le=50)


class Stopping(Part):
    """End the queries early once little is left to learn: when the best next answer promised less than `below_bits` of
    information for `in_a_row` queries, and at least `at_least` were answered.
    """

    below_bits: float = Field(0.1, gt=0, le=1)  # as in backend/learning/choosing.py
    in_a_row: int = Field(3, ge=1, le=20)
    at_least: int = Field(8, ge=2, le=200)


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


class BlockStage(Part):
    """The trials of one condition, all in one view."""

    view: View
    trials: list[Trials] = Field(min_length=1)


class Meanwhile(Part):
    """What the participant does while the job runs."""

    questionnaire: Slug


class TrainStage(Part):
    """Starts when the answer before it is stored; the participant waits at most `give_up_after_s` after `while`.

    recipe: `instant` is recipe A of spec 06 (the policy is there at once; a refinement runs behind it and takes its
    place where it is better), `refine` recipe B, `thesis` the one of thesis 6.4.
    """

    job: Literal["align"] = "align"
    on: Literal["own_answers"] = "own_answers"
    recipe: Literal["instant", "refine", "thesis"] = "instant"
    meanwhile: Meanwhile | None = Field(None, alias="while")
    give_up_after_s: int = Field(120, ge=1, le=1800)  # DESIGN.md, sketch of a protocol


class ComparisonStage(Part):
    """Base policy and own policy in `scenes` new scenes, blind, sides drawn by lot in each; then, if `guess`, which
    drive of the last pair came from the participant's own answers.
    """

    arms: tuple[Literal["base"], Literal["own"]] = ("base", "own")
    scenes: int = Field(3, ge=1, le=10)
    blind: Literal[True] = True
    view: View | None = Field(None, description="default: the view of the block before")
    guess: bool = True


class DebriefingStage(Part):
    """The last page. completion_code: `random`, or one code for everybody. return_url: may hold `{code}`."""

    text: FileName
    completion_code: Annotated[str, BeforeValidator(str), Field(pattern=_CODE)] = "random"
    return_url: Annotated[str, Field(pattern=_ADDRESS, max_length=400)] | None = None


Stage = TextStage | ConsentStage | QuestionnaireStage | BlockStage | TrainStage | ComparisonStage | DebriefingStage


class StageEntry(Part):
    """One entry of `stages`: exactly one of these keys."""

    information: TextStage | None = None
    consent: ConsentStage | None = None
    questionnaire: QuestionnaireStage | None = None
    instruction: TextStage | None = None
    block: BlockStage | None = None
    train: TrainStage | None = None
    comparison: ComparisonStage | None = None
    debriefing: DebriefingStage | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> StageEntry:
        given = [kind for kind in STAGE_KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            what = " and ".join(given) or "nothing"
            raise ValueError(f"must be exactly one stage, has {what}; one of {', '.join(STAGE_KINDS)}")
        return self

    @property
    def kind(self) -> str:
        return next(kind for kind in STAGE_KINDS if getattr(self, kind) is not None)

    @property
    def stage(self) -> Stage:
        found: Stage = getattr(self, self.kind)
        return found


class Protocol(Part):
    """A study protocol. `query_set`: name of a shipped set, id of one made here, or path of a `.npz` file."""

    protocol: Slug
    version: int = Field(ge=1)
    title: Localized
    languages: list[Annotated[str, Field(pattern=_LANGUAGE)]] = Field(min_length=1)
    minutes: int = Field(15, ge=1, le=240, description="how long a session takes, as participants are told")
    participants: int | None = Field(None, ge=1, description="how many people are taken in; default as many as come")
    link_valid_days: int = Field(14, ge=1, le=365, description="how long a session can be continued")
    contact: str | None = Field(None, max_length=200, description="whom participants may ask; default the house's")
    licence: str | None = Field(None, max_length=200, description="of the data, written into every export")
    citation: str | None = Field(None, max_length=400, description="how to cite the data")
    assignment: Assignment = Assignment()
    symmetry: Literal["none", "left_right"] = Field(
        "none", description="left_right: nobody minds on which side the robot passes, so no answer is read as a side"
    )
    query_set: str = Field(min_length=1, max_length=300)
    stages: list[StageEntry] = Field(min_length=1)


class Option(Part):
    """One answer of a choice."""

    value: Annotated[str, BeforeValidator(str), Field(min_length=1, max_length=60)]
    label: Localized


class Item(Part):
    """One question. scale: 1 to `points` with labelled ends; choice: one of `options`; number; text."""

    key: Slug
    type: Literal["scale", "choice", "number", "text"]
    text: Localized
    required: bool = True
    points: int = Field(7, ge=2, le=11)
    low: Localized | None = None
    high: Localized | None = None
    options: list[Option] = []
    min: int | None = None
    max: int | None = None
    max_length: int = Field(2000, ge=1, le=2000)

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Item:
        if self.type == "scale" and (self.low is None or self.high is None):
            raise ValueError("a scale needs 'low' and 'high', the labels of its ends")
        if self.type == "choice" and len(self.options) < 2:
            raise ValueError("a choice needs at least two 'options'")
        return self


class ItemBlock(Part):
    """Items that share a screen."""

    title: Localized | None = None
    items: list[Item] = Field(min_length=1)


class Questionnaire(Part):
    """A questionnaire file."""

    title: Localized
    text: Localized | None = None
    blocks: list[ItemBlock] = Field(min_length=1)

    @property
    def items(self) -> list[Item]:
        return [item for block in self.blocks for item in block.items]


def json_schema() -> dict[str, Any]:
    """JSON Schema of a protocol, for editors."""
    return Protocol.model_json_schema(by_alias=True)
