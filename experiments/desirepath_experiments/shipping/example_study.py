"""Makes the example study that `desirepath serve --demo` brings: simulated people walk a shipped protocol on a server
of its own, with the jobs that follow. How it is packed and brought back lives in `store/example_study.py`.
"""

from __future__ import annotations

import tempfile
import time
from contextlib import closing
from pathlib import Path

from sqlalchemy import select

from desirepath.cli.loopback import loopback_server
from desirepath.installed import PROTOCOLS
from desirepath.learning.cards import Card, card_path, file_sha256, source_commit
from desirepath.learning.preferences.oracles import ResponseModel
from desirepath.learning.shipping.storing import Request
from desirepath.report.simulated_cohorts import Cohort
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.example_study import FILE
from desirepath.store.models import Job, Study
from desirepath.store.outbox import enqueue_job
from desirepath.store.shipped_policies import policy_artefact
from desirepath.store.snapshots import take_snapshot
from desirepath.study.protocol.freezing import freeze
from desirepath.study.simulated.http import simulate_study
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from desirepath_experiments.shipping.example_packing import pack_example

PROTOCOL = "quick_preference_study"
NAME = "Example study (simulated people)"
PEOPLE = (
    "min-human-distance", "person-on-left", "slow-near-person", "clearance", "far-and-smooth", "fastest", "shortest",
    "random",
)  # fmt: skip
LAPSES = 0.05
SCENES = 100  # of evaluations and comparisons: their files hold every scene, and the whole is to stay small
REPLAYS = 2
PATIENCE_S = 900.0
SETUP = "study_room"
BY = "example"


def ship_example_study(request: Request) -> Card:
    """Open the study, walk `PEOPLE` through it, measure what was learned, and store it with its card."""
    with tempfile.TemporaryDirectory(prefix="desirepath-example-") as folder:
        settings = Settings(data=Path(folder) / "data", database_url=None, artefacts_url=None)
        database = Database(settings.database)
        with loopback_server(settings) as (url, _), closing(database):
            files = ArtefactStore(settings.artefacts)
            with database.transaction() as s:
                frozen = freeze(PROTOCOLS / f"{PROTOCOL}.yaml")
                study = create_study(s, files, frozen, name=NAME, created_by=None)
                study_id, token = study.id, study.recruiting_token
            people, model = ",".join(PEOPLE), ResponseModel(lapse_rate=LAPSES)
            walked = simulate_study(
                url, token, len(PEOPLE), Character(people, model, request.seed, Cohort(seed=request.seed))
            )
            request.on_progress(0.8, {name: walked[name] for name in ("completed", "comparisons")})
            _measure(database, files, study_id)
            with database.transaction() as s:
                s.get_one(Study, study_id).state = "closed"
            packed = pack_example(database, files, study_id)
    target = request.folder / FILE.parent.name / FILE.name
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(packed.content)
    card = Card(
        "example_study",
        NAME,
        request.setup,
        target.name,
        file_sha256(target),
        command=f"desirepath ship example-study {request.setup} --seed {request.seed}",
        seed=request.seed,
        commit=source_commit(),
        config={"protocol": PROTOCOL, "people": list(PEOPLE), "lapse_rate": LAPSES, "scenes": SCENES},
        scenes={},
        results={"completed": walked["completed"], "comparisons": walked["comparisons"], "rows": packed.counts},
        parents=request.parents("base", "conditioned", "queries_varied_200"),
        notes=["Simulated people: programs with a preference each answered; nobody took part. Every row is marked so."],
    )
    card.save(card_path(target))
    return card


def _measure(database: Database, files: ArtefactStore, study_id: str) -> None:
    """A snapshot of all answers; every policy is measured, the first that was shown beside the base policy."""
    _await_jobs(database)
    with database.transaction() as s:
        take_snapshot(s, files, study_id=study_id, whose="simulated")
        aligned = select(Job).where(Job.study_id == study_id, Job.kind == "align", Job.state == "succeeded")
        results = [dict(job.result or {}) for job in s.scalars(aligned.order_by(Job.created_at))]
        for result in results:
            evaluated = {"policy": result["policy"], "scenes": SCENES}
            enqueue_job(s, "evaluate", evaluated, study_id=study_id, created_by=BY)
        shown = next(result["policy"] for result in results if result["passed"])
        base = policy_artefact(s, f"{SETUP}/base").id
        compared = {"policy_a": base, "policy_b": shown, "scenes": SCENES, "replays": REPLAYS}
        enqueue_job(s, "compare", compared, study_id=study_id, created_by=BY)
    _await_jobs(database)


def _await_jobs(database: Database) -> None:
    """Raises RuntimeError if some are not done in time."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        with database.session() as s:
            if s.scalar(select(Job.id).where(Job.state.in_(("queued", "running", "cancelling"))).limit(1)) is None:
                return
        time.sleep(1.0)
    raise RuntimeError(f"the example study's jobs were not done within {PATIENCE_S:.0f} s")
