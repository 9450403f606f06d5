"""Imitation of a search among pedestrians: what commands cost, what is learned of it, the policy as it is kept."""

import numpy as np
import pytest
import torch

from backend.learning.pedestrians.crowd_evaluation import crowd_scene_set, evaluate_crowds
from backend.learning.pedestrians.crowd_networks import Chooser, actor_acts
from backend.learning.pedestrians.crowd_planners import PLANNERS
from backend.learning.pedestrians.crowd_states import SIZES, mirrors, states
from backend.learning.pedestrians.crowd_training import actor_from_arrays, actor_to_arrays
from backend.learning.pedestrians.foresight import COMMANDS, MIRRORED, MOST_M, actions_of_commands, costs_by_velocity
from backend.learning.pedestrians.imitation import ImitationConfig, imitate, learn_from
from backend.learning.scene_sets import Purpose
from backend.simulation.crowds.crowd_engine import CrowdEngine
from backend.simulation.crowds.crowd_scenes import PUBLISHED


def begun(n: int, **settings: float) -> CrowdEngine:
    engine = CrowdEngine(n_envs=n, **settings)
    engine.reset(crowd_scene_set(n, PUBLISHED, purpose=Purpose.SELECT, seed=9))
    return engine


def test_who_is_told_how_everybody_moves_arrives_more_often_than_orca():
    scenes = crowd_scene_set(30, PUBLISHED, purpose=Purpose.SELECT, seed=0)
    told, orca = (
        evaluate_crowds(None, "ranges", scenes, plan=PLANNERS[name]).rates()["success"]
        for name in ("constant_velocity", "orca")
    )
    assert told >= 75 > 55 > orca


def test_costs_are_above_the_best_and_the_cheapest_commands_lead_along_the_path():
    engine = begun(12)
    costs = costs_by_velocity(engine)
    assert costs.shape == (12, len(COMMANDS))
    np.testing.assert_array_equal(costs.min(axis=1), 0)
    assert costs.max() <= MOST_M
    moves = actions_of_commands(engine.setup.limits)[costs.argmin(axis=1)]
    before = engine.path_left_m()
    for _ in range(5):
        engine.step(moves)
        moves = actions_of_commands(engine.setup.limits)[costs_by_velocity(engine).argmin(axis=1)]
    assert np.median(before - engine.path_left_m()) > 0.2


def test_a_command_into_somebody_who_comes_is_dearest():
    engine = begun(1)
    x, y, yaw = engine.poses[0]
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    engine.world.people_xy[0, 1] = (x, y) + 1.2 * ahead
    engine.world.people_v[0, 1] = -0.6 * ahead
    engine.world.facing[0, 1] = -ahead
    assert costs_by_velocity(engine)[0, 0] == MOST_M, "straight on, fast"
    engine.world.people_v[0, 1] = 0.9 * ahead
    assert costs_by_velocity(engine)[0, 0] < MOST_M, "behind who goes away there is room"


def mirrored(engine: CrowdEngine) -> CrowdEngine:
    """The same moment with left and right exchanged."""
    other = begun(engine.n_envs, noise_m=0.0)
    for name in ("boxes", "people_xy", "people_v", "facing", "paths", "routes", "robots"):
        getattr(other.world, name)[:] = getattr(engine.world, name)
        getattr(other.world, name)[..., 1] *= -1
    other.world.boxes[..., 5] *= -1
    other.world.robots[:, 2] *= -1
    other._begin(np.arange(engine.n_envs))
    return other


@pytest.mark.parametrize("given", SIZES)
def test_a_mirrored_state_is_what_is_sensed_where_left_and_right_have_changed_places(given):
    one = begun(12, noise_m=0.0)
    other, (source, signs) = mirrored(one), mirrors(given)
    moves = np.random.default_rng(0).uniform(-1, 1, (12, 2)).astype(np.float32)
    for _ in range(3):
        one.step(moves)
        other.step(moves * np.array([1, -1], np.float32))
    apart = np.abs(states(one, given)[:, source] * signs - states(other, given))
    assert (apart > 0.03).mean() < 0.02, "a beam beside an edge meets something else"
    unchanged = np.abs(states(one, given) - states(other, given))
    assert (unchanged > 0.03).mean() > 0.2


def test_mirrored_commands_turn_to_the_other_side():
    np.testing.assert_array_equal(MIRRORED[MIRRORED], np.arange(len(COMMANDS)))
    assert [tuple(COMMANDS[k]) for k in MIRRORED[:3]] == [(0, 1), (-0.13, 1), (0.13, 1)]


@pytest.mark.parametrize(
    ("wrong", "named"),
    [({"labels": 0}, "labels"), ({"dearest_m": (20.0,)}, "dearest_m"), ({"mirrored": 2.0}, "mirrored")],
)
def test_settings_that_cannot_be_name_themselves(wrong, named):
    with pytest.raises(ValueError, match=named):
        ImitationConfig(**wrong)


def test_what_is_told_is_learned():
    engine, random = begun(60), np.random.default_rng(0)
    for _ in range(8):
        engine.step(random.uniform(-1, 1, (60, 2)).astype(np.float32))
    told, seen = (torch.as_tensor(of) for of in (costs_by_velocity(engine), states(engine, "ranges")))
    torch.manual_seed(0)
    actor, dearest = Chooser("b3", tables=2, which=1), torch.tensor([[1.0], [4.0]])
    adam = torch.optim.Adam(actor.parameters(), 2e-3)
    for _ in range(400):
        learn_from(actor, adam, seen, told, dearest)
    with torch.no_grad():
        foretold = actor.costs(seen)
    for table, most in enumerate((1.0, 4.0)):
        should = (told / most).clamp(max=1.0)
        assert (foretold[:, table] - should).square().mean() < 0.5 * should.var(dim=0).mean()


def test_a_training_tells_how_it_goes_and_keeps_one_table():
    rows = []
    config = ImitationConfig("b3", labels=200, n_envs=8, batch_size=8, evaluations=2, evaluation_episodes=2)
    learned = imitate(config, lambda fraction, row: rows.append((fraction, row["labels"], row["dearest_m"])))
    assert rows == [(0.52, 104, 2.0), (1, 200, 1.0), (1, 200, 2.0), (1, 200, 4.0)]
    assert learned.actor.tables == 1


@pytest.mark.parametrize("which", [0, 2])
def test_the_kept_table_acts_as_among_the_others_and_comes_back_from_its_numbers(which):
    torch.manual_seed(0)
    whole = Chooser("b3", tables=3, which=which)
    seen = states(begun(8), "ranges")
    alone = actor_from_arrays("b3", actor_to_arrays(whole.alone()))
    assert isinstance(alone, Chooser)
    with torch.no_grad():
        costs = whole.costs(torch.as_tensor(seen))[:, which]
        torch.testing.assert_close(alone.costs(torch.as_tensor(seen))[:, 0], costs)
    np.testing.assert_array_equal(actor_acts(alone)(seen), actor_acts(whole)(seen))
