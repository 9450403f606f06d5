"""Reads the texts and questionnaires that a protocol names, with every problem where it stands in its file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from desirepath.analysis.scale_wordings import INSTRUMENTS, SCALES
from desirepath.analysis.scales import Scale, ScaleItem, frozen_items, wording_digest
from desirepath.grammar import source as yaml_source
from desirepath.grammar.conditions import Crossed
from desirepath.grammar.error_words import meant, read_as
from desirepath.grammar.questionnaires import Item, ItemBlock, Questionnaire
from desirepath.grammar.skipping import problems_within
from desirepath.grammar.source import Problem, ProtocolError, Source
from desirepath.grammar.text_files import NotUtf8Error
from desirepath.grammar.texts import variant
from desirepath.study.protocol.schema import Protocol, all_texts, text_numbers
from desirepath.study.protocol.stages import STAGES, StageEntry
from desirepath.study.steps import Stage

_BRACES = re.compile(r"\{(\w+)\}")
MOST_STAGES = 100  # (ours) the shipped ones have up to 10
MOST_TRIALS = 2_000  # of one participant (ours): 40 hours
MOST_CONDITIONS = 100  # cells of a block's crossing (ours)
LARGEST_VERSION = 2**31 - 1  # what a column of whole numbers holds
TEXTS = ("title", "text", "low", "high", "label")  # keys of a questionnaire under which each language has a text
Read = Callable[[str], str | None]
"""Content of a file named relative to the protocol, None if there is none. Raises NotUtf8Error."""


def check_size(source: Source) -> Source:
    """The file itself, where it has no more stages than can be checked while somebody waits. Raises ProtocolError."""
    stages = source.value(("stages",))
    if isinstance(stages, list) and len(stages) > MOST_STAGES:
        message = f"has {len(stages):,} stages; a protocol has at most {MOST_STAGES}"
        raise ProtocolError([source.problem(("stages", MOST_STAGES), message)])
    version = source.value(("version",))
    if isinstance(version, int) and version > LARGEST_VERSION:
        raise ProtocolError([source.problem(("version",), f"must be at most {LARGEST_VERSION}")])
    return source


def too_long(protocol: Protocol, source: Source) -> Iterator[Problem]:
    """Where it asks more than a session can hold; before anything is planned."""
    trials = 0
    for index, entry in enumerate(protocol.stages):
        stage = entry.stage
        if not isinstance(stage, Crossed):
            continue
        here = ("stages", index, entry.kind)
        cells = {name: math.prod(map(len, (getattr(stage, name) or {}).values())) for name in ("each", "one_of")}
        for name, number in cells.items():
            if number > MOST_CONDITIONS:
                message = f"makes {number:,} conditions; a stage has at most {MOST_CONDITIONS}"
                yield source.problem((*here, name), message)
                return
        trials += cells["each"] * entry.stage.trials_asked()
        if trials > MOST_TRIALS:
            message = f"brings a participant to {trials:,} trials; a session has at most {MOST_TRIALS:,}"
            yield source.problem((*here, "trials"), message)
            return


def valid_part(source: Source, problems: Collection[Problem]) -> Protocol | None:
    """What can be looked at further of a protocol with these problems: its stages without the fields that are wrong,
    nothing in place of those that need them, defaults for other keys. None where stages or languages are not known."""
    paths = [_PART.findall(problem.field) for problem in problems]
    wrong = {path[0] for path in paths}
    data = json.loads(json.dumps(source.data))
    languages, stages = data.get("languages"), data.get("stages")
    if "languages" in wrong or not isinstance(languages, list) or not isinstance(stages, list):
        return None
    for _, *path in (path for path in paths if path[0] == "stages"):
        _drop(stages, path)
    kept = {"protocol": "unknown", "version": 1, "title": dict.fromkeys(languages, "-")} | {
        key: value for key, value in data.items() if key in Protocol.model_fields and key not in wrong
    }
    empty: dict[str, Any] = {next(iter(STAGES)): Stage()}
    nothing = StageEntry.model_construct(**empty)
    entries = [nothing] * len(stages)
    for index, stage in enumerate(stages):
        with suppress(ValidationError):
            entries[index] = StageEntry.model_validate(stage)
    try:
        whole = Protocol.model_validate({**kept, "stages": [_NOTHING]})
    except ValidationError:
        return None
    return whole.model_copy(update={"stages": entries})


_PART = re.compile(r"[^.\[\]]+")
_NOTHING = {"information": {"text": "-"}}


def _drop(data: Any, path: Sequence[str]) -> None:
    """Take what stands there out of its mapping."""
    for part in path[:-1]:
        if isinstance(data, list) and part.isdecimal() and int(part) < len(data):
            data = data[int(part)]
        elif isinstance(data, dict):
            data = data.get(part)
    if isinstance(data, dict):
        data.pop(path[-1], None)


class Reader:
    """Reads what one protocol names. `files` collects the content of all that was read, by name."""

    def __init__(self, protocol: Protocol, source: Source, read: Read, *, strict: bool = True) -> None:
        """strict: as `parse` has it."""
        self.protocol, self.source, self.files = protocol, source, {}
        self.unreadable: dict[str, Problem] = {}  # files that are there and are no text
        self._given, self._strict = read, strict
        self.absent = [language for language in protocol.languages if self._is_absent(language)]
        self._languages = [language for language in protocol.languages if language not in self.absent]

    files: dict[str, str]

    def _read(self, name: str) -> str | None:
        try:
            return self._given(name)
        except NotUtf8Error as wrong:
            self.unreadable[name] = Problem(name, wrong.line, "(file)", None, str(wrong))
            return None

    def _is_absent(self, language: str) -> bool:
        """Whether nothing at all is there in that language, so that one error says it for every text."""
        names = [variant(name, language) for name, _ in all_texts(self.protocol)]
        there = (self._read(name) is not None or name in self.unreadable for name in names)
        return language not in self.protocol.title and not any(there)

    def language_problems(self) -> list[Problem]:
        """Languages that are named twice or in which nothing is there, and a title that is not there in all."""
        named = self.protocol.languages
        problems = [
            self.source.problem(
                ("languages", named.index(language)),
                "has no title and no text; write them in this language, or take it out of the languages",
            )
            for language in self.absent
        ]
        if len(set(named)) != len(named):
            problems.append(self.source.problem(("languages",), "names a language twice"))
        problems += self.check_localized(self.protocol.title, ("title",), self.source)
        if self.protocol.welcome:
            problems += self.check_localized(self.protocol.welcome, ("welcome",), self.source)
        if self.protocol.payment:
            problems += self.check_localized(self.protocol.payment, ("payment",), self.source)
        for index, entry in enumerate(self.protocol.stages):
            for text, path in entry.stage.local_texts():
                problems += self.check_localized(text, ("stages", index, entry.kind, *path), self.source)
        return problems

    def check_localized(self, text: dict[str, str], path: yaml_source.Path, source: Source) -> list[Problem]:
        """What is wrong with a text that stands in the file itself, in each language."""
        missing = [language for language in self._languages if not text.get(language, "").strip()]
        unknown = [language for language in text if language not in self.protocol.languages]
        problems = []
        if missing:
            problems.append(source.problem(path, f"has no text for {', '.join(missing)}; needed: one per language"))
        if unknown:
            allowed = ", ".join(self.protocol.languages)
            problems.append(source.problem((*path, unknown[0]), f"is not one of the protocol's languages ({allowed})"))
        return problems

    # ---- markdown texts ----------------------------------------------------------------------------------------------

    def text(self, name: str, path: yaml_source.Path) -> list[Problem]:
        """Read a text in every language; `path`: where the protocol names it."""
        if Path(name).is_absolute() or ".." in Path(name).parts:
            return [self.source.problem(path, "must be a path below the protocol's folder, without '..'")]
        missing, problems = [], []
        for language in self._languages:
            names = [variant(name, language), *([name] if len(self.protocol.languages) == 1 else [])]
            chosen = next((candidate for candidate in names if self._read(candidate) is not None), names[-1])
            content = self._read(chosen)
            if content is None:
                missing += [] if any(candidate in self.unreadable for candidate in names) else [chosen]
            elif not content.strip():
                problems.append(self.source.problem(path, f"the text {chosen} is empty"))
            elif unknown := self._unfilled(content):
                known = list(text_numbers(self.protocol))
                allowed = ", ".join(f"{{{word}}}" for word in known)
                message = f"the text {chosen} has {{{unknown}}}; what is filled in: {allowed}"
                problems.append(self.source.problem(path, message + meant(unknown, known)))
            else:
                self.files[chosen] = content
        if missing:
            problems.append(self.source.problem(path, f"needs the file {', '.join(missing)} beside the protocol"))
        return problems

    def _unfilled(self, content: str) -> str | None:
        known = text_numbers(self.protocol)
        return next((word for word in _BRACES.findall(content) if word not in known), None)

    # ---- questionnaires ----------------------------------------------------------------------------------------------

    def questionnaire(self, name: str, path: yaml_source.Path) -> Questionnaire:
        """Read a questionnaire, validated scales filled in. Raises ProtocolError with every problem."""
        file = f"questionnaires/{name}.yaml"
        content = self._read(file)
        if content is None and file in self.unreadable:
            raise ProtocolError([])  # said with the others that are no text
        if content is None:
            message = f"there is no file {file} beside the protocol, and no instrument of that name"
            raise ProtocolError([self.source.problem(path, message + meant(name, list(INSTRUMENTS)))])
        self.files[file] = content
        own = Source(file, content)
        questionnaire, problems = read_as(own, Questionnaire, strict=self._strict)
        if questionnaire is None or questionnaire.instrument is None:  # an instrument has the languages that it has
            for where, text in _texts_in(own.data):
                problems += self.check_localized(text, where, own)
        elif strange := [scale for scale in questionnaire.instrument.scales if scale not in SCALES]:
            message = f"is no scale of a shipped instrument; there are: {', '.join(SCALES)}"
            problems.append(own.problem(("instrument", "scales", strange[0]), message))
        if questionnaire is None:
            raise ProtocolError(problems)
        blocks = []
        for b, block in enumerate(questionnaire.blocks):
            try:
                items = self._scale(block, ("blocks", b, "scale"), own) if block.scale else block.items
                blocks.append(block.with_items(items))
            except ProtocolError as wrong:
                problems += wrong.problems
        whole = questionnaire.model_copy(update={"blocks": blocks})
        problems += [*_keys_twice(whole, own), *_borrowed_names(name, whole, own), *problems_within(name, whole, own)]
        if problems:
            raise ProtocolError(problems)
        return whole

    def _scale(self, block: ItemBlock, path: yaml_source.Path, own: Source) -> list[Item]:
        """The scale's items, which become part of the study's own copy."""
        scale = SCALES.get(block.scale or "")
        if scale is None:
            message = f"is no validated scale; there are: {', '.join(SCALES)}{meant(block.scale, list(SCALES))}"
            raise ProtocolError([own.problem(path, message)])
        kept = f"scales/{scale.name}.json"
        frozen = self._read(kept)
        if not scale.languages:
            self.files[kept] = frozen = frozen or _as_file(self._with_words(scale, block, path, own))
            return [Item(**item) for item in frozen_items(frozen)]
        there = [language for language in self._languages if language in scale.languages]
        if block.items and not all(_is_verbatim(block.items, scale, language) for language in there):
            message = (
                f"has items that are not those of {scale.names[0]} word by word; leave 'items' out to ask the scale "
                "itself, or leave 'scale' out and give the questionnaire another name"
            )
            raise ProtocolError([own.problem(path, message)])
        self.files[kept] = frozen = frozen or _as_file(scale)
        return [Item(**item) for item in frozen_items(frozen)]

    def _with_words(self, scale: Scale, block: ItemBlock, path: yaml_source.Path, own: Source) -> Scale:
        """A scale whose words may not be shipped, with those that the questionnaire supplies."""
        if not block.items:
            message = (
                f"is {scale.names[0]}, whose words may not be shipped with this program; supply them as 'items' of "
                f"type scale with {scale.points} points and the keys {', '.join(item.key for item in scale.items)} "
                "(`desirepath studies instruments NAME` prints a file to fill in)"
            )
            raise ProtocolError([own.problem(path, message)])
        given = [ScaleItem(i.key, i.text, i.low or {}, i.high or {}, reversed=i.reversed) for i in block.items]
        try:
            worded = scale.with_words(given)
        except ValueError as problem:
            raise ProtocolError([own.problem(path, str(problem))]) from None
        whole = all(set(self._languages) <= words.keys() for i in given for words in (i.text, i.low, i.high))
        marks = all((i.type, i.points, i.when) == ("scale", scale.points, []) for i in block.items)
        if not whole or not marks:
            message = (
                f"needs of every item text, low and high in {', '.join(self._languages)}, type scale, "
                f"{scale.points} points, and no 'when'"
            )
            raise ProtocolError([own.problem(path, message)])
        return worded


def _texts_in(data: Any, path: yaml_source.Path = ()) -> Iterator[tuple[yaml_source.Path, dict[str, str]]]:
    """What is written once per language in a questionnaire, wherever that is valid."""
    if isinstance(data, dict | list):
        for key, inner in data.items() if isinstance(data, dict) else enumerate(data):
            if key in TEXTS and isinstance(inner, dict) and all(isinstance(word, str) for word in inner.values()):
                yield (*path, key), inner
            else:
                yield from _texts_in(inner, (*path, key))


def _as_file(scale: Scale) -> str:
    return json.dumps(asdict(scale), ensure_ascii=False, indent=1)


def _is_verbatim(items: Collection[Item], scale: Scale, language: str) -> bool:
    wording = [
        (item.text.get(language, ""), (item.low or {}).get(language, ""), (item.high or {}).get(language, ""))
        for item in items
    ]
    marks = [(item.type, item.points, item.reversed, bool(item.when)) for item in items]
    wanted = [("scale", scale.points, item.reversed, False) for item in scale.items]  # a scale is asked whole
    return wording_digest(wording, scale.points) == scale.digest(language) and marks == wanted


def _keys_twice(questionnaire: Questionnaire, own: Source) -> list[Problem]:
    problems = []
    seen: set[str] = set()
    for b, block in enumerate(questionnaire.blocks):
        for i, item in enumerate(block.items):
            if item.key in seen:
                path = ("blocks", b, "scale") if block.scale else ("blocks", b, "items", i, "key")
                problems.append(own.problem(path, f"{item.key!r} is used twice; every item needs its own"))
            seen.add(item.key)
    return problems


def _named(names: Sequence[str]) -> re.Pattern[str]:
    """Any of these names as words of a text, the longest first."""
    longest = sorted(map(re.escape, names), key=len, reverse=True)
    return re.compile(rf"\b({'|'.join(longest)})\b", re.IGNORECASE)


def _borrowed_names(name: str, questionnaire: Questionnaire, own: Source) -> list[Problem]:
    """A validated scale's name over items that are not its own. The names of those that are asked may hold others'."""
    asked = {block.scale for block in questionnaire.blocks}
    rightly = _named([n for scale in asked if scale in SCALES for n in SCALES[scale].names] or ["\n"])
    problems = []
    for scale in SCALES.values():
        if scale.name in asked:
            continue
        words = _named([*scale.names, scale.name])
        message = (
            f"carries the name of the validated scale {scale.names[0]}, whose items are not asked here; "
            f"ask it with '- scale: {scale.name}', or choose another name"
        )
        titles: list[tuple[yaml_source.Path, dict[str, str] | None]] = [(("title",), questionnaire.title)]
        titles += [(("blocks", b, "title"), block.title) for b, block in enumerate(questionnaire.blocks)]
        problems += [
            own.problem(path, message)
            for path, title in titles
            if words.search(rightly.sub("", " / ".join((title or {}).values())))
        ]
        if words.fullmatch(name):
            problems.append(own.problem(("title",), f"the file's name {message}"))
    return problems
