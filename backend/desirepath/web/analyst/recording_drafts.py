"""Recordings on their way in: one folder per upload in the data folder, no database, until somebody keeps what became
of it.

A draft has `recordings/` (what was sent), `answers.csv`, `mapping.yaml`, `asked.json` (as which setup, which pairs),
and what two commands made of them in processes of their own: `found.json` (`desirepath queries inspect`), `made.json`
with `queries.npz` (`desirepath queries import --out`). The page is `recording_pages.py`'s.
"""

from __future__ import annotations

import json
import re
import secrets
import shutil
import stat
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool

from desirepath.jobs.process import ONE_THREAD, environment_of
from desirepath.recordings.mapping import Mapping
from desirepath.recordings.recording import BOUNDS, MIB
from desirepath.settings import Settings
from desirepath.store.database import MIN_FREE_BYTES
from desirepath.web.core.draft_folders import RefusedUpload, find_folder, list_folders, new_folder, write_whole
from desirepath.web.core.throttle import LARGEST_STREAM
from desirepath.zip_files import BROKEN, files_in, open_zip

MOST_BYTES = LARGEST_STREAM  # of an upload, all together: what is larger is imported where it lies
MOST_FILES = BOUNDS.files
LONGEST_S = 1_800.0  # of reading
PIECE = 4 * MIB
MEMORY_BYTES = 4_096 * MIB  # address space of one reading
AT_ONCE = threading.BoundedSemaphore(2)  # readings of this server process
BEAT_S = 1.0
STALE_S = 15.0  # a process that nobody has heard of for so long ended with its server
ANSWERS = "answers.csv"
MOST_NAME_BYTES = 255  # of a file's name, as file systems have it
_PART = re.compile(r"[^\x00-\x1f/\\:*?\"<>|]{1,120}")


class UploadError(RefusedUpload):
    """An upload that is not taken; `code` is a key below `recordings.errors` in recordings.yaml."""


@dataclass(frozen=True)
class RecordingDraft:
    """One upload."""

    id: str
    folder: Path

    @property
    def recordings(self) -> Path:
        return self.folder / "recordings"

    @property
    def queries(self) -> Path:
        return self.folder / "queries.npz"

    @property
    def answers(self) -> Path | None:
        return self.folder / ANSWERS if (self.folder / ANSWERS).is_file() else None

    @property
    def mapping_yaml(self) -> str:
        file = self.folder / "mapping.yaml"
        return file.read_text(encoding="utf-8") if file.is_file() else ""

    def files(self) -> list[tuple[str, int]]:
        """Names below `recordings` and bytes of all that was sent, answers last."""
        inside = sorted(one for one in self.recordings.rglob("*") if one.is_file())
        found = [(str(one.relative_to(self.recordings)), one.stat().st_size) for one in inside]
        return found + ([(ANSWERS, self.answers.stat().st_size)] if self.answers else [])

    def read(self, name: str) -> dict[str, Any]:
        """What `inspect` (found) or `import` (made) said, or what was asked; empty where that is not there yet."""
        file = self.folder / f"{name}.json"
        found: dict[str, Any] = json.loads(file.read_bytes()) if file.is_file() else {}
        return found

    def write(self, name: str, content: dict[str, Any]) -> None:
        write_whole(self.folder / f"{name}.json", json.dumps(content).encode())

    def map(self, mapping: str) -> None:
        write_whole(self.folder / "mapping.yaml", mapping.encode())

    def forget(self, *names: str) -> None:
        """Let go of what was made: something that it was made of has changed."""
        for name in names:
            (self.folder / name).unlink(missing_ok=True)

    @property
    def is_working(self) -> bool:
        try:
            return time.time() - (self.folder / "working").stat().st_mtime < STALE_S
        except FileNotFoundError:  # not begun, or ended just now
            return False

    def claim(self) -> None:
        """Have it to oneself until `working` goes. Raises UploadError while files are read or placed."""
        beat = self.folder / "working"
        if not self.is_working:
            beat.unlink(missing_ok=True)
        try:
            beat.open("x").close()
        except (FileExistsError, FileNotFoundError):  # or it was kept or discarded just now
            raise UploadError("busy") from None

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """The same within a block."""
        self.claim()
        try:
            yield
        finally:
            self.forget("working")

    def discard(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)


def find_recording_draft(data: Path, draft_id: str) -> RecordingDraft | None:
    folder = find_folder(data / "recordings", draft_id)
    return RecordingDraft(draft_id, folder) if folder is not None and folder.is_dir() else None


