"""From answers to a policy: lineage, determinism, the gate, the comparison's drives, accuracy on held-out answers."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import func, select

from desirepath.jobs import aligning, free_form
from desirepath.jobs.aligning import align, comparison_rollouts
from desirepath.jobs.alignments.conditioning_search import ConditioningSearchParams
from desirepath.jobs.alignments.each_scene import EachSceneParams
from desirepath.jobs.alignments.each_scene_trained import EachSceneTrainedParams
from desirepath.jobs.alignments.fine_tuning import FineTuningParams
from desirepath.jobs.alignments.instant import InstantParams
from desirepath.jobs.answers import posterior_of_person, preferences_of
from desirepath.jobs.answers import snapshot_of as snapshot_artefact_of
from desirepath.jobs.context import JobContext, Progress
from desirepath.jobs.kept_artefacts import ArtefactError
from desirepath.jobs.kinds import RewardModelParams
from desirepath.jobs.runners import learn_reward_model
from desirepath.learning.alignment import each_scene
from desirepath.learning.alignment.each_scene import PREDICTED_FROM
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.choosing import Answers, ChoosingPolicy, PeopleInGeneral
from desirepath.learning.policies.policy import Policy, read_policy
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.policies.stand_ins import load_stand_ins
from desirepath.learning.preferences.objectives import NAMES, preference_weights
from desirepath.settings import Settings
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.store.artefacts import ArtefactStore, lineage, load_trajectory
from desirepath.store.database import Database
from desirepath.store.erasure import erase_participant
from desirepath.store.job_results import AlignResult, RewardModelResult
from desirepath.store.models import Artefact, Job, Participant, Response, Session, TrajectoryRow, utc_now
from desirepath.store.outbox import enqueue_job
from desirepath.store.shipped_policies import policy_artefact, register_shipped
from desirepath.store.snapshots import take_snapshot
from tests.answered_study import add_answered_study

QUICK = {"updates": 12, "gate_scenes": 50, "comparisons": 2}


def aligned(context, params):
    """The job's result, which is what jobs of its kind may keep."""
    result = align(context, params)
    AlignResult.model_validate(result)
    return result


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory) -> tuple[Settings, Database, ArtefactStore]:
    settings = Settings(data=tmp_path_factory.mktemp("aligning"), _env_file=None)
    database, files = Database(settings.database), ArtefactStore(settings.artefacts)
    database.migrate()
    with database.transaction() as s:
        register_shipped(s, files)
    return settings, database, files


def begin(services: tuple[Settings, Database, ArtefactStore], kind: str, params: dict[str, object]) -> JobContext:
    """The context of a job whose row says it runs."""
    settings, database, files = services
    with database.transaction() as s:
        job = enqueue_job(s, kind, params)
        job.state = "running"
    return JobContext(settings, database, files, job, Progress(database, job.id))


def snapshot_of(services: tuple[Settings, Database, ArtefactStore], **study: object) -> str:
    _, database, files = services
    study_id = add_answered_study(database, files, **study)
    with database.transaction() as s:
        return take_snapshot(s, files, study_id=study_id, whose="simulated").id


def test_alignment_walks_back_to_the_answers_and_is_repeatable(services):
    _, database, files = services
    snapshot = snapshot_of(services, answers=15)
    params = FineTuningParams(snapshot=snapshot, **QUICK)
    first = aligned(begin(services, "align", params.model_dump()), params)
    assert first["passed"] is True
    assert first["gate"]["scenes"] == 50
    with database.session() as s:
        tree = lineage(s, first["policy"])
        answers = set(s.scalars(select(Response.id).where(Response.id.in_(tree.all_answers()))))
        assert {parent.role: parent.artefact.kind for parent in tree.parents} == {
            "base": "policy",
            "reward_model": "reward_model",
            "answers": "snapshot",
        }
        made, base = tree.artefact, policy_artefact(s, "study_room/base")
    assert len(answers) == 15
    assert made.simulated
    assert made.card["parents"]["base: study_room/base"] == base.id
    assert made.card["config"]["updates"] == 12
    assert made.card["results"]["gate"]["passed"]

    assert len(first["comparisons"]) == 2
    for pair in first["comparisons"]:
        drives = [load_trajectory(files, pair[side]) for side in ("base", "own")]
        assert {drive.scene.digest() for drive in drives} == {pair["scene"]}
        assert all(drive.outcome == 1 for drive in drives)

    again = aligned(begin(services, "align", params.model_dump()), params)
    assert {**again, "seconds": 0} == {**first, "seconds": 0}


