"""What a process of this machine, or it with all that it started, has used so far: memory, processor time. Linux."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


def resident_mb(pid: int) -> float:
    """Resident memory of a process."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    line = next(line for line in status.splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) / 1024


def processor_s(pid: int) -> float:
    """Processor time that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def family(pid: int) -> list[int]:
    """The process and all that it started and that still live, and what they started."""
    children: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text(encoding="utf-8").rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        children.setdefault(int(fields[1]), []).append(int(stat.parent.name))
    pids = [pid]
    for parent in pids:
        pids += children.get(parent, [])
    return pids


def family_mb(pid: int) -> float:
    """Resident memory of a process and all that it started; what they share counts for each."""
    return sum(_of_living(resident_mb, member) for member in family(pid))


def family_s(pid: int) -> float:
    """Processor time of a process and all that it started and that still live."""
    return sum(_of_living(processor_s, member) for member in family(pid))


def _of_living(what: Callable[[int], float], pid: int) -> float:
    try:
        return what(pid)
    except (OSError, StopIteration):  # it has ended meanwhile
        return 0.0


def children_of(pid: int) -> list[int]:
    """The living processes that it started itself."""
    return [member for member in family(pid)[1:] if _parent_of(member) == pid]


def command_of(pid: int) -> str:
    """The command line of a process, empty when it is gone or only waits to be buried."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    except OSError:
        return ""


def _parent_of(pid: int) -> int | None:
    try:
        return int(Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[1])
    except OSError:
        return None


@dataclass(frozen=True)
class Usage:
    """What a process has used: processor time; bytes given to the system and written to the disk; how often one of its
    threads slept and was woken. memory_mb: its share of what it holds with others (PSS), now."""

    command: str
    processor_s: float
    written_bytes: int
    disk_bytes: int
    wakeups: int
    memory_mb: float

    def __sub__(self, before: Usage) -> Usage:
        """What was used since then."""
        return Usage(
            self.command,
            self.processor_s - before.processor_s,
            self.written_bytes - before.written_bytes,
            self.disk_bytes - before.disk_bytes,
            self.wakeups - before.wakeups,
            self.memory_mb,
        )


def usage_of(pid: int) -> Usage:
    """What a process has used so far. Raises OSError when it has ended."""
    process = Path(f"/proc/{pid}")
    written = _numbers(process / "io")
    return Usage(
        command=command_of(pid).strip(),
        processor_s=processor_s(pid),
        written_bytes=written["wchar"],
        disk_bytes=written["write_bytes"],
        wakeups=sum(_numbers(thread / "status")["voluntary_ctxt_switches"] for thread in (process / "task").iterdir()),
        memory_mb=_numbers(process / "smaps_rollup")["Pss"] / 1024,
    )


def _numbers(file: Path) -> dict[str, int]:
    """The lines `name: number ...` of a file in /proc."""
    lines = (line.partition(":") for line in file.read_text(encoding="utf-8").splitlines())
    return {name: int(rest.split()[0]) for name, _, rest in lines if rest.split() and rest.split()[0].isdigit()}
