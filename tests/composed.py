"""What `docker compose up` would start, as processes of this machine on loopback, from the same definitions.

Commands, environments, secrets, volumes and health checks are read from `docker-compose.yml`, the proxy's rules from
`deploy/Caddyfile`. What cannot be the same without containers stands in `DIFFERENT`.

python -m tests.composed walk: start it, walk a short study through it (one participant in Chromium, one over HTTP),
export and check it, back it up and serve the backup. python -m tests.composed upgrade [--old COMMIT]: start the version
of a commit, let people take part, upgrade to this one under them, count what was lost. Exit code 0 where nothing was.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tarfile
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import httpx
from sqlalchemy import create_engine, func, make_url, select, text

from desirepath.cli.loopback import free_port_pair
from desirepath.grammar.source import Source
from desirepath.store.database import Database
from desirepath.store.dataset.columns import CHECKSUMS_FILE
from desirepath.store.dataset.reading import check_files
from desirepath.store.models import Job, JobAttempt, Response
from desirepath_experiments.benchmarks.faults import half_trials, lost_answers
from desirepath_experiments.benchmarks.persistent import Persistent
from desirepath_experiments.own_postgres import own_postgres
from tests.s3 import BUCKET, s3_store

ROOT = Path(__file__).resolve().parents[1]
DIFFERENT = (
    "plain http at the proxy, as no certificate can be had for a name of loopback",
    "the proxy is given the web processes' ports instead of finding them by the name `web`",
    "PostgreSQL of this machine's version over a socket that asks for no password",
    "the store of files is moto's; one Python environment instead of images",
)
PATIENCE_S = 120.0
DRAIN_S = 30.0
LOOK_S = 0.1
BEFORE_S, GOING_ON_S = 3.0, 90.0  # people are under way before an upgrade begins; the longest until they go on after it
QUICK_STUDY = "study_protocols/quick_preference_study.yaml"
# Watched by each participant. Trajectories play at their own speed, so the study's fifteen take ten minutes.
PAIRS = 6
BACKUP = f"s3://{BUCKET}/backups/walked.tar"


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
        environment = self.environment | self._environment_of(defined, name, port) | package_of(source)
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
    if shutil.which("caddy") is None:
        raise ComposeError("caddy is missing; on Debian: sudo apt-get install caddy")
    with contextlib.ExitStack() as held:
        postgres = held.enter_context(own_postgres())
        database = _create_database(postgres, "desirepath")
        subprocess.run(["make", "-s", "-f", str(ROOT / "Makefile"), "secrets"], cwd=folder, check=True)
        (folder / "data").mkdir(exist_ok=True)
        held.enter_context(s3_store())
        port = free_port_pair()
        plain = {name: value for name, value in os.environ.items() if not name.startswith("DESIREPATH_")}
        environment = plain | {
            "DESIREPATH_DATABASE_URL": database,
            "DESIREPATH_ARTEFACTS_URL": f"s3://{BUCKET}/artefacts",
            "DESIREPATH_DATA": str(folder / "data"),
        }
        stage = f"http://stage.localhost:{port}"
        running = Composed(folder, f"http://localhost:{port}", environment, _stage=stage)
        held.callback(running.stop)
        for _ in range(web):
            running.start("web", source=source)
        for _ in range(workers):
            running.start("worker", source=source)
        running.proxy_to(running.web)
        yield running


def package_of(source: Path) -> dict[str, str]:
    """The environment in which that source tree is `desirepath`, whatever is installed."""
    return {"PYTHONPATH": os.pathsep.join(str(source / folder) for folder in ("backend", "app", "experiments"))}


def _create_database(server: str, name: str) -> str:
    """A new database beside the one that the URL names; its URL."""
    url = make_url(server)
    engine = create_engine(url.set(drivername="postgresql+psycopg"), isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
    engine.dispose()
    return url.set(database=name).render_as_string(hide_password=False)


def _check(defined: dict[str, Any], port: int) -> list[str]:
    """The health check's command, for this machine's Python and that process's port."""
    kind, *words = defined["healthcheck"]["test"]
    if kind != "CMD":
        raise ComposeError(f"health check {defined['healthcheck']['test']}: only CMD is known here")
    return [sys.executable if word == "python" else word.replace(":8000/", f":{port}/") for word in words]


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


def shortened(pairs: int, into: Path) -> Path:
    """The quick study with so many pairs that count, one scene to compare in and to prefer, all else as it is.
    Written into the folder `into` with what it names; returns its file."""
    shutil.copytree(ROOT / Path(QUICK_STUDY).parent, into)
    file = into / Path(QUICK_STUDY).name
    written = file.read_text(encoding="utf-8")
    for here, there in (
        ("count: 15, choose", f"count: {pairs}, choose"),
        ("scenes: 6, blind", "scenes: 1, blind"),
        ("preferred: 5", "preferred: 1"),
    ):
        if written.count(here) != 1:
            raise ComposeError(f"{QUICK_STUDY}: has {here!r} {written.count(here)} times, not once")
        written = written.replace(here, there)
    file.write_text(written, encoding="utf-8")
    return file


