"""Opens the database and hands out transactions. The tables live in `models`, their history in `migrations`.

One way in for SQLite (a file, the default) and PostgreSQL (by URL): writers queue instead of deadlocking, and a commit
that returned is on disk. Who waited in vain gets DatabaseBusy: nothing was stored, and asking again is safe.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import shutil
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sqlalchemy import Connection, create_engine, event, func, inspect, make_url, select, text
from sqlalchemy.exc import DBAPIError, OperationalError, StatementError
from sqlalchemy.orm import Session

from desirepath.store.models import Base, Setting, utc_now
from desirepath.store.models.base import UtcDateTime
from desirepath.store.plain_data import Unstorable, dump_json, load_json

if TYPE_CHECKING:
    from alembic.config import Config

MIGRATIONS = Path(__file__).with_name("migrations")
BUSY_TIMEOUT_MS = 10_000  # how long a writer waits for other processes
TURN_PATIENCE_S = 4.0  # ours: and before that for those of its own process; together less than a page waits (send.js)
MIN_FREE_BYTES = 100 * 2**20  # ours: below this a training's artefacts or a vacuum would fill the disk
PROBE_BYTES = 64 * 1024
NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
NO_SERVER = ("connection failed", "connection is bad", "could not translate host name")  # in what psycopg says
START_LOOK_S = 0.1
START_LOCK = 7_305_442  # as below, for what else a start makes
MIGRATION_LOCK = 7_305_441  # any fixed number: the PostgreSQL advisory lock that two starting processes share
COMPACT_PENDING = "compact_pending"  # setting: an erasure committed, its vacuum has not finished yet
COMPACT_TRIES_S = 15.0
COMPACT_LOOK_S = 0.2
LOG_PATIENCE_S = 1.0
_SEES_OLDER = text("""
SELECT EXISTS (SELECT 1 FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()
  AND age(backend_xmin) > age(CAST(CAST(:now AS text) AS xid)))
