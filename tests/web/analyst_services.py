"""An installation in which analysts have worked: a snapshot, a reward model, an evaluation, a comparison, jobs."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from desirepath.jobs.comparing import compare_two, evaluate_policy
from desirepath.jobs.context import JobContext, Progress
from desirepath.jobs.kinds import CompareParams, EvaluateParams, RewardModelParams
from desirepath.jobs.params import Params
from desirepath.jobs.process import finish, log_file
from desirepath.jobs.runners import learn_reward_model
from desirepath.settings import Settings
from desirepath.store.models import Job, utc_now
from desirepath.store.outbox import enqueue_job
from desirepath.store.shipped_policies import register_shipped
from desirepath.store.snapshots import take_snapshot
from desirepath.web.application import build_services
from desirepath.web.core.dependencies import Services
from tests.answered_study import add_answered_study


@pytest.fixture(scope="session")
def worked_data(fresh_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its data folder; tests copy it."""
    data = tmp_path_factory.mktemp("worked") / "data"
    shutil.copytree(fresh_data, data)
    services = build_services(Settings(data=data, _env_file=None))
    with services.database.transaction() as s:
        register_shipped(s, services.files)
    work_with(services, add_answered_study(services.database, services.files, participants=2, answers=8))
    services.database.close()
    return data


def work_with(services: Services, study: str) -> None:
    """Everything that analysts make of a study, and jobs in every state."""
    with services.database.transaction() as s:
        snapshot = take_snapshot(s, services.files, study_id=study, whose="simulated").id
        queued = enqueue_job(s, "align", {"snapshot": snapshot}, study_id=study, created_by="experimenter")
        queued.message = "waiting"
        failed = enqueue_job(s, "train_base", {"setup": "open_field", "seed": 3}, created_by="experimenter")
        failed.error, failed.started_at = "The training process was killed by SIGKILL.", utc_now()
        finish(failed, "failed")
        killed = failed.id
    begun = Progress(services.database, killed)
    for update in (100, 200, 300):
        begun(update / 1000, {"updates": update, "transitions": 26.0 * update})
    begun.flush()
    _work(services, study, learn_reward_model, RewardModelParams(snapshot=snapshot), "reward_model")
    _work(services, None, evaluate_policy, EvaluateParams(policy="study_room/base", scenes=20), "evaluate")
    pair = CompareParams(policy_a="study_room/base", policy_b="study_room/ensemble/1", scenes=30, replays=2)
    _work(services, None, compare_two, pair, "compare")
    log_file(services.settings, queued.id).parent.mkdir(parents=True)
    log_file(services.settings, queued.id).write_text("first line\nsecond <b>line</b>\n")


def _work(services: Services, study: str | None, work: object, params: Params, kind: str) -> None:
    """Do a job here and now, as its process would."""
    with services.database.transaction() as s:
        job = enqueue_job(s, kind, params.model_dump(mode="json", exclude_defaults=True), study_id=study)
        job.state, job.started_at = "running", utc_now()
    progress = Progress(services.database, job.id)
    result = work(JobContext(services.settings, services.database, services.files, job, progress), params)  # type: ignore[operator]
    progress.flush()
    with services.database.transaction() as s:
        row = s.get_one(Job, job.id)
        row.keep_result(result)
        finish(row, "succeeded")
