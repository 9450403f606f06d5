"""The words that people read: catalogues in `frontend/locales/LANGUAGE/FILE.yaml`, and how they become sentences.

A key begins with its file: `t("participant.trial.start")`. No template and no script holds a text of its own; texts
that belong to a study (information, consent, questions) come from its protocol, not from here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import date, datetime
from pathlib import Path
from typing import Any

from babel import Locale
from babel.dates import format_date
from babel.numbers import format_decimal, format_percent

from desirepath.grammar.source import Source, file_text

DEFAULT_LANGUAGE = "en"
# Where a language alone leaves the notation open, e.g. whether the month or the day comes first.
LOCALES = {"en": "en_GB"}
PLURAL_CATEGORIES = frozenset({"zero", "one", "two", "few", "many", "other"})
_PLACEHOLDER = re.compile(r"\{([a-z_][a-z0-9_]*)\}")

Entry = str | dict[str, Any]


class TextError(LookupError):
    """A text was asked for that no catalogue has, or that needs a value nobody gave."""


class Catalogue:
    """All texts of one language. Call it: `t("participant.progress", index=7, total=15)`."""

    def __init__(self, language: str, entries: dict[str, Any]) -> None:
        self.language = language
        self._entries = entries
        self._locale = Locale.parse(LOCALES.get(language, language))

    def __call__(self, key: str, **values: object) -> str:
        """The text of `key` with its `{placeholders}` filled.

        Whole and decimal numbers are written the language's way (pass a string for a year or a code). An entry with
        plural forms (`one`, `other`, ...) is chosen by the value `count`.

        Raises:
            TextError: unknown key, a key that names a group, or a placeholder without a value.
        """
        entry: Any = self._find(key)
        if isinstance(entry, dict):
            if "other" not in entry or not PLURAL_CATEGORIES.issuperset(entry):
                raise TextError(f"text {key!r} is a group of texts; name one of {', '.join(sorted(entry))}")
            count = values.get("count")
            if not isinstance(count, int | float):
                raise TextError(f"text {key!r} has plural forms; give count=NUMBER, got {count!r}")
            entry = entry.get(self._locale.plural_form(count), entry["other"])

        def fill(match: re.Match[str]) -> str:
            name = match.group(1)
            if name not in values:
                raise TextError(f"text {key!r} needs a value for {{{name}}}; given: {', '.join(values) or 'none'}")
            return self._show(values[name])

        return _PLACEHOLDER.sub(fill, str(entry))

    def knows(self, key: str) -> bool:
        """Whether there is a text or a group of texts under `key`; for keys made from data, e.g. error codes."""
        try:
            self._find(key)
        except TextError:
            return False
        return True

    def table(self, key: str) -> dict[str, Any]:
        """The group of raw texts under `key`, placeholders unfilled: what a page's script gets as JSON."""
        entry = self._find(key)
        if not isinstance(entry, dict):
            raise TextError(f"text {key!r} is one text, not a group")
        return entry

    def number(self, value: float, digits: int | None = None) -> str:
        """`value` in the language's notation, with exactly `digits` decimals where given."""
        pattern = None if digits is None else "#,##0" + ("." + "0" * digits if digits else "")
        return format_decimal(value, format=pattern, locale=self._locale)

    def exact(self, value: float) -> str:
        """`value` with as many decimals as it has, up to ten digits: nothing small becomes 0."""
        digits = f"{value:.10g}"
        return digits if "e" in digits else self.number(value, len(digits.partition(".")[2]))

    def percent(self, value: float, digits: int = 0) -> str:
        """A share from 0 to 1 as a percentage."""
        unit = "\N{NO-BREAK SPACE}%" if self._locale.language == "de" else "%"
        return format_percent(
            value, format="#,##0" + ("." + "0" * digits if digits else "") + unit, locale=self._locale
        )

    def interval(self, low: str, high: str) -> str:
        """Two ends that are written already, in brackets: with a semicolon where decimals have a comma."""
        return f"[{low}{';' if self._locale.language == 'de' else ','} {high}]"

    def date(self, value: date) -> str:
        """A day in words, e.g. `21 November 2026`."""
        return format_date(value, format="long", locale=self._locale)

    def moment(self, value: datetime) -> str:
        """A day in words with the time of day, in the value's own time zone."""
        return f"{self.date(value)}, {value:%H:%M}"

    def _find(self, key: str) -> Entry:
        entry: Any = self._entries
        for part in key.split("."):
            if not isinstance(entry, dict) or part not in entry:
                raise TextError(f"no text {key!r} in language {self.language!r} (stopped at {part!r})")
            entry = entry[part]
        found: Entry = entry
        return found

    def _show(self, value: object) -> str:
        if isinstance(value, bool) or not isinstance(value, int | float):
            return str(value)
        return format_decimal(value, locale=self._locale)


