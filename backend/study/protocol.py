"""Reads study protocols: the YAML, the texts and questionnaires it names, checked and frozen.

Every error names file, line, field, value and what is allowed. What the keys mean stands in `schema.py`; what is made
of a protocol (plans, pages) lives elsewhere.
"""

from __future__ import annotations

import difflib
import hashlib
import re
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from backend.store.models import Study, protocol_digest
from backend.study import source as yaml_source
from backend.study.schema import (
    PATTERNS,
    BlockStage,
    ComparisonStage,
    Protocol,
    Queries,
    Questionnaire,
    QuestionnaireStage,
    StageEntry,
    TrainStage,
)
from backend.study.source import Problem, ProtocolError, Source

PROTOCOLS = Path(__file__).resolve().parents[2] / "study_protocols"
DATASETS = PROTOCOLS.parent / "datasets"
POINT = re.compile(r"^- \[ \] +(.+)$", re.MULTILINE)
_BRACES = re.compile(r"\{(\w+)\}")
M = TypeVar("M", bound=BaseModel)
Read = Callable[[str], str | None]
"""Content of a file named relative to the protocol, None if there is none."""
Content = tuple[str, tuple[tuple[str, Any], ...]]
"""YAML and the files that it names."""

__all__ = ["FrozenProtocol", "ProtocolError", "StageSummary", "describe_stages", "freeze", "freeze_text"]


@dataclass(frozen=True)
class FrozenProtocol:
    """A checked protocol with all that it names. `files`: name -> content; `hash`: sha256 of all of it."""

    yaml: str
    protocol: Protocol
    questionnaires: dict[str, Questionnaire]
    files: dict[str, str]
    hash: str

    @property
    def data(self) -> dict[str, Any]:
        """The protocol as plain data, with defaults filled in."""
        return self.protocol.model_dump(mode="json", by_alias=True)

    def title(self, language: str) -> str:
        return local(self.protocol.title, language)

    def text(self, name: str, language: str) -> tuple[str, str]:
        """Title (the first heading) and the rest of a markdown text in that language."""
        content = self.files.get(variant(name, language))
        if content is None:
            content = self.files.get(name) or self.files[variant(name, self.protocol.languages[0])]
        first, _, rest = filled(content, self.protocol).strip().partition("\n")
        if first.startswith("# "):
            return first[2:].strip(), rest.strip()
        return self.title(language), content.strip()

    def consent_hash(self, language: str) -> str:
        """sha256 of the consent text exactly as it is shown in that language."""
        name = next(entry.consent.text for entry in self.protocol.stages if entry.consent)
        content = filled(self.files.get(variant(name, language), self.files.get(name, "")), self.protocol)
        return hashlib.sha256(content.encode()).hexdigest()


def text_numbers(protocol: Protocol) -> dict[str, int]:
    """What a text may name in braces, so that it stays true when the protocol is changed: name -> number."""
    pairs = {"learning": 0, "regular": 0}
    compared = 0
    for entry in protocol.stages:
        if isinstance(entry.stage, BlockStage):
            for one in entry.stage.trials:
                probes = one.queries.probes
                pairs[one.queries.role] += one.queries.count + probes.repeat + probes.swap
        elif isinstance(entry.stage, ComparisonStage):
            compared += entry.stage.scenes
    return {
        "minutes": protocol.minutes,
        "pairs": pairs["regular"],
        "practice_pairs": pairs["learning"],
        "comparison_pairs": compared,
    }


def filled(text: str, protocol: Protocol) -> str:
    """The text with `{minutes}`, `{pairs}` and so on as numbers."""
    for name, number in text_numbers(protocol).items():
        text = text.replace(f"{{{name}}}", str(number))
    return text


def local(text: dict[str, str], language: str) -> str:
    """The text in that language, in the first one it has otherwise."""
    return text.get(language) or next(iter(text.values()))


def variant(name: str, language: str) -> str:
    """`texts/consent.md` in German is `texts/consent.de.md`."""
    stem, dot, ending = name.rpartition(".")
    return f"{stem}.{language}{dot}{ending}" if dot else f"{name}.{language}"