def test_instant_policy_is_the_conditioned_one_at_the_weights_of_the_answers(services):
    _, database, files = services
    params = InstantParams(snapshot=snapshot_of(services, answers=15), gate_scenes=50, comparisons=2, hold_out=2)
    result = aligned(begin(services, "align", params.model_dump()), params)
    assert result["passed"]
    assert result["predicted"]["verdict"] in ("better", "no_better_than_chance", "no_better_than_majority")
    assert "check" not in result, "nobody asked whether it is surely better"
    assert result["predicted"]["low"] < result["predicted"]["accuracy"] <= result["predicted"]["high"]
    assert len(result["comparisons"]) == 2
    assert (result["held_out"]["answers"], result["held_out"]["folds"]) == (15, 2)
    with database.session() as s:
        tree = lineage(s, result["policy"])
        assert {parent.role for parent in tree.parents} == {"base", "reward_model", "answers", "conditioned"}
        told = tree.artefact.card["config"]["preference_weights"]
        reward_model = s.get_one(Artefact, result["reward_model"])
    assert max(told.values()) == 1
    assert reward_model.card["config"]["model"] == "weights"
    assert reward_model.card["results"]["predicted"] == result["predicted"]
    assert tree.artefact.card["results"]["predicted"] == result["predicted"]
    made = Policy.from_bytes(files.get(result["policy"]))
    weights = np.array([told.get(name, 0) for name in NAMES], dtype=np.float32)
    expected = load_conditioned("study_room/conditioned").at(weights)
    assert np.allclose(made.actor[1], expected.actor[1], atol=1e-3)  # the card rounds the weights
    assert not made.critic


def test_who_wants_what_no_objective_names_gets_a_policy_of_the_library_at_once(services):
    found = {}
    for oracle in ("min-human-distance", "network:31"):
        params = InstantParams(
            snapshot=snapshot_of(services, answers=15, oracle=oracle), gate_scenes=50, comparisons=2, surely_better=0.9
        )
        context = begin(services, "align", params.model_dump())
        of_participant = preferences_of(context, snapshot_artefact_of(context, params.snapshot)[1])
        believed = posterior_of_person(of_participant)
        answers = [one for of_one in of_participant.values() for one in of_one]
        base = load_policy("study_room/base")
        found[oracle] = believed[0], free_form.free_form(context, params, base, believed[0], answers)
    assert found["min-human-distance"][0].something_else() < 0.5
    assert found["min-human-distance"][1] is None, "the nine objectives say it"
    assert found["network:31"][0].something_else() >= 0.5
    made, verdict = found["network:31"][1]
    assert len(made.results["step_weights"]) == 24
    assert made.config["recipe"] == "own_policy_library"
    assert 0 <= verdict.probability_better <= 1
    assert made.gate.success_rate > 0.9
    assert made.policy.recovery_policies


