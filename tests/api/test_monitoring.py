"""The live monitor: what stands out in somebody's answers, and that every flag leads to the rows behind it."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import timedelta

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from backend.api.core.dependencies import Services
from backend.api.lab import monitoring, people_rows
from backend.store.events import log_event
from backend.store.models import Participant, Response, Session, Trial, new_id, utc_now
from tests.api.lab_services import Walked


def answer(services: Services, walked: Walked, code: str, key: str, **given: object) -> str:
    """One more stored answer of a participant, to a trial where `drives` says so. Returns the trial's id."""
    drives = given.pop("drives", None)
    with services.database.transaction() as s:
        session = s.scalars(select(Session).join(Participant).where(Participant.code == code)).one()
        trial = None
        if drives is not None:
            a, b = drives  # type: ignore[misc]
            trial = Trial(
                session_id=session.id,
                step_key=key,
                index=900,
                kind="query",
                role=given.pop("role", "regular"),
                view="top_down",
                trajectory_a=a,
                trajectory_b=b,
                phase="answered",
                probe_of=given.pop("probe_of", None),
            )
            s.add(trial)
            s.flush()
        row = {"kind": "preference", "decision_s": 2.0, **given}
        s.add(
            Response(
                session_id=session.id, trial_id=trial.id if trial else None, step_key=key, request_id=new_id(), **row
            )
        )
        return trial.id if trial else ""


def flags(services: Services, walked: Walked, code: str) -> tuple[str, ...]:
    with services.database.session() as s:
        return next(p.flags for p in people_rows.people(s, walked.id, utc_now()) if p.code == code)


def rows_of(lab: TestClient, walked: Walked, code: str, flag: str) -> int:
    """How many rows stand behind the flag's link on the Now tab."""
    page = lab.get(f"/lab/studies/{walked.id}/people").text
    row = page.split(f'/people/{code}"')[1].split("</tr>")[0]
    link = next(a for a in re.findall(r'class="tag attention" href="([^"]+)"', row) if flag in a)
    shown = lab.get(link.replace("&amp;", "&"))
    assert shown.status_code == 200
    return int(re.search(r"(\d+) (?:answers?|events?)", re.sub(r"<[^>]+>", " ", shown.text)).group(1))


@pytest.fixture
def drives(lab_services: Services) -> tuple[str, str]:
    with lab_services.database.session() as s:
        trial = s.scalars(select(Trial)).first()
        return trial.trajectory_a, trial.trajectory_b


def test_choices_that_were_hardly_choices_are_flagged_for_people_only(lab, lab_services, walked, drives):
    for code in (walked.fresh, walked.bot):
        for k in range(5):
            answer(
                lab_services, walked, code, f"fast.{k}", drives=drives, value={"choice": "ab"[k % 2]}, decision_s=0.1
            )
    assert "too_fast" in flags(lab_services, walked, walked.fresh)
    assert "too_fast" not in flags(lab_services, walked, walked.bot)
    assert rows_of(lab, walked, walked.fresh, "too_fast") == 5


def test_always_the_same_letter_is_flagged_from_eight_answers_on(lab, lab_services, walked, drives):
    for k in range(7):
        answer(lab_services, walked, walked.fresh, f"side.{k}", drives=drives, value={"choice": "a"})
    assert "one_sided" not in flags(lab_services, walked, walked.fresh)
    answer(lab_services, walked, walked.fresh, "side.7", drives=drives, value={"choice": "a"})
    assert "one_sided" in flags(lab_services, walked, walked.fresh)
    assert rows_of(lab, walked, walked.fresh, "one_sided") == 8


def test_a_failed_check_is_flagged_with_its_answer(lab, lab_services, walked):
    answer(lab_services, walked, walked.fresh, "check", kind="comprehension", value={"goal": "wrong", "passed": False})
    answer(lab_services, walked, walked.fresh, "check.2", kind="comprehension", value={"goal": "right", "passed": True})
    assert flags(lab_services, walked, walked.fresh) == ("failed_checks",)
    assert rows_of(lab, walked, walked.fresh, "failed_checks") == 1


