"""A stored answer as pages show it: what was asked and what was said, in the reader's words. Knows no table and renders
nothing; the stored form stays beside it, for whoever works with exports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from desirepath.explain.flow_words import ExplanationWords
from desirepath.grammar.questionnaires import MARKS, Item, Questionnaire
from desirepath.grammar.texts import local
from desirepath.learning.rules.rule import Condition, Rule
from desirepath.store.marks import marks_in
from desirepath.study.kinds import meet_your_robot, robot_drive
from desirepath.study.kinds.rating import RATING, RatingStage
from desirepath.study.protocol.freezing import FrozenProtocol
from desirepath.web.core.catalogues import Catalogue

WORDS = "lab.answers.said"


class Said(NamedTuple):
    """One line of an answer. asked: empty where the kind of answer says it already."""

    asked: str
    answer: str


@dataclass(frozen=True)
class AnswerWords:
    """versions: the study's protocols, the newest first."""

    t: Catalogue
    versions: Sequence[FrozenProtocol]

    def title(self, name: str) -> str | None:
        """What participants read above the questionnaire of that name; None for a name that is none's."""
        found = next((one.questionnaires[name] for one in self.versions if name in one.questionnaires), None)
        return local(found.title, self.t.language) if found else None

    def item(self, key: str) -> str:
        """The words of the item of that key, with its key where no version has it."""
        asked = (item for one in self.versions for q in one.questionnaires.values() for item in q.items)
        return next((local(item.text, self.t.language) for item in asked if item.key == key), key)

    def item_answer(self, key: str, value: Mapping[str, Any]) -> str:
        """What was answered to one item of a questionnaire."""
        asked = find_questionnaire(self.versions, value)
        found = next((item for item in asked.items if item.key == key), None) if asked else None
        return self._item(found, value.get(key)) if found else str(value.get(key))

    def lines(self, kind: str, step_key: str, value: Mapping[str, Any]) -> list[Said]:
        """Line by line; none of an answer that nothing is known of, whose stored form is all there is."""
        asked = find_questionnaire(self.versions, value)
        if kind in ("questionnaire", "comprehension") and asked is not None:
            return self._questionnaire(asked, value)
        tell = {
            "consent": self._consent,
            "attention": self._attention,
            "importance_ranking": self._ranking,
            "demonstration": self._demonstration,
            "think_aloud": self._voice,
            "method_comparison": self._methods,
            "rules": self._rules,
        }.get(kind)
        if tell is not None:
            return tell(value)
        if kind == "preference" and "degree" in value:
            return [self._degree(value)]
        if kind == "order":
            return [Said("", said_of_several(self.t, value))]
        if kind == "mark":
            return [Said("", said_of_marks(self.t, value))]
        if RATING in value:
            return self._rating(step_key, value)
        return self._weights(value) if "weights" in value else []

    def _questionnaire(self, asked: Questionnaire, value: Mapping[str, Any]) -> list[Said]:
        said = [
            Said(local(item.text, self.t.language), self._item(item, value[item.key]))
            for item in asked.items
            if item.key in value
        ]
        if "passed" in value:
            said.append(Said(self.t(f"{WORDS}.check"), self.t(f"{WORDS}.{'passed' if value['passed'] else 'failed'}")))
        if value.get("timed_out"):
            said.append(Said("", self.t(f"{WORDS}.timed_out")))
        return said

    def _item(self, item: Item, given: Any) -> str:
        labels = {option.value: local(option.label, self.t.language) for option in item.options}
        if given in (None, ""):
            return self.t(f"{WORDS}.nothing")
        if isinstance(given, list):
            return self._places([labels.get(str(one), str(one)) for one in given])
        if item.type == "scale":
            return self._of(given, item.points)
        return labels.get(str(given), str(given))

    def _places(self, names: Sequence[str]) -> str:
        return ", ".join(f"{place}. {name}" for place, name in enumerate(names, 1))

    def _of(self, value: Any, points: int) -> str:
        return self.t(f"{WORDS}.of", value=str(value), points=str(points))

    def _yes(self, value: Any) -> str:
        return self.t(f"lab.protocol.{'asked' if value else 'not_asked'}")

    def _consent(self, value: Mapping[str, Any]) -> list[Said]:
        purposes = value.get("purposes") or {}
        version = value.get("version")
        return [
            *([Said(self.t("lab.protocol.facts.version"), str(version))] if version else []),
            *(Said(self.t(f"{WORDS}.purposes.{name}"), self._yes(agreed)) for name, agreed in purposes.items()),
        ]

    def _attention(self, value: Mapping[str, Any]) -> list[Said]:
        passed = self.t(f"{WORDS}.{'passed' if value.get('passed') else 'failed'}")
        letters = {name: str(value.get(name) or "–").upper() for name in ("choice", "instructed")}
        return [Said("", self.t(f"{WORDS}.attention", passed=passed, **letters))]

    def _ranking(self, value: Mapping[str, Any]) -> list[Said]:
        name = ExplanationWords(things=self.t.table("explanation.things")).thing
        return [Said("", self._places([name(one) for one in value.get("ranking", ())]))]

    def _demonstration(self, value: Mapping[str, Any]) -> list[Said]:
        return [Said("", self.t(f"{WORDS}.{'no_path' if value.get('skipped') else 'path'}"))]

    def _methods(self, value: Mapping[str, Any]) -> list[Said]:
        """Which method each robot came from, and the weights that it drove by."""
        methods, weights = value.get("methods") or {}, value.get("weights") or {}
        said = {side: self.t(f"editor.values.{method}") for side, method in methods.items()}
        return [Said(f"{side.upper()}: {name}", self._weighed(weights.get(side, {}))) for side, name in said.items()]

    def _rules(self, value: Mapping[str, Any]) -> list[Said]:
        """Each rule by its sentence: when it holds, and what is then wished, as its card said it."""
        return [self._rule(Rule.model_validate(one)) for one in value.get("rules", ())]

    def _rule(self, rule: Rule) -> Said:
        t, own = self.t, "live.script.rules"
        when = [self._condition(one) for one in rule.when] or [t(f"{own}.always")]
        then = [
            t(f"live.weights.{one.objective}.name")
            if one.more
            else t(f"{own}.slower")
            if one.objective == "faster"
            else t(f"{own}.less", what=t(f"live.weights.{one.objective}.name"))
            for one in rule.wishes
        ]
        then += [
            t(
                f"{own}.zones.{zone.kind}",
                what=t(f"{own}.{'into' if zone.kind == 'room' else 'things'}.{zone.of}") if zone.of else "",
            )
            for zone in rule.zones
        ]
        lines = [t(f"{own}.when_line", when=" + ".join(when)), t(f"{own}.then_line", then="; ".join(then))]
        return Said(t("live.script.quoted", words=rule.words), ". ".join(lines) + ("" if rule.on else " (–)"))

    def _condition(self, one: Condition) -> str:
        own = "live.script.rules"
        label = one.label.removeprefix("not:")
        if one.of is None:
            said = self.t(f"{own}.conditions.{label}")
        elif one.kind == "room":
            said = self.t(f"{own}.room.{one.of}")
        else:
            said = self.t(f"{own}.{one.kind}", what=self.t(f"{own}.things.{one.of}"))
        return self.t(f"{own}.not", what=said) if one.label.startswith("not:") else said

    def _degree(self, value: Mapping[str, Any]) -> Said:
        """How clearly one of a pair is the better one, or that neither is."""
        if value["degree"] == "no_difference":
            return Said("", self.t("lab.protocol.facts.no_difference"))
        how = self.t(f"participant.trial.degree.{value['degree_of']}.{value['degree']}")
        return Said(self.t(f"editor.values.{value['degree_of']}"), f"{value['choice'].upper()}: {how}")

    def _voice(self, value: Mapping[str, Any]) -> list[Said]:
        if value.get("recording"):
            return [Said("", self.t(f"{WORDS}.recorded", seconds=self.t.number(value.get("seconds") or 0, 0)))]
        return [Said("", self.t(f"{WORDS}.{'not_recorded' if value.get('agreed') else 'declined'}"))]

    def _rating(self, step_key: str, value: Mapping[str, Any]) -> list[Said]:
        for version in self.versions:
            for key, stage in version.protocol.keyed_stages:
                if isinstance(stage, RatingStage) and step_key.startswith(f"{key}."):
                    question = local(stage.scale.question, self.t.language)
                    return [Said(question, self._of(value[RATING], stage.scale.points))]
        return []

    def _weights(self, value: Mapping[str, Any]) -> list[Said]:
        """Whatever ends with weights: set by sliders, said in a sentence, corrected on the own robot or a real one."""
        t, said = self.t, []
        if "sentence" in value:
            said.append(Said(t("live.words.label"), t("live.script.quoted", words=value["sentence"])))
            said.append(Said(t("live.words.understood"), self._weighed(value.get("understood") or {})))
        if "agreement" in value:
            said.append(Said(t("live.meet.question"), self._of(value["agreement"], meet_your_robot.POINTS)))
            said.append(Said(t(f"{WORDS}.learned"), self._weighed(value.get("learned") or {})))
        if value.get("liked") is not None:
            said.append(Said(t("robots.drive.liked"), self._of(value["liked"], robot_drive.POINTS)))
        if value.get("corrected") is False:
            return [*said, Said(t(f"{WORDS}.corrected"), self._yes(False))]
        end = f"{WORDS}.{'corrected_to' if 'corrected' in value else 'set'}"
        return [*said, Said(t(end), self._weighed(value["weights"]))]

    def _weighed(self, weights: Mapping[str, float]) -> str:
        named = [f"{self._objective(name)} {self.t.number(one, 2)}" for name, one in weights.items() if one]
        return ", ".join(named) or self.t("lab.learnt.nothing")

    def _objective(self, name: str) -> str:
        keys = (f"shared.objectives.{name}", f"flow.three_objectives.{name}")
        return next((self.t(key) for key in keys if self.t.knows(key)), name)


