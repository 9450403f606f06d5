"""The shipped instruments, listed for people, and the file of one whose words may not be shipped, to be filled in."""

from __future__ import annotations

from typing import Any

import yaml

from desirepath.analysis.scale_wordings import INSTRUMENTS, SCALES
from desirepath.grammar.error_words import meant
from desirepath.grammar.questionnaires import Questionnaire, frozen_questionnaire

LANGUAGES = ("en", "de")  # in which a file to fill in asks for words


def list_instruments() -> list[dict[str, Any]]:
    """Each by its name: what it measures, how many items, in which languages its words are shipped, range, terms."""
    return [_listed(name, frozen_questionnaire(name, text)) for name, text in INSTRUMENTS.items()]


def _listed(name: str, file: Questionnaire) -> dict[str, Any]:
    head = file.instrument
    assert head is not None, name  # noqa: S101
    scales = [SCALES[block.scale] for block in file.blocks if block.scale]
    own = [item for block in file.blocks for item in block.items]
    languages = scales[0].languages if scales else tuple(own[0].text)
    scored = [part for scale in scales for part in scale.scored]
    return {
        "name": name,
        "known_as": ", ".join(head.names),
        "measures": head.measures["en"],
        "items": sum(len(scale.items) for scale in scales) + len(own),
        "words": ", ".join(sorted(languages)) or "not shipped",
        "scores": "; ".join(f"{part.names[0]} {part.lowest:g} to {part.highest:g}" for part in scored) or "none",
        "german": head.translations.get("de", ""),
        "terms": head.licence,
        "source": head.source,
    }


def file_to_fill_in(name: str) -> str:
    """The instrument's file; of one whose words are not shipped, with the places for them. Raises LookupError."""
    if name not in INSTRUMENTS:
        raise LookupError(
            f"no instrument {name!r}; there are: {', '.join(INSTRUMENTS)}{meant(name, list(INSTRUMENTS))}"
        )
    file = frozen_questionnaire(name, INSTRUMENTS[name])
    scales = [SCALES[block.scale] for block in file.blocks if block.scale]
    if not scales or any(scale.languages for scale in scales):
        return INSTRUMENTS[name]
    blank = dict.fromkeys(LANGUAGES, "")
    blocks = [
        {
            "scale": scale.name,
            "items": [
                {"key": item.key, "type": "scale", "points": scale.points}
                | ({"reversed": True} if item.reversed else {})
                | {part: dict(blank) for part in ("text", "low", "high")}
                for item in scale.items
            ],
        }
        for scale in scales
    ]
    terms = file.instrument.licence if file.instrument else ""
    note = (
        f"# Fill in every text in the study's languages; put this into questionnaires/{name}.yaml beside the protocol."
    )
    words = {"title": file.title, "text": file.text, "blocks": blocks}
    return f"{note}\n# {terms}\n{yaml.safe_dump(words, allow_unicode=True, sort_keys=False, width=100)}"
