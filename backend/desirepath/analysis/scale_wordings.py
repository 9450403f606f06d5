"""The instruments that are shipped, a file each in `study_protocols/instruments`: their scales, word by word, scoring,
source and terms. A file is a questionnaire as well, which a protocol asks by the file's name."""

from __future__ import annotations

from typing import Any

from desirepath.analysis.scales import Scale, ScaleItem
from desirepath.grammar.source import Source, file_text
from desirepath.installed import PROTOCOLS

Words = dict[str, Any]
"""By language: an item's text, or the two words of a pair, whose first is answered by 1."""


def _read_scale(name: str, head: dict[str, Any], stored: dict[str, Any]) -> Scale:
    texts, ends, other_ends = stored["items"], stored.get("ends", {}), stored.get("other_ends", {})
    turned = stored.get("reversed", ())

    def item(key: str, words: Words) -> ScaleItem:
        pairs = {language: said for language, said in words.items() if isinstance(said, list)}
        text = {language: " – ".join(said) if language in pairs else said for language, said in words.items()}
        own = pairs or other_ends.get(key, ends)
        low, high = ({language: pair[k] for language, pair in own.items()} for k in (0, 1))
        return ScaleItem(key, text, low, high, reversed=key in turned)

    return Scale(
        name=name,
        names=tuple(stored.get("names", head["names"])),
        points=stored["points"],
        items=tuple(item(*of) for of in texts.items()),
        lowest=stored["lowest"],
        highest=stored["highest"],
        scoring=stored["scoring"],
        source=head["source"],
        licence=head["licence"],
        subscales=stored.get("subscales", {}),
        overall=stored.get("overall", True),
    )


INSTRUMENTS: dict[str, str] = {
    file.stem: file_text(file) for file in sorted((PROTOCOLS / "instruments").glob("*.yaml"))
}
"""Every shipped instrument's file by its name."""
_HEADS: dict[str, dict[str, Any]] = {
    name: Source(f"{name}.yaml", text).data["instrument"] for name, text in INSTRUMENTS.items()
}
SCALES: dict[str, Scale] = {
    name: _read_scale(name, head, stored) for head in _HEADS.values() for name, stored in head.get("scales", {}).items()
}