def test_a_choice_per_scene_is_compared_and_nothing_else_says_that_it_is_better(services):
    _, database, files = services
    snapshot = snapshot_of(services, answers=9, oracle="network:31")
    params = EachSceneParams(snapshot=snapshot, gate_scenes=50, comparisons=3, policies=5, surely_better=0.9)
    result = aligned(begin(services, "align", params.model_dump()), params)
    assert (result["passed"], len(result["comparisons"])) == (True, 3)
    assert "personal" not in result
    assert result["check"]["answers"] == 9
    made = read_policy(files.get(result["policy"]))
    assert isinstance(made, ChoosingPolicy)
    assert len(made.policies) == 6
    assert made.made_for == snapshot
    with database.session() as s:
        tree = lineage(s, result["policy"])
        assert {parent.role for parent in tree.parents} == {"base", "reward_model", "answers"}
        assert len(tree.all_answers()) == 9
    lent = InstantParams(
        snapshot=snapshot_of(services, answers=10), gate_scenes=50, comparisons=1, other=result["policy"]
    )
    assert len(aligned(begin(services, "align", lent.model_dump()), lent)["yoked"]) == 1, "it is lent as any"


def test_one_trained_on_the_answers_is_among_those_chosen_from_in_place_of_the_least_expected(services):
    _, _, files = services
    snapshot = snapshot_of(services, answers=9, oracle="network:31")
    asked = {"snapshot": snapshot, "gate_scenes": 50, "comparisons": 1, "policies": 4, "surely_better": 0.9}
    params = EachSceneTrainedParams(**asked, updates=20)
    result = aligned(begin(services, "align", params.model_dump()), params)
    library = EachSceneParams(**asked)
    before = read_policy(files.get(aligned(begin(services, "align", library.model_dump()), library)["policy"]))
    made = read_policy(files.get(result["policy"]))
    assert [one.digest() for one in made.policies[:-1]] == [one.digest() for one in before.policies[:-1]]
    trained = made.policies[-1]
    assert trained.digest() not in {one.digest() for one in before.policies}
    base = load_policy("study_room/base")
    assert [len(actor) for actor in trained.recovery_policies] == [len(base.actor)], "freed where it is stuck"
    assert result["passed"]


def test_a_robot_is_not_compared_with_one_that_drives_alike_where_that_decides(services):
    params = EachSceneParams(snapshot=snapshot_of(services, answers=9), comparisons=3)
    context = begin(services, "align", params.model_dump())
    base = (load_policy("study_room/base"), "study_room/base")
    assert comparison_rollouts(context, params, "base", base, base, with_alike=False) == []
    assert len(comparison_rollouts(context, params, "base", base, base)) == 3


def test_a_choice_per_scene_is_made_of_what_the_library_was_made_of(services):
    params = EachSceneParams(snapshot=snapshot_of(services, answers=9), base="study_room/ensemble/0")
    with pytest.raises(LearningError, match="made from study_room/base alone"):
        align(begin(services, "align", params.model_dump()), params)


def test_a_choice_per_scene_is_one_persons(services):
    params = EachSceneParams(snapshot=snapshot_of(services, answers=9, participants=2), policies=2)
    with pytest.raises(LearningError, match="of one person, not of 2"):
        align(begin(services, "align", params.model_dump()), params)


def test_the_own_policy_is_compared_although_the_lender_was_erased_meanwhile(services):
    earlier = f"{snapshot_of(services, answers=8, name='Before')},{'0' * 64}"
    params = InstantParams(
        snapshot=snapshot_of(services, answers=15),
        gate_scenes=50,
        comparisons=2,
        other="0" * 64,
        surely_better=0.9,
        earlier=earlier,
    )
    result = aligned(begin(services, "align", params.model_dump()), params)
    assert result["personal"]["probability_better"] >= 0.9, "fifteen answers for more room"
    assert result["check"]["answers"] == 15
    assert result["prior"] == {"earlier_participants": 1}, "the other one was erased"
    assert len(result["comparisons"]) == 2
    assert result["yoked"] == []


