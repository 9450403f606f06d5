"""A backup of a running installation comes back whole, or says what is wrong with it."""

from __future__ import annotations

import hashlib
import io
import json
import tarfile
from pathlib import Path

import pytest
from sqlalchemy import select

from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.backup import BackupError, backup, restore
from desirepath.store.database import Database, StorageError
from desirepath.store.demonstration_snapshots import read_demonstrations
from desirepath.store.erasure import erase_participant
from desirepath.store.models import Response, Setting, StrokeRow, TaskFile, TrajectoryRow
from desirepath.store.simulated_demonstrations import take_simulated_demonstrations
from desirepath.store.snapshots import load_snapshot, take_snapshot
from tests import postgres
from tests.store.small_study import SmallStudy


def test_a_backup_taken_while_somebody_writes_comes_back_to_the_same_answers(study: SmallStudy, tmp_path: Path):
    _, session = study.participant("P1")
    with study.database.transaction() as s:
        snapshot = take_snapshot(s, study.files, session_id=session).id
    with study.database.transaction() as s:
        s.add(Setting(key="not committed yet", value={}))
        s.flush()
        said = backup(study.database, study.files, tmp_path / "backups" / "monday.tar")
    assert said["artefacts"] == 11
    assert said["missing"] == []
    assert [path.name for path in (tmp_path / "backups").iterdir()] == ["monday.tar"]
    assert (tmp_path / "backups" / "monday.tar").stat().st_mode & 0o077 == 0
    study.participant("P2", drives=100)  # after the backup

    back = restore(tmp_path / "backups" / "monday.tar", tmp_path / "new" / "data")
    assert back["artefacts"] == 11
    database = Database(f"sqlite:///{tmp_path / 'new' / 'data' / 'desirepath.sqlite'}")
    files = ArtefactStore((tmp_path / "new" / "data" / "artefacts").as_uri())
    database.migrate()
    with database.session() as s:
        assert s.get(Setting, "not committed yet") is None
        assert set(s.scalars(select(Response.session_id))) == {session}
        assert len(load_snapshot(s, files, snapshot).answers) == 4
        for trajectory_id in s.scalars(select(TrajectoryRow.id)):
            load_trajectory(files, trajectory_id)


def test_paths_that_participants_drew_and_tasks_of_sweeps_come_back_too(study: SmallStudy, tmp_path: Path):
    """Their files are named by rows of their own, which are no trajectories and no artefacts."""
    _, session = study.participant("P1")
    drawn, task = study.files.put(b"as it was drawn"), study.files.put(b"what a worker computed")
    with study.database.transaction() as s:
        about = {"environment": "study_room", "pair": 0, "view": "top_down", "pointer": "mouse", "drawn": {}}
        s.add(
            StrokeRow(
                session_id=session, step_key="d", attempt=1, state="kept", request_id="r", demonstration=drawn, **about
            )
        )
        s.add(TaskFile(key="a task", sha256=task))
        made = take_simulated_demonstrations(
            s, study.files, style="field_of_view", environment="room", per_pair=1, seed=0
        )
    backup(study.database, study.files, tmp_path / "a.tar")
    restore(tmp_path / "a.tar", tmp_path / "new")
    files = ArtefactStore((tmp_path / "new" / "artefacts").as_uri())
    for one in read_demonstrations(files.get(made.id))[1]:
        assert files.exists(one.demonstration)
    assert (files.get(drawn), files.get(task)) == (b"as it was drawn", b"what a worker computed")


