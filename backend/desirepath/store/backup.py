"""Copies an installation into one file (database, artefacts, setups that were brought), and brings it back into an
empty one.

The jobs' own tables (DBOS's) are not copied: what a job needs is its row, and a worker starts unfinished ones again.
How PostgreSQL's part is made and brought back lives in `postgres_dump.py`.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import shutil
import sqlite3
import tarfile
import tempfile
import uuid
from contextlib import closing
from pathlib import Path
from typing import Any

from desirepath.os_errors import in_words
from desirepath.simulation.setups import UPLOADED, uploaded_setups
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database, StorageError
from desirepath.store.demonstration_snapshots import programmed_files
from desirepath.store.models import utc_now
from desirepath.store.postgres_dump import NAMED_FILES, BackupError, bring_back, check_empty, dump
from desirepath.store.robot_recordings import recordings_of

FORMAT = "desirepath-backup-1"
POSTGRES_FORMAT = "desirepath-backup-postgresql-1"
DATABASE_MEMBER = "desirepath.sqlite"
POSTGRES_MEMBER = "desirepath.pgdump"
ARTEFACT_FOLDER = "artefacts"
MANIFEST_MEMBER = "manifest.json"
FILES_AT_ONCE = 256  # held in memory while restoring
ARTEFACT_MEMBER = re.compile(rf"{ARTEFACT_FOLDER}/([0-9a-f]{{64}})")
SETUP_MEMBER = re.compile(rf"{UPLOADED}/[A-Za-z0-9_./-]+")

__all__ = ["BackupError", "backup", "restore"]


def backup(db: Database, files: ArtefactStore, out: Path) -> dict[str, Any]:
    """Write database, artefacts and the setups that were brought into the tar file `out`; the server may keep running.

    Returns {"file", "bytes", "artefacts", "setup_files", "missing"}; missing: files that rows name but the store does
    not have.
    A backup holds everything that the database holds, recruiting ids included, and it is not reached by a later
    erasure: keep it as safe as the data folder, and not longer than needed. Raises BackupError if `out` exists or
    PostgreSQL's own programs are not there.
    """
    if out.exists():
        raise BackupError(f"out = {str(out)!r} exists already; choose another name")
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = out.with_name(f".{out.name}-{uuid.uuid4().hex}")
    try:
        with tempfile.TemporaryDirectory(dir=out.parent) as folder:
            if db.file is not None:
                form, copy = FORMAT, Path(folder) / DATABASE_MEMBER
                _copy_database(db.file, copy)
                named = _list_named_files(copy)
            else:
                form, copy = POSTGRES_FORMAT, Path(folder) / POSTGRES_MEMBER
                named = dump(db, copy)
            with db.session() as s:
                named = dict.fromkeys(sorted(programmed_files(s, files) | recordings_of(s)), False) | named
            names = [name for name in named if files.exists(name)]
            missing = [name for name, quarantined in named.items() if name not in names and not quarantined]
            sums = {copy.name: hashlib.sha256(copy.read_bytes()).hexdigest()}
            sums |= {f"{ARTEFACT_FOLDER}/{name}": name for name in names}
            brought = _setup_files()
            sums |= {name: hashlib.sha256(content).hexdigest() for name, content in brought.items()}
            manifest = {"format": form, "made_at": utc_now().isoformat(), "sha256": sums, "missing": missing}
            partial.touch(mode=0o600)
            with tarfile.open(partial, "w") as tar:
                _add(tar, MANIFEST_MEMBER, json.dumps(manifest, indent=1).encode())
                tar.add(copy, copy.name)
                for name in names:
                    _add(tar, f"{ARTEFACT_FOLDER}/{name}", files.get(name))
                for name, content in brought.items():
                    _add(tar, name, content)
        partial.rename(out)
    finally:
        partial.unlink(missing_ok=True)
    return {
        "file": str(out),
        "bytes": out.stat().st_size,
        "artefacts": len(names),
        "setup_files": len(brought),
        "missing": missing,
    }


def _setup_files() -> dict[str, bytes]:
    """What lies in the folders of setups that somebody brought, by member; not what a training left on its way."""
    folder = uploaded_setups()
    files = {f"{UPLOADED}/{path.relative_to(folder).as_posix()}": path for path in sorted(folder.rglob("*"))}
    return {
        name: path.read_bytes()
        for name, path in files.items()
        if _is_file_of_setup(name) and path.is_file() and not path.is_symlink()
    }


def restore(
    source: Path, data: Path, *, database_url: str | None = None, artefacts_url: str | None = None
) -> dict[str, Any]:
    """Bring a backup back: of SQLite into the data folder, which must hold no database; of PostgreSQL into the empty
    database of that URL. artefacts_url: where the artefacts go, by default into the data folder.

    Returns {"data", "artefacts", "setup_files", "made_at"}. Everything is checked against its sha256 before the
    database is put in place. Raises BackupError.
    """
    on_postgres = database_url is not None and not database_url.startswith("sqlite")
    wanted, member = (POSTGRES_FORMAT, POSTGRES_MEMBER) if on_postgres else (FORMAT, DATABASE_MEMBER)
    target = data / DATABASE_MEMBER
    if on_postgres:
        check_empty(str(database_url))
    elif target.exists():
        raise BackupError(f"{target} exists; restore into an empty data folder (set DESIREPATH_DATA)")
    data.mkdir(mode=0o700, parents=True, exist_ok=True)
    files = ArtefactStore(artefacts_url or (data / ARTEFACT_FOLDER).resolve().as_uri())
    partial = data / f".{member}-{uuid.uuid4().hex}"
    try:
        with tarfile.open(source, "r:") as tar:
            manifest = json.loads(_member(tar, MANIFEST_MEMBER))
            _check_format(source, manifest.get("format"), wanted)
            setup_files = _unpack(source, tar, manifest["sha256"], partial, files)
        if not partial.exists():
            raise BackupError(f"{source}: holds no database")
        if on_postgres:
            bring_back(str(database_url), partial)
        else:
            shutil.move(partial, target)
        for name, content in setup_files.items():
            (data / name).parent.mkdir(parents=True, exist_ok=True)
            (data / name).write_bytes(content)
    except StorageError:
        raise
    except (OSError, tarfile.TarError, KeyError, json.JSONDecodeError) as problem:
        raise BackupError(f"{source}: is no whole backup ({in_words(problem)})") from problem
    finally:
        partial.unlink(missing_ok=True)
    return {
        "data": str(data),
        "artefacts": len(manifest["sha256"]) - 1 - len(setup_files),
        "setup_files": len(setup_files),
        "made_at": manifest["made_at"],
    }


def _check_format(source: Path, stated: object, wanted: str) -> None:
    if stated == wanted:
        return
    if stated in (FORMAT, POSTGRES_FORMAT):
        of = (
            "SQLite (leave DESIREPATH_DATABASE_URL empty)"
            if stated == FORMAT
            else "PostgreSQL (DESIREPATH_DATABASE_URL)"
        )
        raise BackupError(f"{source}: is of an installation on {of}; bring it back into such a one")
    raise BackupError(f"{source}: format {stated!r} is unknown; this version reads {FORMAT!r} and {POSTGRES_FORMAT!r}")


def _unpack(
    source: Path, tar: tarfile.TarFile, sums: dict[str, str], partial: Path, files: ArtefactStore
) -> dict[str, bytes]:
    """Every member, checked: artefacts into the store, the database to `partial`. Returns the files of setups."""
    waiting: list[bytes] = []
    setup_files: dict[str, bytes] = {}
    for name, sha in sums.items():
        content = _member(tar, name)
        if hashlib.sha256(content).hexdigest() != sha:
            raise BackupError(f"{source}: {name} is damaged (its sha256 differs)")
        if ARTEFACT_MEMBER.fullmatch(name):
            waiting.append(content)
            if len(waiting) == FILES_AT_ONCE:
                files.put_all(waiting)
                waiting = []
        elif name in (DATABASE_MEMBER, POSTGRES_MEMBER):
            partial.touch(mode=0o600)
            partial.write_bytes(content)
        elif _is_file_of_setup(name):
            setup_files[name] = content
    files.put_all(waiting)
    return setup_files


def _is_file_of_setup(name: str) -> bool:
    """A file of a setup that somebody brought: no part of its path is empty or begins with a point."""
    return SETUP_MEMBER.fullmatch(name) is not None and all(part[:1] not in ("", ".") for part in name.split("/"))


def _copy_database(file: Path, copy: Path) -> None:
    """SQLite's own online backup: a consistent copy while others write."""
    with closing(sqlite3.connect(file)) as source, closing(sqlite3.connect(copy)) as target:
        source.backup(target)
        target.execute("PRAGMA journal_mode = DELETE")  # one file, no log beside it


def _list_named_files(copy: Path) -> dict[str, bool]:
    """The files that rows of the copied database name -> whether an erasure may have removed the file itself."""
    with closing(sqlite3.connect(copy)) as connection:
        rows = [row for query in NAMED_FILES for row in connection.execute(query)]
    return dict(sorted((str(name), bool(gone)) for name, gone in rows))


def _add(tar: tarfile.TarFile, name: str, content: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size, member.mode = len(content), 0o600
    tar.addfile(member, io.BytesIO(content))


def _member(tar: tarfile.TarFile, name: str) -> bytes:
    """One member's content, read without unpacking: no path in the archive is ever used as a path here."""
    member = tar.extractfile(name)
    if member is None:
        raise KeyError(f"{name} is not a file")
    return member.read()
