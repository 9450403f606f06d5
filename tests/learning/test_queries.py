"""Queries show two trajectories worth comparing, and a stored set is the same set."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.policies.shipped import load_ensemble, load_policy
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.queries.queries import (
    QueryConfig,
    QuerySet,
    flaw,
    generate_queries,
    look_alike,
    path_gap_m,
)
from desirepath.simulation.scenes import check_scene
from desirepath.simulation.setups import SetupError
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath_experiments.reproduction.enquery.computing import segment_queries


@pytest.fixture(scope="module")
def few() -> QuerySet:
    return generate_queries(load_ensemble("study_room"), QueryConfig(count=12, seed=77, scenes_per_round=32))


def test_both_drives_share_scene_start_and_goal_and_have_no_flaw(few: QuerySet) -> None:
    config = QueryConfig()
    assert len({query.scene.seed for query in few.queries}) == len(few) == 12
    for query in few.queries:
        check_scene(query.scene)
        a, b = query.trajectory_a, query.trajectory_b
        assert a.scene == b.scene == query.scene
        np.testing.assert_array_equal(a.poses[0], b.poses[0])
        assert query.members[0] != query.members[1]
        assert flaw(a, config) is flaw(b, config) is None
        assert not look_alike(a, b, config)


def test_every_dropped_drive_is_counted(few: QuerySet) -> None:
    counts = few.filtered
    assert counts["drives"] == 4 * counts["scenes"]
    assert counts["scenes"] == len(few) + counts["look_alike"] + counts["one_drive_left"]


def test_filters_name_the_flaw(few: QuerySet) -> None:
    config = QueryConfig()
    trajectory = few.queries[0].trajectory_a
    assert flaw(replace(trajectory, outcome=Outcome.COLLISION), config) == "collision"
    assert flaw(replace(trajectory, outcome=Outcome.TIMEOUT), config) == "timeout"
    assert flaw(replace(trajectory, self_intersections=1), config) == "self_intersection"
    assert flaw(trajectory, replace(config, max_duration_s=1.0)) == "too_long"
    assert flaw(trajectory, replace(config, min_duration_s=60.0)) == "too_short"
    assert look_alike(trajectory, trajectory, config)


def test_path_gap_of_a_parallel_path_is_its_offset(few: QuerySet) -> None:
    trajectory = few.queries[0].trajectory_a
    beside = replace(trajectory, poses=trajectory.poses + np.array([0.3, 0.4, 0.0], dtype=np.float32))
    assert path_gap_m(trajectory, beside) == pytest.approx(0.5, abs=1e-5)


def test_a_stored_set_is_the_same_set(few: QuerySet, tmp_path: Path) -> None:
    few.save(tmp_path / "few.npz")
    again = QuerySet.load(tmp_path / "few.npz")
    assert [query.digest() for query in again.queries] == [query.digest() for query in few.queries]
    assert again.filtered == few.filtered
    assert again.to_bytes() == few.to_bytes()


def test_the_same_seed_asks_the_same(few: QuerySet) -> None:
    again = generate_queries(load_ensemble("study_room"), QueryConfig(count=12, seed=77, scenes_per_round=32))
    assert again.to_bytes() == few.to_bytes()


def test_too_few_scenes_say_what_was_dropped() -> None:
    with pytest.raises(LearningError, match="gave queries in only 0"):
        generate_queries(load_ensemble("study_room"), QueryConfig(count=50, max_scenes=8, scenes_per_round=8))


def test_members_of_two_setups_are_refused() -> None:
    members = [load_policy("study_room/base"), load_policy("open_field/base")]
    with pytest.raises(SetupError, match="member 1 is open_field"):
        generate_queries(members)


def test_one_member_cannot_make_a_query() -> None:
    with pytest.raises(LearningError, match="2 trajectories need as many"):
        generate_queries([load_policy("study_room/base")])


def test_no_query_set_in_a_foreign_file(tmp_path: Path) -> None:
    (tmp_path / "queries.npz").write_bytes(b"PK not really")
    for name in ("queries.npz", "missing.npz"):
        with pytest.raises(LearningError, match="query set"):
            QuerySet.load(tmp_path / name)


def test_baseline_segments_are_four_seconds_of_two_scenes() -> None:
    pairs = segment_queries(load_policy("open_field/base"), 10, seed=1, pool_scenes=40)
    assert len(pairs) == 10
    for a, b in pairs:
        assert a.duration_s == b.duration_s == pytest.approx(4.0)
        assert a.scene.seed != b.scene.seed
        _consistent(a)
        Preference(a, b)


def _consistent(segment: Trajectory) -> None:
    np.testing.assert_array_equal(segment.observations[1:], segment.next_observations[:-1])
    assert len(segment.poses) == len(segment.actions) + 1