def walk_study(running: Composed, *, participants: int = 1) -> dict[str, Any]:
    """Open the shortened study, walk simulated participants through it (the first in Chromium, the others over HTTP
    alone), export it and check the export, back all of it up on the store, restore that and serve what came of it.

    Returns {"opened_s", "walked": as `studies simulate --json`,
    "answers": {"acknowledged", "stored", "exported"}, "export": {"files", "checksums", "exported_s"}, "jobs": per
    attempt {"kind", "machine", "outcome"}, "lost": answers acknowledged to
    somebody and not in the export, "backup": as `backup --json`, "restored": {"answers", "page": what the study's link
    answers there, "seconds"}}. Raises ComposeError, DatasetError.
    """
    began = time.monotonic()
    study, link = open_study(running, protocol=shortened(PAIRS, running.folder / "protocols"))
    opened_s = time.monotonic() - began
    walking = [
        "studies",
        "simulate",
        study,
        "--participants",
        str(participants),
        "--browser",
        "1",
        "--url",
        running.url,
    ]
    walked = _said(running, walking)
    began, folder = time.monotonic(), running.folder / "export"
    _said(running, ["studies", "export", study, "--out", str(folder)])
    check_files(folder)
    exported_s = time.monotonic() - began
    with (folder / "responses.csv").open(encoding="utf-8", newline="") as file:
        exported = sum(1 for _ in csv.DictReader(file))
    stored, taken_up = _stored(running)
    saved = _said(running, ["backup", "--out", BACKUP])
    checksums = (folder / CHECKSUMS_FILE).read_text(encoding="utf-8").splitlines()
    return {
        "opened_s": round(opened_s, 1),
        "walked": walked,
        "answers": {"acknowledged": walked["responses"], "stored": stored, "exported": exported},
        "lost": walked["responses"] - exported,
        "export": {"files": len(checksums), "checksums": "all of them hold", "exported_s": round(exported_s, 1)},
        "jobs": taken_up,
        "backup": saved,
        "restored": _restored(running, link),
    }


def _stored(running: Composed) -> tuple[int, list[dict[str, str]]]:
    """How many answers a deployment's database holds, and of every attempt at a job its kind, machine and outcome."""
    database = Database(running.environment["DESIREPATH_DATABASE_URL"])
    with database.session() as s:
        stored = s.scalar(select(func.count()).select_from(Response)) or 0
        attempts = select(Job.kind, JobAttempt.machine, JobAttempt.outcome).join(Job, Job.id == JobAttempt.job_id)
        taken_up = [
            {"kind": kind, "machine": machine, "outcome": outcome or "running"}
            for kind, machine, outcome in s.execute(attempts.order_by(JobAttempt.began_at))
        ]
    database.close()
    return stored, taken_up


def _restored(running: Composed, link: str) -> dict[str, Any]:
    """Bring the backup back into another database and another folder of the store, and serve it."""
    began = time.monotonic()
    other = {
        "DESIREPATH_DATABASE_URL": _create_database(running.environment["DESIREPATH_DATABASE_URL"], "restored"),
        "DESIREPATH_ARTEFACTS_URL": f"s3://{BUCKET}/restored",
        "DESIREPATH_DATA": str(running.folder / "restored"),
    }
    again = replace(running, environment=running.environment | other, web=[], workers=[])
    _said(again, ["restore", BACKUP])
    served = again.start("web")
    try:
        page = httpx.get(f"http://127.0.0.1:{served.port}/join/{link}", timeout=30).status_code
        answers, _ = _stored(again)
    finally:
        served.stop()
    return {"answers": answers, "page": page, "seconds": round(time.monotonic() - began, 1)}


def _said(running: Composed, command: list[str], source: Path = ROOT) -> dict[str, Any]:
    """What a command of that version says of this deployment; how far it is goes to stderr. Raises ComposeError."""
    asked = [sys.executable, "-m", "desirepath", *command, "--json"]
    known = running.environment | package_of(source)
    ended = subprocess.run(asked, env=known, cwd=source, stdout=subprocess.PIPE, text=True, check=False)
    if ended.returncode != 0:
        raise ComposeError(f"desirepath {' '.join(command)}: exit code {ended.returncode} {ended.stdout[-800:]}")
    said: dict[str, Any] = json.loads(ended.stdout)
    return said


def open_study(running: Composed, *, source: Path = ROOT, protocol: Path = Path(QUICK_STUDY)) -> tuple[str, str]:
    """A study in a deployment, made by the version of that source tree: its id and the token of its link."""
    study = _said(running, ["studies", "create", str(protocol), "--live"], source)
    return study["study"], study["link"].rpartition("/")[2]


