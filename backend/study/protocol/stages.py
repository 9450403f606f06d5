"""What a protocol may say about each of its stages. Blocks of trials are in `schema_blocks.py`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from backend.study.grammar.parts import Address, Code, FileName, Localized, Part, Slug, Version
from backend.study.grammar.skipping import When
from backend.study.grammar.words import STAGE_KINDS, View
from backend.study.protocol.blocks import BlockBreak, BlockStage
from backend.study.protocol.demonstration_stages import DemonstrationsStage, EvaluationStage


class TextStage(Part):
    """A page of text; `text` names a markdown file with one variant per language (`information.en.md`)."""

    text: FileName


class ConsentStage(Part):
    """Consent. Lines `- [ ] ...` at the end of the text are points that are ticked one by one.

    purposes: what may be agreed to or not beside the study itself, each with its sentence. `training`: learning models
    from the answers; `open_data`: publishing them. Who does not agree takes part all the same.
    """

    text: FileName
    version: Version
    purposes: dict[Literal["training", "open_data"], Localized] = {}


class QuestionnaireStage(Part):
    """`use` names a file in `questionnaires/`. time_limit_s: what is filled in by then is stored."""

    use: Slug
    time_limit_s: int | None = Field(None, ge=10, le=7200)


class ComprehensionStage(Part):
    """Questions with one right answer each (`correct`). Who errs `attempts` times leaves kindly (`end`) or goes on.

    text: a page of text that is shown above the questions again from the second attempt on.
    """

    use: Slug
    attempts: int = Field(2, ge=1, le=5)
    on_failure: Literal["end", "go_on"] = "end"
    text: FileName | None = None
    time_limit_s: int | None = Field(None, ge=10, le=7200)


class AppointmentStage(Part):
    """Here one appointment ends. The next begins at the earliest `after_days` later and at the latest `within_days`,
    with a link or code that is shown, on any device.
    """

    text: FileName
    after_days: float = Field(1.0, ge=0, le=365)
    within_days: float = Field(14.0, gt=0, le=730)

    @model_validator(mode="after")
    def _has_a_window(self) -> AppointmentStage:
        if self.within_days <= self.after_days:
            raise ValueError(f"within_days = {self.within_days:g} must be more than after_days = {self.after_days:g}")
        return self


class Meanwhile(Part):
    """What the participant does while the job runs."""

    questionnaire: Slug


def _recipe_in_new_words(given: object) -> object:
    """Protocols of before call fine-tuning `refine`."""
    return "fine_tuning" if given == "refine" else given


class TrainStage(Part):
    """Starts when the answer before it is stored; the participant waits at most `give_up_after_s` after `while`.

    job: `align` learns from choices between drives, `demonstrations` from drawn paths, one controller per environment.
    recipe (of `align`): `instant` is there at once (a conditioning search runs behind it and takes its place where it
    is better), `fine_tuning` trains on the learned reward, `thesis` as in thesis 6.4.
    """

    job: Literal["align", "demonstrations"] = "align"
    on: Literal["own_answers"] = "own_answers"
    recipe: Annotated[Literal["instant", "fine_tuning", "thesis"], BeforeValidator(_recipe_in_new_words)] = "instant"
    meanwhile: Meanwhile | None = Field(None, alias="while")
    give_up_after_s: int = Field(120, ge=1, le=1800)  # DESIGN.md, sketch of a protocol


class ComparisonStage(Part):
    """Base policy and own policy in `scenes` new scenes, blind, sides drawn by lot in each; then, if `guess`, which
    drive of the last pair came from the participant's own answers. Who drew paths sees `dwa`, the dynamic window
    approach (spec 02), in place of `base`.

    `other` as a third arm: in `scenes` further scenes the own policy against that of another participant, the one whose
    alignment was ready last (yoked). Who prefers the own one there does not merely like what everybody likes.
    """

    arms: tuple[Literal["base", "dwa", "own", "other"], ...] = ("base", "own")
    scenes: int = Field(3, ge=1, le=10)
    blind: Literal[True] = True
    view: View | None = Field(None, description="default: the view of the block before")
    guess: bool = True

    @field_validator("arms")
    @classmethod
    def _can_be(cls, arms: tuple[str, ...]) -> tuple[str, ...]:
        if arms not in (("base", "own"), ("base", "own", "other"), ("dwa", "own")):
            raise ValueError("must be [base, own], [base, own, other] or [dwa, own]")
        return arms

    @property
    def opponents(self) -> tuple[str, ...]:
        """What the own policy is compared with, `scenes` times each."""
        return tuple(arm for arm in self.arms if arm != "own")

    @property
    def pairs(self) -> int:
        """How many comparisons there are."""
        return self.scenes * len(self.opponents)


class DebriefingStage(Part):
    """The last page. completion_code: `random`, or one code for everybody. return_url: may hold `{code}`."""

    text: FileName
    completion_code: Code = "random"
    return_url: Address | None = None


Stage = (
    TextStage
    | ConsentStage
    | QuestionnaireStage
    | ComprehensionStage
    | BlockBreak
    | BlockStage
    | DemonstrationsStage
    | TrainStage
    | ComparisonStage
    | EvaluationStage
    | AppointmentStage
    | DebriefingStage
)


class StageEntry(Part):
    """One entry of `stages`: exactly one of these keys, and `when` if not everybody shall meet it."""

    information: TextStage | None = None
    consent: ConsentStage | None = None
    questionnaire: QuestionnaireStage | None = None
    comprehension: ComprehensionStage | None = None
    instruction: TextStage | None = None
    block: BlockStage | None = None
    demonstrations: DemonstrationsStage | None = None
    break_: BlockBreak | None = Field(None, alias="break")
    train: TrainStage | None = None
    comparison: ComparisonStage | None = None
    evaluation: EvaluationStage | None = None
    appointment: AppointmentStage | None = None
    debriefing: DebriefingStage | None = None
    when: When | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> StageEntry:
        given = [kind for kind in STAGE_KINDS if self._of(kind) is not None]
        if len(given) != 1:
            what = " and ".join(given) or "nothing"
            raise ValueError(f"must be exactly one stage, has {what}; one of {', '.join(STAGE_KINDS)}")
        return self

    def _of(self, kind: str) -> Stage | None:
        found: Stage | None = getattr(self, kind + "_" * (kind == "break"))
        return found

    @property
    def kind(self) -> str:
        return next(kind for kind in STAGE_KINDS if self._of(kind) is not None)

    @property
    def stage(self) -> Stage:
        found = self._of(self.kind)
        assert found is not None  # noqa: S101  exactly one is given
        return found


def stage_keys(stages: list[StageEntry]) -> list[str]:
    """A short name for every stage, unique within the protocol; plan steps carry it as `stage`."""
    keys: list[str] = []
    for entry in stages:
        stage = entry.stage
        name = stage.use if isinstance(stage, QuestionnaireStage) else entry.kind
        same = sum(1 for key in keys if key == name or key.startswith(f"{name}_"))
        keys.append(f"{name}_{same + 1}" if same else name)
    return keys
