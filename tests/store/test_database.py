"""Transactions queue, commits survive kill -9, and a disk that cannot be used is told in a sentence."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import select, text
from sqlalchemy.event import listens_for
from sqlalchemy.exc import IntegrityError

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database, DatabaseBusy, StorageError, check_writable
from desirepath.store.models import Setting
from tests import postgres

# Writes one answer after another and says the id of each once its transaction has returned.
WRITER = """
import sys
from desirepath.store.database import Database
from desirepath.store.models import Setting
database = Database(sys.argv[1])
for k in range(100_000):
    with database.transaction() as s:
        s.add(Setting(key=f"answer-{k}", value={"choice": "a"}))
    print(k, flush=True)
"""
# Writes until the disk (here: the largest file this process may have) is full, then says what it was told.
FILLER = """
import resource, signal, sys
from desirepath.store.database import Database, StorageError
from desirepath.store.models import Setting
database = Database(sys.argv[1])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
try:
    for k in range(1_000):
        with database.transaction() as s:
            s.add(Setting(key=f"answer-{k}", value={"text": "x" * 20_000}))
        print(k, flush=True)
except StorageError as problem:
    print(problem, flush=True)
"""


def test_answers_acknowledged_before_a_kill_are_there_afterwards(database: Database):
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(database.url)], stdout=subprocess.PIPE, text=True, cwd=Path.cwd()
    )
    acknowledged = []
    for line in writer.stdout:
        acknowledged.append(int(line))
        if len(acknowledged) == 25:
            writer.send_signal(signal.SIGKILL)
    assert writer.wait() == -signal.SIGKILL
    again = Database(str(database.url))
    again.migrate()
    with again.session() as s:
        stored = set(s.scalars(select(Setting.key)))
        assert s.connection().exec_driver_sql("PRAGMA integrity_check").scalar() == "ok"
    assert len(acknowledged) >= 25
    assert {f"answer-{k}" for k in acknowledged} <= stored


def test_writers_that_read_first_queue_instead_of_losing_a_count(database: Database):
    with database.transaction() as s:
        s.add(Setting(key="count", value={"n": 0}))

    def add_ten() -> None:
        for _ in range(10):
            with database.transaction() as s:
                row = s.get(Setting, "count")
                row.value = {"n": row.value["n"] + 1}

    threads = [threading.Thread(target=add_ten) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    with database.session() as s:
        assert s.get(Setting, "count").value == {"n": 80}


def test_writers_get_in_in_the_order_in_which_they_came(database: Database):
    order: list[int] = []

    def write(number: int) -> None:
        with database.transaction():
            order.append(number)

    threads = [threading.Thread(target=write, args=(number,)) for number in range(8)]
    with database.transaction():
        for number, thread in enumerate(threads):
            thread.start()
            while database.turns.waiting <= number:  # the next one comes when this one stands in line
                time.sleep(0.001)
    for thread in threads:
        thread.join()
    assert order == list(range(8))


def test_who_waits_in_vain_is_told_and_the_others_go_on(database: Database, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("desirepath.store.database.TURN_PATIENCE_S", 0.05)
    told: list[DatabaseBusy] = []

    def write_while_another_does() -> None:
        try:
            with database.transaction() as s:
                s.add(Setting(key="late", value={}))
        except DatabaseBusy as problem:
            told.append(problem)

    with database.transaction() as s:
        s.add(Setting(key="first", value={}))
        impatient = threading.Thread(target=write_while_another_does)
        impatient.start()
        impatient.join()
    assert "nothing was stored" in str(told[0])
    write_while_another_does()
    assert len(told) == 1
    with database.session() as s:
        assert set(s.scalars(select(Setting.key))) == {"first", "late"}


def test_another_process_that_keeps_writing_is_told_the_same_way(database: Database, tmp_path: Path):
    other = sqlite3.connect(tmp_path / "desirepath.sqlite", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with database.session() as s:  # the connection that the writer will get
        s.connection().exec_driver_sql("PRAGMA busy_timeout = 50")
    with pytest.raises(DatabaseBusy, match="another process kept writing"), database.transaction() as s:
        s.add(Setting(key="a", value={}))
    other.close()
    with database.transaction() as s:
        s.add(Setting(key="a", value={}))


def test_an_exception_leaves_nothing_behind(database: Database):
    def fail_halfway() -> None:
        with database.transaction() as s:
            s.add(Setting(key="half", value={}))
            s.flush()
            raise RuntimeError("in the middle")

    with pytest.raises(RuntimeError):
        fail_halfway()
    with database.session() as s:
        assert s.get(Setting, "half") is None


def test_a_reading_session_cannot_write_and_the_next_writer_can(database: Database):
    with pytest.raises(StorageError, match="opened for reading"), database.session() as s:
        s.execute(text("INSERT INTO setting (key, value) VALUES ('a', '{}')"))
    with database.transaction() as s:
        s.add(Setting(key="a", value={}))


def test_only_what_may_be_lost_with_the_power_does_not_wait_for_the_disk(database: Database):
    def waits() -> int:
        with database.transaction() as s:
            return s.connection().exec_driver_sql("PRAGMA synchronous").scalar_one()

    assert waits() == 2  # FULL
    with database.transaction(durable=False) as s:
        assert s.connection().exec_driver_sql("PRAGMA synchronous").scalar_one() == 1  # NORMAL
        s.add(Setting(key="passing", value={"n": 1}))
    assert waits() == 2  # the same connection from the pool, durable again
    with database.session() as s:
        assert s.get_one(Setting, "passing").value == {"n": 1}


def test_every_connection_is_durable_and_clean(database: Database):
    wanted = {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1, "secure_delete": 1, "busy_timeout": 10_000}
    with database.session() as s:
        found = {name: s.connection().exec_driver_sql(f"PRAGMA {name}").scalar() for name in wanted}
    assert found == wanted


def test_a_full_disk_is_told_and_earlier_answers_stay(database: Database):
    filled = subprocess.run(
        [sys.executable, "-c", FILLER, str(database.url)], capture_output=True, text=True, check=True, cwd=Path.cwd()
    )
    *acknowledged, message = filled.stdout.splitlines()
    assert "disk" in message
    assert "nothing of this change was stored" in message
    with database.session() as s:
        stored = set(s.scalars(select(Setting.key)))
    assert acknowledged
    assert {f"answer-{k}" for k in acknowledged} <= stored


def test_a_nearly_full_disk_is_told_at_start(tmp_path: Path):
    with pytest.raises(StorageError, match="MB free on its disk"):
        check_writable(tmp_path, min_free_bytes=shutil.disk_usage(tmp_path).free + 2**30)


@pytest.fixture
def read_only_folder(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path]:
    """A folder that this user cannot write: by its mode, for root a disk mounted so."""
    if os.geteuid() == 0:
        folder = request.getfixturevalue("small_disk")
        subprocess.run(["mount", "-o", "remount,ro", folder], check=True)
    else:
        folder = tmp_path / "read-only"
        folder.mkdir(0o500)
    yield folder
    if os.geteuid() != 0:
        folder.chmod(0o700)


def test_a_small_disk_that_fills_up_keeps_what_was_stored(small_disk: Path):
    with pytest.raises(StorageError, match="only 1 MB free on its disk"):
        check_writable(small_disk)
    files = ArtefactStore((small_disk / "artefacts").as_uri())
    first = files.put(b"weights")
    with pytest.raises(StorageError, match=r"No space left on device.*check free space"):
        files.put(b"x" * 2_000_000)
    assert [path.name for path in small_disk.rglob("*") if path.is_file()] == [first]
    with pytest.raises(StorageError, match="disk is full"):
        fill(f"sqlite:///{small_disk / 'desirepath.sqlite'}")


def fill(url: str) -> None:
    with closing(Database(url)) as database:
        database.migrate()
        for k in range(100):
            with database.transaction() as s:
                s.add(Setting(key=f"answer-{k}", value={"text": "x" * 20_000}))


def test_a_read_only_data_folder_is_told_at_start(read_only_folder: Path):
    with pytest.raises(StorageError, match=r"cannot be written.*DESIREPATH_DATA"):
        check_writable(read_only_folder, min_free_bytes=0)
    with pytest.raises(StorageError, match="cannot be opened"):
        Database(f"sqlite:///{read_only_folder / 'desirepath.sqlite'}").migrate()


def test_a_data_folder_that_is_a_file_is_told(tmp_path: Path):
    (tmp_path / "data").write_text("not a folder")
    with pytest.raises(StorageError, match=r"data folder .*data cannot be written"):
        check_writable(tmp_path / "data")


def test_check_writable_leaves_nothing_behind(tmp_path: Path):
    check_writable(tmp_path / "new" / "data")
    assert list((tmp_path / "new" / "data").iterdir()) == []


def test_an_error_does_not_repeat_what_was_to_be_stored(database: Database):
    with pytest.raises(IntegrityError) as told, database.transaction() as s:
        s.execute(text("INSERT INTO setting (key) VALUES (:key)"), {"key": "planted-canary"})
    assert "planted-canary" not in str(told.value)


def test_a_file_that_is_no_database_is_told(tmp_path: Path):
    (tmp_path / "desirepath.sqlite").write_bytes(b"these are not the pages you are looking for" * 100)
    with pytest.raises(StorageError, match="damaged or no database"):
        Database(f"sqlite:///{tmp_path / 'desirepath.sqlite'}").migrate()


def test_a_database_server_that_does_not_answer_is_told():
    with pytest.raises(StorageError, match="no database server answers there"):
        Database("postgresql://nobody@127.0.0.1:1/nothing").migrate()


@pytest.mark.parametrize("url", ["sqlite://", "sqlite:///:memory:", "mysql://localhost/x"])
def test_urls_that_keep_nothing_or_are_unknown_are_refused(url: str):
    with pytest.raises(StorageError, match="database url"):
        Database(url)


def test_compacting_removes_deleted_text_from_every_file(database: Database, tmp_path: Path):
    with database.transaction() as s:
        s.add(Setting(key="secret", value={"text": "planted-canary"}))
    assert any(b"planted-canary" in file.read_bytes() for file in tmp_path.glob("desirepath.sqlite*"))
    with database.transaction() as s:
        s.delete(s.get(Setting, "secret"))
    assert database.compact()
    assert not any(b"planted-canary" in file.read_bytes() for file in tmp_path.glob("desirepath.sqlite*"))


def test_after_closing_everything_stands_in_one_file_for_its_owner_alone(database: Database, tmp_path: Path):
    with database.transaction() as s:
        s.add(Setting(key="kept", value={"text": "planted-canary"}))
    beside = [tmp_path / f"desirepath.sqlite{ending}" for ending in ("", "-wal", "-shm")]
    assert {file.name: file.stat().st_mode & 0o777 for file in beside} == {file.name: 0o600 for file in beside}
    with closing(sqlite3.connect(beside[0])) as another:  # a process that goes on
        another.execute("SELECT * FROM setting").fetchall()
        database.close()
        assert b"planted-canary" in beside[0].read_bytes()
        assert b"planted-canary" not in beside[1].read_bytes()
    assert [file.name for file in beside if file.exists()] == ["desirepath.sqlite"]


def test_what_another_user_could_read_is_shut(migrated: Path, tmp_path: Path):
    file = tmp_path / "new" / "desirepath.sqlite"
    check_writable(file.parent)
    shutil.copy(migrated, file)
    file.chmod(0o644)
    Database(f"sqlite:///{file}").migrate()
    assert (file.stat().st_mode & 0o777, file.parent.stat().st_mode & 0o777) == (0o600, 0o700)


def test_on_postgresql_compacting_stops_nobody_who_writes(postgres_server: str, tmp_path: Path):
    """VACUUM FULL wrote every table anew and let nobody in meanwhile: 23 s a GB."""
    with postgres.holding(postgres_server, tmp_path / "none") as url:
        database = Database(url)
        with database.engine.connect() as writes:
            writes.execute(text("LOCK TABLE response, event, setting IN ROW EXCLUSIVE MODE"))
            assert database.compact()
        database.close()


def test_on_postgresql_compacting_says_where_somebody_still_sees_what_was_deleted(
    postgres_server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("desirepath.store.database.COMPACT_TRIES_S", 0.0)  # do not wait for the reader
    with postgres.holding(postgres_server, tmp_path / "none") as url:
        database = Database(url)
        with database.transaction() as s:
            s.add(Setting(key="secret", value={"text": "x"}))
        with database.session() as reading:  # an export, a backup
            reading.get(Setting, "secret")
            with database.transaction() as s:
                s.delete(s.get_one(Setting, "secret"))
            assert not database.compact()
        assert database.compact()
        with database.engine.connect() as connection:
            connection.execute(text("CREATE EXTENSION pgstattuple"))
            assert connection.scalar(text("SELECT dead_tuple_count FROM pgstattuple('setting')")) == 0
        database.close()


def test_compacting_gives_up_while_somebody_reads_and_says_so(
    database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("desirepath.store.database.COMPACT_TRIES_S", 0.0)  # do not wait for the reader
    with database.transaction() as s:
        s.add(Setting(key="a", value={}))
    reader = sqlite3.connect(tmp_path / "desirepath.sqlite", isolation_level=None)
    reader.execute("BEGIN")
    reader.execute("SELECT * FROM setting").fetchall()
    assert not database.compact()
    reader.close()
    assert database.compact()


def test_however_long_somebody_reads_the_file_is_written_anew_once(database: Database, tmp_path: Path):
    """It was once more each time the log could not be emptied, and nobody could answer meanwhile."""
    said: list[str] = []
    listens_for(database.engine, "checkout")(lambda raw, *_: raw.set_trace_callback(said.append))
    reader = sqlite3.connect(tmp_path / "desirepath.sqlite", isolation_level=None, check_same_thread=False)
    reader.execute("BEGIN")
    reader.execute("SELECT * FROM setting").fetchall()
    ends = threading.Timer(1.5, reader.close)
    ends.start()
    assert database.compact()
    ends.join()
    assert sum("wal_checkpoint" in one for one in said) > 1
    assert said.count("VACUUM") == 1
