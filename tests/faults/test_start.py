"""What `desirepath serve` says when it cannot start: one sentence, no traceback, nothing half begun."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from sqlalchemy import select

from desirepath.cli.loopback import free_port_pair
from desirepath.settings import Settings
from desirepath.store.models import ServerProcess
from desirepath.web.replicas.only_server import running_server
from desirepath.web.replicas.supervisor import COUNTS
from desirepath.web.server import _peer_host
from tests import postgres
from tests.faults.installation import Installation, Visitor, hear, run_command
from tests.faults.test_killed_benchmark import alive, children
from tests.running import until


def refused_to_start(data: Path, port: int | None = None, host: str = "127.0.0.1") -> str:
    """What `serve` wrote when it gave up."""
    where = ("--port", str(port or free_port_pair()), "--host", host)
    ended = run_command("serve", "--data", str(data), *where, data=data)
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


def started(
    data: Path, port: int, host: str = "127.0.0.1", *, worker: bool = False, processes: int = 1
) -> subprocess.Popen[str]:
    """A server of its own, once it has said where it is."""
    command = [sys.executable, "-m", "desirepath", "serve", "--data", str(data), "--port", str(port), "--host", host]
    command += ["--processes", str(processes)]
    server = subprocess.Popen(
        command,
        env={**os.environ, "DESIREPATH_WORKER": str(worker).lower()},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert server.stdout is not None
    while "Stop with" not in (line := server.stdout.readline()):
        assert line, "it ended before it was ready"
    return server


def ended(server: subprocess.Popen[str], how: int = signal.SIGTERM) -> None:
    server.send_signal(how)
    server.communicate(timeout=60)


def test_a_folder_that_another_server_has(tmp_path: Path) -> None:
    """Two of them on one SQLite file started without a word, each knowing half of what goes on."""
    data, port = tmp_path / "data", free_port_pair()
    settings = Settings(data=data, _env_file=None)
    first = started(data, port)
    assert running_server(settings) == f"http://127.0.0.1:{port}"
    (tmp_path / "link").symlink_to(data)
    for folder in (data, tmp_path / "link"):
        said = refused_to_start(folder)
        assert f"process {first.pid} at http://127.0.0.1:{port}" in said
        assert "--data" in said
    ended(first, signal.SIGKILL)
    assert running_server(settings) is None
    ended(started(data, port))  # whoever was killed holds nothing


def test_whatever_a_server_wrote_is_its_users_alone_and_none_of_it_in_a_log(tmp_path: Path) -> None:
    data = tmp_path / "data"
    server = started(data, free_port_pair(), worker=True)
    until(lambda: (data / "worker.heartbeat").exists())
    ended(server)
    open_to_others = [one for one in (data, *data.rglob("*")) if one.stat().st_mode & 0o077]
    assert open_to_others == []
    assert {one.name for one in data.glob("*.sqlite*")} == {
        "desirepath.sqlite",
        "desirepath.sqlite.serving",
        "jobs.sqlite",
    }


@pytest.fixture
def ipv6() -> None:
    with socket.socket(socket.AF_INET6) as probe:
        try:
            probe.bind(("::1", 0))
        except OSError:
            pytest.skip("this machine has no IPv6")


@pytest.mark.usefixtures("ipv6")
@pytest.mark.parametrize("host", ["[::1]", "::"])  # without brackets: below
def test_an_ipv6_address(tmp_path: Path, host: str) -> None:
    port = free_port_pair()
    server = started(tmp_path / "data", port, host)
    try:
        page = httpx.get(f"http://[::1]:{port}/lab/sign-in")
        assert page.status_code == 200
        # Chromium takes no IPv6 address there, ignores the line and blocks the stage
        assert f"frame-src 'self' http://*:{port + 1};" in page.headers["content-security-policy"]
        assert httpx.get(f"http://[::1]:{port + 1}/").status_code == 404  # the stage's door
        assert httpx.get(f"http://[::1]:{port}/metrics").status_code == 200  # asked from here
        assert f"port {port} on ::" in refused_to_start(tmp_path / "other", port, host)
    finally:
        ended(server)


@pytest.mark.usefixtures("ipv6")
def test_several_processes_at_an_ipv6_address_leave_nothing_when_killed(
    postgres_server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever is killed takes nothing away: the folder of counts stood there until the next start."""
    (temporary := tmp_path / "tmp").mkdir()
    with postgres.holding(postgres_server, tmp_path / "none") as url:
        installation, port = Installation(tmp_path / "data", url), free_port_pair()
        monkeypatch.setenv("DESIREPATH_DATABASE_URL", url)
        monkeypatch.setenv("TMPDIR", str(temporary))
        supervisor = started(tmp_path / "data", port, "::1", processes=2)
        servers = children(supervisor.pid)
        try:
            person = Visitor(f"http://[::1]:{port}", installation.study)
            person.walk_to_first_trial()
            assert person.open_page().status_code == 200
            with person.stage() as stage:
                hear(stage, '"type": "show"')
            with installation.database.session() as s:
                doors = list(s.scalars(select(ServerProcess.address)))
            assert [one.rpartition(":")[0] for one in doors] == ["[::1]"] * 2
            assert len(list(temporary.glob(f"{COUNTS}*"))) == 1
        finally:
            ended(supervisor, signal.SIGKILL)
        until(lambda: not any(map(alive, servers)))
        assert list(temporary.glob(f"{COUNTS}*")) == []
        installation.database.close()


@pytest.mark.parametrize(
    ("host", "reached"), [("192.0.2.7", "192.0.2.7"), ("2001:db8::7", "[2001:db8::7]"), ("::", None)]
)
def test_other_processes_reach_one_where_it_listens(host: str, reached: str | None) -> None:
    """A machine's own name may lead elsewhere: with Debian to 127.0.1.1."""
    assert _peer_host(Settings(host=host, _env_file=None)) == (reached or socket.gethostname())


def test_a_host_that_is_none(tmp_path: Path) -> None:
    said = refused_to_start(tmp_path / "data", None, "no such host")
    assert "host = 'no such host'" in said
    assert "127.0.0.1 or ::1" in said