def test_who_names_another_drive_when_asked_again_is_flagged(lab, lab_services, walked, drives):
    first = [
        answer(lab_services, walked, walked.fresh, f"q.{k}", drives=drives, value={"choice": "ab"[k % 2]})
        for k in range(4)
    ]

    def again(k: int, *, turned: bool, choice: str) -> None:
        shown = drives[::-1] if turned else drives
        role = "swap" if turned else "repeat"
        value = {"choice": choice}
        answer(lab_services, walked, walked.fresh, f"p.{k}", drives=shown, value=value, role=role, probe_of=first[k])

    again(0, turned=False, choice="a")  # the same
    again(1, turned=True, choice="a")  # B was chosen and is A now: the same
    again(2, turned=False, choice="b")  # another
    assert "inconsistent" not in flags(lab_services, walked, walked.fresh)  # too few to tell
    again(3, turned=True, choice="b")  # another
    assert "inconsistent" in flags(lab_services, walked, walked.fresh)
    assert rows_of(lab, walked, walked.fresh, "inconsistent") == 2


def test_choices_that_go_round_are_flagged(lab, lab_services, walked):
    with lab_services.database.session() as s:
        shown = list(s.scalars(select(Trial.trajectory_a).distinct().limit(6)))

    def triad(number: int, *, circular: bool) -> None:
        first, second, third = shown[3 * number : 3 * number + 3]
        pairs = ((first, second), (second, third), (third, first))
        for k, pair in enumerate(pairs):
            value = {"choice": "a" if circular or k < 2 else "b"}
            answer(lab_services, walked, walked.fresh, f"t.{number}.{k}", drives=pair, value=value, role="transitivity")

    triad(0, circular=True)
    assert "inconsistent" not in flags(lab_services, walked, walked.fresh)  # once happens by chance
    triad(1, circular=True)
    assert "inconsistent" in flags(lab_services, walked, walked.fresh)
    assert rows_of(lab, walked, walked.fresh, "inconsistent") == 6


def test_who_looked_away_again_and_again_is_flagged(lab, lab_services, walked):
    with lab_services.database.transaction() as s:
        session = s.scalars(select(Session).join(Participant).where(Participant.code == walked.fresh)).one()
        for kind in ("trial_interrupted", "stroke_interrupted"):  # a pair's drive, the drive of a drawn path
            for reason in ("hidden", "hidden", "stage_connected"):
                log_event(s, kind, session_id=session.id, reason=reason)
    assert flags(lab_services, walked, walked.fresh) == ("lost_focus",)
    assert rows_of(lab, walked, walked.fresh, "stroke_interrupted") == 6


def test_time_per_trial_is_from_answer_to_answer_within_a_session():
    at = utc_now()

    def given(seconds: float, **changed: object) -> monitoring._Given:
        one = monitoring._Given(
            "r", "s1", "preference", {}, 1.0, at + timedelta(seconds=seconds), "regular", "t", None, None
        )
        return replace(one, **changed)

    assert monitoring._trial_s([given(0)]) is None
    times = [
        given(0, trial=None),
        given(20),
        given(30),
        given(1000),
        given(5000, session="s2"),
        given(5012, session="s2"),
    ]
    assert monitoring._trial_s(times) == pytest.approx(16.0)  # 20, 10, 970 and 12: a pause weighs little


def test_the_monitor_tells_the_same_as_data(lab, walked):
    told = lab.get(f"/api/lab/studies/{walked.id}/monitor").json()
    people = {one["code"]: one for one in told["people"]}
    assert people[walked.finished]["trial_s"] > 5
    assert told["median_trial_s"] > 5
    assert told["orders"] == []  # one condition only
    assert not people[walked.bot]["pilot"]