def test_the_own_policy_is_compared_with_a_stand_in_and_with_no_preferences_in_scenes_of_their_own(services):
    _, database, files = services
    snapshot = snapshot_of(services, answers=15)
    params = InstantParams(snapshot=snapshot, gate_scenes=50, comparisons=2, neutral=2, stand_in=1)
    result = aligned(begin(services, "align", params.model_dump()), params)
    conditioned = load_conditioned("study_room/conditioned")
    person = load_stand_ins("study_room").people[1]
    with database.session() as s:
        neutral_id = policy_artefact(s, "study_room/conditioned").id
    rivals = {
        "base": (result["comparisons"], load_policy("study_room/base"), None),
        "neutral": (result["neutral"], conditioned.at(preference_weights({})), neutral_id),
        "other": (result["yoked"], conditioned.at(preference_weights(person["weights"])), "study_room/stand_ins/1"),
    }
    for against, (pairs, policy, made_by) in rivals.items():
        assert len(pairs) == 2
        for pair in pairs:
            with database.session() as s:
                row = s.get_one(TrajectoryRow, pair[against])
                shown = load_trajectory(files, row.id)
            assert made_by in (None, row.made_by)
            (again,) = rollout(get_setup("study_room"), policy.rollout_policy, [shown.scene])
            np.testing.assert_allclose(again.poses, shown.poses, atol=1e-3)  # driven alone, not among many
    seeds = [pair["scene_seed"] for pairs, _, _ in rivals.values() for pair in pairs]
    assert len(set(seeds)) == 6
    with pytest.raises(LearningError, match="stand_in = 999: setup study_room has 0 to 23"):
        align(begin(services, "align", {}), params.model_copy(update={"stand_in": 999}))


def test_no_two_stand_ins_drive_alike():
    people = load_stand_ins("study_room").people
    assert len({str(one["weights"]) for one in people}) == len(people) == 24
    assert all(one["gate_success"] >= 0.9 for one in people)


def test_people_who_want_the_same_have_a_policy_each(services):
    _, database, files = services
    tree = {}
    for answers in (13, 14):
        snapshot = snapshot_of(services, answers=answers)
        params = InstantParams(snapshot=snapshot, gate_scenes=50, comparisons=0)
        result = aligned(begin(services, "align", params.model_dump()), params)
        with database.session() as s:
            tree[answers] = lineage(s, result["policy"])
    policies = [Policy.from_bytes(files.get(one.artefact.id)) for one in tree.values()]
    np.testing.assert_array_equal(policies[0].actor[1], policies[1].actor[1])
    assert {answers: len(one.all_answers()) for answers, one in tree.items()} == {13: 13, 14: 14}


def test_conditioning_search_goes_on_from_the_instant_policy_and_is_shown_only_if_better(services):
    _, database, _ = services
    params = ConditioningSearchParams(snapshot=snapshot_of(services, answers=15), tried=12, comparisons=2)
    result = aligned(begin(services, "align", params.model_dump()), params)
    with database.session() as s:
        card = s.get_one(Artefact, result["policy"]).card
    assert result["passed"] == result["takes_over"]
    if card["config"].get("recipe") == "instant":  # nothing better found: the instant policy, stored before
        assert not result["takes_over"]
    else:
        assert card["config"]["tried"] == 12
        assert card["results"]["takes_over"] == result["takes_over"]
        assert card["scenes"]["gate"]["last_scene_seed"] > card["scenes"]["gate"]["first_scene_seed"] + 50
    assert bool(result["comparisons"]) == result["passed"]
    better = result["better_than_instant"]
    assert better["low"] <= better["value"] <= better["high"]


def test_policy_that_does_not_pass_the_gate_gets_no_comparison(services):
    params = FineTuningParams(
        snapshot=snapshot_of(services, answers=3), **{**QUICK, "gate_min_success": 1.0, "gate_scenes": 2_000}
    )
    result = aligned(begin(services, "align", params.model_dump()), params)
    assert result["passed"] is False
    assert result["comparisons"] == []


def test_nothing_is_kept_of_answers_that_are_erased_meanwhile(services):
    _, database, _ = services
    params = FineTuningParams(snapshot=snapshot_of(services, answers=4), **QUICK)
    context = begin(services, "align", params.model_dump())
    context.progress.part = lambda first, last: erase_then(context, params.snapshot)  # type: ignore[method-assign]
    with pytest.raises(ArtefactError, match="quarantined"):
        align(context, params)
    with database.session() as s:
        made = s.scalars(select(Artefact).where(Artefact.job_id == context.job.id, Artefact.kind == "policy"))
        assert list(made) == []


