"""Places for files outside of the database: a folder of this machine or an S3-compatible store, by fsspec URL.

What the files are called and mean lives with who writes them (`artefacts.py`, `backup.py`, `dataset`).
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec

from desirepath.store.database import DiskFull, StorageError, is_full

S3_PATIENCE = {"connect_timeout": 5, "read_timeout": 30, "retries": {"max_attempts": 1}}  # seconds; s3fs asks again
S3_TRIES = 3
LAST_OF_FOLDER = "checksums.sha256"


class StoreAway(StorageError):
    """The store of files does not answer. Nothing was stored by this call; it may be asked for again."""


def file_system_of(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it. Raises StorageError for a URL that nothing here can read."""
    options: dict[str, Any] = {}
    if url.startswith("s3://"):
        # Other processes write, too: what was listed a moment ago says nothing.
        options = {"use_listings_cache": False, "config_kwargs": S3_PATIENCE}
    try:
        system, path = fsspec.core.url_to_fs(url, **options)
    except (ValueError, ImportError) as problem:
        known = "known are file:///FOLDER and s3://BUCKET/FOLDER"
        raise StorageError(f"store of files {url!r}: {problem}; {known}") from None
    if url.startswith("s3://"):
        system.retries = S3_TRIES
    return system, str(path)


@contextlib.contextmanager
def explain_errors(url: str) -> Iterator[None]:
    """Raise StorageError, which names the place, for whatever the block cannot do there; FileNotFoundError as it is."""
    try:
        yield
    except (FileNotFoundError, StorageError):
        raise
    except Exception as problem:
        remote = not url.startswith("file:")
        if not isinstance(problem, OSError) and not _is_of_the_store(problem):
            raise
        reason = (problem.strerror if isinstance(problem, OSError) else None) or str(problem) or type(problem).__name__
        if is_full(problem):
            raise DiskFull(f"artefact store {url}: {reason}; check free space and permissions") from problem
        advice = "does it run, and may this machine reach it?" if remote else "check free space and permissions"
        raise (StoreAway if remote else StorageError)(f"artefact store {url}: {reason}; {advice}") from problem


def _is_of_the_store(problem: Exception) -> bool:
    """Whether the libraries that speak to the store raised it; their errors have no common kind."""
    return type(problem).__module__.partition(".")[0] in ("botocore", "aiobotocore", "aiohttp", "s3fs", "fsspec")


def is_remote(where: str) -> bool:
    """Whether a place that somebody named is a URL, not a folder of this machine."""
    return "://" in where


@contextlib.contextmanager
def write_to(where: str) -> Iterator[Path]:
    """A path to write a file or a folder at; on a remote place it is there once the block has ended, or not at all.

    Of a folder the file with the checksums of all others goes last: without it nobody reads the rest.
    Raises StorageError where something is there already.
    """
    if not is_remote(where):
        yield Path(where)
        return
    system, path = file_system_of(where)
    with explain_errors(where):
        if system.exists(path):
            raise StorageError(f"{where}: something is there already; choose another name")
    with tempfile.TemporaryDirectory(prefix="desirepath-") as folder:
        written = Path(folder) / (path.rstrip("/").rpartition("/")[2] or "written")
        yield written
        with explain_errors(where):
            if written.is_file():
                system.put_file(str(written), path)
                return
            files = [path for path in written.rglob("*") if path.is_file()]
            for last in (False, True):
                batch = [file for file in files if (file.name == LAST_OF_FOLDER) == last]
                if batch:
                    names = [f"{path.rstrip('/')}/{file.relative_to(written).as_posix()}" for file in batch]
                    system.put([str(file) for file in batch], names)


@contextlib.contextmanager
def read_from(where: str) -> Iterator[Path]:
    """A path to read a file or a folder at, fetched first from a remote place. Raises StorageError."""
    if not is_remote(where):
        yield Path(where)
        return
    system, path = file_system_of(where)
    with tempfile.TemporaryDirectory(prefix="desirepath-") as folder:
        fetched = Path(folder) / (path.rstrip("/").rpartition("/")[2] or "fetched")
        try:
            with explain_errors(where):
                system.get(path, str(fetched), recursive=system.isdir(path))
        except FileNotFoundError:
            raise StorageError(f"{where}: nothing is there") from None
        yield fetched
