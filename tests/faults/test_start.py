"""What `desirepath serve` says when it cannot start: one sentence, no traceback, nothing half begun."""

from __future__ import annotations

import socket
import subprocess
from pathlib import Path

from backend.experiments.loopback import free_port_pair
from tests.faults.installation import run_command


def refused_to_start(data: Path, port: int | None = None) -> str:
    """What `serve` wrote when it gave up."""
    ended = run_command("serve", "--data", str(data), "--port", str(port or free_port_pair()), data=data)
    assert ended.returncode == 1, ended.stderr
    assert "Traceback" not in ended.stderr
    assert "running" not in ended.stdout
    return " ".join(ended.stderr.split())


def test_a_data_folder_that_is_a_file(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.write_text("not a folder")
    assert f"data folder {data} cannot be written" in refused_to_start(data)
    assert data.read_text() == "not a folder"


def test_a_disk_without_room(small_disk: Path) -> None:
    said = refused_to_start(small_disk)
    assert "only 1 MB free on its disk" in said
    assert "DESIREPATH_DATA" in said
    assert list(small_disk.iterdir()) == []


def test_a_read_only_data_folder(small_disk: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    data = small_disk / "data"
    assert f"data folder {data} cannot be written (Read-only file system)" in refused_to_start(data)


def test_a_port_that_is_taken(tmp_path: Path) -> None:
    port = free_port_pair()
    with socket.socket() as other:
        other.bind(("127.0.0.1", port + 1))
        other.listen()
        said = refused_to_start(tmp_path / "data", port)
    assert f"port {port + 1} on 127.0.0.1 cannot be used" in said
    assert "--port" in said
