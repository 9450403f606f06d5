"""What was stored before the rooms were rebuilt still opens: the database, its plans, exports, protocols and job rows.

These are everybody's guard: a name that changes is read under its old one, or the database is migrated.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import func, select

from desirepath.jobs.kinds import get_kind
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import analyse
from desirepath.report.tidy_tables import read_study
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.reading import read_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.demonstration_snapshots import read_demonstrations
from desirepath.store.erasure import erase_participant
from desirepath.store.models import Artefact, Base, Job, Participant, Response, Session, Study, Trial
from desirepath.store.snapshots import load_snapshot
from desirepath.study.protocol.freezing import freeze, thaw
from desirepath.study.session.versions import protocol_of
from tests.store.old_installation import OldInstallation, Returning, unpack

STUDIES = ("Quick", "Interface", "Moving", "Two appointments", "Quick demonstration", "Personalisation", "The rest")
# Links, and kinds of step that whoever goes on there meets.
GOING_ON = {
    "quick watching": {"trial", "wait", "questionnaire", "debriefing"},
    "quick paused": {"trial", "wait", "questionnaire", "debriefing"},
    "quick waiting": {"wait", "debriefing"},
    "quick excluded": {"wait", "debriefing"},
    "interface in the middle": {"trial", "instruction", "break", "questionnaire", "debriefing"},
    "moving after the walked path": {"demonstration", "questionnaire", "debriefing"},
    "two between appointments": {"instruction", "evaluation", "questionnaire", "debriefing"},
    "two in the second": {"evaluation", "questionnaire", "debriefing"},
    "drawn, comparing": {"comparison", "guess", "debriefing"},
    "drawn, watched": {"demonstration", "questionnaire", "wait", "debriefing"},
    "personalisation 1": {"comparison", "guess", "debriefing"},
    "rest in the middle": {"trial", "attention", "questionnaire", "break", "debriefing"},
    "rest on version 2": {"information", "comprehension", "trial", "attention", "questionnaire", "debriefing"},
}
OVER = {"quick bot": "completed", "quick withdrawn": "withdrawn", "rest screened out": "screened_out"}
OVER |= {"rest expired": "expired", "personalisation 0": "completed"}


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> OldInstallation:
    return unpack(tmp_path_factory.mktemp("old"))


@pytest.fixture
def old(unpacked: OldInstallation, tmp_path: Path) -> OldInstallation:
    return unpacked.copied(tmp_path / "old")


@pytest.fixture
def upgraded(old: OldInstallation) -> Database:
    """Its database, brought to the newest revision."""
    database = Database(f"sqlite:///{old.folder / 'desirepath.sqlite'}")
    database.migrate()
    yield database
    database.close()


def study_named(database: Database, name: str) -> Study:
    with database.session() as s:
        return s.scalars(select(Study).where(Study.name == name)).one()


def test_an_old_database_comes_to_the_newest_revision_with_all_its_rows(upgraded: Database):
    with upgraded.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []
    with upgraded.session() as s:
        states = Counter(s.scalars(select(Session.state)))
        assert {table: s.scalar(select(func.count()).select_from(table)) for table in (Study, Participant, Job)} == {
            Study: 7,
            Participant: 23,
            Job: 18,
        }
        assert s.scalar(select(func.count()).select_from(Response)) == 281
    assert set(states) == {"active", "paused", "completed", "withdrawn", "expired", "screened_out"}


@pytest.mark.parametrize("who", GOING_ON)
def test_whoever_was_on_the_way_goes_on_to_the_end(upgraded: Database, old: OldInstallation, who: str):
    returning = Returning(upgraded, old.artefacts, old.tokens[who])
    assert GOING_ON[who] <= {*returning.to_the_end(), returning.view.kind}
    assert returning.state() == "completed"


def test_who_had_ended_has_ended_and_every_link_is_known(upgraded: Database, old: OldInstallation):
    assert set(old.tokens) == set(GOING_ON) | set(OVER)
    states = {who: Returning(upgraded, old.artefacts, old.tokens[who]).state() for who in OVER}
    assert states == OVER


@pytest.mark.parametrize("name", STUDIES)
def test_every_old_study_is_exported_imported_and_exported_again(
    upgraded: Database, old: OldInstallation, tmp_path: Path, name: str
):
    study = study_named(upgraded, name)
    export_study(upgraded, old.artefacts, study.id, tmp_path / "out", pilots=True)
    there, their_files = Database(f"sqlite:///{tmp_path / 'there.sqlite'}"), ArtefactStore((tmp_path / "b").as_uri())
    there.migrate()
    import_dataset(there, their_files, tmp_path / "out")
    export_study(there, their_files, study.id, tmp_path / "again", pilots=True)
    written = {path.relative_to(tmp_path / "out") for path in (tmp_path / "out").rglob("*") if path.is_file()}
    again = {path.relative_to(tmp_path / "again") for path in (tmp_path / "again").rglob("*") if path.is_file()}
    assert written == again
    for file in sorted(written):
        assert (tmp_path / "out" / file).read_bytes() == (tmp_path / "again" / file).read_bytes(), file


@pytest.mark.parametrize("name", ["Quick", "Two appointments"])
def test_old_data_sets_are_read_and_imported(upgraded: Database, old: OldInstallation, tmp_path: Path, name: str):
    folder = old.export(name.replace(" ", "_"))
    there = Database(f"sqlite:///{tmp_path / 'there.sqlite'}")
    there.migrate()
    said = import_dataset(there, ArtefactStore((tmp_path / "there").as_uri()), folder)
    with there.session() as s, upgraded.session() as here:
        study = here.scalars(select(Study).where(Study.name == name)).one()
        assert said["study"] == study.id
        stays = Session.study_id == study.id, Session.state != "withdrawn"
        given = select(Response.id, Response.value, Response.created_at).join(Session).where(*stays)
        assert s.execute(given.order_by(Response.id)).all() == here.execute(given.order_by(Response.id)).all()
        shown = select(Trial.id, Trial.role, Trial.trajectory_a, Trial.kind, Trial.phase).join(Session).where(*stays)
        assert s.execute(shown.order_by(Trial.id)).all() == here.execute(shown.order_by(Trial.id)).all()
    assert len(read_dataset(folder).tables["responses"]) == said["responses"]


def test_old_protocols_are_valid_and_stored_ones_thaw(upgraded: Database, old: OldInstallation):
    shipped = sorted((old.folder / "study_protocols").glob("*.yaml"))
    assert [freeze(path).protocol.protocol for path in shipped] == [path.stem for path in shipped]
    with upgraded.session() as s:
        assert {thaw(study).protocol.protocol for study in s.scalars(select(Study))} >= {path.stem for path in shipped}
        assert {protocol_of(s, session).protocol.version for session in s.scalars(select(Session))} == {1, 2}


def test_old_job_rows_and_snapshots_open(upgraded: Database, old: OldInstallation):
    with upgraded.session() as s:
        for job in s.scalars(select(Job)):
            get_kind(job.kind).parse(job.params)
        answers = {a.id: load_snapshot(s, old.artefacts, a.id) for a in _of_kind(s, "snapshot")}
        drawn = {a.id: read_demonstrations(old.artefacts.get(a.id)) for a in _of_kind(s, "demonstrations")}
    assert {len(one.training_answers()) for one in answers.values()} == {2, 3}
    assert len(drawn) == 3


def _of_kind(s: object, kind: str) -> list[Artefact]:
    return list(s.scalars(select(Artefact).where(Artefact.kind == kind, Artefact.quarantined_at.is_(None))))


@pytest.mark.parametrize("name", STUDIES)
def test_old_answers_are_reported_on(upgraded: Database, old: OldInstallation, name: str):
    study = study_named(upgraded, name)
    with upgraded.session() as s:
        data, load = read_study(s, old.artefacts, study)
    found = analyse(data, load, "all", AnalysisPlan(sessions="all"))
    assert found.flow.joined >= 0


def test_everybody_in_it_can_be_erased(upgraded: Database, old: OldInstallation):
    with upgraded.session() as s:
        everybody = list(s.scalars(select(Participant.id)))
    for person in everybody:
        erase_participant(upgraded, old.artefacts, person, "tester", data=old.folder, compact=False)
    with upgraded.session() as s:
        assert s.scalar(select(func.count()).select_from(Response)) == 0
        assert s.scalar(select(func.count()).select_from(Participant)) == 0


def test_old_names_are_read_and_new_ones_written(upgraded: Database, old: OldInstallation, tmp_path: Path):
    """`turned` is `sides_swapped`, role and mark `learning` are `practice`: in the database and in data sets."""
    before = read_dataset(old.export("Quick")).tables["trials"]
    study = study_named(upgraded, "Quick")
    export_study(upgraded, old.artefacts, study.id, tmp_path / "out", pilots=True)
    now = read_dataset(tmp_path / "out").tables["trials"]
    marks = ("trial", "role", "practice", "sides_swapped")
    assert [[row[name] for name in marks] for row in before] == [[row[name] for name in marks] for row in now]
    assert {row["role"] for row in now if row["practice"]} == {"practice"}
    assert {True, False} <= {row["sides_swapped"] for row in now}
    with upgraded.session() as s:
        assert "learning" not in set(s.scalars(select(Trial.role)))