@pytest.mark.parametrize("erased", ["quarantined", "gone"])
def test_no_file_is_left_of_a_derived_policys_rollouts_when_its_answers_are_erased_meanwhile(
    services, monkeypatch, erased
):
    """The erasure comes when the policy is stored already and its rollouts for the comparison are not."""
    settings, database, files = services
    study = add_answered_study(database, files, answers=7 if erased == "gone" else 6)
    with database.transaction() as s:
        snapshot = take_snapshot(s, files, study_id=study, whose="simulated").id
    params = InstantParams(snapshot=snapshot, gate_scenes=50, comparisons=2)
    context = begin(services, "align", params.model_dump())
    before: set[str] = set()
    prepared = aligning.comparison_rollouts

    def erase_first(*given: object, **named: object) -> object:
        before.update(path.name for path in (settings.data / "artefacts").rglob("*") if path.is_file())
        if erased == "quarantined":
            with database.transaction() as s:
                s.get_one(Artefact, snapshot).quarantined_at = utc_now()
        else:
            with database.session() as s:
                people = list(s.scalars(select(Participant.id).where(Participant.study_id == study)))
            for person in people:
                erase_participant(database, files, person, "tester", data=settings.data, compact=False)
        return prepared(*given, **named)

    monkeypatch.setattr(aligning, "comparison_rollouts", erase_first)
    with pytest.raises(ArtefactError, match="quarantined" if erased == "quarantined" else "not there any more"):
        align(context, params)
    after = {path.name for path in (settings.data / "artefacts").rglob("*") if path.is_file()}
    assert after - before == set()
    with database.session() as s:
        made = s.scalars(select(Artefact.id).where(Artefact.job_id == context.job.id, Artefact.kind == "policy"))
        for policy in made:
            assert list(s.scalars(select(TrajectoryRow).where(TrajectoryRow.made_by == policy))) == []


def erase_then(context: JobContext, snapshot: str) -> Progress:
    """What an erasure does to a snapshot, at the moment when the training begins."""
    with context.database.transaction() as s:
        s.get_one(Artefact, snapshot).quarantined_at = utc_now()
    return Progress(context.database, context.job.id)


def test_reward_model_is_measured_per_participant_on_answers_it_did_not_see(services):
    _, database, _ = services
    params = RewardModelParams(snapshot=snapshot_of(services, participants=3, answers=15))
    context = begin(services, "reward_model", params.model_dump())
    result = learn_reward_model(context, params)
    assert [row["participant"] for row in result["held_out"]] == ["P001", "P002", "P003"]
    for row in result["held_out"]:
        assert row["n"] == 15
        assert row["method"] == "5_folds"
        assert row["low"] < row["accuracy"] <= row["high"] <= 1
    assert sum(row["accuracy"] for row in result["held_out"]) / 3 > 0.6
    assert abs(sum(result["importance"].values()) - 1) < 1e-5
    context.progress.flush()
    with database.session() as s:
        assert s.get_one(Job, context.job.id).progress > 0.5


def test_two_answers_cannot_be_held_out_and_the_job_says_so(services):
    params = RewardModelParams(snapshot=snapshot_of(services, participants=1, answers=2))
    result = learn_reward_model(begin(services, "reward_model", params.model_dump()), params)
    RewardModelResult.model_validate(result)
    assert result["held_out"] == [{"participant": "P001", "n": 2, "reason": "too_few_answers"}]