""")


class StorageError(OSError):
    """The data folder or the database cannot be used; the message says what to do."""


class DatabaseBusy(StorageError):
    """Others kept writing for too long. Nothing of this change was stored, so it may be asked for again."""


class DiskFull(StorageError):
    """There is no room left. Nothing of this change was stored; it may be asked for again once there is."""


def is_full(problem: BaseException | None) -> bool:
    """Whether an error comes of a disk without room, however deep that is buried."""
    while problem is not None:
        if isinstance(problem, DiskFull) or (isinstance(problem, OSError) and problem.errno in NO_ROOM):
            return True
        if isinstance(problem, shutil.Error):  # of a copied folder: it has all its files' errors, as texts
            return any(f"[Errno {number}]" in str(problem) for number in NO_ROOM)
        problem = problem.__cause__
    return False


class Turns:
    """Lets the writers of one process in one at a time, first come, first served.

    SQLite alone lets a waiting writer sleep up to 0.1 s between two looks, and whoever looks at the right moment goes
    first: with twenty writers some waited for more than ten seconds while the file was free most of the time.
    """

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._waiting: deque[threading.Lock] = deque()
        self._taken = False

    @property
    def waiting(self) -> int:
        """How many stand in line."""
        return len(self._waiting)

    @contextlib.contextmanager
    def turn(self, patience_s: float) -> Iterator[None]:
        """Wait for the turn and keep it for the block. Raises TimeoutError if it did not come in time."""
        with self._guard:
            ticket = threading.Lock() if self._taken else None
            if ticket is not None:
                ticket.acquire()
                self._waiting.append(ticket)
            self._taken = True
        if ticket is not None and not ticket.acquire(timeout=patience_s):
            with self._guard:
                if ticket in self._waiting:  # else it was handed over this very moment
                    self._waiting.remove(ticket)
                    raise TimeoutError
        try:
            yield
        finally:
            with self._guard:
                if self._waiting:
                    self._waiting.popleft().release()
                else:
                    self._taken = False


def check_writable(folder: Path, *, min_free_bytes: int = MIN_FREE_BYTES) -> None:
    """Make sure that data can be kept in `folder` (made if missing) before anything starts.

    Raises StorageError if the folder is read-only, is no folder, or its disk is (nearly) full.
    """
    probe = folder / f".probe-{os.getpid()}-{time.monotonic_ns()}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        free = shutil.disk_usage(folder).free
        if free < min_free_bytes:
            raise StorageError(
                f"data folder {folder}: only {free / 2**20:.0f} MB free on its disk, at least "
                f"{min_free_bytes / 2**20:.0f} MB are needed; free some space or set DESIREPATH_DATA to another folder"
            )
        with probe.open("wb") as file:
            file.write(b"\0" * PROBE_BYTES)
            file.flush()
            os.fsync(file.fileno())
    except StorageError:
        raise
    except OSError as problem:
        raise StorageError(
            f"data folder {folder} cannot be written ({problem.strerror or problem}); "
            "make it writable for this user, free some space, or set DESIREPATH_DATA to another folder"
        ) from problem
    finally:
        with contextlib.suppress(OSError):
            probe.unlink(missing_ok=True)


class Database:
    """The database behind one URL: `sqlite:///path` or `postgresql://...`.

    `engine` begins writing transactions; `transaction()` and `session()` are what the other rooms use.
    """

    def __init__(self, url: str) -> None:
        parsed = make_url(url)
        if parsed.drivername in ("postgresql", "postgres"):
            parsed = parsed.set(drivername="postgresql+psycopg")
        self.url = parsed
        self.is_sqlite = parsed.get_backend_name() == "sqlite"
        # An error goes to the log, what was to be stored must not.
        common: dict[str, Any] = {"pool_size": 20, "hide_parameters": True}
        common |= {"json_serializer": dump_json, "json_deserializer": load_json}
        if self.is_sqlite:
            if not parsed.database or parsed.database == ":memory:":
                raise StorageError(f"database url {url!r}: name a file, as in sqlite:///data/desirepath.sqlite")
            self.file: Path | None = Path(parsed.database)
            waits = {"timeout": BUSY_TIMEOUT_MS / 1000, "check_same_thread": False}
            engine = create_engine(parsed, connect_args=waits, max_overflow=40, **common)
            event.listen(engine, "connect", _set_up_sqlite)
            event.listen(engine, "begin", _begin_sqlite)
            reading: dict[str, Any] = {"reads_only": True}
            passing: dict[str, Any] = {"passing": True}
        elif parsed.get_backend_name() == "postgresql":
            self.file = None
            engine = create_engine(parsed, pool_pre_ping=True, **common)
            reading = {"postgresql_readonly": True, "isolation_level": "REPEATABLE READ"}
            passing = {}
        else:
            raise StorageError(f"database url {url!r}: known are sqlite:///FILE and postgresql://USER@HOST/NAME")
        self.engine = engine
        self.turns = Turns()
        self._done_at: dict[str, float] = {}
        self._reading = engine.execution_options(**reading)
        self._passing = engine.execution_options(**passing)

    def is_due(self, what: str, *, every_s: float) -> bool:
        """Whether that was last due so many seconds ago, or never; asking means to do it now."""
        now = time.monotonic()
        due = now - self._done_at.get(what, -math.inf) >= every_s
        if due:
            self._done_at[what] = now
        return due

    def migrate(self) -> None:
        """Bring the tables to the newest revision; does nothing where they are. Safe from several processes at once.

        Raises StorageError if the database cannot be opened or is newer than this version.
        """
        with self.explain_errors():
            if self.file is not None:
                self.file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                _make_private(self.file)
            with self.engine.begin() as connection:
                if not self.is_sqlite:
                    connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": MIGRATION_LOCK})
                if _revision_of(connection) != newest_revision():
                    self._upgrade(connection)
            with self.session() as s:
                pending = s.get(Setting, COMPACT_PENDING) is not None
        if pending:
            self.compact()

    @contextlib.contextmanager
    def one_starts(self) -> Iterator[None]:
        """Of several processes that start at once, perhaps on several machines, one is in this block at a time: what
        each makes where it is missing is made once."""
        if self.is_sqlite:
            yield
            return
        with self.explain_errors(), self.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            # Asked again and again: a statement that waits would hold up the indexes that the jobs' engine makes.
            while not connection.execute(text("SELECT pg_try_advisory_lock(:key)"), {"key": START_LOCK}).scalar_one():
                time.sleep(START_LOOK_S)
            try:
                yield
            finally:
                connection.execute(text("SELECT pg_advisory_unlock(:key)"), {"key": START_LOCK})

    def _upgrade(self, connection: Connection) -> None:
        from alembic import command  # a third of a second that a restart need not wait
        from alembic.util import CommandError

        try:
            command.upgrade(migration_config(connection), "head")
        except CommandError as problem:
            raise StorageError(
                f"database {self.file or self.url.render_as_string(hide_password=True)} was written by another "
                f"version of desirepath ({problem}); install that version or restore an older backup"
            ) from problem

    @contextlib.contextmanager
    def transaction(self, *, durable: bool = True) -> Iterator[Session]:
        """A session that may write; commits when the block ends, rolls back on any exception.

        durable: a commit waits for the disk. False for what may be lost with the machine's power (never with a killed
        process), like where in a trial somebody is: SQLite then writes the log without waiting, and the next durable
        commit takes it to the disk in its order. On PostgreSQL `synchronous_commit` is off for the transaction.
        On SQLite writers take turns, and the write lock is taken at the first statement, so what was read in here is
        still true at the commit. On PostgreSQL lock what you are about to change (`with_for_update`) or compare and
        set. Raises DatabaseBusy if the turn does not come in time.
        """
        engine = self.engine if durable else self._passing
        with self._turn(), self.explain_errors(), Session(engine, expire_on_commit=False) as s, s.begin():
            if not (durable or self.is_sqlite):
                s.execute(text("SET LOCAL synchronous_commit = off"))
            yield s

    @contextlib.contextmanager
    def _turn(self) -> Iterator[None]:
        if not self.is_sqlite:
            yield
            return
        with contextlib.ExitStack() as held:
            try:
                held.enter_context(self.turns.turn(TURN_PATIENCE_S))
            except TimeoutError:
                problem_words = f"others kept writing for more than {TURN_PATIENCE_S:.0f} s; nothing was stored"
                raise DatabaseBusy(f"database {self.file}: {problem_words}") from None
            yield

    @contextlib.contextmanager
    def session(self) -> Iterator[Session]:
        """A session that only reads, one consistent view; the database refuses writes in it."""
        with self.explain_errors(), Session(self._reading, expire_on_commit=False) as s:
            yield s

    def compact(self) -> bool:
        """Make sure that deleted rows are read by nobody any more, while others read and write.

        On SQLite they are in no file afterwards: the write-ahead log is truncated and the file rewritten. PostgreSQL
        removes them from tables and indexes and keeps the freed bytes until new rows take their place; these, the
        server's own write-ahead log and its backups are its administrator's (docs/deployment.md). Returns False if
        somebody kept reading what was before; an erasure's is then done at the next start.
        """
        if not (self._vacuum_sqlite() if self.is_sqlite else self._vacuum_postgresql()):
            return False
        self._forget_pending()
        return True

    def close(self) -> None:
        """Give all connections back. Of SQLite everything stands in the one file then, as far as no other process
        reads or writes just now."""
        self.engine.dispose()
        if self.file is not None:
            empty_log(self.file)

    def _vacuum_postgresql(self) -> bool:
        """Vacuum our tables, once nobody sees them as they were before; in the end anyhow."""
        deadline = time.monotonic() + COMPACT_TRIES_S
        quoted = self.engine.dialect.identifier_preparer.quote
        tables = ", ".join(quoted(table.name) for table in Base.metadata.sorted_tables)
        with self.explain_errors(), self.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            now = connection.execute(text("SELECT CAST(CAST(pg_current_xact_id() AS xid) AS text)")).scalar_one()
            while seen := connection.execute(_SEES_OLDER, {"now": now}).scalar_one():
                if time.monotonic() > deadline:
                    break
                time.sleep(COMPACT_LOOK_S)
            connection.execute(text(f"VACUUM (INDEX_CLEANUP ON) {tables}"))
            return not seen

    def _vacuum_sqlite(self) -> bool:
        """Rewrite the file, once: nobody else writes meanwhile. Then empty the log, once nobody is in it."""
        for statement in ("VACUUM", "PRAGMA wal_checkpoint(TRUNCATE)"):
            deadline = time.monotonic() + COMPACT_TRIES_S
            while not self._done_alone(statement):
                if time.monotonic() > deadline:
                    return False
                time.sleep(COMPACT_LOOK_S)
        return True

    def _done_alone(self, statement: str) -> bool:
        """Whether nobody kept SQLite from it; the caller tries again, nobody waits for us meanwhile."""
        raw = self.engine.raw_connection()
        try:
            cursor = raw.cursor()
            cursor.execute("PRAGMA busy_timeout = 1000")
            cursor.execute("PRAGMA query_only = OFF")
            busy = cursor.execute(statement).fetchone()  # of a checkpoint only
            return not (busy and busy[0])
        except sqlite3.OperationalError as problem:
            if "locked" in str(problem) or "busy" in str(problem):
                return False
            raise
        finally:
            raw.cursor().execute(f"PRAGMA busy_timeout = {BUSY_TIMEOUT_MS}")
            raw.close()

    def _forget_pending(self) -> None:
        with self.transaction() as s:
            row = s.get(Setting, COMPACT_PENDING)
            if row is not None:
                s.delete(row)

    @contextlib.contextmanager
    def explain_errors(self) -> Iterator[None]:
        """Turn what the disk or the connection did into a StorageError with a sentence, what SQLAlchemy wraps of
        `dump_json` back into Unstorable; other errors pass."""
        try:
            yield
        except DBAPIError as problem:
            message = str(problem.orig)
            where = self.file or self.url.render_as_string(hide_password=True)
            if "disk is full" in message or "No space left on device" in message:
                reason = "the disk is full; nothing of this change was stored. Free some space and try again"
                raise DiskFull(f"database {where}: {reason} ({message})") from problem
            if "disk I/O error" in message:
                reason = "the disk is full or broken; nothing of this change was stored. Free some space and try again"
            elif "readonly database" in message and "query_only" not in message:
                reason = "the database was opened for reading or its file is read-only; nothing was stored"
            elif "unable to open database file" in message:
                reason = "the file cannot be opened; check that its folder exists and is writable"
            elif "file is not a database" in message or "malformed" in message:
                reason = "the file is damaged or no database; restore a backup (`desirepath restore`)"
            elif "database is locked" in message:
                raise DatabaseBusy(
                    f"database {where}: another process kept writing for more than {BUSY_TIMEOUT_MS / 1000:.0f} s; "
                    f"nothing was stored ({message})"
                ) from problem
            elif any(words in message for words in NO_SERVER):
                reason = "no database server answers there; check DESIREPATH_DATABASE_URL and that the server runs"
                raise DatabaseBusy(f"database {where}: {reason} ({message})") from problem
            elif isinstance(problem, OperationalError) and problem.connection_invalidated:
                # Where it was lost at the commit itself nobody knows whether it was stored; requests may be repeated.
                raise DatabaseBusy(f"database {where}: the connection was lost; ask again ({message})") from problem
            else:
                raise
            raise StorageError(f"database {where}: {reason} ({message})") from problem
        except StatementError as problem:
            if isinstance(problem.orig, Unstorable):
                raise problem.orig from None
            raise


def empty_log(file: Path) -> None:
    """Take what stands in a SQLite file's write-ahead log into the file; whoever is last to close it removes the log.

    Waits a moment for others, and leaves in the log what cannot be taken now: it is read at the next start.
    """
    if not file.with_name(f"{file.name}-wal").exists():
        return
    with (
        contextlib.suppress(sqlite3.Error),
        contextlib.closing(sqlite3.connect(file, timeout=LOG_PATIENCE_S)) as connection,
    ):
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def _make_private(file: Path) -> None:
    """For its owner alone; SQLite gives the files beside it the same mode."""
    with contextlib.suppress(OSError):  # another user's, or read-only: opening it says what is wrong
        file.touch(mode=0o600)
        for part in (file, file.with_name(f"{file.name}-wal"), file.with_name(f"{file.name}-shm")):
            if part.exists() and part.stat().st_mode & 0o077:
                part.chmod(0o600)


def shared_now(s: Session) -> datetime:
    """The time by the one clock that all machines of an installation have in common: the database server's, and on
    SQLite, which serves one machine, that machine's. For whatever one machine writes and another compares."""
    if s.get_bind().dialect.name == "sqlite":
        return utc_now()
    return s.execute(select(func.clock_timestamp(type_=UtcDateTime()))).scalar_one()


