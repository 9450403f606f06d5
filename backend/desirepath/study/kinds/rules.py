"""Kind of step `rules`: rules that last, told in sentences, seen as cards and pictures, corrected, ordered, revoked.

What is read of a sentence, and how a robot obeys, is `learning/rules`'s. The rules as they end, with every change on
the way there, and which of two pictures shows each as it was meant, are the answer.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from desirepath.grammar.parts import an_example
from desirepath.grammar.source import Path, Problem, Source
from desirepath.grammar.texts import local
from desirepath.learning.rules.rule import MOST_CHANGES as MOST_WISHES
from desirepath.learning.rules.rule import MOST_RULES, Rule
from desirepath.learning.words.lexicon import LONGEST
from desirepath.simulation.setup_parts import PLACES
from desirepath.study.kind import Acting, Moment, Page, Simulated
from desirepath.study.kinds.live import LONGEST_S, AskedLiveStage, LiveKind, LiveStep
from desirepath.study.kinds.words import language_of
from desirepath.study.steps import Pace, Planning, Stage
from desirepath.study.wire import STORED_IN_ROOM, BadValue, Besides, InRoomAnswer

if TYPE_CHECKING:
    from desirepath.simulation.scene import Scene
    from desirepath.simulation.trajectory import Trajectory

MOST_CHANGES = 400
ROOM_S, PER_RULE_S = 60.0, 120.0  # ours: to look around, to tell a rule and look at its paths
SPOKEN: Mapping[str, tuple[str, ...]] = {
    "en": ("When I sit, keep behind me", "In the kitchen go slower", "Never between me and the sofa"),
    "de": ("Wenn ich sitze, bleib hinter mir", "In der Küche langsamer", "Nie zwischen mir und dem Sofa"),
}
"""What simulated participants tell."""
Sentence = Annotated[str, Field(max_length=LONGEST)]
Side = Literal["a", "b"]


class RulesStage(AskedLiveStage):
    """The participant tells the robot rules in sentences: in which situation it should drive how, and where not."""

    model_config = an_example({"scenes": 3})

    measures = True

    setup: Literal["study_room"] = "study_room"
    least: int = Field(1, ge=0, le=MOST_RULES, description="rules that must be told")

    def plan(self, at: Planning) -> list[RulesStep]:  # type: ignore[override]  # a list of steps
        fields = {"setup": self.setup, "scenes": self.scenes, "view": self.view, "least": self.least}
        return [RulesStep.model_validate({"kind": "rules", "key": at.key, "stage": at.key, **fields})]

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return ROOM_S + PER_RULE_S * max(self.least, 1)

    def problems(self, here: Path, stages: Sequence[Stage], source: Source) -> Iterator[Problem]:
        if self.objectives:
            yield source.problem((*here, "objectives"), "is of tuning; a rule may say anything of all nine")


class RulesStep(LiveStep):
    """least: rules that must be told."""

    kind: Literal["rules"]
    least: int = 1


class RuleChange(BaseModel):
    """One thing was done. seconds: since the page was opened; rule: its place in the list, from 0, before it was done;
    words: the sentence of what was told or edited; to: its place after it was moved."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    seconds: float = Field(ge=0, le=LONGEST_S, allow_inf_nan=False)
    do: Literal["told", "edited", "answered", "drawn", "moved", "off", "on", "revoked"]
    rule: int = Field(ge=0, lt=MOST_RULES)
    words: Sentence = ""
    to: int | None = Field(None, ge=0, lt=MOST_RULES)