@pytest.mark.parametrize("after", [0, 1, 2, 3])
def test_an_erasure_while_the_job_runs_leaves_no_file_of_what_was_derived(
    services, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int
):
    """Wherever it cuts in: before the reward model, the policy, or between the trajectories that are kept of it."""
    settings, database, files = services
    study_id = add_answered_study(database, files, answers=8)
    with database.session() as s:
        person = s.scalars(select(Participant.id).where(Participant.study_id == study_id)).one()
    with database.transaction() as s:
        snapshot = take_snapshot(s, files, study_id=study_id, whose="simulated").id
    params = InstantParams(snapshot=snapshot, gate_scenes=50, comparisons=2, seed=5 + after)  # scenes of its own
    context = begin(services, "align", params.model_dump())
    before = set(files.names())
    kept = []
    transaction = Database.transaction

    @contextmanager
    def cut_in(self: Database, **named: object) -> Iterator[object]:
        if self is database and not kept:
            with transaction(self) as s:
                made = s.scalar(select(func.count()).select_from(Artefact).where(Artefact.job_id == context.job.id))
                made += len(s.scalars(select(TrajectoryRow).where(TrajectoryRow.id.not_in(before))).all())
            if made >= after:
                kept.append(made)
                erase_participant(Database(settings.database), files, person, "tester", data=tmp_path, compact=False)
        with transaction(self, **named) as s:
            yield s

    monkeypatch.setattr(Database, "transaction", cut_in)
    with pytest.raises(ArtefactError, match=r"erased|no reward model|no snapshot"):
        align(context, params)
    monkeypatch.undo()
    assert kept == [after]
    with database.session() as s:
        of_base = TrajectoryRow.made_by == policy_artefact(s, "study_room/base").id
        assert set(files.names()) - before <= set(s.scalars(select(TrajectoryRow.id).where(of_base)))


def with_those_before(snapshot: str, people: list[str]) -> EachSceneParams:
    return EachSceneParams(
        snapshot=snapshot, gate_scenes=50, comparisons=1, policies=3, population=2, people=",".join(people)
    )


@pytest.fixture(scope="module")
def five(services) -> list[str]:
    """Snapshots of five who want the same."""
    return [snapshot_of(services, answers=8 + k, name=f"Before {k}") for k in range(5)]


def test_the_own_policy_is_compared_with_what_those_before_want_and_nothing_of_who_is_erased_stays(services, five):
    settings, database, files = services
    own = snapshot_of(services, answers=9, oracle="network:31")
    params = with_those_before(own, five)
    context = begin(services, "align", params.model_dump())
    result = aligned(context, params)
    told = result["in_general"]
    assert (told["people"], told["passed"]) == (5, True)
    assert told["at_least"] > PREDICTED_FROM
    assert 1 <= len(result["population"]) <= 2
    shown = {pair["scene_seed"] for pair in result["comparisons"]}
    assert not shown & {pair["scene_seed"] for pair in result["population"]}
    with database.session() as s:
        made_by = s.scalars(select(Artefact.id).where(Artefact.name.startswith("policy in general"))).one()
        assert {own, *five} <= {parent.artefact.id for parent in lineage(s, made_by).parents}
        answered = select(Response.id).where(Response.id.in_(lineage(s, five[0]).all_answers()))
        whose = select(Session.participant_id).join(Response).where(Response.id.in_(answered)).distinct()
        person = s.scalars(whose).one()
    policy = read_policy(files.get(made_by))
    assert isinstance(policy, ChoosingPolicy)
    assert isinstance(policy.answers, PeopleInGeneral)
    assert [len(one) for one in policy.answers.people] == [8, 9, 10, 11, 12]

    erase_participant(database, files, person, "tester", data=settings.data, compact=False)
    with database.session() as s:
        assert s.get_one(Artefact, made_by).quarantined_at is not None
        assert s.get_one(Artefact, result["policy"]).quarantined_at is None, "learned from own answers alone"
        assert s.get_one(Job, context.job.id).params["people"] == ",".join(five[1:])
        left = s.scalars(select(Artefact.card)).all()
    assert made_by not in files.names(), "it held their answers"
    assert all(five[0] not in json.dumps(card) for card in left)
    again = aligned(begin(services, "align", params.model_dump()), params)
    assert again["in_general"] == {"people": 4, "passed": False}, "four are too few"
    assert "population" not in again


