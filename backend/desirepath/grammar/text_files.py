"""Text that came from outside: UTF-8, without the mark some editors put before it, with one kind of line end."""

from __future__ import annotations

import codecs
from pathlib import Path

MARK = "\ufeff"  # the byte order mark


class NotUtf8Error(ValueError):
    """Bytes that are no UTF-8 text. encoding: what they look like; line: where the first of them stands, 1-based."""

    def __init__(self, encoding: str, line: int) -> None:
        self.encoding, self.line = encoding, line
        super().__init__(f"is not UTF-8 text (looks like {encoding}): save it as UTF-8")


def decode_utf8(content: bytes) -> str:
    """The text. Raises NotUtf8Error."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as wrong:
        wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or b"\0" in content
        raise NotUtf8Error("UTF-16" if wide else "Latin-1", content.count(b"\n", 0, wrong.start) + 1) from None
    if (at := text.find("\0")) >= 0:
        raise NotUtf8Error("UTF-16", text.count("\n", 0, at) + 1)
    return as_text(text)


def as_text(pasted: str) -> str:
    """The same of what a browser or a program hands over as text already."""
    return pasted.removeprefix(MARK).replace("\r\n", "\n").replace("\r", "\n")


def read_text(file: Path) -> str:
    """A file's text. Raises OSError, or NotUtf8Error."""
    return decode_utf8(file.read_bytes())
