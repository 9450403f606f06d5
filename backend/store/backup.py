"""Copies an installation with SQLite into one file, and brings it back into an empty data folder.

The jobs' own database is not copied: what a job needs is its row here, and a worker starts unfinished ones again. On
PostgreSQL the server's own tools do this better.
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

from backend.store.artefacts import ArtefactStore
from backend.store.database import Database
from backend.store.models import utc_now

FORMAT = "desirepath-backup-1"
DATABASE_MEMBER = "desirepath.sqlite"
ARTEFACT_FOLDER = "artefacts"
MANIFEST_MEMBER = "manifest.json"
FILES_AT_ONCE = 256  # held in memory while restoring
ARTEFACT_MEMBER = re.compile(rf"{ARTEFACT_FOLDER}/([0-9a-f]{{64}})")


class BackupError(ValueError):
    """The backup cannot be made or brought back; nothing was changed."""


def backup(db: Database, files: ArtefactStore, out: Path) -> dict[str, Any]:
    """Write database and artefacts into the tar file `out`; the server may keep running.

    Returns {"file", "bytes", "artefacts", "missing"}; missing: files that rows name but the store does not have.
    A backup holds everything that the database holds, recruiting ids included, and it is not reached by a later
    erasure: keep it as safe as the data folder, and not longer than needed. Raises BackupError if `out` exists.
    """
    if db.file is None:
        raise BackupError(
            "backup: this installation uses PostgreSQL; use pg_dump, and copy the artefact store beside it"
        )
    if out.exists():
        raise BackupError(f"out = {str(out)!r} exists already; choose another name")
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = out.with_name(f".{out.name}-{uuid.uuid4().hex}")
    try:
        with tempfile.TemporaryDirectory(dir=out.parent) as folder:
            copy = Path(folder) / DATABASE_MEMBER
            _copy_database(db.file, copy)
            named = _named_files(copy)
            names = [name for name in named if files.exists(name)]
            missing = [name for name, quarantined in named.items() if name not in names and not quarantined]
            sums = {DATABASE_MEMBER: hashlib.sha256(copy.read_bytes()).hexdigest()}
            sums |= {f"{ARTEFACT_FOLDER}/{name}": name for name in names}
            manifest = {"format": FORMAT, "made_at": utc_now().isoformat(), "sha256": sums, "missing": missing}
            partial.touch(mode=0o600)
            with tarfile.open(partial, "w") as tar:
                _add(tar, MANIFEST_MEMBER, json.dumps(manifest, indent=1).encode())
                tar.add(copy, DATABASE_MEMBER)
                for name in names:
                    _add(tar, f"{ARTEFACT_FOLDER}/{name}", files.get(name))
        partial.rename(out)
    finally:
        partial.unlink(missing_ok=True)
    return {"file": str(out), "bytes": out.stat().st_size, "artefacts": len(names), "missing": missing}


def restore(source: Path, data: Path) -> dict[str, Any]:
    """Bring a backup back into the data folder, which must hold no database. Returns {"data", "artefacts", "made_at"}.

    Everything is checked against its sha256 before the database is put in place. Raises BackupError.
    """
    target = data / DATABASE_MEMBER
    if target.exists():
        raise BackupError(f"{target} exists; restore into an empty data folder (set DESIREPATH_DATA)")
    data.mkdir(parents=True, exist_ok=True)
    files = ArtefactStore((data / ARTEFACT_FOLDER).resolve().as_uri())
    partial = data / f".{DATABASE_MEMBER}-{uuid.uuid4().hex}"
    waiting: list[bytes] = []
    try:
        with tarfile.open(source, "r:") as tar:
            manifest = json.loads(_member(tar, MANIFEST_MEMBER))
            if manifest.get("format") != FORMAT:
                raise BackupError(
                    f"{source}: format {manifest.get('format')!r} is unknown; this version reads {FORMAT!r}"
                )
            for name, sha in manifest["sha256"].items():
                content = _member(tar, name)
                if hashlib.sha256(content).hexdigest() != sha:
                    raise BackupError(f"{source}: {name} is damaged (its sha256 differs)")
                if ARTEFACT_MEMBER.fullmatch(name):
                    waiting.append(content)
                    if len(waiting) == FILES_AT_ONCE:
                        files.put_all(waiting)
                        waiting = []
                elif name == DATABASE_MEMBER:
                    partial.write_bytes(content)
        files.put_all(waiting)
        if not partial.exists():
            raise BackupError(f"{source}: holds no database")
        shutil.move(partial, target)
    except (OSError, tarfile.TarError, KeyError, json.JSONDecodeError) as problem:
        raise BackupError(f"{source}: is no whole backup ({problem})") from problem
    finally:
        partial.unlink(missing_ok=True)
    return {"data": str(data), "artefacts": len(manifest["sha256"]) - 1, "made_at": manifest["made_at"]}


def _copy_database(file: Path, copy: Path) -> None:
    """SQLite's own online backup: a consistent copy while others write."""
    with closing(sqlite3.connect(file)) as source, closing(sqlite3.connect(copy)) as target:
        source.backup(target)
        target.execute("PRAGMA journal_mode = DELETE")  # one file, no log beside it


def _named_files(copy: Path) -> dict[str, bool]:
    """The files that rows of the copied database name -> whether an erasure may have removed the file itself."""
    with closing(sqlite3.connect(copy)) as connection:
        trajectories = connection.execute("SELECT id FROM trajectory").fetchall()
        artefacts = connection.execute("SELECT id, quarantined_at IS NOT NULL FROM artefact").fetchall()
    return dict(
        sorted({**{name: False for (name,) in trajectories}, **{name: bool(gone) for name, gone in artefacts}}.items())
    )


def _add(tar: tarfile.TarFile, name: str, content: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size, member.mode = len(content), 0o600
    tar.addfile(member, io.BytesIO(content))


def _member(tar: tarfile.TarFile, name: str) -> bytes:
    """One member's content, read without unpacking: no path in the archive is ever used as a path here."""
    found = tar.extractfile(name)
    if found is None:
        raise KeyError(f"{name} is not a file")
    return found.read()
