"""A rolling upgrade of a deployment: migration first, the new version beside the old one, then the old one drains.

People take part all the while; what was acknowledged to them and is not stored, or half stored, is counted.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tarfile
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

from desirepath.store.database import Database
from desirepath_experiments.benchmarks.faults import half_trials, lost_answers
from desirepath_experiments.benchmarks.persistent import Persistent
from desirepath_experiments.composed import ROOT, Composed, ComposeError, composed

QUICK_STUDY = "study_protocols/quick_preference_study.yaml"
BEFORE_S, PATIENCE_S = 3.0, 90.0  # people are under way before it begins; the longest until they go on after it


def open_study(running: Composed, *, source: Path = ROOT, protocol: Path = Path(QUICK_STUDY)) -> tuple[str, str]:
    """A study in a deployment, made by the version of that source tree, whose tables these are: its id and the token of
    its link. protocol: its file, seen from that source tree. Raises ComposeError."""
    making = [sys.executable, "-m", "desirepath", "study", "create", str(protocol), "--live", "--json"]
    known = running.environment | {"PYTHONPATH": str(source)}
    made = subprocess.run(making, cwd=source, env=known, capture_output=True, text=True, check=False)
    if made.returncode != 0:
        raise ComposeError(f"no study could be opened: {made.stdout[-400:]}{made.stderr[-800:]}")
    study = json.loads(made.stdout)
    return study["study"], study["link"].rpartition("/")[2]


def upgrade(running: Composed, new: Path, *, tell: Callable[[str], None] = lambda words: None) -> None:
    """Replace every process of a deployment by one from the source tree `new`, in the order that `docs/deployment.md`
    has for containers. Raises ComposeError; what was there before then still serves."""
    old_web, old_workers = list(running.web), list(running.workers)
    tell("the new version's migration, under the old one")
    migrated = subprocess.run(
        [sys.executable, "-m", "desirepath", "migrate"],
        cwd=new,
        env=running.environment | {"PYTHONPATH": str(new)},
        capture_output=True,
        text=True,
        check=False,
    )
    if migrated.returncode != 0:
        raise ComposeError(f"migration: {migrated.stdout[-400:]}{migrated.stderr[-800:]}")
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
    put off), "upgrade_s", "phases": per part of the upgrade {"what", "seconds", "longest_pause_s" of the pauses that
    began in it}}. Raises ComposeError, NoPostgres.
    """
    with ExitStack() as held:
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
        phases: list[tuple[str, float]] = [("before it", 0.0)]

        def said(words: str) -> None:
            phases.append((words, time.monotonic()))
            tell(words)

        upgrade(running, ROOT, tell=said)
        took = time.monotonic() - began
        phases.append(("after it", time.monotonic()))
        _until_all_answered(taking_part, {n: len(one.acknowledged) for n, one in enumerate(taking_part)})
        stopping.set()
        for thread in threads:
            thread.join(PATIENCE_S)
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
            "phases": _pauses(phases, moments),
        }
        database.close()
        return result


def _pauses(phases: list[tuple[str, float]], moments: list[float]) -> list[dict[str, Any]]:
    """Of each part of an upgrade how long it took and the longest pause between answers that began in it."""
    parts = []
    for (what, since), (_, until) in pairwise([*phases, ("", moments[-1])]):
        pauses = [b - a for a, b in pairwise(moments) if since <= a < until]
        since = max(since, moments[0])
        parts.append(
            {"what": what, "seconds": round(until - since, 1), "longest_pause_s": round(max(pauses, default=0.0), 2)}
        )
    return parts


def _until_all_answered(people: list[Persistent], more_than: dict[int, int]) -> None:
    deadline = time.monotonic() + PATIENCE_S
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
