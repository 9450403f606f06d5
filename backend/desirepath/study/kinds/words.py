"""Kind of step `words`: a wish in the participant's own words, read into preference weights, then corrected by hand.

What is read of a sentence is `learning/words`'s; the controls are `live.py`'s. Sentence and correction are the answer.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from desirepath.grammar.parts import an_example
from desirepath.grammar.source import Path, Problem, Source
from desirepath.grammar.texts import local
from desirepath.learning.words.lexicon import LONGEST, Language
from desirepath.study.kind import Moment, Page, Simulated
from desirepath.study.kinds.live import (
    OBJECTIVES,
    OPPOSITES,
    SAME,
    AskedLiveStage,
    LiveAnswer,
    LiveKind,
    LiveStep,
    PersonSetup,
    Weights,
    check_history,
    distance,
    slide,
)
from desirepath.study.steps import Planning, Stage
from desirepath.study.wire import STORED_IN_ROOM, BadValue, Besides

if TYPE_CHECKING:  # the objectives bring numba along; a server that starts need not wait for it
    from desirepath.learning.words.understanding import Understood

MEANT = 0.8  # weight of what somebody says they meant, asked back; ours
MOST_QUESTIONS = 10
Sentence = Annotated[str, StringConstraints(max_length=LONGEST)]
SPOKEN: Mapping[str, Mapping[str, str]] = {
    "en": {
        "farther": "keep well away from me",
        "closer": "come close to me",
        "person_on_left": "keep me on your left side",
        "person_on_right": "keep me on your right side",
        "clearance": "keep away from the furniture",
        "shorter": "take the shortest way",
        "smoother": "drive in gentle curves",
        "slower_near_person": "slow down when you are near me",
        "faster": "be quick",
    },
    "de": {
        "farther": "bleib weit weg von mir",
        "closer": "komm nah an mich heran",
        "person_on_left": "halt mich auf deiner linken Seite",
        "person_on_right": "halt mich auf deiner rechten Seite",
        "clearance": "bleib von den Möbeln weg",
        "shorter": "nimm den kürzesten Weg",
        "smoother": "fahr in sanften Kurven",
        "slower_near_person": "fahr langsam, wenn du bei mir bist",
        "faster": "beeil dich",
    },
}
"""How simulated participants put an objective; what they wish most comes first."""
NO_WISH = {"en": "I do not mind how it drives", "de": "Mir ist egal, wie er fährt"}


class WordsStage(AskedLiveStage):
    """The participant writes in a sentence how the robot should drive; what was understood is shown and corrected."""

    model_config = an_example({"setup": "study_room", "scenes": 3})

    measures = True

    setup: PersonSetup = "study_room"
    correct: bool = Field(True, description="false: the sentence alone, without sliders to correct it")

    def plan(self, at: Planning) -> list[WordsStep]:  # type: ignore[override]  # a list of steps
        fields = {"setup": self.setup, "scenes": self.scenes, "view": self.view}
        fields |= {} if self.correct else {"correct": False}
        return [WordsStep.model_validate({"kind": "words", "key": at.key, "stage": at.key, **fields})]

    def problems(self, here: Path, stages: Sequence[Stage], source: Source) -> Iterator[Problem]:
        if self.objectives:
            yield source.problem((*here, "objectives"), "is of tuning; a sentence may say anything of all nine")


class WordsStep(LiveStep):
    """correct: by sliders, after what was understood."""

    kind: Literal["words"]
    correct: bool = True


class Meant(BaseModel):
    """What somebody says they meant, asked back. question: which one, from 0; objective: None: none of these."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    question: int = Field(ge=0, lt=MOST_QUESTIONS)
    objective: str | None = Field(None, max_length=40)


class WordsAnswer(LiveAnswer):
    """The sentence, what was meant where it was asked back, and the weights as they were corrected."""

    sentence: Sentence
    meant: list[Meant] = Field([], max_length=MOST_QUESTIONS)


class AboutWords(Besides):
    language: str | None = Field(None, description="in which the sentence is read")
    correct: bool | None = Field(None, description="whether it is corrected by sliders")


