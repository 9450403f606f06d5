"""Tiny videos as containers have them, made of their parts, with no picture that a player could show."""

from __future__ import annotations

import struct

EBML, DOCTYPE, SEGMENT, INFO, TRACKS, CLUSTER = "1A45DFA3", "4282", "18538067", "1549A966", "1654AE6B", "1F43B675"


def element(name: str, *content: bytes) -> bytes:
    inside = b"".join(content)
    return bytes.fromhex(name) + (0x10000000 | len(inside)).to_bytes(4, "big") + inside


def webm(seconds: float | None = 3.0, *, doctype: bytes = b"webm", track: int = 1, mark: bytes = b"") -> bytes:
    """mark: makes it another file."""
    said = element("4489", struct.pack(">d", seconds * 1000)) if seconds is not None else b""
    info = element(INFO, element("2AD7B1", (1_000_000).to_bytes(3, "big")), said)
    tracks = element(TRACKS, element("AE", element("83", bytes([track]))))
    return element(EBML, element(DOCTYPE, doctype)) + element(SEGMENT, info, tracks, element(CLUSTER, b"x" * 40 + mark))


def box(name: bytes, *content: bytes) -> bytes:
    inside = b"".join(content)
    return struct.pack(">I4s", 8 + len(inside), name) + inside


def mp4(seconds: float = 3.0, *, handler: bytes = b"vide", fragments: bool = False, long: bool = False) -> bytes:
    units = 0 if fragments else round(seconds * 600)
    head = struct.pack(">IQQIQ", 1 << 24, 0, 0, 600, units) if long else struct.pack(">IIIII", 0, 0, 0, 600, units)
    more = box(b"mvex", box(b"mehd", struct.pack(">II", 0, round(seconds * 600)))) if fragments else b""
    track = box(b"trak", box(b"mdia", box(b"hdlr", b"\0" * 8 + handler + b"\0" * 12)))
    return (
        box(b"ftyp", b"isom\0\0\2\0")
        + box(b"moov", box(b"mvhd", head + b"\0" * 80), track, more)
        + box(b"mdat", b"x" * 64)
    )
