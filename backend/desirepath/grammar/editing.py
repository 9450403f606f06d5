"""Changes single fields of a YAML text; every other character, comments and order stay as they were written.

Where to cut says libyaml, by the events of `source.py`'s loader. What comes out is read again and must hold exactly
what was asked for, else it is refused: what anchors share, or a layout not understood here, is edited by hand.
"""

from __future__ import annotations

import json
import math
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import yaml

from desirepath.grammar.source import CORE, Path, ProtocolError, Source, YamlLoader, field_name


class EditError(ValueError):
    """A change that this text does not take; `field` is where."""

    def __init__(self, path: Path, why: str) -> None:
        self.field = field_name(path)
        super().__init__(f"{self.field}: {why}")


def set_value(text: str, path: Path, value: Any) -> str:
    """The text with that value there; keys that are missing on the way are added, list items are not."""
    written = _Text(text)
    while (node := written.find(path)) is None:
        parent, key = written.find(path[:-1]), path[-1]
        if isinstance(key, int) or not (parent is None or parent.is_mapping or parent.empty):
            raise EditError(path, "is not there")
        if parent is not None and parent.is_mapping:
            return written.checked(path, value, *_added_key(written, parent, key, value))
        path, value = path[:-1], {key: value}
    start, end = node.start, written.end(node)
    if node.is_block:
        start = written.after_key(path, node)
    space = " " if start and text[start - 1] not in " \t[{,\n" else ""
    return written.checked(path, value, start, end, space + _inline(value) + _comment_of_literal(text, node.start))


def _comment_of_literal(text: str, start: int) -> str:
    """What is remarked behind the `|` or `>` that begins there."""
    first, _, remark = text[start:].partition("\n")[0].partition("#")
    return f"  #{remark}" if first[:1] in ("|", ">") and remark else ""


def remove(text: str, path: Path) -> str:
    """The text without that key or list item, and without the comment lines directly above it."""
    written = _Text(text)
    parent, at = written.find(path[:-1]), written.place(path)
    if parent is None or at is None:
        raise EditError(path, "is not there")
    if len(parent.parts) == 1:
        return set_value(text, path[:-1], {} if parent.is_mapping else [])
    begin, end = written.begin(parent.parts[at]), written.end(parent.parts[at][1])
    first = written.chunks(parent)[at][0] if parent.is_block else begin
    if parent.is_block and not written.column(first):
        start, end = (first - 1 if first else 0), written.line_end(end)
        end += not first  # the line break before it, or behind the first line
        return written.checked(path, _GONE, start, end, "")
    if at:
        start, beside = written.end(parent.parts[at - 1][1]), text[written.end(parent.parts[at - 1][1]) : begin]
    else:  # the next one takes its place
        start, beside, end = begin, text[end : written.begin(parent.parts[1])], written.begin(parent.parts[1])
    if "#" in beside:
        raise EditError(path, "has a comment beside it that would be lost")
    return written.checked(path, _GONE, start, end, "")


def insert(text: str, path: Path, index: int, value: Any) -> str:
    """The text with the value before that item of the list at `path`; behind the last where index is their number."""
    written = _Text(text)
    node, there = written.find(path), (*path, index)
    if node is None or not node.parts:
        if index or (node is not None and not (node.is_list or node.empty)):
            raise EditError(there, "is not there")
        if node is None or not written.in_block(path):
            return set_value(text, path, [value])
        start = written.after_key(path, node)
        block = "\n" + _as_lines(value, written.column(written.key(path)) + 2)
        return written.checked(path, [value], start, written.end(node), block)
    if not node.is_list or index > len(node.parts):
        raise EditError(there, "is not there")
    if node.is_block:
        chunks = written.chunks(node)
        column = written.column(written.dash(node.parts[0][1]))
        lines, last = _as_lines(value, column), index == len(chunks)
        at = chunks[-1][1] if last else chunks[index][0]
        lines = f"\n{lines}" if last else f"{lines}\n"
    elif index == len(node.parts):
        at, lines = written.end(node.parts[-1][1]), f", {_inline(value)}"
    else:
        at, lines = node.parts[index][1].start, f"{_inline(value)}, "
    return written.checked(there, _Inserted(value), at, at, lines)


