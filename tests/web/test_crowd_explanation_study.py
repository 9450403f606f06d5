"""The explanation study among pedestrians over HTTP, with what is shipped: a bot ranks people with and without what the
robot attends to, and its answers say what was shown."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from sqlalchemy import select

from desirepath.store.models import Response, Session, Trial
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.simulated.http import simulate_study
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from desirepath.web.core.dependencies import Services

PROTOCOL = Path(__file__).resolve().parents[2] / "study_protocols" / "crowd_explanation_study.yaml"


def test_a_bot_ranks_people_under_four_conditions(client, services: Services) -> None:
    text = PROTOCOL.read_text()
    assert "trials: 6" in text
    with services.database.transaction() as s:
        frozen = freeze_text(text.replace("trials: 6", "trials: 1"))
        link = create_study(s, services.files, frozen, name="Attended", created_by=None).recruiting_token
    done = simulate_study("", link, 1, Character(seed=2), client=client)
    assert (done["participants"], done["completed"]) == (1, 1)
    with services.database.session() as s:
        assert s.scalars(select(Session)).one().state == "completed"
        rows = s.execute(select(Response.value, Trial.block, Trial.role).join(Trial)).all()
    ranked = [(value, block) for value, block, role in rows if role == "regular"]
    assert Counter((block, value["attention"], value["lidar"]) for value, block in ranked) == {
        ("attention-lidar", True, True): 1,
        ("attention-bare", True, False): 1,
        ("hidden-lidar", False, True): 1,
        ("hidden-bare", False, False): 1,
    }
    people = {"person", "pedestrian 1", "pedestrian 2", "pedestrian 3", "pedestrian 4"}
    assert all(set(value["ranking"]) == set(value["scores"]) == people for value, _ in ranked)
