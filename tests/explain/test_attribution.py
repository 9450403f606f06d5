"""An explanation is right where the answer is known: gradients, sums, what is hidden, a look one way only."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.explain.attribution import attribute, baseline, explain
from desirepath.explain.methods import METHODS, AttributionError
from desirepath.explain.sight import Sight, sight_of
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Obstacle, Person, Pose, Room, Scene
from desirepath.simulation.setups import SetupError, get_setup
from desirepath.simulation.trajectory import Trajectory
from desirepath_experiments.benchmarks.explanations import faithfulness, gain_over_chance

SETUP = get_setup("study_room")


@pytest.fixture(scope="module")
def policy() -> Policy:
    return load_policy("study_room/base")


@pytest.fixture(scope="module")
def trajectories(policy: Policy) -> list[Trajectory]:
    return rollout(SETUP, policy.rollout_policy, scene_set("study_room", 4, purpose=Purpose.FIGURE, seed=1))


@pytest.fixture(scope="module")
def sights(trajectories: list[Trajectory]) -> list[Sight]:
    return [sight_of(one) for one in trajectories]


def looks(sector: int) -> Callable[[Tensor], Tensor]:
    """Slower the nearer that sector's ray ends; blind to everything else."""
    return lambda seen: torch.stack([torch.tanh(seen[:, SETUP.polar_size + sector]), 0 * seen[:, 0]], dim=1)


def test_what_is_seen_of_all_things_together_is_what_was_observed(sights: list[Sight]) -> None:
    for sight in sights:
        nothing = np.zeros((len(sight.observations), len(sight.things)), dtype=bool)
        np.testing.assert_allclose(sight.without(nothing), sight.observations, atol=2e-6)


def test_saliency_is_the_gradient(policy: Policy, sights: list[Sight]) -> None:
    actor, seen = actor_of(policy), sights[0].observations[:5]
    double = torch.from_numpy(seen).double()
    exact = actor_of_double(policy)
    found = attribute(actor, seen, setup=SETUP, method="saliency", command="turning")
    step = 1e-6
    for column in range(0, seen.shape[1], 5):
        ahead, behind = double.clone(), double.clone()
        ahead[:, column] += step
        behind[:, column] -= step
        difference = ((exact(ahead) - exact(behind))[:, 1] / (2 * step)).numpy()
        np.testing.assert_allclose(found[:, column], difference, rtol=2e-3, atol=2e-5)


def actor_of_double(policy: Policy) -> Callable[[Tensor], Tensor]:
    """The same network in double precision, for finite differences."""
    layers = [torch.from_numpy(array.astype(np.float64)) for array in policy.actor]

    def relu(x: Tensor, k: int) -> Tensor:
        return torch.relu(x @ layers[2 * k] + layers[2 * k + 1])

    def act(seen: Tensor) -> Tensor:
        split = policy.shape.task_inputs
        task, lidar = relu(relu(seen[:, :split], 0), 1), relu(relu(seen[:, split:], 2), 3)
        hidden = relu(relu(torch.cat([task, lidar], 1), 4), 5)
        return torch.tanh(hidden @ layers[12] + layers[13])

    return act


def test_integrated_gradients_add_up_to_the_difference_from_the_empty_room(policy: Policy, sights: list[Sight]) -> None:
    actor, seen = actor_of(policy), sights[0].observations
    found = attribute(actor, seen, setup=SETUP, method="integrated_gradients", command="turning")
    with torch.no_grad():
        apart = (actor(torch.from_numpy(seen)) - actor(torch.from_numpy(baseline(seen, SETUP))))[:, 1].numpy()
    np.testing.assert_allclose(found.sum(axis=1), apart, atol=0.05)
    assert np.abs(found.sum(axis=1) - apart).mean() < 0.01


def test_what_is_hidden_scores_nothing(policy: Policy) -> None:
    """A pillar right behind a wide box, seen from the start."""
    box = Obstacle("box", Pose(2.0, 0.0), 0.5, 2.0, 1.0)
    pillar = Obstacle("pillar", Pose(2.6, 0.0), 0.2, 0.2, 1.0)
    scene = Scene(
        "study_room", 0, Pose(0.0, 0.0), Pose(0.0, 3.0), 0.36, Person(Pose(-2.0, 0.0)), (box, pillar), Room(8, 8)
    )
    there = rollout(SETUP, lambda seen: np.tile(np.float32([-1, 0]), (len(seen), 1)), [scene], max_steps=3)[0]
    sight = sight_of(there)
    assert not sight.seen[:, sight.things.index("pillar")].any()
    for method in METHODS:
        explained = explain(actor_of(policy), sight, method=method)
        assert not explained.scores[:, sight.things.index("pillar")].any()
        assert explained.scores[:, sight.things.index("box")].any()


