"""An empty database comes to the newest revision, on SQLite and PostgreSQL, and then is what the models say; rows of
older revisions stay as they are."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Column, String, delete, insert, inspect, select, text, update
from sqlalchemy.exc import DBAPIError

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import MIGRATIONS, Database, StorageError, migration_config
from desirepath.store.erasure import erase_participant
from desirepath.store.migrations.__main__ import draft_revision
from desirepath.store.models import (
    Artefact,
    ArtefactParent,
    Audit,
    Base,
    Erasing,
    Event,
    HeadPose,
    Identity,
    Participant,
    Response,
    Session,
    StrokeRow,
    Study,
    StudyRole,
    Tombstone,
    User,
)
from desirepath.store.snapshots import take_snapshot
from desirepath.study.robots import admit_robot, find_robot
from tests.store.small_study import SmallStudy


def test_an_empty_database_becomes_what_the_models_say(either: Database):
    either.migrate()
    either.migrate()  # a second start changes nothing
    with either.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []
        newest = ScriptDirectory.from_config(migration_config(connection)).get_current_head()
        assert context.get_current_revision() == newest


def test_the_newest_revision_has_the_models_constraints(either: Database, tmp_path: Path):
    """What Alembic's comparison leaves out: checks, unique constraints and foreign keys, by name."""

    def constraints(database: Database) -> set[tuple[str, str | None]]:
        seen = inspect(database.engine)
        kinds = (seen.get_check_constraints, seen.get_unique_constraints, seen.get_foreign_keys, seen.get_indexes)
        return {
            (table, found["name"])
            for table in set(seen.get_table_names()) - {"alembic_version"}
            for kind in kinds
            for found in kind(table)
        }

    either.migrate()
    plain = Database(f"sqlite:///{tmp_path / 'plain.sqlite'}")
    Base.metadata.create_all(plain.engine)
    wanted = constraints(plain)
    assert ("trial", "ck_trial_phase") in wanted
    assert ("response", "uq_response_session_id_step_key") in wanted
    assert wanted <= constraints(either)


def test_a_database_of_a_newer_version_is_told(either: Database):
    either.migrate()
    with either.engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(StorageError, match=r"was written by another version of desirepath .*9999"):
        either.migrate()


def test_several_processes_may_start_at_once(tmp_path: Path):
    url = f"sqlite:///{tmp_path / 'shared.sqlite'}"
    start = "import sys; from desirepath.store.database import Database; Database(sys.argv[1]).migrate()"
    started = [subprocess.Popen([sys.executable, "-c", start, url], stderr=subprocess.PIPE) for _ in range(3)]
    errors = [process.communicate()[1].decode() for process in started]
    assert [process.returncode for process in started] == [0, 0, 0], errors


def test_the_next_revision_is_drafted_from_the_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    scripts = tmp_path / "migrations"
    shutil.copytree(MIGRATIONS, scripts)
    monkeypatch.setattr("desirepath.store.database.MIGRATIONS", scripts)
    remark = Column("remark", String(20))
    Base.metadata.tables["setting"].append_column(remark)
    try:
        drafted = draft_revision("Remarks on settings", "0099")
    finally:
        Base.metadata.tables["setting"]._columns.remove(remark)
    assert drafted.name == "v0099_remarks_on_settings.py"
    newest = ScriptDirectory(str(MIGRATIONS)).get_current_head()
    assert f"down_revision = '{newest}'" in drafted.read_text()
    assert "sa.Column('remark', sa.String(length=20), nullable=True)" in drafted.read_text()


