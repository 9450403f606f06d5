"""YAML with line numbers: where in a file a field stands, so that an error can point at it. Knows no protocol.

A file from outside is bounded before anything is built from it, and read once: with libyaml, by its events.
"""

from __future__ import annotations

import math
import pathlib
import re
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import yaml

from desirepath.grammar.text_files import NotUtf8Error, read_text

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
    """A file of a study that cannot be used; `problems` has every one that was found, by file and line."""

    def __init__(self, problems: list[Problem]) -> None:
        self.problems = sorted(problems, key=lambda problem: (problem.file, problem.line))
        super().__init__("; ".join(str(problem) for problem in self.problems))

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


class YamlLoader(yaml.CSafeLoader):
    """The core schema of YAML 1.2, and `<<` merges mappings: `yes`, `1:30`, `1_000` and `2026-01-01` are text, 012 is
    twelve. What is tagged as anything else is refused; numbers end."""


_TAG = "tag:yaml.org,2002:"
TEXT = f"{_TAG}str"
_MERGE = f"{_TAG}merge"
_NO_TEXT = (f"{_TAG}int", f"{_TAG}float", f"{_TAG}bool")
_CORE = {
    "null": (r"~|null|Null|NULL|", [*"~nN", ""]),
    "bool": (r"true|True|TRUE|false|False|FALSE", [*"tTfF"]),
    "int": (r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", [*"-+0123456789"]),
    "float": (
        r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        [*"-+.0123456789"],
    ),
    "merge": ("<<", ["<"]),
}
CORE = [(_TAG + name, re.compile(f"(?:{pattern})$"), first) for name, (pattern, first) in _CORE.items()]
"""How plain scalars are read: (tag, pattern, first characters)."""
YamlLoader.yaml_implicit_resolvers = {}
for _rule in CORE:
    YamlLoader.add_implicit_resolver(*_rule)


def _whole(written: str) -> int:
    return int(written, {"0o": 8, "0x": 16}.get(written[:2], 10))


def _real(written: str) -> float:
    return float(written.lower().replace(".inf", "inf").replace(".nan", "nan"))


def _bounded(read: Callable[[str], float]) -> Callable[[YamlLoader, yaml.ScalarNode], float]:
    """A number's constructor that refuses what no database holds."""

    def bounded(loader: YamlLoader, node: yaml.ScalarNode) -> float:
        value = math.inf if len(str(node.value)) > LONGEST_NUMBER else read(node.value)
        if not abs(value) <= LARGEST_NUMBER:
            raise yaml.constructor.ConstructorError(None, None, "holds a number that is too large", node.start_mark)
        return value

    return bounded


YamlLoader.yaml_constructors = {
    tag: how
    for tag, how in yaml.SafeLoader.yaml_constructors.items()
    if tag in (None, TEXT, f"{_TAG}null", f"{_TAG}seq", f"{_TAG}map")
}
YamlLoader.add_constructor(f"{_TAG}bool", lambda _, node: {"true": True, "false": False}[node.value.lower()])
YamlLoader.add_constructor(f"{_TAG}int", _bounded(_whole))
YamlLoader.add_constructor(f"{_TAG}float", _bounded(_real))


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


def file_text(path: pathlib.Path) -> str:
    """A file's text. Raises ProtocolError where it cannot be read."""
    try:
        return read_text(path)
    except OSError as wrong:
        line, message = 1, f"cannot be read: {wrong.strerror}"
    except NotUtf8Error as wrong:
        line, message = wrong.line, str(wrong)
    raise ProtocolError([Problem(str(path), line, "(file)", None, message)])


class Source:
    """One YAML file's data, the line of each of its fields, and how each was written. twice: keys that are given again,
    of which the last counts in `data`."""

    def __init__(self, file: str, text: str) -> None:
        """Raises ProtocolError for text that is too much, no YAML or no mapping."""
        self.file = file
        self.data: Any
        self.twice: list[Problem] = []
        self._keys: dict[int, dict[str, tuple[int, yaml.Node]]] = {}  # of each mapping: key -> its line, its value
        try:
            if len(text) > LONGEST:
                raise _TooMuch(1, f"it has more than {LONGEST:,} characters")
            _within_limits(yaml.parse(text, Loader=YamlLoader))
            loader = YamlLoader(text)
            try:
                self.root = loader.get_single_node()
                self._read_keys(self.root, ())  # before merged keys are filled in
                self.data = None if self.root is None else loader.construct_document(self.root)
            finally:
                loader.dispose()
        except _TooMuch as wrong:
            raise ProtocolError([Problem(file, wrong.line, "(file)", None, f"is too much: {wrong}")]) from None
        except yaml.YAMLError as wrong:
            mark = getattr(wrong, "problem_mark", None)
            line = mark.line + 1 if mark else 1
            problem = getattr(wrong, "problem", None) or "cannot be read"
            raise ProtocolError([Problem(file, line, "(file)", None, f"is not valid YAML: {problem}")]) from None
        except (ValueError, LookupError) as wrong:  # what its tag cannot hold, as !!int x
            raise ProtocolError([Problem(file, 1, "(file)", None, f"holds a value that is none: {wrong}")]) from None
        if not isinstance(self.data, dict):
            kind = "empty" if self.data is None else "a list" if isinstance(self.data, list) else "one value"
            message = f"must be a mapping of keys to values, such as 'title: {{en: My study}}', is {kind}"
            raise ProtocolError([Problem(file, 1, "(file)", None, message)])

    def _read_keys(self, node: yaml.Node | None, path: Path) -> None:
        """What stands under which key; keys are text, whatever they look like."""
        if isinstance(node, yaml.MappingNode):
            keys = self._keys.setdefault(id(node), {})
            seen: set[str] = set()
            for key, value in node.value:
                name, line = str(key.value), key.start_mark.line + 1
                if isinstance(key, yaml.ScalarNode) and key.tag != _MERGE:
                    key.tag = TEXT
                if name in seen:
                    where = field_name((*path, name))
                    self.twice.append(Problem(self.file, line, where, None, "is given twice; keep one of them"))
                seen.add(name)
                keys[name] = line, value
                self._read_keys(value, (*path, name))
        elif isinstance(node, yaml.SequenceNode):
            for index, value in enumerate(node.value):
                self._read_keys(value, (*path, index))

    def _deepest(self, path: Path) -> tuple[int, yaml.Node | None]:
        """Line of the deepest part of `path` that is in the file, and the node at its end, None where that is not."""
        node, line = self.root, 1
        for part in path:
            if isinstance(node, yaml.MappingNode) and str(part) in self._keys[id(node)]:
                line, node = self._keys[id(node)][str(part)]
            elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
                node = node.value[part]
                line = node.start_mark.line + 1
            else:
                return line, None
        return line, node

    def line(self, path: Path) -> int:
        """Line of the deepest part of `path` that is in the file (a missing key: its mapping's line)."""
        return self._deepest(path)[0]

    def written(self, path: Path) -> str | None:
        """A number, true or false as it was written: `01234567`, `1.10`; None for everything else."""
        _, node = self._deepest(path)
        return str(node.value) if isinstance(node, yaml.ScalarNode) and node.tag in _NO_TEXT else None

    def value(self, path: Path) -> Any:
        """What stands there, None if nothing does."""
        node = self.data
        for part in path:
            try:
                node = node[part]
            except (KeyError, IndexError, TypeError):
                return None
        return node

    def problem(self, path: Path, message: str) -> Problem:
        """A problem with the field at `path`."""
        value = self.value(path)
        shown = value if isinstance(value, str | int | float | bool | None) else None
        return Problem(self.file, self.line(path), field_name(path), shown, message)
