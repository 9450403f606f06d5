"""Reads study protocols: the YAML and all that it names, checked and frozen.

Every error names file, line, field, value and what is allowed. What the keys mean stands in `schema.py`; what is made
of a protocol (plans, pages) lives elsewhere.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from desirepath.analysis.scale_wordings import INSTRUMENTS
from desirepath.grammar.error_words import meant, read_as
from desirepath.grammar.questionnaires import Questionnaire
from desirepath.grammar.source import Problem, ProtocolError, Source, file_text
from desirepath.grammar.text_files import as_text, read_text
from desirepath.grammar.texts import local, variant
from desirepath.installed import PROTOCOLS
from desirepath.simulation.setups import setup_folders
from desirepath.store.models import ProtocolVersion, Study, protocol_digest
from desirepath.study.frozen import Training
from desirepath.study.kinds.comparison import ComparisonStage
from desirepath.study.kinds.consent import ConsentStage
from desirepath.study.kinds.demonstration import DemonstrationsStage
from desirepath.study.kinds.evaluation import EvaluationStage
from desirepath.study.kinds.wait import TrainStage
from desirepath.study.protocol.analysis_checks import analysis_problems
from desirepath.study.protocol.checking import order_problems, problems_across
from desirepath.study.protocol.headset_words import head_problems, headset_warnings
from desirepath.study.protocol.reading import Read, Reader, check_size, too_long, valid_part
from desirepath.study.protocol.schema import Protocol, all_questionnaires, all_texts, fill_in
from desirepath.study.protocol.stages import T

Content = tuple[str, tuple[tuple[str, Any], ...]]
"""YAML and the files that it names."""
Sets = tuple[Path, Mapping[str, str]]
"""Where query sets may lie: beside the protocol, and in the store by id."""

__all__ = ["FrozenProtocol", "ProtocolError", "freeze", "freeze_text", "thaw", "validate_protocol_file"]


@dataclass(frozen=True)
class FrozenProtocol:
    """A checked protocol with all that it names. `files`: name -> content; `hash`: sha256 of all of it; `query_set`:
    the one it names, a file by its whole path."""

    yaml: str
    protocol: Protocol
    questionnaires: dict[str, Questionnaire]
    files: dict[str, str]
    hash: str
    query_set: str | None

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
        first, _, rest = fill_in(content, self.protocol).strip().partition("\n")
        if first.startswith("# "):
            return first[2:].strip(), rest.strip()
        return self.title(language), content.strip()

    def stage(self, kind: type[T]) -> T:
        """The stage of that class; one that every protocol has, or that a step of it was planned by."""
        found = self.protocol.stage_of(kind)
        assert found is not None, f"the protocol has no {kind.__name__}"  # noqa: S101
        return found

    @property
    def consent(self) -> ConsentStage:
        """The protocol's consent stage; every protocol has one."""
        return self.stage(ConsentStage)

    @property
    def training(self) -> Training | None:
        """What it says about learning from its own answers."""
        train = self.protocol.stage_of(TrainStage)
        comparison = self.protocol.stage_of(ComparisonStage)
        drawn = self.protocol.stages_of(DemonstrationsStage)
        if train is None:
            return None
        return Training(
            job=train.job,
            recipe=train.recipe,
            prior=train.prior,
            give_up_after_s=train.give_up_after_s,
            scenes=comparison.scenes if comparison else 0,
            opponents=comparison.opponents if comparison else (),
            stand_ins=comparison is not None and comparison.stand_ins,
            rated=self.protocol.stage_of(EvaluationStage) is not None,
            environments=tuple(dict.fromkeys(stage.environment for stage in drawn)),
        )

    @property
    def learns_from(self) -> str:
        """What participants are told that the robot learns from: answers or paths."""
        return self.training.learns_from if self.training else "answers"

    def consent_hash(self, language: str) -> str:
        """sha256 of the consent text exactly as it is shown in that language."""
        name = self.consent.text
        content = fill_in(self.files.get(variant(name, language), self.files.get(name, "")), self.protocol)
        return hashlib.sha256(content.encode()).hexdigest()


def freeze(file: Path | str, query_sets: Mapping[str, str] | None = None) -> FrozenProtocol:
    """Read a protocol and everything it names. Raises ProtocolError with every problem.

    query_sets: id -> description of the sets that a protocol may name by id (`store.query_sets.query_sets_here`).
    """
    path = Path(file)
    return freeze_text(file_text(path), file=path.name, folder=path.parent, query_sets=query_sets)


def freeze_text(
    text: str,
    *,
    file: str = "protocol.yaml",
    folder: Path = PROTOCOLS,
    query_sets: Mapping[str, str] | None = None,
    in_part: bool = False,
) -> FrozenProtocol:
    """The same for YAML that was uploaded or pasted; its texts and questionnaires come from `folder`, or are shipped
    instruments. in_part: only to be looked at, so that what a whole protocol needs may be missing: stages, what its
    analysis is about."""

    def read(name: str) -> str | None:
        path = folder / name
        try:
            if path.is_file():
                return read_text(path)
        except OSError:
            return None
        return INSTRUMENTS.get(path.stem) if name == f"questionnaires/{path.stem}.yaml" else None

    return _frozen(as_text(text), file, read, (folder, query_sets or {}), in_part=in_part)


