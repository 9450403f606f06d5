"""Benchmark: chapter 7's study by simulated participants over HTTP, then its report and its data set, there and back.

What they were made with is known, so it also says what the report found of it, and what beside it. How sure such an
answer is, one study does not tell: those are `benchmark known-cohorts` and `null-cohorts`.
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from desirepath.cli.loopback import loopback_server
from desirepath.installed import PROTOCOLS
from desirepath.report.findings import Findings, analyse
from desirepath.report.made_up_cohorts import VIEWS_DIFFER, Cohort
from desirepath.report.study_report import write_study_report
from desirepath.report.tidy_tables import read_study
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset.columns import CHECKSUMS_FILE
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Study
from desirepath.store.shipped_policies import register_shipped
from desirepath.study.protocol.freezing import freeze
from desirepath.study.simulated.http import simulate_study
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study

PROTOCOL = PROTOCOLS / "interface_study.yaml"


def benchmark_study(
    *, participants: int = 31, seed: int = 0, tell: Callable[[str], None] = lambda words: None
) -> dict[str, Any]:
    """Seconds of the wall clock and of the processor for every part, and the machine's load before and after.

    simulate: all participants one after another over HTTP; its `server_s` holds the server's start. round_trip: whether
    the data set of an imported data set has the same files, byte by byte. put_in, found: what differs between the
    conditions. Raises SimulationError, RuntimeError if the server does not start.
    """
    cohort = replace(VIEWS_DIFFER, seed=seed)
    load = [round(value, 2) for value in os.getloadavg()]
    with tempfile.TemporaryDirectory(prefix="desirepath-benchmark-") as folder:
        home = Path(folder)
        settings = Settings(data=home / "data", database_url=None, artefacts_url=None)
        settings.data.mkdir()
        database, files = Database(settings.database), ArtefactStore(settings.artefacts)
        database.migrate()
        with database.transaction() as s:
            register_shipped(s, files)
            study = create_study(s, files, freeze(PROTOCOL), name="Benchmark", created_by=None)
        seconds: dict[str, dict[str, float]] = {}
        tell(f"{participants} simulated participants")
        with _timed(seconds, "simulate"):
            before = _children_s()
            with loopback_server(settings, worker=False) as (url, _):
                walked = simulate_study(url, study.recruiting_token, participants, Character(cohort=cohort))
            server_s = _children_s() - before
        seconds["simulate"]["server_s"] = round(server_s, 1)
        tell("report")
        with database.session() as s:
            row = s.get_one(Study, study.id)
            with _timed(seconds, "report"):
                data, load_trajectory = read_study(s, files, row)
                report = write_study_report(data, load_trajectory, home / "report", who="simulated")
        found = analyse(data, load_trajectory, "simulated")
        tell("data set")
        with _timed(seconds, "export"):
            export_study(database, files, study.id, home / "there")
        again, their_files = Database(f"sqlite:///{home / 'again.sqlite'}"), ArtefactStore((home / "again").as_uri())
        with _timed(seconds, "import"):
            again.migrate()
            imported = import_dataset(again, their_files, home / "there")
        export_study(again, their_files, study.id, home / "back")
        del imported["study"]  # another one every time
        sums = [(home / name / CHECKSUMS_FILE).read_text(encoding="utf-8") for name in ("there", "back")]
        database.close()
        again.close()
    return {
        "simulated": True,
        "protocol": PROTOCOL.stem,
        "participants": participants,
        "completed": walked["completed"],
        "answers": report["answers"],
        "responses": walked["responses"],
        "seconds": seconds,
        "round_trip": {"same": sums[0] == sums[1], "files": len(sums[0].splitlines()), **imported},
        "put_in": _put_in(cohort),
        "found": _found(found),
        "agreement": {" - ".join(pair): round(of.share.mean, 3) for pair, of in found.between.items()},
        "cohort": cohort.as_dict(),
        "cores": os.cpu_count(),
        "load_average": {"before": load, "after": [round(value, 2) for value in os.getloadavg()]},
    }


def _put_in(cohort: Cohort) -> list[str]:
    return sorted([*cohort.ratings, *cohort.first_choice])


def _found(found: Findings) -> list[str]:
    """Items and rankings in which the conditions differ after correction."""
    tested = [(one.item.key, one.test) for one in found.items] + [(one.item.key, one.test) for one in found.rankings]
    return sorted(key for key, test in tested if test.significant(found.plan.alpha))


@contextmanager
def _timed(seconds: dict[str, dict[str, float]], part: str) -> Iterator[None]:
    wall, own = time.perf_counter(), time.process_time()
    yield
    seconds[part] = {
        "wall_s": round(time.perf_counter() - wall, 1),
        "own_processor_s": round(time.process_time() - own, 1),
    }


def _children_s() -> float:
    """Processor seconds of the processes that this one started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
