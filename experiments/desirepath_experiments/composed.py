"""What `docker compose up` would start, as processes of this machine on loopback, from the same definitions.

Commands, environments, secrets, volumes and health checks are read from `docker-compose.yml`, the proxy's rules from
`deploy/Caddyfile`. What cannot be the same without containers stands in `DIFFERENT`. Walking a study through it lives
in `composed_walk.py`, the rolling upgrade in `upgrading.py`.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sqlalchemy import create_engine, text

from desirepath.cli.loopback import free_port_pair
from desirepath.grammar.source import Source
from desirepath_experiments.own_postgres import own_postgres

ROOT = Path(__file__).resolve().parents[2]
DIFFERENT = (
    "plain http at the proxy, as no certificate can be had for a name of loopback",
    "the proxy is given the web processes' ports instead of finding them by the name `web`",
    "PostgreSQL of this machine's version over a socket that asks for no password",
    "the store of files is moto's; one Python environment instead of images",
)
BUCKET = "desirepath"
PATIENCE_S = 120.0
DRAIN_S = 30.0
LOOK_S = 0.1


class ComposeError(RuntimeError):
    """Something did not start or is not healthy; names it with the end of its log."""


def services_of(compose: Path, variables: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """The services of a compose file, `${NAME}` and `${NAME:-default}` in it replaced."""
    written = compose.read_text(encoding="utf-8")

    def value(found: re.Match[str]) -> str:
        return variables.get(found[1]) or found[2] or ""

    read = Source(compose.name, re.sub(r"\$\{(\w+)(?::-([^}]*))?\}", value, written)).data
    services: dict[str, dict[str, Any]] = read["services"]
    return services


@dataclass
class Started:
    """One process. port: of its pages, where it has any; check: its health check, as the compose file has it."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path
    environment: dict[str, str]
    check: list[str]
    port: int = 0

    def healthy(self) -> bool:
        """Whether the compose file's health check says so."""
        ended = subprocess.run(self.check, env=self.environment, capture_output=True, check=False)
        return ended.returncode == 0

    def stop(self, number: signal.Signals = signal.SIGTERM) -> None:
        """As `docker stop`: ask, wait, kill."""
        if self.process.poll() is None:
            self.process.send_signal(number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(DRAIN_S)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def __str__(self) -> str:
        return f"{self.name} (process {self.process.pid})"


@dataclass
class Composed:
    """A running deployment. url: the pages behind the proxy; environment: what reaches the same data as it."""

    folder: Path
    url: str
    environment: dict[str, str]
    web: list[Started] = field(default_factory=list)
    workers: list[Started] = field(default_factory=list)
    _started: int = 0
    _stage: str = ""
    _proxy: subprocess.Popen[bytes] | None = None

    def start(self, service: str, *, source: Path = ROOT) -> Started:
        """One more process of that service (`web` or `worker`) from that source tree; waits until it is healthy."""
        self._started += 1
        name = f"{service}-{self._started}"
        defined = services_of(source / "docker-compose.yml", self.environment)[service]
        port = free_port_pair()
        environment = self.environment | self._environment_of(defined, name, port) | {"PYTHONPATH": str(source)}
        program, *arguments = defined["command"]
        if program != "desirepath":
            raise ComposeError(f"service {service}: its command begins with {program!r}, not with desirepath")
        command = [sys.executable, "-m", "desirepath.cli.ends_with_parent", *arguments]
        log = self.folder / f"{name}.log"
        with log.open("wb") as out:
            process = subprocess.Popen(
                command,
                cwd=source,
                env=environment,
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=out,
                start_new_session=True,
            )
        started = Started(name, process, log, environment, _check(defined, port), port if service == "web" else 0)
        _until(started.healthy, lambda: process.poll() is not None, f"{name} is not healthy", log)
        (self.web if service == "web" else self.workers).append(started)
        return started

    def _environment_of(self, defined: dict[str, Any], name: str, port: int) -> dict[str, str]:
        """A service's environment, with the places of this machine for those of a container."""
        said = {key: str(value) for key, value in defined["environment"].items()}
        said["DESIREPATH_DATABASE_URL"] = self.environment["DESIREPATH_DATABASE_URL"]
        secret = Path(said["DESIREPATH_DATABASE_PASSWORD_FILE"]).name
        said["DESIREPATH_DATABASE_PASSWORD_FILE"] = str(self.folder / "secrets" / secret)
        said["DESIREPATH_PUBLIC_URL"] = self.url
        said["DESIREPATH_PUBLIC_STAGE_URL"] = self._stage
        return said | {
            "DESIREPATH_ARTEFACTS_URL": self.environment["DESIREPATH_ARTEFACTS_URL"],
            "DESIREPATH_DATA": self.environment["DESIREPATH_DATA"],
            "DESIREPATH_HOST": "127.0.0.1",
            "DESIREPATH_PORT": str(port),
            "DESIREPATH_MACHINE": name,
        }

    def proxy_to(self, web: list[Started]) -> None:
        """Have the proxy hand visitors to these web processes from now on; nobody's connection is cut."""
        written = (ROOT / "deploy" / "Caddyfile").read_text(encoding="utf-8")
        for offset, inner in ((0, 8000), (1, 8001)):
            places = " ".join(f"127.0.0.1:{one.port + offset}" for one in web)
            written, times = re.subn(rf"dynamic a web {inner} \{{[^}}]*\}}", f"to {places}", written)
            if times != 1:
                raise ComposeError(f"deploy/Caddyfile: names `dynamic a web {inner}` {times} times, not once")
        file = self.folder / "Caddyfile"
        admin = self.folder / "caddy.sock"
        options = f"{{\n\tadmin unix/{admin}\n\tauto_https off\n\tstorage file_system {self.folder / 'caddy'}\n}}\n"
        file.write_text(options + written, encoding="utf-8")
        known = self.environment | {"DESIREPATH_DOMAIN": self.url, "DESIREPATH_STAGE_DOMAIN": self._stage}
        said = ["--config", str(file), "--adapter", "caddyfile"]
        log = self.folder / "proxy.log"
        if self._proxy is not None:
            again = ["caddy", "reload", *said, "--address", f"unix/{admin}", "--force"]
            done = subprocess.run(again, env=known, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                raise ComposeError(f"the proxy does not take its new rules: {done.stderr[-800:]}")
            return
        with log.open("wb") as out:
            self._proxy = subprocess.Popen(["caddy", "run", *said], env=known, stdout=out, stderr=out)
        port = int(self.url.rpartition(":")[2])
        _until(lambda: _listens(port), lambda: self._proxy is None or self._proxy.poll() is not None, "proxy", log)

    def stop(self) -> None:
        """End everything that was started."""
        for one in (*self.web, *self.workers):
            one.stop()
        if self._proxy is not None:
            self._proxy.terminate()
            self._proxy.wait(DRAIN_S)


@contextlib.contextmanager
def composed(folder: Path, *, web: int = 2, workers: int = 2, source: Path = ROOT) -> Iterator[Composed]:
    """PostgreSQL, a store of files, so many web processes and workers, and the proxy before them; ends with the block.

    Raises ComposeError, NoPostgres.
    """
    with contextlib.ExitStack() as held:
        postgres = held.enter_context(own_postgres())
        server = create_engine(postgres.replace("postgresql:", "postgresql+psycopg:"), isolation_level="AUTOCOMMIT")
        with server.connect() as connection:
            connection.execute(text("CREATE DATABASE desirepath"))
        server.dispose()
        subprocess.run(["make", "-s", "-f", str(ROOT / "Makefile"), "secrets"], cwd=folder, check=True)
        (folder / "data").mkdir(exist_ok=True)
        port, store = _free_port(), held.enter_context(_moto(folder / "store.log"))
        plain = {name: value for name, value in os.environ.items() if not name.startswith("DESIREPATH_")}
        environment = (
            plain
            | store
            | {
                "DESIREPATH_DATABASE_URL": postgres.replace("/postgres?", "/desirepath?"),
                "DESIREPATH_ARTEFACTS_URL": f"s3://{BUCKET}/artefacts",
                "DESIREPATH_DATA": str(folder / "data"),
            }
        )
        stage = f"http://stage.localhost:{port}"
        running = Composed(folder, f"http://localhost:{port}", environment, _stage=stage)
        held.callback(running.stop)
        for _ in range(web):
            running.start("web", source=source)
        for _ in range(workers):
            running.start("worker", source=source)
        running.proxy_to(running.web)
        yield running


@contextlib.contextmanager
def _moto(log: Path) -> Iterator[dict[str, str]]:
    """An S3-compatible store with one bucket; yields the environment in which it is found."""
    port = _free_port()
    with log.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)], stdout=out, stderr=out
        )
    keys = {"AWS_ACCESS_KEY_ID": "here", "AWS_SECRET_ACCESS_KEY": "here", "AWS_DEFAULT_REGION": "us-east-1"}
    known = keys | {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}"}
    try:
        _until(lambda: _listens(port), lambda: process.poll() is not None, "the store of files", log)
        making = f"import boto3; boto3.client('s3').create_bucket(Bucket={BUCKET!r})"
        subprocess.run([sys.executable, "-c", making], env=os.environ | known, check=True)
        yield known
    finally:
        process.kill()
        process.wait()


def _check(defined: dict[str, Any], port: int) -> list[str]:
    """The health check's command, for this machine's Python and that process's port."""
    kind, *words = defined["healthcheck"]["test"]
    if kind != "CMD":
        raise ComposeError(f"health check {defined['healthcheck']['test']}: only CMD is known here")
    return [sys.executable if word == "python" else word.replace(":8000/", f":{port}/") for word in words]


def _free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def _listens(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
        return True
    return False


def _until(holds: Callable[[], bool], died: Callable[[], bool], said: str, log: Path) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        if died() or time.monotonic() > deadline:
            raise ComposeError(f"{said}: {log.read_text(errors='replace')[-1500:]}")
        time.sleep(LOOK_S)
