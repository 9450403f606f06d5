"""Kind of step `questionnaire`: items of every type, validated scales, attention checks among them, time limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, WithJsonSchema
from sqlalchemy import select

from desirepath.analysis.colour_plates import colour_plate
from desirepath.grammar.conditions import Condition
from desirepath.grammar.parts import Slug, an_example
from desirepath.grammar.questionnaires import Item, Questionnaire
from desirepath.grammar.skipping import asks_anything, is_asked, may_ask, may_ask_something
from desirepath.grammar.source import Path
from desirepath.grammar.texts import local
from desirepath.grammar.when import Earlier, ItemWhen
from desirepath.store.models import Participant, Response, Session, Study
from desirepath.study.kind import Kind, Moment, Page, Simulated, seconds_left
from desirepath.study.personalising.controller_rollouts import rollouts_for
from desirepath.study.plan.assignment import places_held_by
from desirepath.study.steps import BlockPart, Planning, Stage, Step
from desirepath.study.wire import Answer, BadValue, Besides, Flag, whole

if TYPE_CHECKING:
    import numpy as np

    from desirepath.report.simulated_cohorts import SimulatedPerson

LARGEST_NUMBER = 10**12  # ours; beyond 2^53 no table holds it exactly, and beyond 10^308 none holds it at all


class BlockQuestionnaire(BlockPart):
    """A questionnaire in a block, asked once per condition."""

    model_config = an_example({"use": "interface_items"})

    use: Slug
    time_limit_s: int | None = Field(None, ge=10, le=7200)

    def step(self, prefix: str, place: str, condition: Condition, where: Mapping[str, Any]) -> Step:
        return QuestionnaireStep.of(f"{prefix}.{self.use}", self.use, self.time_limit_s, **where)

    def questionnaires(self) -> Iterator[tuple[str, str]]:
        yield self.use, "use"


class QuestionnaireStage(Stage):
    """`use` names a file in `questionnaires/`. time_limit_s: what is filled in by then is stored."""

    model_config = an_example({"use": "demographics"})

    asks = True

    use: Slug
    time_limit_s: int | None = Field(None, ge=10, le=7200)

    def plan(self, at: Planning) -> list[Step]:
        return [QuestionnaireStep.of(at.key, self.use, self.time_limit_s, stage=at.key)]

    def own_name(self) -> str | None:
        return self.use

    def questionnaires(self) -> Iterator[tuple[str, Path]]:
        yield self.use, ("use",)


class AskingStep(Step):
    """A step that asks a questionnaire."""

    questionnaire: str
    time_limit_s: int | None = None

    def least_s(self, *, timed_out: bool) -> int:
        return self.time_limit_s or 0 if timed_out else 0

    @property
    def most_s(self) -> int | None:
        return self.time_limit_s

    @property
    def title_of(self) -> tuple[Literal["text", "questionnaire"], str] | None:
        return "questionnaire", self.questionnaire

    @property
    def sort(self) -> tuple[str, ...]:
        return (*super().sort, self.questionnaire)


class QuestionnaireStep(AskingStep):
    """environment: of the controller that it asks about, in an evaluation."""

    kind: Literal["questionnaire"]
    environment: str | None = None

    @classmethod
    def of(cls, key: str, questionnaire: str, time_limit_s: int | None = None, **where: Any) -> QuestionnaireStep:
        """A step with what is said alone. where: stage, block and so on."""
        limited = {"time_limit_s": time_limit_s} if time_limit_s is not None else {}
        fields = {"kind": "questionnaire", "key": key, **where, "questionnaire": questionnaire, **limited}
        return cls.model_validate(fields)


A = TypeVar("A", bound=AskingStep)

_ANSWERS = [{"type": "integer"}, {"type": "string"}, {"type": "array", "items": {"type": "string"}}, {"type": "null"}]
ItemAnswer = Annotated[Any, WithJsonSchema({"anyOf": _ANSWERS})]
"""A number, a value, a text, or all values of a ranking, best first. Which, the item says."""


class QuestionnaireAnswer(Answer):
    """The answers by item. timed_out: what was filled in when the time was over."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, ItemAnswer]

    timed_out: Flag = False


class Option(BaseModel):
    value: str
    label: str


class AskedItem(BaseModel):
    """An item as it is shown, and the right answer where there is one."""

    key: str
    type: str
    text: str
    required: bool
    when: list[ItemWhen] | None = None
    low: str | None = None
    high: str | None = None
    points: int | None = None
    options: list[Option] | None = None
    min: int | None = None
    max: int | None = None
    answer: str | None = None


class AboutQuestionnaire(Besides):
    questionnaire: str | None = None
    items: list[AskedItem] | None = None


