"""A stored answer in the reader's words, whatever kind of step stored it."""

from __future__ import annotations

import pytest

from desirepath.installed import FRONTEND
from desirepath.study.protocol.freezing import freeze
from desirepath.web.core.catalogues import Texts
from desirepath.web.lab.answer_words import AnswerWords
from tests.web.lab_services import QUICK

SET = {"weights": {"smoother": 0.54, "farther": 1.0}, "start": {}, "history": []}
STORED = {
    "consent": {"given": True, "version": "2026-11", "purposes": {"training": True, "open_data": False}},
    "attention": {"choice": "a", "instructed": "b", "passed": False},
    "importance_ranking": {"ranking": ["wall east", "box 2", "person"], "scores": {}, "placed_s": []},
    "demonstration": {"stroke": "4" * 32},
    "think_aloud": {"agreed": True, "problem": "", "recording": "5" * 64, "seconds": 12.2},
    "tuning": SET,
    "words": SET | {"sentence": "Please be gentle.", "understood": {"smoother": 1.0}, "corrected": True},
    "meet_your_robot": SET | {"agreement": 4, "learned": {"closer": 1.0}, "corrected": False},
    "method_comparison": {
        "choice": "b",
        "methods": {"a": "words", "b": "drawing"},
        "weights": {"a": {"farther": 1.0}, "b": {}},
    },
    "robot_drive": SET | {"liked": 6, "stops": []},
    "preference": {"choice": "b", "degree": "slight", "degree_of": "strength", "possible": 5},
    "rules": {
        "rules": [
            {
                "words": "Slow, unless I sit in the kitchen",
                "when": [{"kind": "sitting", "holds": False}, {"kind": "room", "of": "kitchen"}],
                "wishes": [{"objective": "faster", "more": False}],
                "zones": [{"kind": "between", "of": "sofa"}],
                "on": False,
            }
        ],
        "edits": 1,
    },
    "order": {"groups": [[2], [], [3, 1]], "ask": "groups"},
    "mark": {"marks": [{"at_s": 1.25, "why": "too_close"}, {"at_s": 3.0, "why": None}]},
}
IN_WORDS = {
    "en": {
        "consent": "Version 2026-11; Learning from the answers yes; Publishing the answers no",
        "attention": "A, asked for B: failed",
        "rules": "“Slow, unless I sit in the kitchen” When: not: you sit + in the kitchen. "
        "Then: slower; not between you and the sofa (–)",
        "order": "piles, the least liked first: 2 | – | 3, 1",
        "mark": "marked: 1.2 s (Too close), 3.0 s",
        "importance_ranking": "1. wall, +x, 2. box 2, 3. person",
        "demonstration": "kept this path",
        "think_aloud": "recorded, 12 s",
        "tuning": "Weights at the end fewer and gentler turns 0.54, farther from the person 1.00",
        "words": "Your wish “Please be gentle.”; This is what was understood fewer and gentler turns 1.00; "
        "Changed to fewer and gentler turns 0.54, farther from the person 1.00",
        "meet_your_robot": "Is that you? 4 of 5; "
        "Learned from the answers closer to the person 1.00; Changed afterwards no",
        "method_comparison": "A: words farther from the person 1.00; B: drawing all zero",
        "robot_drive": "How did you like the way it drove? 6 of 7; "
        "Weights at the end fewer and gentler turns 0.54, farther from the person 1.00",
    },
    "de": {
        "consent": "Version 2026-11; Lernen aus den Antworten ja; Veröffentlichen der Antworten nein",
        "attention": "A, verlangt war B: nicht bestanden",
        "preference": "wie viel besser B: Etwas",
        "order": "Stapel, am wenigsten gemocht zuerst: 2 | – | 3, 1",
        "mark": "markiert: 1,2 s (Zu nah), 3,0 s",
        "tuning": "Gewichte am Ende weniger und sanftere Kurven 0,54, weiter weg vom Menschen 1,00",
    },
}


@pytest.mark.parametrize(("language", "kind"), [(one, kind) for one, kinds in IN_WORDS.items() for kind in kinds])
def test_what_a_step_stored_is_said_in_words(language, kind):
    words = AnswerWords(Texts(FRONTEND / "locales").get(language), [freeze(QUICK)])
    lines = words.lines(kind, f"{kind}.1", STORED[kind])
    assert "; ".join(f"{line.asked} {line.answer}".strip() for line in lines) == IN_WORDS[language][kind]


def test_an_answer_of_a_plug_in_or_to_items_that_no_version_has_is_left_to_its_stored_form():
    words = AnswerWords(Texts(FRONTEND / "locales").get("en"), [freeze(QUICK)])
    assert words.lines("of_a_plug_in", "one", {"how": 3}) == []
    assert words.lines("questionnaire", "demographics", {"shoe_size": 44}) == []
    assert words.lines("questionnaire", "demographics", {"degree": "master"}) == []
    assert words.item_answer("shoe_size", {"shoe_size": 44}) == "44"
