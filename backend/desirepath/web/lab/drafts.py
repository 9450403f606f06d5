"""Protocols that are being looked at before a study is opened: one folder per draft in the data folder, no database.

A draft holds `protocol.yaml` with the texts and questionnaires it names, laid out as in `study_protocols/`.
"""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml

from desirepath.grammar import text_files
from desirepath.grammar.source import ProtocolError, Source
from desirepath.grammar.text_files import NotUtf8Error, as_text, read_text
from desirepath.installed import PROTOCOLS
from desirepath.study.protocol.freezing import FrozenProtocol, find_shipped_protocols, freeze_text
from desirepath.web.core.draft_folders import RefusedUpload, find_folder, new_folder, write_whole

LARGEST_FILE = 512 * 1024  # bytes; a protocol has a few kB
MOST_FILES = 40
MOST_TRIES = 8  # to leave stages out that need one that was left out
FOLDERS = {".md": "texts", ".yaml": "questionnaires"}  # where an uploaded file belongs, by its ending
_STAGE = re.compile(r"stages\[([0-9]{1,6})\]")
_FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


class DraftError(RefusedUpload):
    """A draft that cannot be made; `code` is a key below `draft_errors` in lab.yaml."""


@dataclass(frozen=True)
class Draft:
    """One draft; `file` is its protocol."""

    id: str
    folder: Path

    @property
    def file(self) -> Path:
        return self.folder / "protocol.yaml"

    @property
    def yaml(self) -> str:
        return read_text(self.file)

    @property
    def mark(self) -> str:
        """Of the protocol as it stands: another text has another."""
        return hashlib.sha256(self.yaml.encode()).hexdigest()[:32]

    def save(self, yaml: str) -> None:
        """Replace the protocol. Raises DraftError if it is empty or too large."""
        write_whole(self.file, _checked("protocol.yaml", as_text(yaml)).encode())

    def add(self, texts: Mapping[str, bytes]) -> None:
        """Add texts (`.md`) and questionnaires (`.yaml`), or replace those of the same name. Raises DraftError."""
        if len(texts) > MOST_FILES:
            raise DraftError("too_many_files", most=MOST_FILES)
        kept = {_file_name(name): decode_upload(name, content) for name, content in texts.items()}
        for name, text in kept.items():
            write_whole(self.folder / FOLDERS[Path(name).suffix] / name, text.encode())

    def freeze(self, query_sets: Mapping[str, str]) -> FrozenProtocol:
        """The checked protocol. query_sets: what it may name by id. Raises ProtocolError with every problem."""
        return self._frozen(self.yaml, query_sets)

    def _frozen(self, text: str, query_sets: Mapping[str, str], *, in_part: bool = False) -> FrozenProtocol:
        return freeze_text(text, file=self.file.name, folder=self.folder, query_sets=query_sets, in_part=in_part)

    def freeze_valid(self, query_sets: Mapping[str, str]) -> tuple[FrozenProtocol, list[int]]:
        """The protocol of those stages alone in which nothing is wrong, for a look at them, and their indices. Raises
        ProtocolError where something else is wrong, or they make no protocol."""
        source = Source(self.file.name, self.yaml)
        stages = source.data.get("stages") if isinstance(source.data, dict) else None
        kept = list(range(len(stages))) if isinstance(stages, list) else []
        for tries_left in reversed(range(MOST_TRIES)):
            text = yaml.safe_dump({**source.data, "stages": [stages[k] for k in kept]}) if stages else self.yaml
            try:
                return self._frozen(text, query_sets, in_part=True), kept
            except ProtocolError as problem:
                named = [_STAGE.match(one.field) for one in problem.problems if one.file == source.file]
                wrong = {int(found[1]) for found in named if found}
                if not wrong or not tries_left:
                    raise
                kept = [k for place, k in enumerate(kept) if place not in wrong]
        raise AssertionError("the last try raises")

    def discard(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)


def draft_from_shipped(data: Path, name: str) -> Draft:
    """Copy a shipped protocol and all texts. Raises DraftError for an unknown name."""
    known = {file.stem: file for file in find_shipped_protocols()}
    if name not in known:
        raise DraftError("unknown_protocol", name=name)
    return draft_from_text(data, read_text(known[name]))


def draft_from_text(
    data: Path, yaml: str, texts: Mapping[str, bytes] | None = None, own: Mapping[str, str] | None = None
) -> Draft:
    """A draft of pasted or uploaded YAML, with the shipped texts and questionnaires beside it.

    texts: file name -> bytes, `.md` are texts, `.yaml` questionnaires; they are added to the shipped or replace them.
    own: a study's frozen files, path -> content, between the two.

    Raises DraftError for an empty, too large or not readable file, a name that is no plain file name, or a frozen file
    that would lie outside the draft (a data set from elsewhere may name anything).
    """
    _checked("protocol.yaml", yaml)
    texts = texts or {}
    if len(texts) > MOST_FILES:
        raise DraftError("too_many_files", most=MOST_FILES)
    sent = {_file_name(name): decode_upload(name, content) for name, content in texts.items()}
    folder = new_folder(data / "drafts")
    draft = Draft(folder.name, folder)
    try:
        _fill(draft, own or {}, sent)
        draft.save(yaml)
    except Exception:
        draft.discard()
        raise
    return draft


def _fill(draft: Draft, kept: Mapping[str, str], sent: Mapping[str, str]) -> None:
    for folder in FOLDERS.values():
        shutil.copytree(PROTOCOLS / folder, draft.folder / folder)
    places = {Path(path).name: path for path in kept}
    uploaded = {places.get(name, f"{FOLDERS[Path(name).suffix]}/{name}"): text for name, text in sent.items()}
    for path, text in {**kept, **uploaded}.items():
        if not (draft.folder / path).resolve().is_relative_to(draft.folder.resolve()):
            raise DraftError("file_name", name=path)
        (draft.folder / path).parent.mkdir(parents=True, exist_ok=True)
        write_whole(draft.folder / path, text.encode())


def find_draft(data: Path, draft_id: str) -> Draft | None:
    """The draft with this id; None for one that never was or is gone."""
    folder = find_folder(data / "drafts", draft_id)
    draft = Draft(draft_id, folder) if folder is not None else None
    return draft if draft is not None and draft.file.is_file() else None


def _file_name(name: str) -> str:
    plain = name.replace("\\", "/").rsplit("/", 1)[-1]
    if not _FILE_NAME.fullmatch(plain) or Path(plain).suffix not in FOLDERS:
        raise DraftError("file_name", name=name)
    return plain


def decode_upload(name: str, content: bytes) -> str:
    """An uploaded file's text. Raises DraftError."""
    try:
        return _checked(name, text_files.decode_utf8(content))
    except NotUtf8Error as wrong:
        raise DraftError("not_text", name=name, encoding=wrong.encoding) from None


def _checked(name: str, text: str) -> str:
    if not text.strip():
        raise DraftError("empty", name=name)
    if len(text.encode()) > LARGEST_FILE:
        raise DraftError("too_large", name=name, kb=LARGEST_FILE // 1024)
    return text