def freeze(file: Path | str, query_sets: Mapping[str, str] | None = None) -> FrozenProtocol:
    """Read a protocol and everything it names. Raises ProtocolError with every problem.

    query_sets: id -> description of the sets that a protocol may name by id (`store.query_sets.query_sets_here`).
    """
    path = Path(file)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as wrong:
        reason = wrong.strerror if isinstance(wrong, OSError) else "is not UTF-8 text"
        raise ProtocolError([Problem(str(file), 1, "(file)", None, f"cannot be read: {reason}")]) from None
    return freeze_text(text, file=path.name, folder=path.parent, query_sets=query_sets)


def freeze_text(
    text: str,
    *,
    file: str = "protocol.yaml",
    folder: Path = PROTOCOLS,
    query_sets: Mapping[str, str] | None = None,
) -> FrozenProtocol:
    """The same for YAML that was uploaded or pasted; its texts and questionnaires come from `folder`."""

    def read(name: str) -> str | None:
        path = folder / name
        try:
            return path.read_text(encoding="utf-8") if path.is_file() else None
        except (OSError, UnicodeDecodeError):
            return None

    frozen = _frozen(text, file, read)
    problem = _query_set(frozen.protocol.query_set, query_sets or {}, Source(file, text))
    if problem:
        raise ProtocolError([problem])
    return frozen


def thaw(study: Study) -> FrozenProtocol:
    """The frozen protocol of a study, from its own copy alone."""
    content = (study.protocol_yaml, tuple(sorted(study.files.items())))
    found = _thawed.get(content)
    if found is None:
        found = _frozen(study.protocol_yaml, f"{study.protocol_name}.yaml", study.files.get)
        _thawed[content] = found
    return found


_thawed: dict[Content, FrozenProtocol] = {}  # by content, so never stale; one small entry per protocol version


def validate_protocol_file(file: Path | str, query_sets: Mapping[str, str] | None = None) -> dict[str, Any]:
    """{"valid": bool, "errors": [{file, line, field, value, message}]}; never raises for what the file says."""
    try:
        freeze(file, query_sets)
    except ProtocolError as wrong:
        return {"valid": False, "errors": wrong.errors}
    return {"valid": True, "errors": []}


def shipped_protocols() -> list[Path]:
    """The protocol files that come with the product."""
    return sorted(PROTOCOLS.glob("*.yaml"))


# ---- reading -------------------------------------------------------------------------------------------------------


def _frozen(text: str, file: str, read: Read) -> FrozenProtocol:
    source = Source(file, text)
    protocol = _parse(source, Protocol)
    problems = list(_order(protocol, source))
    problems += _localized(protocol.title, ("title",), protocol, source)
    files: dict[str, str] = {}
    questionnaires: dict[str, Questionnaire] = {}
    for index, entry in enumerate(protocol.stages):
        here = ("stages", index, entry.kind)
        if isinstance(entry.stage, QuestionnaireStage):
            wanted: list[tuple[str, yaml_source.Path]] = [(entry.stage.use, (*here, "use"))]
        elif isinstance(entry.stage, TrainStage) and entry.stage.meanwhile:
            wanted = [(entry.stage.meanwhile.questionnaire, (*here, "while", "questionnaire"))]
        else:
            wanted = []
        for name, path in wanted:
            try:
                questionnaires[name] = _questionnaire(name, path, protocol, source, read, files)
            except ProtocolError as wrong:
                problems += wrong.problems
        if hasattr(entry.stage, "text"):
            problems += _texts(entry.stage.text, (*here, "text"), protocol, source, read, files)
    if problems:
        raise ProtocolError(problems)
    files = dict(sorted(files.items()))
    return FrozenProtocol(text, protocol, questionnaires, files, hash=protocol_digest(text, files))


