"""A study's own texts: the variant of a language, numbers of the protocol filled in. `reading.py` reads them."""

from __future__ import annotations

from backend.study.protocol.blocks import BlockStage
from backend.study.protocol.demonstration_stages import DemonstrationsStage
from backend.study.protocol.schema import Protocol
from backend.study.protocol.stages import ComparisonStage


def text_numbers(protocol: Protocol) -> dict[str, int]:
    """What a text may name in braces, so that it stays true when the protocol is changed: name -> number.

    Over all that one participant meets; `pairs_per_block`: of the longest condition.
    """
    pairs = {"learning": 0, "regular": 0}
    compared = blocks = per_block = places = paths = 0
    for entry in protocol.stages:
        if isinstance(entry.stage, BlockStage):
            conditions = len(entry.stage.conditions(0))
            blocks += conditions
            here = {"learning": 0, "regular": 0}
            for one in entry.stage.trials:
                here[one.queries.role] += one.queries.count + one.queries.probes.trials
            per_block = max(per_block, here["regular"])
            for role, count in here.items():
                pairs[role] += count * conditions
        elif isinstance(entry.stage, DemonstrationsStage):
            places += entry.stage.pairs
            paths += entry.stage.pairs * entry.stage.per_pair
        elif isinstance(entry.stage, ComparisonStage):
            compared += entry.stage.pairs
    return {
        "minutes": protocol.minutes,
        "pairs": pairs["regular"],
        "practice_pairs": pairs["learning"],
        "comparison_pairs": compared,
        "blocks": blocks,
        "pairs_per_block": per_block,
        "places": places,
        "paths": paths,
    }


def filled(text: str, protocol: Protocol) -> str:
    """The text with `{minutes}`, `{pairs}` and so on as numbers."""
    for name, number in text_numbers(protocol).items():
        text = text.replace(f"{{{name}}}", str(number))
    return text


def local(text: dict[str, str], language: str) -> str:
    """The text in that language, in the first one it has otherwise."""
    return text.get(language) or next(iter(text.values()))


def variant(name: str, language: str) -> str:
    """`texts/consent.md` in German is `texts/consent.de.md`."""
    stem, dot, ending = name.rpartition(".")
    return f"{stem}.{language}{dot}{ending}" if dot else f"{name}.{language}"