class Words(LiveKind[WordsStep, WordsAnswer]):
    name = "words"
    step = WordsStep
    answers = WordsAnswer
    besides = AboutWords
    stages = {"words": WordsStage}
    stored = {
        "sentence": "what was written, free text",
        "language": "in which it was read",
        "marked": "what was read of it: stretches of the sentence (text), objective and as (wanted; unwanted: less of "
        "it, which no weight can say; lesser: said not to matter, or less; asked back; not understood)",
        "meant": "what they say they meant where it was asked back: objective, or null: none of what was offered",
        "understood": "objective -> weight that the words, and what was meant, stand for",
        "weights": "objective -> weight from 0 to 1 at the end, corrected by hand",
        "corrected": "whether any weight was changed by hand",
        "distance": "Euclidean, from understood to final weights",
        "history": "every change in order, as of `tuning`; those of the sentence are by words",
        **STORED_IN_ROOM,
    }

    def payload(self, step: WordsStep, page: Page) -> dict[str, Any]:
        stage = page.stage_of(step, WordsStage)
        asked = local(stage.question, page.language) if stage is not None and stage.question else None
        own = {"question": asked, "longest": LONGEST, "correct": step.correct}
        return super().payload(step, page) | own

    def check(self, step: WordsStep, answer: WordsAnswer, page: Page) -> dict[str, Any]:
        got = understand(answer.sentence, language_of(page.language))
        meant = [choice.model_dump() for choice in answer.meant]
        for number, one in enumerate(answer.meant):
            if one.question >= len(got.questions):
                raise BadValue(f"value.meant.{number}.question", one.question, "is more than was asked back")
            if one.objective is not None and one.objective not in got.questions[one.question].offered:
                offered = ", ".join(got.questions[one.question].offered)
                raise BadValue(f"value.meant.{number}.objective", one.objective, f"must be one of {offered}, or null")
        stored = super().check(step, answer, page)
        check_history({}, stored)
        start = with_meant(got, answer.meant)
        if not step.correct and distance(start, stored["weights"]) > SAME:
            raise BadValue(
                "value.weights", stored["weights"], "cannot be corrected here; must be what the words stand for"
            )
        corrected = any(change.by != "words" for change in answer.history)
        return stored | {
            "sentence": answer.sentence,
            "language": got.language,
            "marked": [part for part in mark_stretches(answer.sentence, got) if part["as"] != "plain"],
            "meant": meant,
            "understood": start,
            "corrected": corrected and distance(start, stored["weights"]) > 0,
            "distance": distance(start, stored["weights"]),
        }

    def tell_simulated(self, step: WordsStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        return {"language": moment.session.language, "correct": step.correct}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        """Says what it prefers, the foremost first, and corrects by hand what the words were read as."""
        wanted = participant.choose_weights(step)
        language = language_of(step.get("language") or "en")
        parts = [SPOKEN[language][name] for name in sorted(wanted, key=lambda name: -wanted[name])]
        sentence = ", ".join(parts) or NO_WISH[language]
        got = understand(sentence, language)
        spoken = [change | {"by": "words", "seconds": 0.0} for change in slide({}, got.weights)]
        if step.get("correct") is False:
            return {"sentence": sentence, "meant": [], "weights": got.weights, "history": spoken}
        return {
            "sentence": sentence,
            "meant": [],
            "weights": wanted,
            "history": spoken + slide(got.weights, wanted),
        }


def language_of(language: str) -> Language:
    """The language that a page's sentences are expected in, English where its own cannot be read."""
    return "de" if language == "de" else "en"


def understand(sentence: str, language: Language) -> Understood:
    """What is read of it. The caller has bounded its length."""
    from desirepath.learning.words.understanding import words_reader

    return words_reader(language).understand(sentence)


def with_meant(got: Understood, meant: Sequence[Meant]) -> Weights:
    """The weights of the words and of what was meant where it was asked back."""
    weights = dict(got.weights)
    for one in meant:
        if one.objective is not None:
            for pair in OPPOSITES:
                if one.objective in pair:
                    weights = {
                        name: weight for name, weight in weights.items() if name not in set(pair) - {one.objective}
                    }
            weights[one.objective] = max(weights.get(one.objective, 0.0), MEANT)
    return {name: weights[name] for name in OBJECTIVES if weights.get(name, 0) > 0}


def mark_stretches(sentence: str, got: Understood) -> list[dict[str, Any]]:
    """The whole sentence in stretches, so that nobody counts letters: text; as: plain, wanted, unwanted, lesser,
    asked, missed; objective of the first three of them; question: number of what is asked back.
    """
    stretches: list[tuple[int, int, dict[str, Any]]] = []
    stretches += [
        (
            mark.start,
            mark.end,
            {"as": "lesser" if mark.waived else "wanted" if mark.wanted else "unwanted", "objective": mark.objective},
        )
        for mark in got.marks
    ]
    stretches += [(one.start, one.end, {"as": "asked", "question": n}) for n, one in enumerate(got.questions)]
    stretches += [(start, end, {"as": "missed"}) for start, end in got.not_understood]
    found: list[dict[str, Any]] = []
    place = 0
    for start, end, reading in sorted(stretches, key=lambda one: one[:2]):
        if start < place:
            continue
        if start > place:
            found.append({"text": sentence[place:start], "as": "plain"})
        found.append({"text": sentence[start:end], **reading})
        place = end
    if place < len(sentence):
        found.append({"text": sentence[place:], "as": "plain"})
    return found


KIND = Words()