def _questionnaire(
    name: str, path: yaml_source.Path, protocol: Protocol, source: Source, read: Read, files: dict[str, str]
) -> Questionnaire:
    file = f"questionnaires/{name}.yaml"
    content = read(file)
    if content is None:
        raise ProtocolError([source.problem(path, f"there is no file {file} beside the protocol")])
    files[file] = content
    own = Source(file, content)
    questionnaire = _parse(own, Questionnaire)
    problems = _localized(questionnaire.title, ("title",), protocol, own)
    if questionnaire.text:
        problems += _localized(questionnaire.text, ("text",), protocol, own)
    seen: set[str] = set()
    for b, block in enumerate(questionnaire.blocks):
        if block.title:
            problems += _localized(block.title, ("blocks", b, "title"), protocol, own)
        for i, item in enumerate(block.items):
            here: yaml_source.Path = ("blocks", b, "items", i)
            if item.key in seen:
                problems.append(own.problem((*here, "key"), f"{item.key!r} is used twice; every item needs its own"))
            seen.add(item.key)
            for field in ("text", "low", "high"):
                text = getattr(item, field)
                if text is not None:
                    problems += _localized(text, (*here, field), protocol, own)
            for o, option in enumerate(item.options):
                problems += _localized(option.label, (*here, "options", o, "label"), protocol, own)
    if problems:
        raise ProtocolError(problems)
    return questionnaire


def _texts(
    name: str, path: yaml_source.Path, protocol: Protocol, source: Source, read: Read, files: dict[str, str]
) -> list[Problem]:
    if Path(name).is_absolute() or ".." in Path(name).parts:
        return [source.problem(path, "must be a path below the protocol's folder, without '..'")]
    missing = []
    for language in protocol.languages:
        chosen = variant(name, language)
        content = read(chosen)
        if content is None and len(protocol.languages) == 1:
            chosen, content = name, read(name)
        if content is None:
            missing.append(chosen)
        elif not content.strip():
            return [source.problem(path, f"the text {chosen} is empty")]
        elif unknown := [word for word in _BRACES.findall(content) if word not in text_numbers(protocol)]:
            allowed = ", ".join(f"{{{word}}}" for word in text_numbers(protocol))
            told = f"the text {chosen} has {{{unknown[0]}}}; what is filled in: {allowed}"
            return [source.problem(path, told + _meant(unknown[0], list(text_numbers(protocol))))]
        else:
            files[chosen] = content
    return [source.problem(path, f"needs the file {', '.join(missing)} beside the protocol")] if missing else []


def _query_set(name: str, here: Mapping[str, str], source: Source) -> Problem | None:
    """Whether there is such a query set, without opening it (`learning` and torch take seconds to import)."""
    shipped = sorted(path.relative_to(DATASETS).with_suffix("").as_posix() for path in DATASETS.glob("*/queries*.npz"))
    if name in shipped or name in here or (name.endswith(".npz") and Path(name).is_file()):
        return None
    allowed = ", ".join(shipped) or "none"
    # shipped sets that a study has used are here, too, under their names
    made = ", ".join(f"{id_}: {told}" for id_, told in here.items() if told.partition(" (")[0] not in shipped) or "none"
    return source.problem(
        ("query_set",),
        f"is no query set; shipped are: {allowed}; made here, by id: {made}; or the path of a .npz file"
        f"{_meant(name, [*shipped, *here])}",
    )


def _localized(text: dict[str, str], path: yaml_source.Path, protocol: Protocol, source: Source) -> list[Problem]:
    missing = [language for language in protocol.languages if not text.get(language, "").strip()]
    unknown = [language for language in text if language not in protocol.languages]
    problems = []
    if missing:
        problems.append(source.problem(path, f"has no text for {', '.join(missing)}; needed: one per language"))
    if unknown:
        allowed = ", ".join(protocol.languages)
        problems.append(source.problem((*path, unknown[0]), f"is not one of the protocol's languages ({allowed})"))
    return problems


