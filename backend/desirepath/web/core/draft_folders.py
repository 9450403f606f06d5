"""Uploads that wait for somebody to keep them: a folder each in the data folder, no database; forgotten ones go."""

from __future__ import annotations

import re
import secrets
import shutil
import time
from pathlib import Path

LASTS_S = 7 * 86_400  # people may be in them
_ID = re.compile(r"[0-9a-f]{16}")


class RefusedUpload(ValueError):
    """What is not taken; `code` is a key of a text that `values` fill."""

    def __init__(self, code: str, **values: object) -> None:
        self.code, self.values = code, values
        super().__init__(f"{code}: {values}" if values else code)


def new_folder(parent: Path) -> Path:
    """Where the next draft may be made, whose name is its id."""
    return parent / secrets.token_hex(8)


def forget_drafts(data: Path) -> None:
    """Delete those that nobody kept for LASTS_S, of all kinds."""
    for folder in (*list_folders(data / "recordings"), *list_folders(data / "drafts")):
        if time.time() - folder.stat().st_mtime > LASTS_S:
            shutil.rmtree(folder, ignore_errors=True)


def list_folders(parent: Path) -> list[Path]:
    """Of all drafts there."""
    return [folder for folder in parent.glob("*") if _ID.fullmatch(folder.name)]


def find_folder(parent: Path, draft_id: str) -> Path | None:
    """Of the draft with this id; None for what is no id. It may be gone."""
    return parent / draft_id if _ID.fullmatch(draft_id) else None


def write_whole(path: Path, content: bytes) -> None:
    """All of it, or what was there stays: the disk may be full."""
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