def newest_revision() -> str:
    """The revision that `migrate` leads to: the last of the scripts, whose names begin with it."""
    return max(script.name[1:].partition("_")[0] for script in (MIGRATIONS / "versions").glob("v*.py"))


def _revision_of(connection: Connection) -> str | None:
    """The revision that the tables have; None for a database without tables of ours."""
    if not inspect(connection).has_table("alembic_version"):
        return None
    revision: str | None = connection.scalar(text("SELECT version_num FROM alembic_version"))
    return revision


def migration_config(connection: Connection) -> Config:
    """Alembic's configuration for our scripts, running inside `connection`'s transaction."""
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    config.set_main_option("file_template", "v%%(rev)s_%%(slug)s")
    config.attributes["connection"] = connection
    return config


def _set_up_sqlite(connection: sqlite3.Connection, _record: object) -> None:
    connection.isolation_level = None  # we say BEGIN ourselves, below
    cursor = connection.cursor()
    for pragma in (
        f"busy_timeout = {BUSY_TIMEOUT_MS}",
        "journal_mode = WAL",
        "synchronous = FULL",  # an acknowledged answer survives a power cut
        "foreign_keys = ON",
        "secure_delete = ON",
        "temp_store = MEMORY",  # no copies of answers in temporary files
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    # IMMEDIATE: a transaction that first reads and then writes would otherwise fail when two do so at once.
    reads_only = connection.get_execution_options().get("reads_only", False)
    cursor = connection.connection.cursor()
    cursor.execute(f"PRAGMA query_only = {'ON' if reads_only else 'OFF'}")
    # In WAL mode NORMAL waits for the disk at checkpoints only; it has to be said outside a transaction.
    passing = connection.get_execution_options().get("passing", False)
    cursor.execute(f"PRAGMA synchronous = {'NORMAL' if passing else 'FULL'}")
    connection.exec_driver_sql("BEGIN" if reads_only else "BEGIN IMMEDIATE")