def recording_drafts(data: Path) -> list[RecordingDraft]:
    """All there are, newest first."""
    there = list_folders(data / "recordings")
    return [RecordingDraft(one.name, one) for one in sorted(there, key=lambda one: -one.stat().st_mtime)]


def new_recording_draft(data: Path, by: str) -> RecordingDraft:
    """An empty one."""
    folder = new_folder(data / "recordings")
    draft = RecordingDraft(folder.name, folder)
    draft.recordings.mkdir(parents=True)
    draft.write("sent", {"by": by, "at": time.time()})
    return draft


# ---- in --------------------------------------------------------------------------------------------------------------


async def take_in(draft: RecordingDraft, name: str, body: AsyncIterator[bytes], *, answers: bool = False) -> None:
    """Write one file as it comes in, and unpack it if it is a zip. Nothing is left of what is refused.

    Raises UploadError for a name that is none, more than there may be, no room, or while files are read.
    """
    target = draft.folder / ANSWERS if answers else draft.recordings / _checked_name(name)
    files = draft.files()
    room = MOST_BYTES - sum(size for _, size in files)
    if len(files) >= MOST_FILES:
        raise UploadError("too_many", most=MOST_FILES)
    if target.exists() and not answers:
        raise UploadError("twice", name=name)
    if draft.is_working:
        raise UploadError("busy")
    partial = draft.folder / f".{secrets.token_hex(4)}"
    unpacked = partial.with_suffix(".unpacked")
    try:
        taken, waiting = 0, bytearray()
        with partial.open("wb") as out:
            async for chunk in body:
                taken += len(chunk)
                if taken > room:
                    raise UploadError("too_large", mb=MOST_BYTES // MIB)
                waiting += chunk
                if len(waiting) >= PIECE:
                    if shutil.disk_usage(draft.folder).free < MIN_FREE_BYTES:
                        raise UploadError("no_room")
                    await run_in_threadpool(out.write, waiting)  # nobody else waits for the disk
                    waiting = bytearray()
            out.write(waiting)
        if not taken:
            raise UploadError("empty", name=name)
        if not answers and Path(name).suffix.lower() == ".zip" and zipfile.is_zipfile(partial):
            await run_in_threadpool(_unpack, partial, unpacked, room, MOST_FILES - len(files))
            inside = [one for one in unpacked.rglob("*") if one.is_file()]
            await run_in_threadpool(
                _place, draft, {one: draft.recordings / one.relative_to(unpacked) for one in inside}
            )
        else:
            _place(draft, {partial: target})
    finally:
        partial.unlink(missing_ok=True)
        await run_in_threadpool(shutil.rmtree, unpacked, ignore_errors=True)


def _place(draft: RecordingDraft, came: dict[Path, Path]) -> None:
    """Move all that came to where it belongs, or nothing: uploads may run side by side."""
    with draft.claimed():
        there = draft.files()
        if len(there) + len(came) > MOST_FILES:
            raise UploadError("too_many", most=MOST_FILES)
        if sum(size for _, size in there) + sum(one.stat().st_size for one in came) > MOST_BYTES:
            raise UploadError("too_large", mb=MOST_BYTES // MIB)
        for target in came.values():
            if (target.exists() and target.parent != draft.folder) or any(one.is_file() for one in target.parents):
                raise UploadError("twice", name=target.name)
        draft.forget("found.json", "made.json", "queries.npz")
        for source, target in came.items():
            target.parent.mkdir(parents=True, exist_ok=True)
            source.replace(target)


def _checked_name(name: str) -> str:
    if not _PART.fullmatch(name) or name.startswith(".") or len(name.encode(errors="replace")) > MOST_NAME_BYTES:
        raise UploadError("name", name=name[:80])
    return name


def _unpack(archive: Path, into: Path, room: int, files: int) -> None:
    """The plain files of a zip below `into`. Raises UploadError before anything is written, or for one that unpacks to
    more than it says."""
    try:
        with archive.open("rb") as raw, open_zip(raw) as opened:
            wanted = files_in(opened)
            if len(wanted) > files:
                raise UploadError("too_many", most=MOST_FILES)
            if sum(one.file_size for one in wanted) > room:
                raise UploadError("too_large", mb=MOST_BYTES // MIB)
            for one in wanted:
                parts = one.filename.split("/")
                if stat.S_ISLNK(one.external_attr >> 16) or len(parts) > 12:
                    raise UploadError("name", name=one.filename[:80])
                target = into.joinpath(*map(_checked_name, parts))
                target.parent.mkdir(parents=True, exist_ok=True)
                with opened.open(one) as packed, target.open("xb") as out:
                    for chunk in _bounded(packed, one.file_size):
                        if shutil.disk_usage(into).free < MIN_FREE_BYTES:
                            raise UploadError("no_room")
                        out.write(chunk)
    except (FileExistsError, NotADirectoryError, IsADirectoryError) as wrong:
        raise UploadError("twice", name=Path(str(wrong.filename)).name) from None
    except (*BROKEN, OSError, ValueError) as wrong:
        if isinstance(wrong, UploadError) or (isinstance(wrong, OSError) and wrong.errno is not None):
            raise
        raise UploadError("zip", problem=str(wrong)[:200]) from None


def _bounded(packed: Any, size: int) -> Iterator[bytes]:
    left = size
    while chunk := packed.read(MIB):
        left -= len(chunk)
        if left < 0:
            raise UploadError("zip", problem="a file is larger than the zip says")
        yield chunk


# ---- read ------------------------------------------------------------------------------------------------------------


def begin_looking(settings: Settings, draft: RecordingDraft) -> None:
    """Have what is in the recordings looked at."""
    draft.claim()
    _begin(settings, draft, "found", ["queries", "inspect", str(draft.recordings), "--json"], {})


def begin_making(settings: Settings, draft: RecordingDraft, mapping: str, asked: dict[str, Any]) -> None:
    """Have a query set made of them, by the mapping (YAML) and what is asked. Raises UploadError while files are
    read."""
    draft.claim()
    draft.map(mapping)
    draft.write("asked", asked)
    command = ["queries", "import", str(draft.recordings), "--setup", asked["setup"], "--json"]
    command += ["--out", str(draft.queries)]
    command += ["--mapping", str(draft.folder / "mapping.yaml")] if draft.mapping_yaml else []
    command += ["--pairs", asked["pairs"]] if asked.get("pairs") else []
    command += ["--count", str(asked["count"])] if asked.get("count") else []
    command += ["--answers", str(draft.answers)] if draft.answers else []
    _begin(settings, draft, "made", command, {"mapping": mapping})


def _begin(settings: Settings, draft: RecordingDraft, result: str, command: list[str], more: dict[str, Any]) -> None:
    draft.forget(f"{result}.json", *(("queries.npz",) if result == "made" else ("made.json", "queries.npz")))
    threading.Thread(target=_run, args=(settings, draft, result, command, more), daemon=True).start()


def _run(settings: Settings, draft: RecordingDraft, result: str, command: list[str], more: dict[str, Any]) -> None:
    """Run a command until it ends, with a beat that any server process can see; `more` is said with its answer."""
    beat = draft.folder / "working"
    try:
        while not AT_ONCE.acquire(timeout=BEAT_S):
            beat.touch()
        try:
            answer = _answer_to(settings, draft, result, command)
        finally:
            AT_ONCE.release()
        try:
            found = json.loads(answer)
        except ValueError:
            gb = MEMORY_BYTES // (1_024 * MIB)
            found = {"error": f"the reading ended without an answer; it may take {gb} GB of memory: import parts"}
        draft.write(result, found | more)
    except FileNotFoundError:
        pass  # discarded meanwhile
    finally:
        beat.unlink(missing_ok=True)
        (draft.folder / f".{result}").unlink(missing_ok=True)


def _answer_to(settings: Settings, draft: RecordingDraft, result: str, command: list[str]) -> bytes:
    with (draft.folder / f".{result}").open("w+b") as said:
        child = subprocess.Popen(
            [sys.executable, "-m", "desirepath.cli.ends_with_parent", f"--memory={MEMORY_BYTES}", *command],
            stdin=subprocess.PIPE,  # nothing is ever written: it closes with this process
            stdout=said,
            stderr=subprocess.DEVNULL,
            env=environment_of(settings) | ONE_THREAD,
            start_new_session=True,
        )
        began = time.monotonic()
        try:
            while child.poll() is None and time.monotonic() - began < LONGEST_S and draft.folder.is_dir():
                (draft.folder / "working").touch()
                try:
                    child.wait(BEAT_S)
                except subprocess.TimeoutExpired:
                    continue
        finally:
            child.kill()
            child.wait()
        said.seek(0)
        return said.read()


def mapping_of(text: str) -> Mapping:
    """Raises ProtocolError with every problem, by line and field."""
    from desirepath.grammar.error_words import parse
    from desirepath.grammar.source import Source

    return parse(Source("mapping.yaml", text), Mapping) if text.strip() else Mapping()