@pytest.mark.parametrize("method", METHODS)
def test_a_policy_that_looks_at_one_sector_is_explained_by_it(sights: list[Sight], method: str) -> None:
    sight = sights[0]
    sector = int((sight.provider[0] >= 0).nonzero()[0][0])
    explained = explain(looks(sector), sight, method=method)  # type: ignore[arg-type]
    told = np.abs(explained.inputs).max(axis=1) > 0  # against an empty room, a free ray says nothing
    assert told[0]
    assert (np.abs(explained.inputs).argmax(axis=1) == SETUP.polar_size + sector)[told].all()
    provider = sight.provider[0, sector]
    expected = np.zeros(len(explained.things))
    expected[provider] = 1.0
    np.testing.assert_allclose(explained.scores[0], expected, atol=1e-6)


def test_smooth_grad_has_a_seed(policy: Policy, sights: list[Sight]) -> None:
    before = torch.random.get_rng_state()
    first, again, other = (
        attribute(
            actor_of(policy), sights[0].observations, setup=SETUP, method="smooth_grad", command="speed", seed=seed
        )
        for seed in (3, 3, 4)
    )
    assert (first == again).all()
    assert (first != other).any()
    assert (torch.random.get_rng_state() == before).all()


def test_the_true_explanation_beats_chance_and_the_reversed_one_loses(sights: list[Sight]) -> None:
    """Each sector weighs as a known number; taking out what weighs most changes most."""
    weights = torch.linspace(0, 1, SETUP.robot.lidar.sectors) ** 4

    def actor(seen: Tensor) -> Tensor:
        return torch.stack([(seen[:, SETUP.polar_size :] * weights).mean(dim=1), 0 * seen[:, 0]], dim=1)

    true, reversed_ = [], []
    for sight in sights:
        explained = explain(actor, sight, method="integrated_gradients")
        true.append(faithfulness(actor, sight, explained))
        backwards = type(explained)(
            explained.method, "speed", explained.inputs, explained.things, -explained.scores, -explained.weights
        )
        reversed_.append(faithfulness(actor, sight, backwards))
    better = gain_over_chance([one for one in true if one])
    worse = gain_over_chance([one for one in reversed_ if one])
    for name in ("first", "deletion", "insertion"):
        assert better[name]["mean"] > 0 > worse[name]["mean"], name


def test_unknown_methods_and_blind_setups_are_refused(policy: Policy, sights: list[Sight]) -> None:
    with pytest.raises(AttributionError, match=r"method = .lime.: must be one of integrated_gradients, saliency"):
        attribute(actor_of(policy), sights[0].observations, setup=SETUP, method="lime", command="speed")  # type: ignore[arg-type]
    corridor = rollout(
        get_setup("corridor"),
        lambda seen: np.zeros((len(seen), 2), dtype=np.float32),
        scene_set("corridor", 1, purpose=Purpose.FIGURE, seed=0),
        max_steps=2,
    )[0]
    with pytest.raises(SetupError, match="no lidar"):
        sight_of(corridor)


def test_a_policy_is_explained_from_the_command_line(tmp_path: Path) -> None:
    made = CliRunner().invoke(
        app, ["policies", "explain", "study_room/base", "--scene", "7", "--out", str(tmp_path), "--json"]
    )
    assert made.exit_code == 0, made.output
    told = json.loads(made.stdout)
    assert [Path(one["path"]).name for one in told["files"]] == [
        f"explanation.{form}" for form in ("png", "svg", "csv")
    ]
    rows = list(csv.DictReader((tmp_path / "explanation.csv").open()))
    at = [row for row in rows if float(row["time_s"]) == told["at_s"]]
    first = max(at, key=lambda row: float(row["score"]))
    assert first["thing"] == told["most_important"][0]["thing"]
    assert all(row["seen"] == "True" for row in rows if row["thing"] != "person" and float(row["score"]) > 0)
    late = CliRunner().invoke(app, ["policies", "explain", "study_room/base", "--scene", "7", "--at", "999", "--json"])
    assert late.exit_code == 1
    assert "at = 999.0 s: the trajectory has moments from 0 to" in late.stdout + late.stderr


def test_objects_are_scored_over_the_rays_alone_however_much_the_goal_matters(sights: list[Sight]) -> None:
    """Equation 8.2 scales the lidar's part of the gradient; the goal scores at most as much as the first thing."""
    sight = next(one for one in sights if (one.provider[0] >= 0).any())
    sector = int(np.flatnonzero(sight.provider[0] >= 0)[0])

    def goal_first(seen: Tensor) -> Tensor:
        speed = 9 * seen[:, 0] + 0.3 * seen[:, SETUP.polar_size + sector]
        return torch.stack([speed, 0 * speed], dim=1)

    found = explain(goal_first, sight)
    thing = int(sight.provider[0, sector])
    assert found.scores[0, thing] == 1.0
    assert found.scores[0, -1] == 1.0
    assert found.weights[0, -1] == pytest.approx(9.0)
    assert found.weights[0, thing] == pytest.approx(0.3)


def test_a_command_at_its_limit_is_explained_too(sights: list[Sight]) -> None:
    """In single precision tanh(12) is 1 and has no slope."""

    def saturated(seen: Tensor) -> Tensor:
        speed = torch.tanh(12 + seen[:, SETUP.polar_size])
        return torch.stack([speed, 0 * speed], dim=1)

    assert explain(saturated, sights[0]).inputs[:, SETUP.polar_size].min() > 0