def upgrade(running: Composed, new: Path, *, tell: Callable[[str], None] = lambda words: None) -> None:
    """Replace every process of a deployment by one from the source tree `new`, in the order that `docs/deployment.md`
    has for containers. Raises ComposeError; what was there before then still serves."""
    old_web, old_workers = list(running.web), list(running.workers)
    tell("the new version's migration, under the old one")
    _said(running, ["migrate"], new)
    tell("new processes beside the old ones")
    new_web = [running.start("web", source=new) for _ in old_web]
    new_workers = [running.start("worker", source=new) for _ in old_workers]
    running.proxy_to([*old_web, *new_web])
    tell("visitors go to the new ones; the old ones drain")
    running.proxy_to(new_web)
    for one in (*old_web, *old_workers):
        one.stop()
    running.web, running.workers = new_web, new_workers


def rehearse_upgrade(
    old: str | None = None, *, people: int = 4, tell: Callable[[str], None] = lambda words: None
) -> dict[str, Any]:
    """Start the version of that commit (None: this one), let people take part, and upgrade to this one under them.

    Returns {"from", "people", "answers_before", "answers_acknowledged", "answers_lost", "half_trials",
    "longest_pause_s" (between two acknowledged answers of anybody), "sent_again" (requests that got no answer or were
    put off), "upgrade_s"}. Raises ComposeError, NoPostgres.
    """
    with contextlib.ExitStack() as held:
        folder = Path(held.enter_context(tempfile.TemporaryDirectory(prefix="desirepath-upgrade-")))
        source = ROOT if old is None else _checked_out(old, folder / "old")
        running = held.enter_context(composed(folder, source=source))
        _, link = open_study(running, source=source)
        stopping = threading.Event()
        taking_part = [Persistent(running.url, link, number, stopping) for number in range(people)]
        threads = [threading.Thread(target=one.walk, daemon=True) for one in taking_part]
        for thread in threads:
            thread.start()
        _until_all_answered(taking_part, dict.fromkeys(range(people), 0))
        time.sleep(BEFORE_S)
        answered = {number: len(one.acknowledged) for number, one in enumerate(taking_part)}
        began = time.monotonic()
        upgrade(running, ROOT, tell=tell)
        took = time.monotonic() - began
        _until_all_answered(taking_part, {n: len(one.acknowledged) for n, one in enumerate(taking_part)})
        stopping.set()
        for thread in threads:
            thread.join(GOING_ON_S)
        broken = [one.problem for one in taking_part if one.problem]
        if broken or any(thread.is_alive() for thread in threads):
            raise ComposeError(f"people do not get on after the upgrade: {broken[:2]}")
        database = Database(running.environment["DESIREPATH_DATABASE_URL"])
        acknowledged = {key: value for one in taking_part for key, value in one.acknowledged.items()}
        moments = sorted(moment for one in taking_part for moment in one.acknowledged_at)
        result = {
            "from": old or "this version",
            "people": people,
            "answers_before": sum(answered.values()),
            "answers_acknowledged": len(acknowledged),
            "answers_lost": lost_answers(database, acknowledged),
            "half_trials": half_trials(database),
            "longest_pause_s": round(max(b - a for a, b in pairwise(moments)), 2),
            "sent_again": sum(one.sent_again for one in taking_part),
            "upgrade_s": round(took, 1),
        }
        database.close()
        return result


def _until_all_answered(people: list[Persistent], more_than: dict[int, int]) -> None:
    deadline = time.monotonic() + GOING_ON_S
    while not all(len(one.acknowledged) > more_than[number] for number, one in enumerate(people)):
        if time.monotonic() > deadline:
            raise ComposeError(f"somebody does not get on: {[one.problem or one.last for one in people]}")
        time.sleep(0.05)


def _checked_out(commit: str, folder: Path) -> Path:
    """The source tree of a commit of this repository."""
    folder.mkdir()
    packed = folder.with_suffix(".tar")
    subprocess.run(["git", "archive", "-o", str(packed), commit], cwd=ROOT, check=True)
    with tarfile.open(packed) as tar:
        tar.extractall(folder, filter="data")
    return folder


def main() -> int:
    """Exit code 0 where everything was walked and nothing lost."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("what", choices=["walk", "upgrade"])
    asked.add_argument("--participants", type=int, default=2)
    asked.add_argument("--old", help="commit of the version to upgrade from; default this one")
    given = asked.parse_args()
    if given.what == "upgrade":
        result = rehearse_upgrade(
            given.old, people=given.participants, tell=lambda words: print(words, file=sys.stderr)
        )
        well = result["answers_lost"] == result["half_trials"] == 0
    else:
        with tempfile.TemporaryDirectory(prefix="desirepath-composed-") as folder, composed(Path(folder)) as running:
            print(f"{running.url}: {len(running.web)} web, {len(running.workers)} workers", file=sys.stderr)
            result = {"different_from_containers": DIFFERENT} | walk_study(running, participants=given.participants)
        kept = result["lost"] == 0 and result["restored"]["answers"] == result["answers"]["stored"]
        well = kept and result["walked"]["completed"] == given.participants and result["restored"]["page"] == 200
    print(json.dumps(result, indent=1))
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
