"""YAML with line numbers: where in a file a field stands, so that an error can point at it. Knows no protocol."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from typing import Any

import yaml

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


class _Loader(yaml.SafeLoader):
    """YAML whose only booleans are true and false: `on:` is a key of ours, and `no` is Norwegian."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:bool"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile(r"^(?:true|false)$"), list("tf"))


class Source:
    """One YAML file's data and the line of each of its fields."""

    def __init__(self, file: str, text: str) -> None:
        """Raises ProtocolError for text that is no YAML, no mapping, or gives a key twice."""
        self.file = file
        try:
            self._root = yaml.compose(text, Loader=_Loader)
            self.data: Any = yaml.load(text, Loader=_Loader)  # noqa: S506  a SafeLoader
        except yaml.YAMLError as wrong:
            mark = getattr(wrong, "problem_mark", None)
            line = mark.line + 1 if mark else 1
            problem = getattr(wrong, "problem", None) or "cannot be read"
            raise ProtocolError([Problem(file, line, "(file)", None, f"is not valid YAML: {problem}")]) from None
        if not isinstance(self.data, dict):
            kind = "empty" if self.data is None else f"a {type(self.data).__name__}"
            raise ProtocolError([Problem(file, 1, "(file)", None, f"must be a mapping of keys to values, is {kind}")])
        twice = list(self._duplicates(self._root, ()))
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
