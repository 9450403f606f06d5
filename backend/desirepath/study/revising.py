"""Editing the protocol of a running study: what differs, what that means for the data, and the new version itself.

Nothing that somebody has begun ever changes: each session keeps the protocol it was begun with (`versions.py`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.events import log_event
from desirepath.store.models import ProtocolVersion, Session, Study
from desirepath.store.query_sets import query_sets_here
from desirepath.study.plan.counterbalancing import design_of
from desirepath.study.protocol.freezing import FrozenProtocol
from desirepath.study.protocol.stages import stage_keys
from desirepath.study.protocol_rows import FIRST, newest_number, protocol_row
from desirepath.study.session.versions import newest_protocol
from desirepath.study.studies import StudyError, materials_of

MEANS = {
    "words": "New participants read a different wording; the questions stay the same.",
    "consent": "New participants consent to a different text; every answer records the consent it was given under.",
    "items": "Answers to this questionnaire are not comparable across versions; analyse them separately.",
    "trials": "New participants see different trials; analyse the versions separately, or report the change.",
    "stages": "New participants go through different stages, or in a different order; report the change.",
    "assignment": "Counterbalancing starts over; slots of the earlier version no longer count.",
    "taking_in": "Different people or devices are admitted; report it with the exclusion criteria.",
    "analysis": "The analysis plan was changed after data were collected; the report shows it as a deviation.",
    "running": "Only the procedure changes, nothing that is asked or shown.",
}
"""What each sort of change means for data that are there already."""
_SORTS = {
    "title": "words",
    "languages": "words",
    "assignment": "assignment",
    "query_set": "trials",
    "sample": "trials",
    "symmetry": "trials",
    "device": "taking_in",
    "quotas": "taking_in",
    "participants": "taking_in",
    "analysis": "analysis",
}  # top-level keys; what is not named here is how the study is run
_STAGE_SORTS = {"consent": "consent", "block": "trials", "comparison": "trials", "train": "trials"}


@dataclass(frozen=True)
class Change:
    """One difference. `field`: with the stage's key, e.g. `stages.block.trials[0].queries.count`; None: was not there.

    `sort`: key of `MEANS`.
    """

    field: str
    before: Any
    after: Any
    sort: str

    @property
    def means(self) -> str:
        return MEANS[self.sort]

    def as_dict(self) -> dict[str, Any]:
        return {**asdict(self), "means": self.means}


def differences(before: FrozenProtocol, after: FrozenProtocol) -> list[Change]:
    """Everything that differs between two protocols, in the order of the file, but for the version number itself."""
    old, new = _flat_protocol(before), _flat_protocol(after)
    changes = [
        Change(field, old.get(field), new.get(field), _sort(field))
        for field in dict.fromkeys([*old, *new])
        if old.get(field) != new.get(field) and field != "version"
    ]
    keys = [stage_keys(frozen.protocol.stages) for frozen in (before, after)]
    if keys[0] != keys[1]:
        changes.append(Change("stages", ", ".join(keys[0]), ", ".join(keys[1]), "stages"))
    if design_of(before.protocol).digest != design_of(after.protocol).digest and not any(
        change.sort == "assignment" for change in changes
    ):
        changes.append(Change("assignment", "the orders of before", "other orders", "assignment"))
    for name in sorted({*before.files, *after.files}):
        if before.files.get(name) != after.files.get(name):
            changes.append(Change(f"files.{name}", *_lines(before, after, name), _file_sort(name, before, after)))
    return changes


def _flat_protocol(frozen: FrozenProtocol) -> dict[str, Any]:
    data = frozen.data
    stages = data.pop("stages")
    flat = dict(_flat(data, ""))
    for key, entry, stage in zip(stage_keys(frozen.protocol.stages), frozen.protocol.stages, stages, strict=True):
        flat |= dict(_flat(stage[entry.kind], f"stages.{key}"))
        flat |= dict(_flat(stage["when"], f"stages.{key}.when")) if entry.when else {}
    return flat


def _flat(value: Any, field: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(inner, f"{field}.{key}" if field else key)
    elif isinstance(value, list) and value and isinstance(value[0], Mapping):
        for n, inner in enumerate(value):
            yield from _flat(inner, f"{field}[{n}]")
    else:
        yield field, value


def _sort(field: str) -> str:
    first, _, rest = field.partition(".")
    if first != "stages":
        return _SORTS.get(first.partition("[")[0], "running")
    kind = rest.partition(".")[0].rstrip("0123456789").rstrip("_")
    return _STAGE_SORTS.get(kind, "stages")


def _file_sort(name: str, before: FrozenProtocol, after: FrozenProtocol) -> str:
    if name.startswith(("questionnaires/", "scales/")):
        return "items"
    stem = name.rpartition(".")[0]
    consents = {frozen.consent.text.rpartition(".")[0] for frozen in (before, after)}
    return "consent" if any(stem == consent or stem.startswith(f"{consent}.") for consent in consents) else "words"


def _lines(before: FrozenProtocol, after: FrozenProtocol, name: str) -> tuple[str | None, str | None]:
    """How much of a file differs, in lines: its words would fill the screen."""
    old, new = (frozen.files.get(name) for frozen in (before, after))
    if old is None or new is None:
        return (None if old is None else "a file", None if new is None else "a file")
    gone = len(set(old.splitlines()) - set(new.splitlines()))
    come = len(set(new.splitlines()) - set(old.splitlines()))
    return f"{gone} lines", f"{come} other lines"


def query_sets_for(s: DatabaseSession, study: Study) -> dict[str, str]:
    """Those that the study's next protocol may name: what it shows now, too, where that was archived meanwhile."""
    now = protocol_row(s, study, newest_number(s, study))
    return query_sets_here(s, also=now.protocol["materials"]["query_set"])