class Texts:
    """The catalogues of all languages under one folder, read once."""

    def __init__(self, folder: Path, beside: Callable[[str], Iterable[Path]] = lambda _: ()) -> None:
        """beside: the files of plug-ins in a language, whose first keys are names of catalogues. Raises TextError where
        one would replace a text."""
        self._catalogues = {}
        for entry in sorted(child for child in folder.iterdir() if child.is_dir()):
            entries: dict[str, Any] = {file.stem: read_catalogue(file) for file in sorted(entry.glob("*.yaml"))}
            for file in beside(entry.name):
                _add(entries, read_catalogue(file), str(file))
            self._catalogues[entry.name] = Catalogue(entry.name, entries)
        if DEFAULT_LANGUAGE not in self._catalogues:
            raise TextError(f"no catalogue for {DEFAULT_LANGUAGE!r} under {folder}; it needs {DEFAULT_LANGUAGE}/*.yaml")

    @property
    def languages(self) -> tuple[str, ...]:
        return tuple(self._catalogues)

    def get(self, language: str) -> Catalogue:
        """The catalogue of `language`; of English where there is none."""
        return self._catalogues.get(language, self._catalogues[DEFAULT_LANGUAGE])

    def best(self, accept_language: str | None, offered: tuple[str, ...] | None = None) -> str:
        """The first language of an `Accept-Language` header that is offered (all we have, unless given); else the
        first one offered."""
        choice = [code for code in (offered or self.languages) if code in self._catalogues] or [DEFAULT_LANGUAGE]
        wanted: list[tuple[float, str]] = []
        for part in (accept_language or "").split(","):
            tag, _, quality = part.strip().partition(";q=")
            try:
                wanted.append((float(quality or 1), tag.partition("-")[0].lower()))
            except ValueError:
                continue
        for _, code in sorted(wanted, key=lambda pair: -pair[0]):
            if code in choice:
                return code
        return DEFAULT_LANGUAGE if DEFAULT_LANGUAGE in choice else choice[0]


def flatten(entries: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Every (dotted key, text) below `entries`; plural forms count as texts of their own."""
    for name, entry in entries.items():
        key = f"{prefix}{name}"
        if isinstance(entry, Mapping):
            yield from flatten(entry, key + ".")
        else:
            yield key, str(entry)


def placeholders(text: str) -> frozenset[str]:
    """The names in braces that `text` wants filled."""
    return frozenset(_PLACEHOLDER.findall(text))


def _add(entries: dict[str, Any], more: Mapping[str, Any], file: str) -> None:
    for key, entry in more.items():
        if key not in entries:
            entries[key] = entry
        elif isinstance(entry, Mapping) and isinstance(entries[key], dict):
            _add(entries[key], entry, file)
        else:
            raise TextError(f"{file}: {key!r} has a text already; a plug-in only adds texts")


def read_catalogue(file: Path) -> dict[str, Any]:
    """The raw texts of one file."""
    return dict(Source(str(file), file_text(file)).data)