def test_a_choice_per_scene_by_the_light_of_those_before_goes_when_one_of_them_goes(services):
    settings, database, files = services
    people = [snapshot_of(services, answers=8 + k, name=f"Light {k}", oracle="fastest") for k in range(2)]
    own = snapshot_of(services, answers=5, name="By their light")
    params = EachSceneParams(
        snapshot=own, gate_scenes=50, comparisons=0, policies=2, surely_better=0.9, earlier=",".join(people)
    )
    result = aligned(begin(services, "align", params.model_dump()), params)
    assert result["prior"] == {"earlier_participants": 2}
    policy = read_policy(files.get(result["policy"]))
    assert isinstance(policy, ChoosingPolicy)
    assert isinstance(policy.answers, Answers)
    assert policy.answers.before is not None
    assert len(policy.answers) == 5
    with database.session() as s:
        answered = select(Response.id).where(Response.id.in_(lineage(s, people[0]).all_answers()))
        person = s.scalars(select(Session.participant_id).join(Response).where(Response.id.in_(answered))).first()
    erase_participant(database, files, person, "tester", data=settings.data, compact=False)
    with database.session() as s:
        assert s.get_one(Artefact, result["policy"]).quarantined_at is not None
        assert s.get_one(Artefact, own).quarantined_at is None
    assert result["policy"] not in files.names()


def test_who_is_erased_while_a_choice_per_scene_is_made_is_not_among_those_before(services, monkeypatch):
    settings, database, files = services
    people = [snapshot_of(services, answers=8 + k, name=f"Meanwhile {k}", oracle="fastest") for k in range(2)]
    own = snapshot_of(services, answers=5, name="While it is made")
    with database.session() as s:
        answered = select(Response.id).where(Response.id.in_(lineage(s, people[0]).all_answers()))
        person = s.scalars(select(Session.participant_id).join(Response).where(Response.id.in_(answered))).first()
    made = each_scene.choose_each_scene
    times = []

    def erase_first(*of: object, **named: object) -> ChoosingPolicy:
        if not times:
            erase_participant(database, files, person, "tester", data=settings.data, compact=False)
        times.append(1)
        return made(*of, **named)

    monkeypatch.setattr(each_scene, "choose_each_scene", erase_first)
    asked = {"gate_scenes": 50, "comparisons": 0, "policies": 2, "surely_better": 0.9, "earlier": ",".join(people)}
    params = EachSceneParams(snapshot=own, **asked)
    result = aligned(begin(services, "align", params.model_dump()), params)
    assert len(times) == 2, "made again, without them"
    assert result["prior"] == {"earlier_participants": 1}
    with database.session() as s:
        assert s.get_one(Artefact, result["policy"]).card["results"]["prior"] == result["prior"]


def test_a_choice_per_scene_by_the_light_of_people_in_general_is_nobodys_but_ones_own(services):
    _, _, files = services
    own = snapshot_of(services, answers=5, name="In general")
    asked = {"gate_scenes": 50, "comparisons": 0, "policies": 2, "surely_better": 0.9}
    params = EachSceneParams(snapshot=own, prior="people_in_general", **asked)
    result = aligned(begin(services, "align", params.model_dump()), params)
    assert result["prior"] == {"people_in_general": True}
    policy = read_policy(files.get(result["policy"]))
    assert isinstance(policy, ChoosingPolicy)
    assert isinstance(policy.answers, Answers)
    assert policy.answers.before is not None
    assert policy.answers.before.free.name == "people_in_general"
    assert policy.answers.before.steps is None


def test_people_who_want_different_things_are_no_population(services):
    wants = ["min-human-distance", "network:31", "network:7", "thresholds:2", "network:5", "lexicographic:3"]
    people = [snapshot_of(services, answers=8, name=f"Apart {k}", oracle=want) for k, want in enumerate(wants)]
    params = with_those_before(snapshot_of(services, answers=9), people)
    result = aligned(begin(services, "align", params.model_dump()), params)
    assert (result["in_general"]["people"], result["in_general"]["passed"]) == (6, False)
    assert "population" not in result
