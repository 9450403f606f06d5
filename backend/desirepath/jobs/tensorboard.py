"""A job's curves as TensorBoard's event files, one run per line. Written out here: the format is two checksums and a
few bytes of protocol buffers, and TensorBoard itself brings a server along.

Source: tensorflow/core/util/event.proto, framework/summary.proto; lib/io/record_writer.cc for the framing.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

from desirepath.jobs.curves import Points

_POLYNOMIAL = 0x82F63B78  # CRC-32C (Castagnoli), reflected
_MASK_DELTA = 0xA282EAD8

LARGEST = 3.4e38  # what a float of four bytes holds; a loss that diverged may be beyond it


def _table() -> tuple[int, ...]:
    rows = []
    for row in range(256):
        for _ in range(8):
            row = (row >> 1) ^ (_POLYNOMIAL if row & 1 else 0)
        rows.append(row)
    return tuple(rows)


_CRC = _table()


def crc32c(data: bytes) -> int:
    """CRC-32C of some bytes; of b"123456789" it is 0xE3069283."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc = _CRC[(crc ^ byte) & 0xFF] ^ (crc >> 8)
    return crc ^ 0xFFFFFFFF


def event_files(curves: dict[str, dict[str, Points]], *, job: str, at: float) -> dict[str, bytes]:
    """Path below a log folder -> content: a run `JOB`, or `JOB/raw` and `JOB/averaged`. at: Unix time of all points."""
    runs: dict[str, list[tuple[str, Points]]] = {}
    for name, lines in curves.items():
        for line, points in lines.items():
            runs.setdefault(line, []).append((name, points))
    return {
        f"{job}{'/' if line else ''}{line}/events.out.tfevents.{int(at)}.desirepath": _events(scalars, at)
        for line, scalars in runs.items()
    }


def _events(scalars: Iterable[tuple[str, Points]], at: float) -> bytes:
    written = [_record(_double(1, at) + _bytes(3, b"brain.Event:2"))]
    for name, points in scalars:
        for step, value in points:
            summary = _bytes(
                1, _bytes(1, name.encode()) + b"\x15" + struct.pack("<f", min(max(value, -LARGEST), LARGEST))
            )
            written.append(_record(_double(1, at) + b"\x10" + _varint(step) + _bytes(5, summary)))
    return b"".join(written)


def _record(data: bytes) -> bytes:
    length = struct.pack("<Q", len(data))
    return length + _masked_checksum(length) + data + _masked_checksum(data)


def _masked_checksum(data: bytes) -> bytes:
    crc = crc32c(data)
    return struct.pack("<I", ((crc >> 15 | crc << 17) + _MASK_DELTA) & 0xFFFFFFFF)


def _bytes(field: int, data: bytes) -> bytes:
    return bytes([field << 3 | 2]) + _varint(len(data)) + data


def _double(field: int, value: float) -> bytes:
    return bytes([field << 3 | 1]) + struct.pack("<d", value)


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])