def _order(protocol: Protocol, source: Source) -> Iterator[Problem]:
    """What the order of stages must be, so that nobody is asked before they have consented, or shown nothing."""
    kinds = [entry.kind for entry in protocol.stages]

    def at(index: int, message: str) -> Problem:
        return source.problem(("stages", index, kinds[index]), message)

    def first(kind: str) -> int:
        return kinds.index(kind) if kind in kinds else len(kinds)

    if "consent" not in kinds:
        yield source.problem(("stages",), "needs a consent stage before anything is asked")
    if kinds[-1] != "debriefing" or kinds.count("debriefing") != 1:
        yield source.problem(("stages",), "must end with its one debriefing stage")
    for once in ("consent", "train", "comparison"):
        if kinds.count(once) > 1:
            again = len(kinds) - 1 - kinds[::-1].index(once)
            yield at(again, f"stands {kinds.count(once)} times; a protocol has at most one {once} stage")
    for index, kind in enumerate(kinds):
        if kind in ("questionnaire", "block") and index < first("consent") < len(kinds):
            yield at(index, "stands before the consent stage; nothing may be asked before it")
    if "block" not in kinds:
        yield source.problem(("stages",), "needs at least one block of trials")
    if "train" in kinds and first("train") < first("block"):
        yield at(first("train"), "stands before any block; there are no answers to learn from yet")
    if "comparison" in kinds and first("comparison") < first("train"):
        yield at(first("comparison"), "needs a train stage before it that makes the participant's own policy")
    for index, entry in enumerate(protocol.stages):
        if isinstance(entry.stage, BlockStage):
            regular = sum(one.queries.count for one in entry.stage.trials if one.queries.role == "regular")
            for t, one in enumerate(entry.stage.trials):
                probes = one.queries.probes
                if probes.repeat + probes.swap > one.queries.count or (
                    one.queries.role == "learning" and probes.repeat + probes.swap
                ):
                    yield source.problem(
                        ("stages", index, "block", "trials", t, "queries", "probes"),
                        "asks for more probes than there are regular queries to ask again",
                    )
                yield from _chosen(one.queries, ("stages", index, "block", "trials", t, "queries"), kinds, source)
            if not regular:
                yield source.problem(
                    ("stages", index, "block", "trials"), "has learning trials only; add queries of role regular"
                )
    if len(set(protocol.languages)) != len(protocol.languages):
        yield source.problem(("languages",), "names a language twice")


def _chosen(queries: Queries, here: yaml_source.Path, kinds: list[str], source: Source) -> Iterator[Problem]:
    """Where queries may follow the answers: not in practice, not where several blocks must show the same ones."""
    if queries.choose == "random":
        if queries.stop is not None:
            yield source.problem((*here, "stop"), "needs queries that are chosen by disagreement or information")
        return
    if queries.role == "learning":
        yield source.problem((*here, "choose"), "must be random for learning trials; their answers teach nothing")
    if kinds.count("block") > 1:
        yield source.problem(
            (*here, "choose"),
            "must be random, because this protocol's blocks show the same queries; keep one block, or choose: random",
        )
    if queries.stop is not None and queries.stop.at_least > queries.count:
        yield source.problem((*here, "stop", "at_least"), f"is more than the {queries.count} queries there are")


# ---- pydantic's errors in words --------------------------------------------------------------------------------------


def _parse(source: Source, model: type[M]) -> M:
    try:
        return model.model_validate(source.data)
    except ValidationError as wrong:
        problems = [
            source.problem(_in_file(error["loc"]), _in_words(error, model))
            for error in wrong.errors(include_url=False, include_context=True)
        ]
        raise ProtocolError(problems) from None


def _in_file(location: tuple[int | str, ...]) -> yaml_source.Path:
    return tuple(part for part in location if not str(part).startswith("function-"))


def _in_words(error: Any, model: type[BaseModel]) -> str:
    context: dict[str, Any] = error.get("ctx", {})
    given = error.get("input")
    match error["type"]:
        case "missing":
            return "is missing"
        case "extra_forbidden":
            allowed = _allowed_keys(model, error["loc"][:-1])
            return f"is not a key that is known here; allowed: {', '.join(allowed)}{_meant(error['loc'][-1], allowed)}"
        case "literal_error":
            allowed = [word.strip("' ") for word in context["expected"].replace(" or ", ", ").split(",")]
            if len(allowed) == 1:
                return f"must be {allowed[0]}, the only value there is"
            return f"must be one of {', '.join(allowed)}{_meant(given, allowed)}"
        case "greater_than_equal":
            return f"must be at least {context['ge']}"
        case "less_than_equal":
            return f"must be at most {context['le']}"
        case "too_short" | "string_too_short":
            return "must not be empty"
        case "int_parsing" | "int_type" | "int_from_float":
            return "must be a whole number"
        case "string_pattern_mismatch":
            return PATTERNS[context["pattern"]]
        case "value_error":
            return str(context["error"])
        case "model_type" | "dict_type" | "model_attributes_type":
            return "must be a mapping of keys to values"
    said: str = error["msg"]
    return said[0].lower() + said[1:]


