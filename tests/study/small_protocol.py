"""Protocols of few steps in a folder of their own, so that a test says only what it is about."""

from __future__ import annotations

from pathlib import Path

import yaml

from desirepath.study.protocol.freezing import FrozenProtocol, freeze_text

QUESTIONNAIRES = {
    "about": [
        {"key": "age", "type": "number", "min": 18, "max": 99, "text": {"en": "Age?"}},
        {
            "key": "gender",
            "type": "choice",
            "text": {"en": "Gender?"},
            "required": False,
            "options": [{"value": v, "label": {"en": v}} for v in ("woman", "man", "other")],
        },
    ],
    "quiz": [
        {
            "key": "replay",
            "type": "choice",
            "correct": "no",
            "text": {"en": "Can you watch again?"},
            "options": [{"value": v, "label": {"en": v}} for v in ("yes", "no")],
        }
    ],
    "rating": [
        {"key": "ease", "type": "scale", "text": {"en": "Easy?"}, "low": {"en": "no"}, "high": {"en": "yes"}},
        {
            "key": "dull",
            "type": "scale",
            "reversed": True,
            "text": {"en": "Dull?"},
            "low": {"en": "no"},
            "high": {"en": "yes"},
        },
    ],
    "ways": [
        {
            "key": "preference",
            "type": "ranking",
            "text": {"en": "Which way would you rather use?"},
            "options": [{"value": v, "label": {"en": v}} for v in ("choices", "drawing", "words", "sliders")],
        }
    ],
    "more": [
        {
            "items": [
                {
                    "key": "plays",
                    "type": "choice",
                    "text": {"en": "Do you play?"},
                    "options": [{"value": v, "label": {"en": v}} for v in ("yes", "no")],
                },
                {"key": "hours", "type": "number", "text": {"en": "Hours?"}, "when": {"item": "plays", "is": "yes"}},
            ]
        },
        {
            "when": {"questionnaire": "about", "item": "age", "at_least": 40},
            "items": [
                {"key": "since", "type": "number", "text": {"en": "Since?"}, "when": {"item": "hours", "at_least": 5}}
            ],
        },
    ],
    "attentive": [
        {
            "key": "told",
            "type": "scale",
            "instructed": 3,
            "text": {"en": "Please choose 3."},
            "low": {"en": "no"},
            "high": {"en": "yes"},
        }
    ],
    "elders": [
        {
            "when": {"questionnaire": "about", "item": "age", "at_least": 40},
            "items": [
                {
                    "key": "grandchildren",
                    "type": "number",
                    "text": {"en": "How many?"},
                    "when": {"questionnaire": "about", "item": "gender", "one_of": ["woman", "man"]},
                }
            ],
        }
    ],
    "order": [
        {
            "key": "useful",
            "type": "ranking",
            "text": {"en": "Which was most useful?"},
            "options": [{"value": v, "label": {"en": v}} for v in ("top_down", "first_person", "immersive")],
        }
    ],
}
TEXTS = ("information", "consent", "instruction", "pause", "come_back", "sorry", "debriefing")
INFORMATION = {"information": {"text": "information.md"}}
CONSENT = {"consent": {"text": "consent.md", "version": "1"}}
DEBRIEFING = {"debriefing": {"text": "debriefing.md", "completion_code": "random"}}
VIEWS = ["top_down", "first_person", "immersive"]
BLOCK = {"block": {"view": "top_down", "trials": [{"queries": {"count": 2}}]}}
CROSSED = {"block": {"each": VIEWS, "trials": [{"queries": {"count": 3}}]}}
ABOUT = {"questionnaire": {"use": "about"}}
RATING = {"questionnaire": {"use": "rating"}}
QUIZ = {"comprehension": {"use": "quiz", "attempts": 2, "text": "instruction.md"}}
COME_BACK = {"appointment": {"text": "come_back.md", "after_days": 2, "within_days": 9}}


def write_files(folder: Path) -> None:
    """The texts and questionnaires that these protocols may name."""
    (folder / "questionnaires").mkdir(exist_ok=True)
    for name, items in QUESTIONNAIRES.items():
        content = {"title": {"en": name}, "blocks": items if "items" in items[0] else [{"items": items}]}
        (folder / "questionnaires" / f"{name}.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    for name in TEXTS:
        (folder / f"{name}.md").write_text(f"# {name}\nWords about {name}.\n")


def protocol_text(
    stages: list[dict],
    *,
    query_set: str = "study_room/queries_varied_200",
    consent_stage: dict = CONSENT,
    **keys: object,
) -> str:
    """The YAML of a protocol with these stages between consent and debriefing."""
    whole = {
        "protocol": "small",
        "version": 1,
        "title": {"en": "Small"},
        "languages": ["en"],
        "query_set": query_set,
        **keys,
        "stages": [consent_stage, *stages, DEBRIEFING],
    }
    return yaml.safe_dump(whole, sort_keys=False)


def small_protocol(folder: Path, stages: list[dict], **keys: object) -> FrozenProtocol:
    """The same, read and checked."""
    write_files(folder)
    return freeze_text(protocol_text(stages, **keys), folder=folder)
