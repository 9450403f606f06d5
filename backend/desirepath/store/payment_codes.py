"""What of a protocol somebody could be paid with: fixed completion codes and the addresses people return by. Hides both
in the file as it was written and in plain data. Who may see them is the API's, what is written without them is
`dataset/writing.py`'s.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from desirepath.grammar.source import Source

REMOVED = {"completion_code": "REMOVED", "return_url": "https://removed.invalid/"}
"""Key of a protocol -> what stands there in a data set; a protocol can be read with it."""
RANDOM = "random"  # a completion code that everybody gets another one of
_ANCHOR = re.compile(r"(?:!\S*\s+)?(&\S+\s+)")  # behind a tag, if there is one


def is_payment_code(field: str, value: object) -> bool:
    """Whether that field of a protocol (its name, or a path that ends with it) has such a value."""
    return field.rpartition(".")[2] in REMOVED and value is not None and value != RANDOM


def yaml_without(text: str, instead: Mapping[str, str] = REMOVED) -> str:
    """The protocol's YAML with such values replaced by `instead`, all else as it was. Raises ProtocolError."""
    places = dict(_places(Source("protocol.yaml", text).root))
    for (begin, end), key in sorted(places.items(), reverse=True):
        written = text[begin:end]
        anchor = _ANCHOR.match(written)
        line_end = "\n" if written.endswith("\n") else ""
        text = f'{text[:begin]}{anchor.group(1) if anchor else ""}"{instead[key]}"{line_end}{text[end:]}'
    return text


def _places(node: yaml.Node | None) -> Iterator[tuple[tuple[int, int], str]]:
    """(begin, end) in the text -> key, of every such value."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if isinstance(value, yaml.ScalarNode):
                text = None if value.tag == "tag:yaml.org,2002:null" else value.value
                if is_payment_code(str(key.value), text):
                    yield (value.start_mark.index, value.end_mark.index), key.value
            else:
                yield from _places(value)
    elif isinstance(node, yaml.SequenceNode):
        for inner in node.value:
            yield from _places(inner)


def data_without(value: Any, key: str = "") -> Any:
    """The same of plain data, such as a frozen protocol."""
    if isinstance(value, Mapping):
        return {name: data_without(inner, name) for name, inner in value.items()}
    if isinstance(value, list):
        return [data_without(inner) for inner in value]
    return REMOVED[key] if is_payment_code(key, value) else value


def changes_without(changes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The same of a version's changes: field, before, after."""
    return [
        {
            **change,
            **{
                side: data_without(change[side], str(change["field"]).rpartition(".")[2])
                for side in ("before", "after")
            },
        }
        for change in changes
    ]
