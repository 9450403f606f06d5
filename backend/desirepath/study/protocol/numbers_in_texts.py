"""Numbers of the protocol in a study's own texts, so that these stay true when it is changed."""

from __future__ import annotations

from desirepath.study.protocol.schema import Protocol

MAXIMA = ("pairs_per_block",)  # of the longest condition; all others add up over what one participant meets


def text_numbers(protocol: Protocol) -> dict[str, int]:
    """What a text may name in braces: name -> number."""
    numbers = dict.fromkeys(
        (
            "pairs",
            "practice_pairs",
            "further_pairs",
            "comparison_pairs",
            "blocks",
            "pairs_per_block",
            "places",
            "paths",
        ),
        0,
    )
    for entry in protocol.stages:
        for name, number in entry.stage.numbers().items():
            before = numbers.get(name, 0)
            numbers[name] = max(before, number) if name in MAXIMA else before + number
    return {"minutes": protocol.minutes, **numbers}


def fill_in(text: str, protocol: Protocol) -> str:
    """The text with `{minutes}`, `{pairs}` and so on as numbers."""
    for name, number in text_numbers(protocol).items():
        text = text.replace(f"{{{name}}}", str(number))
    return text
