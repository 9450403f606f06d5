"""A study walked through a deployment in Chromium, from the welcome page to a data set whose checksums and answers are
counted, and to a backup that is restored and served. What the deployment is made of lives in `composed.py`.
"""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
from prometheus_client.parser import text_string_to_metric_families
from sqlalchemy import create_engine, func, select, text

from desirepath.store.database import Database
from desirepath.store.dataset.columns import CHECKSUMS_FILE
from desirepath.store.dataset.reading import check_files
from desirepath.store.models import Job, JobAttempt, Response
from desirepath_experiments.composed import BUCKET, ROOT, Composed, ComposeError
from desirepath_experiments.upgrading import QUICK_STUDY, open_study

# Watched by each participant. Trajectories play at their own speed, so the study's fifteen take ten minutes; after less
# than six the robot that learned is seldom surely better, and the study leaves the comparison out.
PAIRS = 6
BACKUP = f"s3://{BUCKET}/backups/walked.tar"


def shortened(pairs: int, into: Path) -> Path:
    """The quick study with so many pairs that count and one scene to compare in, everything else as it is. Written into
    the folder `into` with what it names; returns its file."""
    shutil.copytree(ROOT / Path(QUICK_STUDY).parent, into)
    file = into / Path(QUICK_STUDY).name
    written = file.read_text(encoding="utf-8")
    for here, there in (("count: 15, choose", f"count: {pairs}, choose"), ("scenes: 3, blind", "scenes: 1, blind")):
        if written.count(here) != 1:
            raise ComposeError(f"{QUICK_STUDY}: has {here!r} {written.count(here)} times, not once")
        written = written.replace(here, there)
    file.write_text(written, encoding="utf-8")
    return file


def walk_study(
    running: Composed, *, participants: int = 1, pairs: int = PAIRS, pictures: Path | None = None
) -> dict[str, Any]:
    """Open the shortened study, walk simulated participants through it (the first in Chromium, the others over HTTP
    alone), export it and check the export, back all of it up on the store, restore that and serve what came of it.

    pictures: a folder for one picture of every kind of page. Returns {"opened_s", "walked": as `study simulate --json`,
    "answers": {"acknowledged", "stored", "exported"}, "export": {"files", "checksums", "exported_s"}, "jobs": per
    attempt {"kind", "machine", "outcome"}, "requests": answered by each web process, "lost": answers acknowledged to
    somebody and not in the export, "backup": as `backup --json`, "restored": {"answers", "page": what the study's link
    answers there, "seconds"}}. Raises ComposeError, DatasetError.
    """
    began = time.monotonic()
    study, link = open_study(running, protocol=shortened(pairs, running.folder / "protocols"))
    opened_s = time.monotonic() - began
    walking = ["study", "simulate", study, "--participants", str(participants), "--browser", "1", "--url", running.url]
    walked = _said(running, [*walking, *(["--pictures", str(pictures)] if pictures is not None else [])])
    began, folder = time.monotonic(), running.folder / "export"
    _said(running, ["export", study, "--out", str(folder)])
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
        "requests": {one.name: _requests(one.port) for one in running.web},
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
    here = running.environment["DESIREPATH_DATABASE_URL"]
    server = create_engine(here.replace("postgresql:", "postgresql+psycopg:"), isolation_level="AUTOCOMMIT")
    with server.connect() as connection:
        connection.execute(text("CREATE DATABASE restored"))
    server.dispose()
    other = {
        "DESIREPATH_DATABASE_URL": here.replace("/desirepath?", "/restored?"),
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


def _said(running: Composed, command: list[str]) -> dict[str, Any]:
    """What a command of the product says of this deployment; how far it is goes to stderr."""
    asked = [sys.executable, "-m", "desirepath", *command, "--json"]
    ended = subprocess.run(asked, env=running.environment, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if ended.returncode != 0:
        raise ComposeError(f"desirepath {' '.join(command)}: exit code {ended.returncode} {ended.stdout[-800:]}")
    said: dict[str, Any] = json.loads(ended.stdout)
    return said


def _requests(port: int) -> int:
    """How many requests a web process has answered, by its own metrics."""
    answered = httpx.get(f"http://127.0.0.1:{port}/metrics", timeout=30).raise_for_status().text
    return round(
        sum(
            sample.value
            for family in text_string_to_metric_families(answered)
            for sample in family.samples
            if sample.name == "desirepath_request_seconds_count"
        )
    )