def revise_study(
    s: DatabaseSession, files: ArtefactStore, study: Study, frozen: FrozenProtocol, *, by: str | None
) -> ProtocolVersion:
    """Give the study a new version of its protocol, for new participants.

    Raises StudyError where it is another protocol, its version is not higher, nothing differs, the consent's words
    changed under the same version, or the query set does not do.
    """
    study = s.scalars(select(Study).where(Study.id == study.id).with_for_update()).one()
    number, changes = revision_of(s, study, frozen)
    protocol = frozen.protocol
    materials = materials_of(s, files, frozen)
    if materials["setup"] != study.protocol["materials"]["setup"]:
        raise StudyError(
            f"query_set = {protocol.query_set!r}: is of setup {materials['setup']}, the study's is "
            f"{study.protocol['materials']['setup']}; a study keeps its setup"
        )
    version = ProtocolVersion(
        study_id=study.id,
        number=number,
        protocol_version=protocol.version,
        protocol_yaml=frozen.yaml,
        protocol={**frozen.data, "materials": materials},
        files=frozen.files,
        protocol_hash=frozen.hash,
        changes=[change.as_dict() for change in changes],
        created_by=by,
    )
    s.add(version)
    s.flush()
    log_event(s, "study_revised", study_id=study.id, protocol=study.protocol_name, hash=frozen.hash, number=number)
    return version


def revision_of(s: DatabaseSession, study: Study, frozen: FrozenProtocol) -> tuple[int, list[Change]]:
    """The number that this protocol would get in the study, and everything that it would change. Writes nothing.

    Raises StudyError as `revise_study`, which looks at the query set besides.
    """
    number, before = newest_protocol(s, study)
    protocol = frozen.protocol
    if protocol.protocol != study.protocol_name:
        raise StudyError(
            f"protocol = {protocol.protocol!r}: this study runs {study.protocol_name!r}; open another study"
        )
    changes = differences(before, frozen)
    if not changes:
        raise StudyError("the protocol and its files are what the study has already; nothing to do")
    if protocol.version <= before.protocol.version:
        raise StudyError(f"version = {protocol.version}: must be higher than the study's {before.protocol.version}")
    if before.consent.version == frozen.consent.version and any(change.sort == "consent" for change in changes):
        raise StudyError(
            f"stages.consent.version = {frozen.consent.version!r}: the consent's words changed, so it needs a version "
            "of its own; every answer names the version it was given under"
        )
    return number + 1, changes


@dataclass(frozen=True)
class VersionLine:
    """One protocol of a study with how many people and simulated participants run or ran on it."""

    number: int
    version: int
    protocol_hash: str
    created_at: Any
    created_by: str | None
    people: int
    simulated: int
    changes: list[dict[str, Any]]


def versions_of(s: DatabaseSession, study: Study) -> list[VersionLine]:
    """All protocols of a study in order, the first being its own."""
    counts = {
        (number, simulated): count
        for number, simulated, count in s.execute(
            select(Session.protocol_number, Session.simulated, func.count(func.distinct(Session.participant_id)))
            .where(Session.study_id == study.id)
            .group_by(Session.protocol_number, Session.simulated)
        )
    }
    later = s.scalars(
        select(ProtocolVersion).where(ProtocolVersion.study_id == study.id).order_by(ProtocolVersion.number)
    )
    rows: list[tuple[int, Study | ProtocolVersion, list[Any]]] = [(FIRST, study, [])]
    rows += [(row.number, row, row.changes) for row in later]
    return [
        VersionLine(
            number=number,
            version=row.protocol_version,
            protocol_hash=row.protocol_hash,
            created_at=row.created_at,
            created_by=row.created_by if isinstance(row, ProtocolVersion) else None,
            people=counts.get((number, False), 0),
            simulated=counts.get((number, True), 0),
            changes=changes,
        )
        for number, row, changes in rows
    ]