def test_a_study_of_before_robots_and_headsets_goes_on_with_them(either: Database, files: ArtefactStore):
    either.migrate()
    study = SmallStudy(either, files)
    study.participant("P1")
    with either.engine.begin() as connection:  # what it was at first
        command.downgrade(migration_config(connection), "0001")
    kept = ("study", "participant", "session", "response", "event", "trial")

    def rows() -> dict[str, list[tuple]]:
        with either.engine.connect() as connection:
            return {name: [tuple(row) for row in connection.execute(text(f'SELECT * FROM "{name}"'))] for name in kept}

    before = rows()
    assert before["participant"]
    before["trial"] = [(*row, None, None) for row in before["trial"]]  # with what headset, nobody knows
    assert before["trial"]
    either.migrate()
    assert rows() == before
    with either.transaction() as s:
        robot, token = admit_robot(s, study.id, "Turtle", "experimenter")
        assert find_robot(s, token).id == robot.id
        session = s.scalars(select(Session.id)).one()
        pose = {"times_s": [0.0], "poses": [[0, 0, 1.6, 0, 0, 0, 1]]}
        step = {"session_id": session, "step_key": "block.01", "wearing": "a" * 16}
        s.add(HeadPose(**step, part=0, began_s=0.0, samples=1, recorded=pose))
    with pytest.raises(DBAPIError, match="how a head moved is never changed"), either.transaction() as s:
        s.execute(update(HeadPose).values(part=1))
    with pytest.raises(DBAPIError, match="how a head moved is never deleted"), either.transaction() as s:
        s.execute(delete(HeadPose))


def test_what_was_made_before_stays_and_setups_of_long_names_are_kept(either: Database):
    with either.engine.begin() as connection:
        command.upgrade(migration_config(connection), "0002")

    def made(sha: str, setup: str, parent: str = "") -> None:
        with either.transaction() as s:
            s.add(Artefact(id=sha * 64, kind="policy", name="base", setup=setup, card={}))
            s.flush()
            if parent:
                s.add(ArtefactParent(artefact_id=sha * 64, parent_id=parent * 64, role="base"))

    made("a", "study_room")
    made("b", "study_room", "a")
    either.migrate()
    made("c", "l" * 60, "b")
    with either.session() as s:
        assert list(s.scalars(select(Artefact.setup).order_by(Artefact.id))) == ["study_room", "study_room", "l" * 60]
        assert len(list(s.scalars(select(ArtefactParent)))) == 2
    if either.is_sqlite:
        with either.engine.connect() as connection:
            assert connection.execute(text("PRAGMA integrity_check")).scalar_one() == "ok"
            assert list(connection.execute(text("PRAGMA foreign_key_check"))) == []


def test_migrations_can_be_taken_back(either: Database):
    either.migrate()
    with either.engine.begin() as connection:
        command.downgrade(migration_config(connection), "base")
    with either.engine.connect() as connection:
        assert set(inspect(connection).get_table_names()) <= {"alembic_version"}
    either.migrate()


def test_the_database_itself_refuses_what_may_not_change(either: Database, files: ArtefactStore):
    either.migrate()
    study = SmallStudy(either, files)
    person, session = study.participant("P1")
    other, _ = study.participant("P2", simulated=True, drives=100)
    with either.transaction() as s:
        s.add(Tombstone(study_id=study.id, erased_by="somebody", counts={}))
        s.add(Audit(by="ada", role="owner", action="study_closed", study_id=study.id))

    def refused(statement: object, message: str) -> None:
        with pytest.raises(DBAPIError, match=message), either.transaction() as s:
            s.execute(statement)

    refused(update(Event).values(kind="other"), "events are append-only")
    refused(delete(Event), "events are append-only")
    refused(update(Response).values(value={"choice": "b"}), "a response is never changed")
    refused(delete(Response), "a response is never deleted")
    refused(update(Participant).where(Participant.id == person).values(simulated=True), "participant.simulated")
    refused(update(Session).where(Session.id == session).values(simulated=True), "session.simulated")
    refused(update(Session).where(Session.id == session).values(participant_id=other), "session.simulated")
    refused(update(Study).values(protocol_yaml="other"), "protocol of a study is frozen")
    refused(update(Participant).where(Participant.id == person).values(pilot=True), "participant.pilot")
    refused(delete(Tombstone), "tombstones stay")
    refused(update(Audit).values(by="bob"), "the audit log is append-only")
    refused(delete(Audit), "the audit log is append-only")
    with either.transaction() as s:  # what may change still does
        s.execute(update(Session).where(Session.id == session).values(position=3, state="paused"))
        s.execute(update(Participant).where(Participant.id == person).values(excluded_reason="asleep"))
        s.execute(update(Study).values(state="closed"))


