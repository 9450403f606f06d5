"""ORCA and social-force crowds of the batch engine, checked against the libraries of the field."""

import numpy as np
import pytest

from desirepath.simulation.crowds.avoidance_kernels import ForceRules, OrcaRules, orca_velocity, social_velocity

NO_BOXES = np.zeros((1, 6))


def orca_steps(xy, goals, speeds, steps):
    """Everybody by our ORCA at once: positions (steps, n, 2)."""
    rules, radii = OrcaRules(), np.full(len(xy), 0.3)
    xy, v, kept = xy.copy(), np.zeros_like(xy), []
    for _ in range(steps):
        new = np.zeros_like(v)
        for k in range(len(xy)):
            way = goals[k] - xy[k]
            away = max(np.linalg.norm(way), 1e-9)
            new[k] = orca_velocity(
                k, xy, v, radii, way / away * min(speeds[k], away / rules.dt), speeds[k], NO_BOXES, 0, rules
            )
        v = new
        xy = xy + rules.dt * v
        kept.append(xy.copy())
    return np.array(kept)


def pyrvo_steps(xy, goals, speeds, steps):
    pyrvo = pytest.importorskip("pyrvo")
    rules = OrcaRules()
    simulator = pyrvo.RVOSimulator()
    simulator.set_time_step(rules.dt)
    for place, speed in zip(xy, speeds, strict=True):
        simulator.add_agent(list(map(float, place)), rules.far, 20, rules.horizon, 1.0, 0.3, float(speed))
    kept = []
    for _ in range(steps):
        for k, goal in enumerate(goals):
            at = simulator.get_agent_position(k).to_tuple()
            way = goal - np.array(at)
            away = max(np.linalg.norm(way), 1e-9)
            simulator.set_agent_pref_velocity(k, list(map(float, way / away * min(speeds[k], away / rules.dt))))
        simulator.do_step()
        kept.append([simulator.get_agent_position(k).to_tuple() for k in range(len(xy))])
    return np.array(kept)


@pytest.mark.parametrize("seed", range(4))
def test_orca_walks_as_the_library_does(seed):
    rng = np.random.default_rng(seed)
    n = 8
    angles = np.sort(rng.uniform(0, 2 * np.pi, n)) + np.arange(n) * 1e-3
    xy = np.stack([np.cos(angles), np.sin(angles)], axis=1) * rng.uniform(2.5, 4.0, (n, 1))
    goals, speeds = -xy + rng.normal(0, 0.3, (n, 2)), rng.uniform(0.5, 1.0, n)
    ours, theirs = orca_steps(xy, goals, speeds, 40), pyrvo_steps(xy, goals, speeds, 40)
    # the library computes in single precision: what differs in the seventh digit grows where many meet
    apart = np.linalg.norm(ours - theirs, axis=2)
    assert apart[:10].max() < 1e-4
    assert np.median(apart) < 1e-3


# Velocities (m/s) after one step of PySocialForce 1.1.2, which nobody keeps any more. Made once, with it installed:
#   simulator = pysocialforce.Simulator(social_state(seed)); simulator.peds.step_width = 0.2; simulator.step(1)
#   numpy.round(simulator.peds.vel(), 9)
LIBRARY_VELOCITIES = (
    (
        *((-0.261855621, 0.147412913), (-0.013411278, -0.053611316), (-0.190673871, 0.389518164)),
        *((0.0104545, -0.019669167), (-0.392833389, 0.435961767), (0.273676284, -0.653521317)),
        (-0.371250448, 0.845798017),
    ),
    (
        *((-0.341472143, 0.376233337), (0.032690778, -0.159552667), (-0.189229483, 0.145649139)),
        *((-0.015002927, 0.088390664), (0.027020148, 0.503918604), (-1.282429462, -1.685250196)),
        (0.055367243, -0.077590749),
    ),
    (
        *((-0.175986331, -0.135881305), (0.038961131, -0.037351864), (0.257751224, 0.032103102)),
        *((0.569742324, 0.097273261), (0.265467701, 0.183611653), (0.2341397, 0.505723335)),
        (1.566794393, -0.511248802),
    ),
)


def social_state(seed):
    """Seven people: position (m), velocity (m/s), goal (m)."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-3, 3, (7, 2)), rng.normal(0, 0.6, (7, 2)), rng.uniform(-6, 6, (7, 2))])


@pytest.mark.parametrize("seed", range(3))
def test_social_forces_are_those_of_the_library(seed):
    state = social_state(seed)
    xy, v, goals = (state[:, at : at + 2].copy() for at in (0, 2, 4))
    radii, speeds = np.full(len(state), 0.3), np.linalg.norm(v, axis=1)
    ours = np.array(
        [
            social_velocity(k, xy.copy(), v.copy(), radii, goals[k], speeds[k], NO_BOXES, 0, ForceRules())
            for k in range(len(state))
        ]
    )
    walking = np.linalg.norm(goals - xy, axis=1) > 0.5  # who has arrived stands, there
    assert np.abs(ours - np.array(LIBRARY_VELOCITIES[seed]))[walking].max() < 1e-6


def test_walls_hold_who_avoids():
    wall = np.array([[1.0, 0.0, 0.1, 3.0, 1.0, 0.0]])
    rules, xy, v = OrcaRules(), np.zeros((1, 2)), np.zeros((1, 2))
    forced, fv = np.zeros((1, 2)), np.zeros((1, 2))
    for _ in range(60):
        v[0] = orca_velocity(0, xy, v, np.full(1, 0.3), np.array([1.0, 0.1]), 1.0, wall, 1, rules)
        fv[0] = social_velocity(0, forced, fv, np.full(1, 0.3), np.array([5.0, 1.0]), 1.0, wall, 1, ForceRules())
        xy, forced = xy + 0.2 * v, forced + 0.2 * fv
    assert xy[0, 0] <= 0.9 - 0.3 + 1e-6
    assert forced[0, 0] < 0.9
