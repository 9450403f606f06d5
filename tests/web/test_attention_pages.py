"""The page of what a policy with attention looks at: its rollout with the weights on a stage, in both languages."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from fastapi.testclient import TestClient

from desirepath.learning.errors import LearningError
from desirepath.learning.pedestrians.crowd_networks import Actor, actor_to_arrays
from desirepath.learning.policies.attention import VARIANT, AttentionPolicy
from desirepath.store.artefacts import save_artefact
from desirepath.web.analyst.workspace import Made
from desirepath.web.application import create_application
from desirepath.web.core.dependencies import Services
from desirepath.web.stage.replay_stages import Replay
from desirepath_experiments.shipping.attention import in_half_precision
from desirepath_experiments.training.pedestrians.imitation import ImitationConfig, imitate
from tests.web.lab_services import sign_in

PAGE = "/lab/attention"


def untrained() -> AttentionPolicy:
    torch.manual_seed(3)
    arrays = {name: value.astype(np.float16) for name, value in actor_to_arrays(Actor(VARIANT)).items()}
    return AttentionPolicy("crowd_corridor", arrays)


@pytest.fixture
def policy(lab_services: Services) -> str:
    """Id of a policy with attention."""
    with lab_services.database.transaction() as s:
        return save_artefact(
            s, lab_services.files, kind="attention_policy", name="crowd_corridor/looks", setup="crowd_corridor",
            content=untrained().to_bytes(), card={},
        ).id  # fmt: skip


@pytest.fixture
def analyst(lab_services: Services) -> Iterator[TestClient]:
    with TestClient(create_application(lab_services), follow_redirects=False) as client:
        found = sign_in(client)
        found.follow_redirects = True  # addresses of before lead on to those of now
        yield found


def shown_on(services: Services, page: str) -> Replay:
    token = re.search(r"/stage/([^/\"]+)/", page)
    assert token is not None
    made = services.replays.find_shown(token[1])
    assert isinstance(made, Made)
    (shown,) = made.make()
    assert isinstance(shown, Replay)
    return shown


def test_an_analyst_sees_what_it_attends_to_over_time_or_the_same_rollout_without(analyst, lab_services, policy):
    page = analyst.get(f"{PAGE}?policy={policy}&scene=3500000001&view=immersive").text
    assert "Blue wedges on the floor are sectors of the lidar" in page
    shown = shown_on(lab_services, page)
    trajectory, explained = shown.rollouts[0], shown.explained
    assert (trajectory.scene.setup, shown.view) == ("crowd_corridor", "immersive")
    assert explained is not None
    attention = explained.attention
    assert attention is not None
    for rows in (attention.spatial, attention.temporal):
        assert len(rows) == len(trajectory.poses)
        assert all(len(row) == 30 and sum(row) == pytest.approx(1, abs=1e-3) for row in rows)
    plain = analyst.get(f"{PAGE}?policy={policy}&scene=3500000001&plain=true").text
    assert "Blue wedges" not in plain
    without = shown_on(lab_services, plain)
    assert without.explained is None
    np.testing.assert_array_equal(without.rollouts[0].poses, trajectory.poses)
    assert "Keile" in analyst.get(f"{PAGE}?policy={policy}", headers={"Accept-Language": "de"}).text
    assert f'href="{PAGE}?policy={policy}"' in analyst.get(f"/lab/artefacts/{policy}").text
    assert f'href="{PAGE}?policy={policy}"' in analyst.get("/lab/policies").text


def test_what_cannot_be_shown_is_said(analyst, policy):
    assert analyst.get(PAGE).status_code == 200
    assert analyst.get(f"{PAGE}?policy={'0' * 64}").status_code == 404
    refused = analyst.get(f"{PAGE}?policy={policy}&scene=x")
    assert (refused.status_code, "type a whole number" in refused.text) == (422, True)


def test_what_was_learned_is_a_file_that_comes_back_as_it_was() -> None:
    learned = imitate(ImitationConfig(labels=12, n_envs=3, batch_size=4, evaluation_episodes=2)).actor
    made = in_half_precision(actor_to_arrays(learned))
    read = AttentionPolicy.from_bytes(made.to_bytes())
    assert read.to_bytes() == made.to_bytes()
    assert len(made.to_bytes()) < 320_000
    for name, value in actor_to_arrays(read.actor()).items():
        np.testing.assert_array_equal(value, made.arrays[name].astype(np.float32))
    with pytest.raises(LearningError, match="not a desirepath attention policy"):
        AttentionPolicy.from_bytes(b"nothing")