def move(text: str, path: Path, index: int, to: int) -> str:
    """The text with item `index` of the list at `path` as item `to`, with its comments."""
    written = _Text(text)
    node = written.find(path)
    if node is None or not node.is_list or not (0 <= index < len(node.parts) and 0 <= to < len(node.parts)):
        raise EditError((*path, index), "is not there")
    if node.is_block:
        spans = written.chunks(node)
        chunks = [text[start:end].removesuffix("\n") for start, end in spans]
        chunks.insert(to, chunks.pop(index))
        return written.checked(path, _Moved(index, to), spans[0][0], spans[-1][1], "\n".join(chunks))
    items = [(value.start, written.end(value)) for _, value in node.parts]
    order = [*range(len(items))]
    order.insert(to, order.pop(index))
    moved, at = "", items[0][0]
    for (start, end), source in zip(items, order, strict=True):
        moved += text[at:start] + text[slice(*items[source])]
        at = end
    return written.checked(path, _Moved(index, to), items[0][0], items[-1][1], moved)


# ---- what comes of it in data ----------------------------------------------------------------------------------------

_GONE = object()


@dataclass(frozen=True)
class _Inserted:
    value: Any


@dataclass(frozen=True)
class _Moved:
    index: int
    to: int


def _change(data: Any, path: Path, value: Any) -> None:
    """Change plain data in place."""
    if isinstance(value, _Moved):
        for part in path:
            data = data[part]
        data.insert(value.to, data.pop(value.index))
        return
    for part in path[:-1]:
        data = data[part]
    if value is _GONE:
        del data[path[-1]]
    elif isinstance(value, _Inserted):
        data.insert(path[-1], value.value)
    else:
        data[path[-1]] = value


# ---- where it stands -------------------------------------------------------------------------------------------------


@dataclass
class _Node:
    """A value as it is written: text[start:end], where `end` of a block is not known from its event. parts: (key or
    None, value) of a mapping or list; name: of a scalar."""

    start: int
    end: int
    kind: str
    flow: bool = True
    name: str = ""
    parts: list[tuple[_Node | None, _Node]] = field(default_factory=list)

    @property
    def is_mapping(self) -> bool:
        return self.kind == "mapping"

    @property
    def is_list(self) -> bool:
        return self.kind == "list"

    @property
    def is_block(self) -> bool:
        return not self.flow

    @property
    def empty(self) -> bool:
        return self.kind == "scalar" and self.name in ("", "~", "null")


class _Text:
    """A YAML text with where its values stand. Raises ProtocolError for one that is none."""

    def __init__(self, text: str) -> None:
        self.text, self.data = text, Source("protocol.yaml", text).data
        self._dashes: list[int] = [
            token.start_mark.index
            for token in yaml.scan(text, Loader=YamlLoader)
            if isinstance(token, yaml.BlockEntryToken)
        ]
        events = (
            event
            for event in yaml.parse(text, Loader=YamlLoader)
            if isinstance(event, yaml.NodeEvent | yaml.CollectionEndEvent)
        )
        self.root = _read(next(events), events)

    # ---- by path

    def find(self, path: Path) -> _Node | None:
        node: _Node | None = self.root
        for depth in range(len(path)):
            at = self._place(node, path[depth])
            node = None if node is None or at is None else node.parts[at][1]
        return node

    def place(self, path: Path) -> int | None:
        """Which part of its parent it is."""
        return self._place(self.find(path[:-1]), path[-1])

    def _place(self, node: _Node | None, part: str | int) -> int | None:
        if node is None:
            return None
        if node.is_list and isinstance(part, int):
            return part if 0 <= part < len(node.parts) else None
        named = [at for at, (key, _) in enumerate(node.parts) if key is not None and key.name == part]
        return named[-1] if named else None

    def key(self, path: Path) -> int:
        """Where its key begins, or the dash of a list's item."""
        parent, at = self.find(path[:-1]), self.place(path)
        if parent is None or at is None:
            raise EditError(path, "is not there")
        key, value = parent.parts[at]
        return key.start if key is not None else self.dash(value)

    def in_block(self, path: Path) -> bool:
        parent = self.find(path[:-1])
        return parent is not None and parent.is_block and parent.is_mapping

    def after_key(self, path: Path, node: _Node) -> int:
        """Behind the colon of its key."""
        parent, at = self.find(path[:-1]), self.place(path)
        key = None if parent is None or at is None else parent.parts[at][0]
        if key is None:
            return node.start
        colon = self.text.find(":", key.end, max(node.start, key.end + 1))
        if colon < 0 or self.text[key.end : colon].strip():
            raise EditError(path, "is written in a way that is edited by hand")
        return colon + 1

    # ---- places in the text

    def begin(self, part: tuple[_Node | None, _Node]) -> int:
        key, value = part
        return value.start if key is None else key.start

    def end(self, node: _Node) -> int:
        """Behind its last character; what follows on the line stays."""
        if node.is_block and node.parts:
            return max(self.end(node.parts[-1][1]), node.parts[-1][1].start)
        return node.start + len(self.text[node.start : node.end].rstrip())

    def dash(self, item: _Node) -> int:
        """Of a block list's item."""
        return self._dashes[bisect_left(self._dashes, item.start) - 1]

    def column(self, at: int) -> int:
        return at - self._line(at)

    def _line(self, at: int) -> int:
        return self.text.rfind("\n", 0, at) + 1

    def line_end(self, at: int) -> int:
        end = self.text.find("\n", at)
        return len(self.text) if end < 0 else end

    def chunks(self, node: _Node) -> list[tuple[int, int]]:
        """The whole lines of each part of a block: with the comment lines directly above it, up to the next one's; the
        last to the end of its line. A first part on the line of a dash begins there."""
        firsts = [key.start if key is not None else self.dash(value) for key, value in node.parts]
        starts = []
        for number, first in enumerate(firsts):
            start = self._line(first)
            if self.text[start:first].strip():  # behind a dash, whose line it shares
                starts.append(first)
                continue
            lowest = self.line_end(self.end(node.parts[number - 1][1])) if number else 0
            if node is self.root and not number:
                lowest = start  # what stands above is about the whole file
            while start > lowest + 1:
                above = self._line(start - 1)
                line = self.text[above:start]
                indent = len(line) - len(line.lstrip())
                if above <= lowest - 1 or not line.lstrip().startswith("#") or indent > first - self._line(first):
                    break
                start = above
            starts.append(start)
        return list(zip(starts, [*starts[1:], self.line_end(self.end(node.parts[-1][1]))], strict=True))

    # ---- the change

    def checked(self, path: Path, value: Any, start: int, end: int, written: str) -> str:
        """The text with `written` in place of text[start:end], if that holds exactly the change."""
        text = self.text[:start] + written + self.text[end:]
        meant = json.loads(json.dumps(self.data))
        try:
            _change(meant, path, value)
            found = Source("protocol.yaml", text).data
        except (ProtocolError, LookupError, TypeError):
            found = None
        if found is None or json.dumps(found, sort_keys=True) != json.dumps(meant, sort_keys=True):
            raise EditError(path, "is written in a way that is edited by hand")
        return text


