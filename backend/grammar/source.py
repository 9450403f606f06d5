"""YAML with line numbers: where in a file a field stands, so that an error can point at it. Knows no protocol.

A file from outside is bounded before anything is built from it, and read once: with libyaml, by its events.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import yaml

LONGEST = 512 * 1024  # characters (ours); the longest that is shipped has 3,000
DEEPEST = 32  # mappings and lists within each other (ours); a question's option with its words stands at 10
MOST_VALUES = 20_000  # (ours) keys and values, each alias counted as all that it stands for; the most shipped: 300
LONGEST_NUMBER = 40  # characters; longer ones are slow to read and no number that a study needs
LARGEST_NUMBER = 2**63 - 1  # what a database holds

Path = tuple[str | int, ...]


@dataclass(frozen=True)
class Problem:
    """One thing wrong in a file: `line` is 1-based, `field` like `stages[3].block.view`, `message` says what works."""

    file: str
    line: int
    field: str
    value: Any
    message: str

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        given = f" = {self.value!r}" if isinstance(self.value, str | int | float) else ""
        return f"{self.file}:{self.line}: {self.field}{given}: {self.message}"


class ProtocolError(ValueError):
    """A study protocol that cannot be used; `problems` has every one that was found."""

    def __init__(self, problems: list[Problem]) -> None:
        self.problems = problems
        super().__init__("; ".join(str(problem) for problem in problems))

    @property
    def errors(self) -> list[dict[str, Any]]:
        """The problems as plain data: file, line, field, value, message."""
        return [problem.as_dict() for problem in self.problems]


def field_name(path: Path) -> str:
    """`("stages", 3, "block")` as `stages[3].block`."""
    name = ""
    for part in path:
        name += f"[{part}]" if isinstance(part, int) else f".{part}" if name else part
    return name


class _Loader(yaml.CSafeLoader):
    """YAML whose only booleans are true and false: `on:` is a key of ours, and `no` is Norwegian. Numbers end."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:bool"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile(r"^(?:true|false)$"), list("tf"))


def _bounded(read: Callable[[Any, yaml.ScalarNode], Any]) -> Callable[[_Loader, yaml.ScalarNode], Any]:
    """A number's constructor that refuses what no database holds."""

    def bounded(loader: _Loader, node: yaml.ScalarNode) -> Any:
        value = math.inf if len(str(node.value)) > LONGEST_NUMBER else read(loader, node)
        if not abs(value) <= LARGEST_NUMBER:
            raise yaml.constructor.ConstructorError(None, None, "holds a number that is too large", node.start_mark)
        return value

    return bounded


_Loader.add_constructor("tag:yaml.org,2002:int", _bounded(yaml.SafeLoader.construct_yaml_int))
_Loader.add_constructor("tag:yaml.org,2002:float", _bounded(yaml.SafeLoader.construct_yaml_float))


class _TooMuch(ValueError):
    """YAML beyond a limit; `line` is 1-based."""

    def __init__(self, line: int, message: str) -> None:
        self.line = line
        super().__init__(message)


def _within_limits(events: Iterator[Any]) -> None:
    """Raises _TooMuch for YAML that nests too deep, holds too much once its aliases are filled in, or holds itself."""
    anchored: dict[str, int | None] = {}  # name -> values below it; None while it is still open
    opened: list[tuple[str | None, int]] = []  # of what is open: its anchor, and how many values came before it
    values = 0
    for event in events:
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent):
            held = anchored.get(str(event.anchor), 0)
            if held is None:
                raise _TooMuch(line, f"the alias *{event.anchor} stands within what it names; write it out")
            values += held + 1
        elif isinstance(event, yaml.CollectionStartEvent):
            opened.append((event.anchor, values))
            if event.anchor:
                anchored[event.anchor] = None
            values += 1
            if len(opened) > DEEPEST:
                raise _TooMuch(line, f"more than {DEEPEST} mappings and lists stand within each other")
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = opened.pop()
            if anchor:
                anchored[anchor] = values - before
        elif isinstance(event, yaml.ScalarEvent):
            values += 1
            if event.anchor:
                anchored[event.anchor] = 0
        if values > MOST_VALUES:
            raise _TooMuch(line, f"it holds more than {MOST_VALUES:,} keys and values, aliases filled in")


class Source:
    """One YAML file's data and the line of each of its fields."""

    def __init__(self, file: str, text: str) -> None:
        """Raises ProtocolError for text that is too much, no YAML, no mapping, or gives a key twice."""
        self.file = file
        self.data: Any
        try:
            if len(text) > LONGEST:
                raise _TooMuch(1, f"it has more than {LONGEST:,} characters")
            _within_limits(yaml.parse(text, Loader=_Loader))
            loader = _Loader(text)
            try:
                self._root = loader.get_single_node()
                twice = list(self._duplicates(self._root, ()))  # before merged keys are filled in
                self.data = None if self._root is None else loader.construct_document(self._root)
            finally:
                loader.dispose()
        except _TooMuch as wrong:
            raise ProtocolError([Problem(file, wrong.line, "(file)", None, f"is too much: {wrong}")]) from None
        except yaml.YAMLError as wrong:
            mark = getattr(wrong, "problem_mark", None)
            line = mark.line + 1 if mark else 1
            problem = getattr(wrong, "problem", None) or "cannot be read"
            raise ProtocolError([Problem(file, line, "(file)", None, f"is not valid YAML: {problem}")]) from None
        except (ValueError, LookupError, AttributeError) as wrong:  # what its kind cannot hold, as the day 2026-02-31
            raise ProtocolError([Problem(file, 1, "(file)", None, f"holds a value that is none: {wrong}")]) from None
        if not isinstance(self.data, dict):
            kind = "empty" if self.data is None else f"a {type(self.data).__name__}"
            raise ProtocolError([Problem(file, 1, "(file)", None, f"must be a mapping of keys to values, is {kind}")])
        if twice:
            raise ProtocolError(twice)

    def _duplicates(self, node: yaml.Node | None, path: Path) -> list[Problem]:
        found: list[Problem] = []
        if isinstance(node, yaml.MappingNode):
            seen: set[str] = set()
            for key, value in node.value:
                name = str(key.value)
                if name in seen:
                    line = key.start_mark.line + 1
                    found.append(
                        Problem(self.file, line, field_name((*path, name)), None, "is given twice; keep one of them")
                    )
                seen.add(name)
                found += self._duplicates(value, (*path, name))
        elif isinstance(node, yaml.SequenceNode):
            for index, value in enumerate(node.value):
                found += self._duplicates(value, (*path, index))
        return found

    def line(self, path: Path) -> int:
        """Line of the deepest part of `path` that is in the file (a missing key: its mapping's line)."""
        node, line = self._root, 1
        for part in path:
            if isinstance(node, yaml.MappingNode):
                pairs = {str(key.value): (key, value) for key, value in node.value}
                if str(part) not in pairs:
                    break
                key, node = pairs[str(part)]
                line = key.start_mark.line + 1
            elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
                node = node.value[part]
                line = node.start_mark.line + 1
            else:
                break
        return line

    def value(self, path: Path) -> Any:
        """What stands there, None if nothing does."""
        found = self.data
        for part in path:
            try:
                found = found[part]
            except (KeyError, IndexError, TypeError):
                return None
        return found

    def problem(self, path: Path, message: str) -> Problem:
        """A problem with the field at `path`."""
        value = self.value(path)
        shown = value if isinstance(value, str | int | float | bool | None) else None
        return Problem(self.file, self.line(path), field_name(path), shown, message)