class Asking(Kind[A, QuestionnaireAnswer]):
    """What questionnaires and comprehension checks share."""

    answers = QuestionnaireAnswer
    besides = AboutQuestionnaire

    def payload(self, step: A, page: Page) -> dict[str, Any]:
        asked = page.frozen.questionnaires[step.questionnaire]
        return show_questionnaire(asked, page.language, page.earlier) | {"time_limit_s": step.time_limit_s}

    def payload_now(self, step: A, moment: Moment) -> dict[str, Any]:
        return {"time_left_s": seconds_left(step.time_limit_s, moment)} if step.time_limit_s else {}

    def is_asked(self, step: A, moment: Moment) -> bool:
        return asks_anything(moment.frozen.questionnaires[step.questionnaire], moment.answer_to)

    def may_come(self, step: A, moment: Moment) -> bool:
        return may_ask_something(moment.frozen.questionnaires[step.questionnaire], moment.answer_to)

    def check(self, step: A, answer: QuestionnaireAnswer, page: Page) -> dict[str, Any]:
        questionnaire = page.frozen.questionnaires[step.questionnaire]
        over = answer.timed_out and step.time_limit_s is not None
        answers = _answers(questionnaire, answer.model_extra or {}, page.earlier, over=over)
        answers |= self.marks(questionnaire, answers, page.earlier)
        instructed = [item for item in questionnaire.items if item.instructed is not None and item.key in answers]
        if instructed:  # attention checks: marked, never refused
            right = all(str(answers[item.key]) == item.instructed for item in instructed)
            answers["passed"] = answers.get("passed", True) and right
        return answers | ({"timed_out": True} if over else {})

    def marks(self, questionnaire: Questionnaire, answers: dict[str, Any], earlier: Earlier | None) -> dict[str, Any]:
        """What the answers are marked with."""
        return {}

    def tell_simulated(self, step: A, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        right = {
            item.key: item.correct or item.instructed for item in moment.frozen.questionnaires[step.questionnaire].items
        }
        items = [item for block in payload["blocks"] for item in block["items"]]
        return {
            "questionnaire": step.questionnaire,
            "items": [item | {"answer": right[item["key"]]} for item in items],
        }

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        answers: dict[str, Any] = {}
        for item in step.get("items", []):
            # drawn in any case, so that simulated participants stay comparable
            value = _simulated(item, step.get("block"), participant.random, participant.person)
            if all(
                ItemWhen.model_validate(condition).fits(answers.get(condition["item"]))
                for condition in item.get("when", ())
            ):
                answers[item["key"]] = value
        return answers


class AskQuestionnaire(Asking[QuestionnaireStep]):
    name = "questionnaire"
    step = QuestionnaireStep
    stored = {
        "ITEM": "answer by item; a ranking is the list of values, best first",
        "passed": "attention checks: whether all were right",
        "timed_out": "true where the time was over",
    }
    stages = {"questionnaire": QuestionnaireStage}
    block_parts = {"questionnaire": BlockQuestionnaire}

    def is_asked(self, step: QuestionnaireStep, moment: Moment) -> bool:
        if not super().is_asked(step, moment):
            return False
        return step.environment is None or bool(
            rollouts_for(moment.s, moment.session, step.environment, str(step.block))
        )

    def ends(self, step: QuestionnaireStep, moment: Moment, stored: Mapping[str, Any]) -> str | None:
        for quota in moment.frozen.protocol.quotas:
            if quota.questionnaire == step.questionnaire and str(stored.get(quota.item)) == quota.is_:
                keys = [
                    step_asked.key
                    for step_asked in moment.plan
                    if getattr(step_asked, "questionnaire", None) == quota.questionnaire
                ]
                if len(_others(moment, keys, quota.item, quota.is_)) >= quota.most:
                    return "quota"
        return None


def _others(moment: Moment, keys: list[str], item: str, answer: str) -> set[str]:
    """Who else gave that answer and still counts. The study is locked, so that two cannot take the last place."""
    s = moment.s
    study = s.execute(select(Study).where(Study.id == moment.session.study_id).with_for_update()).scalar_one()
    given = s.execute(
        select(Participant.id, Response.value)
        .join(Session, Session.participant_id == Participant.id)
        .join(Response, Response.session_id == Session.id)
        .where(
            Participant.study_id == study.id,
            Participant.id != moment.session.participant_id,
            Response.step_key.in_(keys),
        )
    )
    same = {person for person, value in given if str(value.get(item)) == answer}
    me = s.get_one(Participant, moment.session.participant_id)
    protocol = moment.frozen.protocol
    return same & places_held_by(s, study, protocol, simulated=me.simulated, pilot=me.pilot)


# ---- what is shown ---------------------------------------------------------------------------------------------------


def show_questionnaire(questionnaire: Questionnaire, language: str, earlier: Earlier | None) -> dict[str, Any]:
    """A questionnaire in one language, without items that earlier answers leave out."""
    asked = [(block, [item for item in block.items if may_ask(item, earlier)]) for block in questionnaire.blocks]
    return {
        "title": local(questionnaire.title, language),
        "text": local(questionnaire.text, language) if questionnaire.text else "",
        "blocks": [
            {
                "title": local(block.title, language) if block.title else None,
                "items": [_shown(item, language) for item in items],
            }
            for block, items in asked
            if items
        ],
    }


def _shown(item: Item, language: str) -> dict[str, Any]:
    shown: dict[str, Any] = {
        "key": item.key,
        "type": item.type,
        "text": local(item.text, language),
        "required": item.required,
    }
    if language not in item.text:  # of an instrument without a translation: the original wording, marked
        shown["lang"] = next(iter(item.text))
    if here := [condition for condition in item.when if condition.questionnaire is None]:
        shown["when"] = [condition.model_dump(by_alias=True, exclude_none=True) for condition in here]
    if item.low and item.high:
        shown |= {"low": local(item.low, language), "high": local(item.high, language)}
    if item.type == "scale":
        shown["points"] = item.points
    if item.plate:
        shown["plate"] = colour_plate(item.plate.shows, item.plate.of)
    if item.type in ("choice", "ranking"):
        shown["options"] = [{"value": option.value, "label": local(option.label, language)} for option in item.options]
    elif item.type == "number":
        shown |= {"min": item.min, "max": item.max}
    return shown


# ---- what is answered ------------------------------------------------------------------------------------------------


def _answers(
    questionnaire: Questionnaire, value: dict[str, Any], earlier: Earlier | None, *, over: bool
) -> dict[str, Any]:
    """The answers by item. over: the time was over, so what is missing is left out instead of asked for."""
    known = {item.key: item for item in questionnaire.items}
    for key in value:
        if key not in known:
            raise BadValue(f"value.{key}", value[key], f"is no item of this questionnaire; items: {', '.join(known)}")
    answers: dict[str, Any] = {}
    for key, item in known.items():
        if not is_asked(item, answers, earlier):
            if value.get(key) not in (None, "", []):
                raise BadValue(f"value.{key}", None, "is not asked after the other answers")
        elif value.get(key) not in (None, "", []):
            answers[key] = _checked(item, value[key])
        elif item.required and not over:
            raise BadValue(f"value.{key}", None, "has no answer yet")
    return answers


def _checked(item: Item, given: Any) -> Any:
    field = f"value.{item.key}"
    allowed = [option.value for option in item.options]
    if item.type == "choice":
        if given not in allowed:
            raise BadValue(field, given, f"must be one of {', '.join(allowed)}")
        return given
    if item.type == "ranking":
        if not isinstance(given, list) or sorted(map(str, given)) != sorted(allowed):
            raise BadValue(
                field, str(given)[:200], f"must be a list of all of {', '.join(allowed)}, best first, no ties"
            )
        return given
    if item.type == "text":
        if not isinstance(given, str) or len(given) > item.max_length:
            raise BadValue(field, None, f"must be a text of at most {item.max_length} characters")
        return given
    return whole_number(field, given, *((1, item.points) if item.type == "scale" else (item.min, item.max)))


def whole_number(field: str, given: Any, low: int | None, high: int | None) -> int:
    """A whole number within limits, also one that was typed. Raises BadValue."""
    try:
        number = whole(given)
    except ValueError as wrong:
        raise BadValue(field, given, str(wrong)) from None
    return within(field, number, low, high)


def within(field: str, number: int, low: int | None, high: int | None) -> int:
    """The number, which must be within the limits. Raises BadValue."""
    low, high = -LARGEST_NUMBER if low is None else low, LARGEST_NUMBER if high is None else high
    if not low <= number <= high:
        raise BadValue(field, str(number)[:40], f"must be a whole number from {low} to {high}")
    return number


def _simulated(
    item: Mapping[str, Any], condition: str | None, random: np.random.Generator, person: SimulatedPerson | None
) -> Any:
    if item.get("answer") is not None:  # a comprehension or attention check
        return int(item["answer"]) if item["type"] == "scale" else item["answer"]
    options = [option["value"] for option in item.get("options", [])]
    if item["type"] == "scale":
        return (
            person.rate(item["key"], condition, item["points"])
            if person
            else int(random.integers(1, item["points"] + 1))
        )
    if item["type"] == "ranking":
        return person.rank(item["key"], options) if person else [options[k] for k in random.permutation(len(options))]
    if item["type"] == "choice":
        return options[int(random.integers(len(options)))]
    if item["type"] == "number":
        low = item["min"] if item["min"] is not None else 0
        high = item["max"] if item["max"] is not None else low + 100
        return int(random.integers(low, high + 1))
    return "simulated"


KIND = AskQuestionnaire()