class Picked(BaseModel):
    """Which of two pictures shows a rule as it was meant; None: neither. place: in which of the homes."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    rule: int = Field(ge=0, lt=MOST_RULES)
    place: int = Field(ge=0, lt=PLACES)
    side: Side | None = None


class RulesAnswer(InRoomAnswer):
    """The rules in their order, every change on the way there, and the pictures that were picked."""

    rules: list[Rule] = Field([], max_length=MOST_RULES)
    history: list[RuleChange] = Field([], max_length=MOST_CHANGES)
    picked: list[Picked] = Field([], max_length=MOST_RULES)


class AboutRules(Besides):
    language: str | None = Field(None, description="in which sentences are read")
    least: int | None = Field(None, description="rules that must be told")


class Rules(LiveKind[RulesStep, RulesAnswer]):
    name = "rules"
    step = RulesStep
    answers = RulesAnswer
    besides = AboutRules
    stages = {"rules": RulesStage}
    stored = {
        "rules": "in their order: words (the sentence, free text), when (conditions), wishes (objectives, more or "
        "less), zones (where the robot must not drive; drawn ones in metres of a place), on (false: switched off)",
        "read": "for each rule whether it stands as its sentence was read, without an answer or a drawing",
        "history": "every change in order: seconds since the page was opened, do (told, edited, answered: asked back, "
        "drawn, moved, off, on, revoked), rule: its place in the list, words: the sentence, "
        "to: where it was moved",
        "edits": "how many of these came after a rule was told, switching on and off apart",
        "picked": "for each rule that was shown obeyed and broken: place, and whether the picture picked as meant was "
        "the obeyed one (obeyed, broken, neither)",
        **STORED_IN_ROOM,
    }

    def scene(self, step: RulesStep, place: int) -> tuple[Scene, tuple[Trajectory, ...]]:
        from desirepath.learning.rules.homes import rule_places

        return rule_places()[place], ()

    def payload(self, step: RulesStep, page: Page) -> dict[str, Any]:
        stage = page.stage_of(step, RulesStage)
        asked = local(stage.question, page.language) if stage is not None and stage.question else None
        shown = {"setup": step.setup, "scenes": step.scenes, "view": step.view, "controls": []}
        bounds = {"longest": LONGEST, "least": step.least, "most": MOST_RULES}
        more = {"most_wishes": MOST_WISHES, "most_changes": MOST_CHANGES}
        return shown | bounds | more | {"question": asked}

    def check(self, step: RulesStep, answer: RulesAnswer, page: Page) -> dict[str, Any]:
        from desirepath.learning.rules.reading import read_rule

        for number, rule in enumerate(answer.rules):
            if not rule.complete:
                raise BadValue(f"value.rules.{number}", rule.words, "is not complete: something is still asked back")
        if len(answer.rules) < step.least:
            raise BadValue("value.rules", len(answer.rules), f"must be {step.least} or more")
        for number, one in enumerate(answer.picked):
            if one.rule >= len(answer.rules) or one.place >= step.scenes:
                raise BadValue(f"value.picked.{number}", one.rule, "is of a rule and a place that there are")
        language = language_of(page.language)
        read = [read_rule(rule.words, language).rule.model_copy(update={"on": rule.on}) for rule in answer.rules]
        return {
            "rules": [rule.model_dump(mode="json") for rule in answer.rules],
            "read": [rule == own for rule, own in zip(answer.rules, read, strict=True)],
            "history": [change.model_dump(mode="json") for change in answer.history],
            "edits": sum(change.do in ("edited", "answered", "drawn", "moved", "revoked") for change in answer.history),
            "picked": [one.model_dump(mode="json") for one in answer.picked],
        }

    def keep(self, step: RulesStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        """Which picture was picked, by what it showed."""
        picked = []
        for one in stored["picked"]:
            obeyed = obeyed_side(acting.session.id, Rule.model_validate(stored["rules"][one["rule"]]), one["place"])
            shown = "neither" if one["side"] is None else "obeyed" if one["side"] == obeyed else "broken"
            picked.append({"rule": one["rule"], "place": one["place"], "shown": shown})
        return {"picked": picked}

    def tell_simulated(self, step: RulesStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        return {"language": moment.session.language, "least": step.least}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        """Tells some rules and leaves them as they were read."""
        from desirepath.learning.rules.reading import read_rule

        language = language_of(step.get("language") or "en")
        many = max(int(step.get("least") or 0), 1 + int(participant.random.integers(2)))
        sentences = [SPOKEN[language][k % len(SPOKEN[language])] for k in range(many)]
        told = [
            {"seconds": float(k), "do": "told", "rule": k, "words": sentence} for k, sentence in enumerate(sentences)
        ]
        rules = [read_rule(sentence, language).rule.model_dump(mode="json") for sentence in sentences]
        return {"rules": rules, "history": told, "picked": []}


def obeyed_side(session_id: str, rule: Rule, place: int) -> Side:
    """On which side the picture of the robot that obeys stands: by lot, and the same whenever it is asked for, whether
    the rule is switched on or off."""
    on = rule.model_copy(update={"on": True})
    lot = hashlib.sha256(f"{session_id}:{place}:{on.model_dump_json()}".encode()).digest()[0]
    return "a" if lot % 2 else "b"


KIND = Rules()
