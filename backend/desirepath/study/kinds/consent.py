"""Kind of step `consent`: sentences to tick, and purposes that may be agreed to or not beside the study itself."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from desirepath.grammar.parts import FileName, Localized, Version, an_example
from desirepath.grammar.source import Path
from desirepath.grammar.texts import local
from desirepath.store.models import Participant
from desirepath.study.kind import Acting, Moment, Page, Simulated
from desirepath.study.kinds.text_page import TextPage, TextStep
from desirepath.study.steps import Planning, Stage, Step
from desirepath.study.wire import Answer, BadValue, Besides, Flag

POINT = re.compile(r"^- \[ \] +(.+)$", re.MULTILINE)
_POINT_LINES = re.compile(r"^- \[ \] +.+\n?", re.MULTILINE)


class ConsentStage(Stage):
    """Consent. Lines `- [ ] ...` at the end of the text are points that are ticked one by one.

    purposes: what may be agreed to or not beside the study itself, each with its sentence. `training`: learning models
    from the answers; `open_data`: publishing them. Who does not agree takes part all the same.
    """

    model_config = an_example({"text": "texts/consent.md", "version": "2026-11"})

    once = True
    for_everybody = True

    text: FileName
    version: Version
    purposes: dict[Literal["training", "open_data"], Localized] = {}

    def plan(self, at: Planning) -> list[Step]:
        return [ConsentStep(kind="consent", key=at.key, stage=at.key, text=self.text)]

    def local_texts(self) -> Iterator[tuple[dict[str, str], Path]]:
        for purpose, text in self.purposes.items():
            yield text, ("purposes", purpose)


class ConsentStep(TextStep):
    kind: Literal["consent"]


def _agreed(given: object) -> object:
    if given is not True:
        raise ValueError("must be true; who does not agree leaves the study")
    return given


def _by_purpose(given: object) -> object:
    if given and not isinstance(given, dict):
        raise ValueError("must be an object with true or false by purpose")
    return given or {}


class ConsentAnswer(Answer):
    """version: of the text that was shown. purposes: what was not ticked was not agreed to."""

    given: Annotated[Literal[True], BeforeValidator(_agreed)]
    version: Annotated[str | None, BeforeValidator(str)] = None
    purposes: Annotated[dict[str, Flag], BeforeValidator(_by_purpose)] = {}


class AboutConsent(Besides):
    purposes: list[str] | None = None


class Consent(TextPage[ConsentStep, ConsentAnswer]):
    name = "consent"
    step = ConsentStep
    consents = True
    answers = ConsentAnswer
    besides = AboutConsent
    stored = {
        "given": "true",
        "version": "of the text",
        "text_hash": "sha256 of the text as it was shown",
        "purposes": "what else was agreed to: training, open_data",
    }
    stages = {"consent": ConsentStage}

    def payload(self, step: ConsentStep, page: Page) -> dict[str, Any]:
        shown = super().payload(step, page)
        consent, text = page.frozen.stage(ConsentStage), shown["text"]
        return shown | {
            "text": _POINT_LINES.sub("", text).strip(),
            "points": [match.group(1).strip() for match in POINT.finditer(text)],
            "purposes": [{"key": key, "text": local(text, page.language)} for key, text in consent.purposes.items()],
            "version": consent.version,
        }

    def check(self, step: ConsentStep, answer: ConsentAnswer, page: Page) -> dict[str, Any]:
        consent = page.frozen.stage(ConsentStage)
        version, asked = consent.version, consent.purposes
        if answer.version is not None and answer.version != version:
            raise BadValue("value.version", answer.version, f"must be {version}, the version that was shown")
        if not set(answer.purposes) <= set(asked):
            allowed = ", ".join(asked) or "none"
            raise BadValue("value.purposes", None, f"must be an object with true or false for {allowed}")
        agreed = {"purposes": {key: answer.purposes.get(key, False) for key in asked}} if asked else {}
        return {"given": True, "version": version, **agreed}

    def keep(self, step: ConsentStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        acting.s.get_one(Participant, acting.session.participant_id).consents = stored.get("purposes", {})
        return {"text_hash": acting.frozen.consent_hash(acting.session.language)}

    def tell_simulated(self, step: ConsentStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        # so that what simulated participants answered may be learned from
        return {"purposes": [purpose["key"] for purpose in payload["purposes"]]}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        return {"given": True, "purposes": dict.fromkeys(step.get("purposes", ()), True)}


KIND = Consent()
