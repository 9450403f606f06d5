"""Pages that not every study has, as the server makes them: checks, breaks, appointments, endings before the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any
from uuid import uuid4

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.installed import PROTOCOLS
from desirepath.settings import Settings
from desirepath.store.models import Session
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.protocol.planning import example_queries, make_plan
from desirepath.study.studies import create_study
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from desirepath.web.participant.session_view import leads_to, next_kind
from tests.study import walking

PROTOCOL = """
protocol: every_kind
version: 1
title: {en: Every kind of page}
languages: [en]
payment: {en: You are paid for the time that you gave.}
query_set: QUERIES
stages:
  - information: {text: texts/information.md}
  - consent:
      text: texts/interface_consent.md
      version: 1
      purposes: {training: {en: "May robots learn from it?"}, open_data: {en: "May it be published?"}}
  - comprehension: {use: clear, attempts: 2, text: texts/instruction.md}
  - block:
      view: top_down
      attention_checks: 1
      trials: [{queries: {count: 1}}]
  - break: {text: texts/interface_break.md, at_least_s: 0}
  - appointment: {text: texts/interface_break.md, after_days: 2, within_days: 9}
  - questionnaire: {use: remark, time_limit_s: 60}
  - debriefing: {text: texts/debriefing.md}
"""
CLEAR = """
title: {en: "Is it clear?"}
blocks:
  - items:
      - key: who
        type: choice
        correct: you
        text: {en: "Who is the wooden figure?"}
        options: [{value: you, label: {en: Me}}, {value: robot, label: {en: The robot}}]
"""
REMARK = """
title: {en: A remark}
blocks: [{items: [{key: remark, type: text, text: {en: "Anything else?"}}]}]
"""


class Visitor:
    """A simulated participant who reads the pages."""

    def __init__(self, client: TestClient, link: str) -> None:
        self.client = client
        joined = client.post(f"/join/{link}", json={"language": "en", "simulated": True}).json()
        self.token = joined["token"]

    @property
    def step(self) -> dict[str, Any]:
        found: dict[str, Any] = self.client.get(f"/api/session/{self.token}").json()["step"]
        return found

    @property
    def page(self) -> str:
        return self.client.get(f"/p/{self.token}").text

    def answer(self, value: dict[str, Any] | None = None) -> dict[str, Any]:
        step = self.step
        api = f"/api/session/{self.token}"
        if step["kind"] == "trial":
            trial = self.client.post(f"{api}/trials/{step['key']}/start", json={}).json()["step"]["trial"]
            for side in "ab":
                told = {"side": side, "playback_id": trial["playback_id"]}
                trial = self.client.post(f"{api}/trials/{step['key']}/seen", json=told).json()["step"]["trial"]
        body = {"request_id": uuid4().hex, "value": value or {}}
        answered: dict[str, Any] = self.client.post(f"{api}/steps/{step['key']}", json=body).json()
        assert answered.get("accepted") is True, answered
        return answered


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory) -> Services:
    return build_services(Settings(data=tmp_path_factory.mktemp("data"), _env_file=None))


@pytest.fixture(scope="module")
def visit(services: Services, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[], Visitor]]:
    folder = tmp_path_factory.mktemp("protocol")
    (folder / "questionnaires").mkdir()
    (folder / "questionnaires" / "clear.yaml").write_text(CLEAR)
    (folder / "questionnaires" / "remark.yaml").write_text(REMARK)
    (folder / "texts").symlink_to(PROTOCOLS / "texts")
    text = PROTOCOL.replace("QUERIES", str(walking.twenty_queries(folder)))
    with services.database.transaction() as s:
        study = create_study(s, services.files, freeze_text(text, folder=folder), name="Every kind", created_by=None)
        link = study.recruiting_token
    with TestClient(create_application(services), follow_redirects=False, client=("127.0.0.1", 50_000)) as client:
        yield lambda: Visitor(client, link)


def to_the_check(visitor: Visitor) -> None:
    assert "Next: your consent." in visitor.page
    visitor.answer()
    page = visitor.page
    assert "May robots learn from it?" in page
    assert page.count("No, I do not agree") == 2
    assert "You are paid for the time that you gave." in page
    visitor.answer({"given": True, "purposes": {"training": False, "open_data": True}})


def test_every_kind_of_page_is_shown(services: Services, visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    to_the_check(visitor)
    assert "This is try 1 of 2." in visitor.page
    visitor.answer({"who": "robot"})
    again = visitor.page
    assert "Not everything was right yet." in again
    assert "Imagine that you are the person" in again  # the text to read once more
    visitor.answer({"who": "you"})
    for _ in range(2):
        step = visitor.step
        if step["kind"] == "attention":
            assert f"please choose the letter {step['instructed'].upper()}." in visitor.page
            visitor.answer({"choice": step["instructed"]})
        else:
            visitor.answer({"choice": "a"})
    assert "Time for a break" in visitor.page
    visitor.answer()
    page = visitor.page
    code = page.partition('id="return-code">')[2].partition("<")[0]
    assert f'data-own-link="/p/{code}"' in page
    assert "type it in at http://testserver/back:" in page
    copy = visitor.client.get(f"/p/{visitor.token}/consent").text
    assert copy.index("No, I do not agree") < copy.index("Yes, I agree")

    typed = visitor.client.post("/back", data={"code": code.replace("-", " ").lower()})
    assert typed.headers["location"] == f"/p/{code}"
    with services.database.session() as s:
        (opens,) = s.scalars(select(Session.opens_at).where(Session.appointment == 2))
    assert f'datetime="{opens.isoformat()}"' in page
    visitor.token = code  # bots need not wait until then
    assert "There is one minute for this page." in visitor.page
    visitor.answer({"timed_out": True})
    assert "Completion code" in visitor.page


def test_who_fails_the_check_is_thanked_and_leaves(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    to_the_check(visitor)
    for _ in range(2):
        visitor.answer({"who": "robot"})
    page = visitor.page
    assert "Thank you for your interest" in page
    assert "Completion code" in page


def test_a_wrong_code_leads_nowhere(visit: Callable[[], Visitor]) -> None:
    client = visit().client
    assert "Go on with your code" in client.get("/back").text
    typed = client.post("/back", data={"code": "../lab"})
    assert typed.headers["location"] == "/p/..%2Flab"
    assert "This link does not lead anywhere" in client.get("/p/NOPE").text


def test_a_page_tells_what_comes_next_and_shows_pairs_only_before_pairs() -> None:
    """Before drawing and before the evaluation there is nothing to choose between; a wait is no page to announce."""
    told = {}
    for name in ("demonstration_study", "quick_preference_study"):
        frozen = freeze_text((PROTOCOLS / f"{name}.yaml").read_text())
        plan = make_plan(frozen.protocol, 0, example_queries(frozen.protocol))
        told |= {
            (name, step.key): (next_kind(plan, k), leads_to(plan, k))
            for k, step in enumerate(plan)
            if step.kind == "instruction"
        }
    assert told == {
        ("demonstration_study", "instruction"): ("demonstration", "demonstration"),
        ("demonstration_study", "instruction_2"): ("evaluation", "evaluation"),
        ("quick_preference_study", "instruction"): ("trial", "trial"),
    }