def test_a_person_cannot_get_a_session_that_may_skip(either: Database, files: ArtefactStore):
    either.migrate()
    study = SmallStudy(either, files)
    _, session = study.participant("P1")
    with either.session() as s:
        row = s.get(Session, session)
        copied = {c.key: getattr(row, c.key) for c in inspect(Session).column_attrs}
    with pytest.raises(DBAPIError, match="must be as its participant"), either.transaction() as s:
        s.add(Session(**{**copied, "id": "0" * 32, "token_hash": "other", "simulated": True}))


def test_what_was_drawn_never_changes_and_a_walk_once(either: Database, files: ArtefactStore, tmp_path: Path):
    either.migrate()
    person, session = SmallStudy(either, files).participant("P1")
    drawn = {"points": [[0.0, 0.0], [1.0, 0.0]], "speeds": [0.2, 0.2], "times_s": [0.0, 1.0]}
    walk = {"source": "walked", "times_s": [0.0], "poses": [[0.0, 0.0, 0.0]], "beside": None}
    with either.transaction() as s:
        s.add(
            StrokeRow(
                session_id=session,
                step_key="demonstrations.1.1",
                attempt=1,
                pair=0,
                environment="corridor",
                view="top_down",
                pointer="mouse",
                drawn=drawn,
                state="drawn",
                request_id="r1",
            )
        )
    with either.transaction() as s:  # a walk comes with the news that the trajectory was watched
        s.scalars(select(StrokeRow)).one().walk = walk
    with pytest.raises(DBAPIError, match="a walk is never changed"), either.transaction() as s:
        s.execute(update(StrokeRow).values(walk={}))
    with pytest.raises(DBAPIError, match="what was drawn is never changed"), either.transaction() as s:
        s.execute(update(StrokeRow).values(drawn={}))
    with pytest.raises(DBAPIError, match="a stroke is never deleted"), either.transaction() as s:
        s.execute(delete(StrokeRow))
    with either.transaction() as s:  # what becomes of it may change
        s.execute(update(StrokeRow).values(state="kept"))
        assert s.execute(select(StrokeRow.drawn, StrokeRow.walk)).one() == (drawn, walk)
    assert erase_participant(either, files, person, "tester", data=tmp_path)["counts"]["strokes"] == 1


def test_nobody_has_a_role_twice_and_an_identity_opens_one_account(either: Database, files: ArtefactStore):
    either.migrate()
    study = SmallStudy(either, files)
    with either.transaction() as s:
        s.add(User(id="bob", name="bob", password_hash="x"))
        s.flush()
        s.add(StudyRole(user_id="bob", study_id=study.id, role="analyst", given_by="ada"))
        s.add(Identity(user_id="bob", issuer="https://uni.example", subject="1"))
        assert s.scalars(select(User.role)).all() == ["viewer"]
    with pytest.raises(DBAPIError), either.transaction() as s:
        s.execute(insert(StudyRole).values(user_id="bob", study_id=study.id, role="analyst", given_by="ada"))
    with pytest.raises(DBAPIError), either.transaction() as s:
        s.add(Identity(user_id="bob", issuer="https://uni.example", subject="1"))


def test_the_key_of_an_erasure_opens_only_what_belongs_to_the_participant(either: Database, files: ArtefactStore):
    either.migrate()
    study = SmallStudy(either, files)
    person, session = study.participant("P1")
    _, others = study.participant("P2", drives=100)

    def with_the_key(statement: object) -> None:
        with either.transaction() as s:
            s.add(Erasing(participant_id=person))
            s.flush()
            s.execute(statement)

    with pytest.raises(DBAPIError, match="a response is never deleted"):
        with_the_key(delete(Response).where(Response.session_id == others))
    with pytest.raises(DBAPIError, match="events are append-only"):
        with_the_key(update(Event).where(Event.session_id == session).values(kind="other"))


def test_a_participant_can_be_erased_on_either_database(either: Database, files: ArtefactStore, tmp_path: Path):
    either.migrate()
    study = SmallStudy(either, files)
    person, _ = study.participant("P1")
    study.participant("P2", drives=100)
    with either.transaction() as s:
        take_snapshot(s, files, study_id=study.id)
    done = erase_participant(either, files, person, "tester", data=tmp_path)
    assert done["compacted"]
    assert len(done["quarantined"]) == 1
    with either.session() as s:
        assert s.get(Participant, person) is None
        assert s.scalars(text("SELECT code FROM participant")).all() == ["P2"]