def thaw(study: Study | ProtocolVersion) -> FrozenProtocol:
    """The frozen protocol of a study or of a later version, from its own copy alone."""
    content = (study.protocol_yaml, tuple(sorted(study.files.items())))
    found = _thawed.get(content)
    if found is None:
        found = _frozen(study.protocol_yaml, "protocol.yaml", study.files.get)
        _thawed[content] = found
    return found


_thawed: dict[Content, FrozenProtocol] = {}  # by content, so never stale; one small entry per protocol version


def validate_protocol_file(file: Path | str, query_sets: Mapping[str, str] | None = None) -> dict[str, Any]:
    """{"valid": bool, "errors": [{file, line, field, value, message}]}, and "warnings" as these, where there are any;
    never raises for what the file says."""
    try:
        frozen = freeze(file, query_sets)
    except ProtocolError as wrong:
        return {"valid": False, "errors": wrong.errors}
    source = Source(Path(file).name, frozen.yaml)
    warnings = [asdict(found) for found in headset_warnings(frozen.protocol, frozen.files, source)]
    return {"valid": True, "errors": [], **({"warnings": warnings} if warnings else {})}


def find_shipped_protocols() -> list[Path]:
    """The protocol files that come with the product."""
    return sorted(PROTOCOLS.glob("*.yaml"))


def shipped_query_sets() -> list[str]:
    """Names of the query and ranking sets that come with the product and with the lab's own setups."""
    return sorted(
        f"{setup}/{path.stem}"
        for setup, of in setup_folders().items()
        for path in (*of.glob("queries*.npz"), *of.glob("scenarios*.npz"))
    )


# ---- reading -------------------------------------------------------------------------------------------------------


def _frozen(text: str, file: str, read: Read, sets: Sets | None = None, *, in_part: bool = False) -> FrozenProtocol:
    """sets: None of a study that there is, which has its own; its declared analysis was not always checked, nor whether
    a number stood in quotes."""
    new = sets is not None
    source = check_size(Source(file, text))
    whole, problems = read_as(source, Protocol, strict=new)
    protocol = whole or valid_part(source, problems)
    if protocol is None:
        raise ProtocolError(problems)
    reader = Reader(protocol, source, read, strict=new)
    problems += reader.language_problems()
    questionnaires: dict[str, Questionnaire] = {}
    for name, path in all_questionnaires(protocol):
        try:
            questionnaires[name] = reader.questionnaire(name, path)
        except ProtocolError as wrong:
            problems += [problem for problem in wrong.problems if problem not in problems]
    for name, path in all_texts(protocol):
        problems += reader.text(name, path)
    problems += reader.unreadable.values()
    query_set = protocol.query_set
    if sets is not None and query_set is not None:
        query_set, unfit = _query_set(query_set, *sets, source)
        problems += unfit
    length = list(too_long(protocol, source))
    if length or whole is None:
        problems += length
    else:
        across = [*problems_across(protocol, questionnaires, source)]
        across += analysis_problems(protocol, questionnaires, source) if new else ()
        across += order_problems(protocol, source) if new else ()
        across += head_problems(protocol, reader.files, source) if new else ()
        problems += [one for one in across if one.field.startswith("stages[") or not in_part]
    if problems:
        raise ProtocolError(problems)
    files = dict(sorted(reader.files.items()))
    return FrozenProtocol(text, protocol, questionnaires, files, protocol_digest(text, files), query_set)


def _query_set(name: str, folder: Path, here: Mapping[str, str], source: Source) -> tuple[str, list[Problem]]:
    """Where that query set is, and why it does for no study. Only files are opened: `learning` loads slowly."""
    shipped = shipped_query_sets()
    if name in shipped or name in here:
        return name, []
    beside = folder / name
    if name.endswith(".npz") and beside.is_file():
        unfit = _unfit(beside)
        return str(beside.resolve()), [source.problem(("query_set",), unfit)] if unfit else []
    allowed = ", ".join(shipped) or "none"
    # shipped sets that a study has used are here, too, under their names
    made = (
        ", ".join(f"{id_}: {whose}" for id_, whose in here.items() if whose.partition(" (")[0] not in shipped) or "none"
    )
    message = (
        f"is no query set; shipped are: {allowed}; made here, by id: {made}; or a .npz file, its path as seen from the "
        f"protocol's folder{meant(name, [*shipped, *here])}"
    )
    return name, [source.problem(("query_set",), message)]


def _unfit(file: Path) -> str | None:
    """Why a file is neither a query set nor a ranking set."""
    from desirepath.explain.methods import AttributionError
    from desirepath.explain.ranking_sets import RankingSet, is_ranking_set
    from desirepath.learning.errors import LearningError
    from desirepath.learning.queries.queries import QuerySet

    try:
        content = file.read_bytes()
        held = (
            RankingSet.from_bytes(content).rollouts if is_ranking_set(content) else QuerySet.from_bytes(content).queries
        )
    except OSError as wrong:
        return f"cannot be read: {wrong.strerror}"
    except (AttributionError, LearningError, ValueError) as wrong:
        return f"the file is no query set: {wrong}; `desirepath queries generate` makes one"
    return None if held else "the file holds no queries; a study needs at least one"
