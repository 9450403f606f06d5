"""The benchmark of what people wait for, small: it makes its installation, visits the lab, and keeps what it made."""

from __future__ import annotations

from pathlib import Path

import pytest
from sqlalchemy import func, select

from desirepath.settings import Settings
from desirepath.store.database import Database
from desirepath.store.models import Event, Participant, Response, Session, Study, Trial
from desirepath_experiments.benchmarks import pages
from desirepath_experiments.benchmarks.pages import benchmark_pages


def test_restart_every_lab_page_and_joins_are_timed_in_an_installation_that_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("SAMPLES", "LOOKS"):
        monkeypatch.setattr(pages, name, 1)
    small = {"studies": 2, "participants": 1, "restarts": 1, "joining": 3, "rounds": 1}
    measured = benchmark_pages(**small, data=tmp_path)
    assert measured["bars"] == {"restart_s": 3.0, "lab_p95_ms": 300.0, "join_p95_ms": 500.0}
    assert measured["met"].keys() == measured["bars"].keys()
    for name in measured["bars"]:
        assert measured[name] > 0
    kinds = {row["page"] for row in measured["lab_pages"]}
    assert {"/lab/studies", "/lab/new", "/lab/jobs", "/lab/policies", "/lab/settings"} <= kinds
    tabs = ("now", "people", "answers", "report", "data", "recruit", "protocol")
    assert {f"/lab/studies/*/{tab}" for tab in tabs} <= kinds

    database = Database(Settings(data=tmp_path, database_url=None, _env_file=None).database)
    with database.session() as s:
        studies = s.scalars(select(Study).order_by(Study.created_at, Study.name)).all()
        assert [study.name for study in studies] == ["Benchmark 1", "Benchmark 2"]
        assert studies[0].recruiting_token != studies[1].recruiting_token
        answers = [_rows(s, Response, study.id) for study in studies]
        assert answers[0] == answers[1] > 75
        assert _rows(s, Trial, studies[0].id) == _rows(s, Trial, studies[1].id) >= 75
        told = [s.scalar(select(func.count()).where(Event.study_id == study.id)) for study in studies]
        assert min(told) > 75
        people = [s.scalar(select(func.count()).where(Participant.study_id == study.id)) for study in studies]
        assert sorted(people) == [1, 4], "who joined did so in one of them"
    database.close()


def _rows(s, table, study_id: str) -> int:
    asked = select(func.count()).select_from(table).join(Session).where(Session.study_id == study_id)
    return s.scalar(asked)
