"""From kept demonstrations to a controller: lineage, the mark of simulation, drives and comparisons, the gate."""

from __future__ import annotations

import pytest

from desirepath.demonstrations.controllers import DWA, roll_out
from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.depth.depth_controller import DepthController
from desirepath.demonstrations.td3_bc.configuration import AFTER_IMITATION, IMITATION
from desirepath.jobs import controller_training
from desirepath.jobs.context import JobContext, Progress
from desirepath.jobs.demonstrating import train_demonstrations
from desirepath.jobs.kept_artefacts import ArtefactError
from desirepath.jobs.kinds import JobParamsError, TrainDemonstrationsParams
from desirepath.learning.policies.policy import Policy
from desirepath.settings import Settings
from desirepath.simulation.demonstration_scenes import demonstration_scene
from desirepath.simulation.trajectory import Outcome
from desirepath.store.artefacts import ArtefactStore, lineage, load_trajectory
from desirepath.store.database import Database
from desirepath.store.demonstration_snapshots import read_demonstrations
from desirepath.store.job_results import DemonstrationsResult
from desirepath.store.models import Artefact
from desirepath.store.outbox import enqueue_job
from desirepath.store.simulated_demonstrations import take_simulated_demonstrations


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory) -> tuple[Settings, Database, ArtefactStore, str]:
    settings = Settings(data=tmp_path_factory.mktemp("demonstrating"), _env_file=None)
    database, files = Database(settings.database), ArtefactStore(settings.artefacts)
    database.migrate()
    with database.transaction() as s:
        taken = take_simulated_demonstrations(s, files, style="field_of_view", environment="room", per_pair=1, seed=0)
        return settings, database, files, taken.id


def run(services: tuple[Settings, Database, ArtefactStore, str], **changes: object) -> dict[str, object]:
    settings, database, files, snapshot = services
    params = TrainDemonstrationsParams(**{"snapshot": snapshot, "updates": 60, "imitated": 0, **changes})
    with database.transaction() as s:
        job = enqueue_job(s, "train_demonstrations", params.model_dump())
        job.state = "running"
    made = train_demonstrations(JobContext(settings, database, files, job, Progress(database, job.id)), params)
    DemonstrationsResult.model_validate(made)
    return made


def test_a_controller_walks_back_to_the_demonstrations_with_its_drives_beside_them(services) -> None:
    _, database, files, snapshot = services
    made = run(services, gate_min_success=0.0)
    policy = Policy.from_bytes(files.get(made["policy"]))
    assert policy.setup == "room"
    with database.session() as s:
        artefact = s.get_one(Artefact, made["policy"])
        assert artefact.simulated  # who drew was programmed
        assert artefact.card["config"]["updates"] == 60
        assert artefact.card["results"]["judged"] == made["judged"]
        assert artefact.card["results"]["gate"] == made["gate"]  # shown on its page as every policy's
        assert [(p.artefact.id, p.role) for p in lineage(s, artefact.id).parents] == [(snapshot, "demonstrations")]
    _, kept = read_demonstrations(files.get(snapshot))
    assert [r["demonstration"] for r in made["rollouts"]] == [one.demonstration for one in kept]
    stored = [load_trajectory(files, rollout["trajectory"]) for rollout in made["rollouts"]]
    again = roll_out(policy, [trajectory.scene for trajectory in stored])
    for driven, same, one in zip(stored, again, kept, strict=True):
        demonstration = Demonstration.from_bytes(files.get(one.demonstration))
        assert (demonstration.style, demonstration.simulated) == ("field_of_view", True)
        assert driven.scene == demonstration.scene
        assert same.digest() == driven.digest()


def test_comparisons_hold_all_three_controllers_in_demonstrated_pairs_where_the_compared_ones_arrive(services) -> None:
    files = services[2]
    made = run(services, gate_min_success=0.0)
    assert [one["scene_seed"] for one in made["situations"]] == [0, 1, 2, 3]  # arrived or not: all of them are rated
    assert all(one in made["situations"] for one in made["comparisons"])
    for compared in made["comparisons"]:
        scene = demonstration_scene("room", compared["scene_seed"])
        assert compared["scene"] == scene.digest()
        drives = {name: load_trajectory(files, compared[name]) for name in ("own", "base", "social_cost")}
        assert {t.scene for t in drives.values()} == {scene}
        assert drives["own"].outcome == drives["base"].outcome == Outcome.SUCCESS
        assert (drives["base"].poses == roll_out(DWA, [scene])[0].poses).all()


def test_a_controller_that_does_not_arrive_is_not_shown(services) -> None:
    made = run(services, updates=16, seed=3)
    arrived = made["judged"]["success_rate"]
    assert made["passed"] == made["gate"]["passed"] == (arrived >= 0.95)
    assert (made["gate"]["success_rate"], made["gate"]["base_success_rate"]) == (arrived, None)
    assert arrived < 0.95  # 16 updates teach nobody
    assert made["comparisons"] == []


def test_what_is_no_snapshot_of_demonstrations_is_refused(services) -> None:
    with pytest.raises(ArtefactError, match="no demonstrations"):
        run(services, snapshot="f" * 64)


def test_demonstrations_beside_a_walking_person_in_homes_become_a_controller_that_goes_by_its_depth_camera(
    services, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, database, files, of_room = services
    monkeypatch.setattr(controller_training, "EXPLORED_HOMES", 2)
    with database.transaction() as s:
        taken = take_simulated_demonstrations(
            s, files, style="field_of_view", environment="home", per_pair=1, seed=0, person="random"
        ).id
    made = run((settings, database, files, taken), updates=16, gate_min_success=0.0)
    with database.session() as s:
        artefact = s.get_one(Artefact, made["policy"])
        assert (artefact.kind, artefact.setup, artefact.simulated) == ("depth_controller", "home", True)
        assert artefact.card["config"]["sensor"] == "depth"
        assert artefact.card["config"]["encoder"]["name"] == "home/depth_encoder"
        assert [(p.artefact.id, p.role) for p in lineage(s, artefact.id).parents] == [(taken, "demonstrations")]
    controller = DepthController.from_bytes(files.get(made["policy"]))
    assert controller.configuration.name == "VAE-HA"
    rollouts = [load_trajectory(files, one["trajectory"]) for one in made["rollouts"]]
    assert len(rollouts) == 4
    assert all(one.scene.walk is not None for one in rollouts)  # the person walks on as they did
    # The study's evaluation shows own, dynamic window and social cost in every situation.
    assert [len({one[who] for who in ("own", "base", "social_cost")}) for one in made["situations"]] == [3] * 4
    with pytest.raises(JobParamsError, match="sensor = 'depth': the paths were drawn in room"):
        run((settings, database, files, of_room), sensor="depth")
    with pytest.raises(JobParamsError, match="sensor = 'places': the paths were drawn in home"):
        run((settings, database, files, taken), sensor="places")


def test_a_controller_imitates_first_unless_told_otherwise(services) -> None:
    _, database, _, snapshot = services
    assert TrainDemonstrationsParams(snapshot=snapshot).imitated > 0
    made = run(services, updates=None, imitated=240, gate_min_success=0.0)
    with database.session() as s:
        card = s.get_one(Artefact, made["policy"]).card
    assert (card["config"]["imitated"], card["config"]["updates"]) == (240, AFTER_IMITATION)
    assert IMITATION in card["departures"]
    assert made["judged"]["success_rate"] > 0