def _read(event: Any, events: Iterator[Any]) -> _Node:
    start = event.start_mark.index
    if isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent):
        kind = "mapping" if isinstance(event, yaml.MappingStartEvent) else "list"
        node = _Node(start, start, kind, flow=bool(event.flow_style))
        while not isinstance(inner := next(events), yaml.CollectionEndEvent):
            key = _read(inner, events) if kind == "mapping" else None
            node.parts.append((key, _read(inner if key is None else next(events), events)))
        node.end = inner.end_mark.index  # type: ignore[union-attr]  # a parser's own events have marks
        return node
    name = str(event.value) if isinstance(event, yaml.ScalarEvent) else "*"
    return _Node(start, event.end_mark.index, "scalar", name=name)


def _added_key(written: _Text, mapping: _Node, key: str | int, value: Any) -> tuple[int, int, str]:
    """(start, end, text) of a new key: behind the last one whose value stands on its line, so that long lists stay
    last."""
    entry = _inline({key: value})[1:-1]
    if not mapping.parts:
        return mapping.start, written.end(mapping), f"{{{entry}}}"
    if mapping.flow:
        at = written.end(mapping.parts[-1][1])
        return at, at, f", {entry}"
    short = [part for part in mapping.parts if part[1].flow]
    behind = (short or mapping.parts)[-1]
    at = written.line_end(written.end(behind[1]))
    column = written.column(written.begin(mapping.parts[0]))
    return at, at, f"\n{' ' * column}{entry}"


# ---- how values are written ------------------------------------------------------------------------------------------


class _Dumper(yaml.SafeDumper):
    """Quotes whatever any schema of YAML could take for something else than text."""


for _tag, _pattern, _first in CORE:
    _Dumper.add_implicit_resolver(_tag, _pattern, _first)


def _inline(value: Any) -> str:
    """On one line, as it may stand anywhere."""
    if isinstance(value, str) and not value.isprintable():
        return str(yaml.dump(value, Dumper=_Dumper, default_style='"', width=math.inf)).strip()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_inline(key)}: {_inline(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    listed = yaml.dump([value], Dumper=_Dumper, default_flow_style=True, allow_unicode=True, width=math.inf)
    return str(listed).strip()[1:-1]


def _as_lines(value: Any, column: int) -> str:
    """As an item of a block list: mappings on lines of their own, the innermost on one line."""
    dumped = str(
        yaml.dump([value], Dumper=_Dumper, default_flow_style=None, sort_keys=False, allow_unicode=True, width=math.inf)
    )
    return "\n".join(" " * column + line for line in dumped.rstrip("\n").split("\n"))