def _meant(given: object, allowed: list[str]) -> str:
    close = difflib.get_close_matches(str(given), allowed, n=1)
    return f"; did you mean {close[0]}?" if close else ""


def _allowed_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    here: type[BaseModel] = model
    for part in location:
        if isinstance(part, int):
            continue
        fields = {field.alias or name: field for name, field in here.model_fields.items()}
        inner = _model_in(fields[part].annotation) if part in fields else None
        if inner is None:
            break
        here = inner
    return [field.alias or name for name, field in here.model_fields.items()]


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if typing.get_origin(annotation) in (list, tuple, typing.Union, types.UnionType, typing.Annotated):
        for inner in typing.get_args(annotation):
            found = _model_in(inner)
            if found:
                return found
    return None


# ---- for the experimenter's page -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StageSummary:
    """One stage, readable. `key` is what plan steps carry as `stage`; `facts`: (word, value) pairs of its settings."""

    key: str
    kind: str
    facts: tuple[tuple[str, str], ...]
    texts: tuple[tuple[str, str], ...]  # (language, markdown)
    questionnaire: str | None


def stage_keys(stages: list[StageEntry]) -> list[str]:
    """A short name for every stage, unique within the protocol."""
    keys: list[str] = []
    for entry in stages:
        stage = entry.stage
        name = stage.use if isinstance(stage, QuestionnaireStage) else entry.kind
        same = sum(1 for key in keys if key == name or key.startswith(f"{name}_"))
        keys.append(f"{name}_{same + 1}" if same else name)
    return keys


def describe_stages(protocol: dict[str, Any], files: dict[str, str]) -> list[StageSummary]:
    """The stages of a study's frozen protocol (`study.protocol`, `study.files`), one readable entry each."""
    known = {name: protocol[name] for name in Protocol.model_fields if name in protocol}
    parsed = Protocol.model_validate(known)
    summaries = []
    for key, entry in zip(stage_keys(parsed.stages), parsed.stages, strict=True):
        data = entry.stage.model_dump(mode="json", by_alias=True, exclude_none=True)
        text = data.pop("text", None)
        texts = []
        for language in parsed.languages if text else ():
            content = files.get(variant(text, language), files.get(text, ""))
            texts.append((language, filled(content, parsed)))
        used = entry.stage.use if isinstance(entry.stage, QuestionnaireStage) else None
        if isinstance(entry.stage, TrainStage) and entry.stage.meanwhile:
            used = entry.stage.meanwhile.questionnaire
        summaries.append(StageSummary(key, entry.kind, tuple(_facts(data)), tuple(texts), used))
    return summaries


def _facts(data: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(data, dict):
        for name, value in data.items():
            yield from _facts(value, f"{prefix} {name}".strip())
    elif isinstance(data, list) and data and isinstance(data[0], dict):
        for number, value in enumerate(data, 1):
            yield from _facts(value, f"{prefix} {number}")
    else:
        shown = ", ".join(map(str, data)) if isinstance(data, list) else str(data).lower()
        yield prefix.replace("_", " "), shown if not isinstance(data, str) else data


def expected_minutes(protocol: Protocol, *, seconds_per_drive: float = 9.0) -> float:
    """How long a session takes by the protocol: two drives with letters and a choice per trial, half a minute per page.

    seconds_per_drive: of the study room's queries, spec 07 (9.8 s and less). Half a minute for a page is ours.
    """
    per_trial = 2 * (seconds_per_drive + 2.0) + 5.0
    trials = 0
    pages = 0
    for entry in protocol.stages:
        stage = entry.stage
        if isinstance(stage, BlockStage):
            trials += sum(q.queries.count + q.queries.probes.repeat + q.queries.probes.swap for q in stage.trials)
        elif isinstance(stage, ComparisonStage):
            trials += stage.scenes
        else:
            pages += 1
    return round((trials * per_trial + pages * 30.0) / 60.0, 1)
