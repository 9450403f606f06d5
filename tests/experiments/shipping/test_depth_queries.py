"""Queries whose trajectories robots with a depth camera drove: found, shipped with a card, asked from in a study."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select

from desirepath.demonstrations.depth.depth_controller import DepthController
from desirepath.demonstrations.depth.states import CONFIGURATIONS
from desirepath.installed import DATASETS
from desirepath.learning.cards import Card, file_sha256
from desirepath.learning.preferences.measures import MEASURES, measures
from desirepath.learning.queries.queries import QuerySet, look_alike
from desirepath.learning.shipped_files import load_card, resolve
from desirepath.simulation.trajectory import Outcome
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.database import Database
from desirepath.store.models import Response, Trial
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import create_study
from desirepath_experiments.shipping import depth
from desirepath_experiments.shipping.depth import SHOWN
from tests.study.small_protocol import small_protocol

TINY = replace(SHOWN, count=3, scenes_per_round=12)


def towards_the_goal(configuration: str, speed_m_s: float) -> DepthController:
    """Weights written by hand: it turns to the goal at one speed, so that tests need no training."""
    shape = CONFIGURATIONS[configuration].shape()
    arrays: list[np.ndarray] = []
    for number, (inputs, outputs) in enumerate(shape.actor_layers()):
        weight, bias = np.zeros((inputs, outputs), np.float32), np.zeros(outputs, np.float32)
        if number == 0:
            weight[1, 0], weight[1, 1] = 1.0, -1.0  # the goal's bearing, to either side
        elif outputs == 2:
            weight[0, 1], weight[1, 1], bias[0] = 4.0, -4.0, np.arctanh(4 * speed_m_s - 1)
        elif number not in (2, 3):  # what the latent is read by stays empty
            weight[0, 0] = weight[1, 1] = 1.0
        arrays += [weight, bias]
    return DepthController(CONFIGURATIONS[configuration], shape, tuple(arrays))


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of artefacts with the encoder, a slow and a fast controller, and queries by them."""
    folder = tmp_path_factory.mktemp("shipped")
    (folder / "home").mkdir()
    shutil.copy(DATASETS / f"{depth.ENCODER}.npz", folder / "home")
    for (configuration, name), speed in zip(depth.SHIPPED.items(), (0.2, 0.45), strict=True):
        (folder / f"{name}.npz").write_bytes(towards_the_goal(configuration, speed).to_bytes())
    depth.ship_queries(folder, TINY)
    return folder


def test_both_arrive_and_can_be_told_apart_among_people_who_stand_and_walk(shipped: Path) -> None:
    queries = QuerySet.load(shipped / f"{depth.QUERIES}.npz")
    assert (queries.setup, len(queries)) == ("home", 3)
    for query in queries.queries:
        both = (query.trajectory_a, query.trajectory_b)
        assert {one.outcome for one in both} == {Outcome.SUCCESS}
        assert not look_alike(*both, TINY)
        slow = both[query.members.index(0)]
        assert slow.duration_s == max(one.duration_s for one in both)
    assert any(query.scene.walk is not None for query in queries.queries)


def test_the_card_tells_what_recorded_them(shipped: Path) -> None:
    card = Card.load(shipped / f"{depth.QUERIES}.card.json")
    assert (card.kind, card.name) == ("query_set", "home/queries_depth_12")
    assert set(card.parents) == {"home/depth_encoder"}
    assert set(card.config["controllers"]) == {"VAE-HA", "VAE-ND"}
    assert card.config["count"] == card.results["queries"] == 3


def test_a_study_asks_from_them(shipped: Path, tmp_path: Path, database: Database, files: ArtefactStore) -> None:
    asked = {"block": {"view": "top_down", "trials": [{"queries": {"count": 3}}]}}
    frozen = small_protocol(tmp_path, [asked], query_set=str(shipped / f"{depth.QUERIES}.npz"))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Seen by depth", created_by=None)
    assert walk_in_process(database, files, study, 1)["completed"] == 1
    known = {query.trajectory_a.digest() for query in QuerySet.load(shipped / f"{depth.QUERIES}.npz").queries}
    with database.session() as s:
        trials = s.scalars(select(Trial)).all()
        answered = s.scalars(select(Response).where(Response.kind == "preference")).all()
    assert (len(trials), len(answered)) == (3, 3)
    assert {load_trajectory(files, trial.trajectory_a).scene.setup for trial in trials} == {"home"}
    assert known <= {load_trajectory(files, one).digest() for t in trials for one in (t.trajectory_a, t.trajectory_b)}


def test_the_side_on_which_somebody_who_walks_is_passed_is_where_they_were_then(shipped: Path) -> None:
    shown = [query.trajectory_a for query in QuerySet.load(shipped / f"{depth.QUERIES}.npz").queries]
    walked = next(one for one in shown if one.scene.walk is not None)
    towards = walked.scene.person_poses(walked.times)[:, :2] - walked.poses[:, :2]
    nearest = np.hypot(*towards.T).argmin()
    bearing = np.arctan2(towards[nearest, 1], towards[nearest, 0]) - walked.poses[nearest, 2]
    assert measures([walked])[0, MEASURES.index("passing_side")] == pytest.approx(np.sin(bearing), abs=1e-5)


def test_the_shipped_set_is_what_its_card_says_and_people_walk_in_it() -> None:
    path = resolve("home/queries_depth_12")
    queries, card = QuerySet.load(path), load_card("home/queries_depth_12")
    assert (card.sha256, card.results["queries"]) == (file_sha256(path), len(queries)) == (card.sha256, 12)
    drawn = [one for query in queries.queries for one in (query.trajectory_a, query.trajectory_b)]
    assert all(one.outcome == Outcome.SUCCESS and one.duration_s <= 20 for one in drawn)
    assert 3 <= sum(query.scene.walk is not None for query in queries.queries) < 12