def said_of_several(t: Catalogue, value: Mapping[str, Any]) -> str:
    """What was said of several trajectories, by their numbers."""
    if value.get("ask") == "groups":
        piles = [", ".join(map(str, pile)) or "–" for pile in value["groups"]]
        return t(f"{WORDS}.piles", piles=" | ".join(piles))
    return t(
        f"{WORDS}.{'best' if value.get('ask') == 'best' else 'in_order'}", order=", ".join(map(str, value["order"]))
    )


def said_of_marks(t: Catalogue, value: Mapping[str, Any]) -> str:
    """The moments that were marked, with what it was where that was said."""
    marks = [
        f"{t.number(mark.at_s, 1)} s" + (f" ({t(f'participant.mark.why.{mark.why}')})" if mark.why else "")
        for mark in marks_in(value) or ()
    ]
    return t(f"{WORDS}.marked", marks=", ".join(marks)) if marks else t(f"{WORDS}.nothing_marked")


def find_questionnaire(versions: Sequence[FrozenProtocol], value: Mapping[str, Any]) -> Questionnaire | None:
    """The newest questionnaire that has every item answered in `value`; None where there is none."""
    keys = set(value) - set(MARKS)
    asked = (one for version in versions for one in version.questionnaires.values())
    return next((one for one in asked if keys <= {item.key for item in one.items}), None)
