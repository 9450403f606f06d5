"""One table of objectives: words, shipped policies, rewards and figures all take their order from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from desirepath.learning.measures.steps import reference
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.preferences.measures import MEASURES, TABLE, measures, typical_differences
from desirepath.learning.preferences.objectives import (
    CROWD_NAMES,
    MIRRORED,
    NAMES,
    OBJECTIVES,
    OPPOSITES,
    best_possible,
    gains,
    scales,
    step_terms_of,
)
from desirepath.learning.shipped_files import load_card
from desirepath.learning.td3.conditioned_training import reward_weights_of
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import get_setup, preference_setups
from desirepath.simulation.walks import Walk

PREFERENCE_SETUPS = preference_setups()

LOCALES = Path(__file__).resolve().parents[2] / "frontend" / "locales"


@pytest.mark.parametrize("language", ["en", "de"])
@pytest.mark.parametrize("catalogue", ["shared", "flow"])
def test_every_objective_has_its_words_in_the_tables_order_and_no_other_has(language: str, catalogue: str) -> None:
    words = yaml.safe_load((LOCALES / language / f"{catalogue}.yaml").read_text(encoding="utf-8"))["objectives"]
    among_people = [name for name in CROWD_NAMES if name not in NAMES]
    assert list(words) == [*NAMES, *among_people]


@pytest.mark.parametrize("setup", PREFERENCE_SETUPS)
def test_shipped_policies_were_trained_on_this_table(setup: str) -> None:
    policy, card = load_conditioned(f"{setup}/conditioned"), load_card(f"{setup}/conditioned")  # reading checks names
    strength = np.where(np.array(NAMES) == "farther", card.results["strength"], 1.0)
    in_order = tuple(scales(setup)[name] for name in NAMES)
    np.testing.assert_allclose(policy.scales, np.array(in_order) * strength)
    assert tuple(card.config["stakes"]["scales"]) == in_order
    assert reward_weights_of(load_policy(f"{setup}/base")).scales == in_order
    assert set(card.results["moved"]) == set(NAMES)
    for one in OBJECTIVES:
        assert card.results["moved"][one.name]["measure"] == one.measured_by


def test_opposites_and_mirror_images_are_mutual() -> None:
    assert [(NAMES[a], NAMES[b]) for a, b in OPPOSITES] == [
        ("farther", "closer"),
        ("person_on_left", "person_on_right"),
    ]
    assert (MIRRORED[MIRRORED] == np.arange(len(NAMES))).all()
    for one in OBJECTIVES:
        other = next((o for o in OBJECTIVES if o.name == one.opposite), None)
        assert other is None or (other.opposite, other.measured_by, other.sign) == (
            one.name,
            one.measured_by,
            -one.sign,
        )


@pytest.mark.parametrize("setup", PREFERENCE_SETUPS)
def test_each_column_is_the_objectives_own(setup: str) -> None:
    random = np.random.default_rng(0)
    size = get_setup(setup).observation_size
    seen, actions = (random.uniform(-1, 1, (50, n)).astype(np.float32) for n in (size, 2))
    terms = step_terms_of(actions, seen, get_setup(setup))
    assert terms.shape == (50, len(NAMES))
    assert (terms <= 0).all()
    assert (terms >= -1 - 1e-6).all()
    np.testing.assert_array_equal(terms[:, NAMES.index("smoother")], -np.abs(actions[:, 1]))
    np.testing.assert_array_equal(terms[:, NAMES.index("faster")], -1)
    better = gains(np.eye(len(MEASURES)))
    assert better[MEASURES.index("path_length_m"), NAMES.index("shorter")] == -1
    assert better[MEASURES.index("min_human_distance_m"), NAMES.index("farther")] == 1
    scene = draw_scenes(setup, range(1))[0]
    bounds = dict(zip(NAMES, best_possible([scene])[0], strict=True))
    assert bounds["farther"] == scene.human_distance_ceiling_m()
    assert (bounds["person_on_left"], bounds["slower_near_person"]) == (1.0, 0.0)


def test_each_measure_has_a_unit_and_a_typical_difference_wherever_preferences_are_asked() -> None:
    for setup in PREFERENCE_SETUPS:
        assert (typical_differences(setup) > 0).all()
    for measure in TABLE:
        assert measure.name.endswith(f"_{measure.unit.replace('/', '_')}") or not measure.unit
        assert measure.noticeable > 0


def test_trajectories_of_several_lengths_are_measured_together_as_alone() -> None:
    standing = list(reference("study_room").trajectories[:12])
    walk = Walk((0.0, 3.0, 9.0), (0.0, 1.0, 2.0), (0.0, 0.5, 2.0), (0.0, 0.0, 0.0))
    walking = [replace(one, scene=replace(one.scene, walk=walk)) for one in standing[:6]]
    some = [*standing, *walking]
    assert len({len(one.poses) for one in some}) > 3
    together = measures(some)
    assert together == pytest.approx(np.concatenate([measures([one]) for one in some]))
    nearest = MEASURES.index("min_human_distance_m")
    for row, one in zip(together, some, strict=True):
        people = one.scene.person_poses(one.times)[:, :2]
        assert row[nearest] == pytest.approx(np.hypot(*(one.poses[:, :2] - people).T).min())
