"""The validated scales that are shipped, as `scales.yaml` has them: word by word, with scoring, source and terms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from desirepath.analysis.scales import Scale, ScaleItem
from desirepath.grammar.source import Source, file_text


def _read_scale(name: str, stored: dict[str, Any]) -> Scale:
    texts = stored.pop("items")
    ends, other_ends, turned = (stored.pop(part, {}) for part in ("ends", "other_ends", "reversed"))

    def item(key: str, text: dict[str, str]) -> ScaleItem:
        own = other_ends.get(key, ends)
        low, high = ({language: pair[k] for language, pair in own.items()} for k in (0, 1))
        return ScaleItem(key, text, low, high, reversed=key in turned)

    return Scale(
        name=name, items=tuple(item(*of) for of in texts.items()), **stored | {"names": tuple(stored["names"])}
    )


_FILE = Path(__file__).with_name("scales.yaml")
SCALES: dict[str, Scale] = {
    name: _read_scale(name, dict(stored)) for name, stored in Source(_FILE.name, file_text(_FILE)).data.items()
}
