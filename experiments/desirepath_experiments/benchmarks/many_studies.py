"""An installation with many studies of many simulated people, to measure pages and joining in: one study is walked
through in this process, the others are its rows once more under ids of their own.

Nothing is measured here. A folder that holds enough of them already is taken as it is.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping
from typing import Any

from sqlalchemy import Table, false, func, insert, or_, select, update
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.installed import PROTOCOLS
from desirepath.report.simulated_cohorts import VIEWS_DIFFER
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Base, Participant, Study, new_id
from desirepath.store.shipped_policies import register_shipped
from desirepath.study.protocol.freezing import freeze
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study

PROTOCOL = PROTOCOLS / "interface_study.yaml"
NAMED = "Benchmark"
REFERRED = {"study_id": "study", "participant_id": "participant", "session_id": "session"}  # where no key says so
COPIED = (
    *("study", "participant", "protocol_version", "recruiting_id", "session", "job", "note", "problem_report"),
    *("stroke", "trial", "job_metric", "response", "event"),
)
DRAWN = ("recruiting_token", "token_hash", "request_id")  # one of a kind in the whole installation
Ids = dict[tuple[str, Any], Any]


def make_studies(
    settings: Settings, studies: int, participants: int, tell: Callable[[str], None] = lambda words: None
) -> list[str]:
    """The ids of `studies` studies in the installation's folder, each with that many people who walked through
    chapter 7's study; made where they are missing (about 5 s of a core each for the first study's people).

    Raises SimulationError.
    """
    database, files = Database(settings.database), ArtefactStore(settings.artefacts)
    database.migrate()
    try:
        with database.transaction() as s:
            register_shipped(s, files)
            known = _complete(s, participants)
        if not known:
            tell(f"{participants} simulated participants")
            known = [_walked(database, files, participants)]
        for number in range(len(known), studies):
            with database.transaction() as s:
                known.append(_again(s, known[0], f"{NAMED} {number + 1}"))
            tell(f"study {number + 1} of {studies}")
        return known[:studies]
    finally:
        database.close()


def _complete(s: DatabaseSession, participants: int) -> list[str]:
    """The benchmark's studies that have at least so many people, oldest first."""
    counted = (
        select(Study.id)
        .join(Participant, Participant.study_id == Study.id)
        .where(Study.name.startswith(NAMED))
        .group_by(Study.id)
        .having(func.count() >= participants)
        .order_by(Study.created_at)
    )
    return list(s.scalars(counted))


def _walked(database: Database, files: ArtefactStore, participants: int) -> str:
    with database.transaction() as s:
        study = create_study(s, files, freeze(PROTOCOL), name=f"{NAMED} 1", created_by=None)
    walk_in_process(database, files, study, participants, Character(cohort=VIEWS_DIFFER))
    return study.id


def _again(s: DatabaseSession, study_id: str, name: str) -> str:
    """Copy a study with everything that belongs to it; returns the copy's id."""
    ids: Ids = {("study", study_id): new_id()}
    for table in Base.metadata.sorted_tables:
        if table.name not in COPIED:
            continue
        rows = [_renamed(table, dict(row), ids) for row in s.execute(_belonging(table, ids)).mappings()]
        if rows:
            s.execute(insert(table), rows)
    made: str = ids["study", study_id]
    s.execute(update(Study).where(Study.id == made).values(name=name))
    return made


def _refers(table: Table) -> Mapping[str, str]:
    """Column -> the table whose rows it names."""
    keys = {column.name: key.column.table.name for column in table.columns for key in column.foreign_keys}
    return {name: of for name, of in REFERRED.items() if name in table.columns} | keys


def _belonging(table: Table, ids: Ids) -> Any:
    """The rows of the study that is copied."""
    if table.name == "study":
        return select(table).where(table.c.id.in_([old for of, old in ids if of == "study"]))
    named = {column: [old for of, old in ids if of == kind] for column, kind in _refers(table).items()}
    return select(table).where(or_(false(), *(table.c[column].in_(old) for column, old in named.items())))


def _renamed(table: Table, row: dict[str, Any], ids: Ids) -> dict[str, Any]:
    """The row under an id of its own, naming the copies of what it named."""
    if "id" in table.columns:
        key = (table.name, row["id"])
        if isinstance(row["id"], int):
            del row["id"]  # counted by the database
        else:
            row["id"] = ids.setdefault(key, new_id())
    for column, kind in _refers(table).items():
        row[column] = ids.get((kind, row[column]), row[column])
    for column in DRAWN:
        if row.get(column):
            row[column] = secrets.token_hex(len(row[column]) // 2 + 1)[: len(row[column])]
    return row