def test_setups_that_were_brought_come_back_with_what_was_trained(
    study: SmallStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("DESIREPATH_DATA", str(tmp_path / "old"))
    files = {"flat/setup.yaml": b"robot: turtlebot2", "flat/ensemble/0.npz": b"weights", "flat/.training/base": b"half"}
    for name, content in files.items():
        (tmp_path / "old/setups" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "old/setups" / name).write_bytes(content)
    (tmp_path / "old/setups/flat/map.pgm").symlink_to("/etc/hostname")
    assert backup(study.database, study.files, tmp_path / "a.tar")["setup_files"] == 2
    assert restore(tmp_path / "a.tar", tmp_path / "new")["setup_files"] == 2
    back = {
        p.relative_to(tmp_path / "new/setups").as_posix() for p in (tmp_path / "new/setups").rglob("*") if p.is_file()
    }
    assert back == {"flat/setup.yaml", "flat/ensemble/0.npz"}
    assert (tmp_path / "new/setups/flat/ensemble/0.npz").read_bytes() == b"weights"


def test_a_backup_made_by_hand_writes_nowhere_else(study: SmallStudy, tmp_path: Path):
    backup(study.database, study.files, tmp_path / "good.tar")
    forged = tmp_path / "forged.tar"
    with tarfile.open(tmp_path / "good.tar") as good, tarfile.open(forged, "w") as bad:
        members = {m.name: good.extractfile(m).read() for m in good.getmembers()}
        manifest = json.loads(members["manifest.json"])
        for name in ("setups/../../escaped", "setups/.hidden/a", "/setups/a"):
            members[name] = b"x"
            manifest["sha256"][name] = hashlib.sha256(b"x").hexdigest()
        members["manifest.json"] = json.dumps(manifest).encode()
        for name, content in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            bad.addfile(info, io.BytesIO(content))
    restore(forged, tmp_path / "new" / "data")
    assert not (tmp_path / "new" / "data" / "setups").exists()
    assert not list(tmp_path.rglob("escaped"))


def test_a_damaged_or_foreign_file_is_refused_and_nothing_is_put_in_place(study: SmallStudy, tmp_path: Path):
    study.participant("P1")
    backup(study.database, study.files, tmp_path / "good.tar")
    good = (tmp_path / "good.tar").read_bytes()
    middle = good.index(b"SQLite format 3") + 5_000
    broken = {
        "flipped.tar": good[:middle] + bytes([good[middle] ^ 1]) + good[middle + 1 :],
        "cut.tar": good[: len(good) // 2],
        "text.tar": b"Dear diary",
    }
    for name, content in broken.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BackupError, match=name):
            restore(tmp_path / name, tmp_path / "new")
    with pytest.raises(BackupError, match=r"missing\.tar"):
        restore(tmp_path / "missing.tar", tmp_path / "new")
    assert not [path for path in (tmp_path / "new").iterdir() if "sqlite" in path.name]


def test_no_path_in_an_archive_is_followed(tmp_path: Path):
    with tarfile.open(tmp_path / "evil.tar", "w") as tar:
        manifest = b'{"format": "desirepath-backup-1", "made_at": "", "missing": [], "sha256": {"../../x": "0"}}'
        for name, content in (("manifest.json", manifest), ("../../x", b"")):
            member = tarfile.TarInfo(name)
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    with pytest.raises(BackupError, match="damaged"):
        restore(tmp_path / "evil.tar", tmp_path / "a" / "b" / "c")
    assert not (tmp_path / "a" / "x").exists()


def test_nothing_is_overwritten(study: SmallStudy, tmp_path: Path):
    (tmp_path / "taken.tar").write_text("another one")
    with pytest.raises(BackupError, match="exists already"):
        backup(study.database, study.files, tmp_path / "taken.tar")
    backup(study.database, study.files, tmp_path / "free.tar")
    with pytest.raises(BackupError, match="empty data folder"):
        restore(tmp_path / "free.tar", tmp_path)


def test_what_is_missing_is_told_but_not_what_an_erasure_removed(study: SmallStudy, tmp_path: Path):
    person, _ = study.participant("P1")
    study.participant("P2", drives=100)
    with study.database.transaction() as s:
        take_snapshot(s, study.files, study_id=study.id)
    erase_participant(study.database, study.files, person, by="tester")
    assert backup(study.database, study.files, tmp_path / "a.tar")["missing"] == []
    with study.database.session() as s:
        lost = s.scalars(select(TrajectoryRow.id)).first()
    study.files.delete(lost)
    assert backup(study.database, study.files, tmp_path / "b.tar")["missing"] == [lost]


def test_a_database_server_that_does_not_answer_is_named_and_nothing_is_left(files: ArtefactStore, tmp_path: Path):
    database = Database("postgresql://nobody@127.0.0.1:1/none")
    with pytest.raises(StorageError, match="no database server answers there"):
        backup(database, files, tmp_path / "out" / "x.tar")
    assert list((tmp_path / "out").iterdir()) == []


def test_a_backup_of_postgresql_comes_back_to_the_same_answers(
    postgres_server: str, files: ArtefactStore, tmp_path: Path
):
    """As with SQLite, by the same command, while somebody writes."""
    with postgres.holding(postgres_server, tmp_path / "none") as url:
        study = SmallStudy(Database(url), files)
        _, session = study.participant("P1")
        with study.database.transaction() as s:
            s.add(Setting(key="not committed yet", value={}))
            s.flush()
            said = backup(study.database, study.files, tmp_path / "monday.tar")
        assert said["missing"] == []
        assert said["artefacts"] >= 8
        study.participant("P2", drives=100)  # after the backup
        with pytest.raises(BackupError, match="has tables already"):
            restore(tmp_path / "monday.tar", tmp_path / "taken", database_url=url)
        study.database.close()
    with postgres.holding(postgres_server, tmp_path / "none", empty=True) as url:
        restore(tmp_path / "monday.tar", tmp_path / "new", database_url=url)
        database = Database(url)
        database.migrate()  # as a server does at its start
        with database.session() as s:
            assert s.get(Setting, "not committed yet") is None
            assert set(s.scalars(select(Response.session_id))) == {session}
            there = ArtefactStore((tmp_path / "new" / "artefacts").as_uri())
            for trajectory_id in s.scalars(select(TrajectoryRow.id)):
                load_trajectory(there, trajectory_id)
        database.close()
    with pytest.raises(BackupError, match="of an installation on PostgreSQL"):
        restore(tmp_path / "monday.tar", tmp_path / "sqlite")
