"""Recruited people are paid: ids beside codes, for whoever may, as files that the platform reads."""

from __future__ import annotations

import csv
import io

from fastapi.testclient import TestClient
from sqlalchemy import select, update

from desirepath.store.models import Audit, Participant, RecruitingId, Session, Study
from tests.web.lab_services import csrf


def send_from_prolific(services, walked) -> dict[str, str]:
    """Give the walked study's people ids of a platform; returns code -> id."""
    ids = {walked.finished: "prolific-1", walked.half_way: "=cmd()", walked.fresh: "prolific-3"}
    with services.database.transaction() as s:
        for code, external_id in ids.items():
            person = s.scalars(select(Participant).where(Participant.code == code)).one()
            s.add(
                RecruitingId(participant_id=person.id, study_id=walked.id, platform="prolific", external_id=external_id)
            )
            if code == walked.fresh:
                s.execute(update(Session).where(Session.participant_id == person.id).values(state="screened_out"))
    return ids


def test_ids_states_codes_and_times_are_listed_and_taken_as_the_platform_wants_them(lab, lab_services, walked):
    here = f"/lab/studies/{walked.id}"
    assert "Nobody has joined with a platform id" in lab.get(f"{here}/payments").text
    ids = send_from_prolific(lab_services, walked)
    page = lab.get(f"{here}/payments").text
    with lab_services.database.session() as s:
        code = s.scalars(select(Session.completion_code).where(Session.completion_code.is_not(None))).first()
    for told in (ids[walked.finished], walked.finished, walked.half_way, code):
        assert told in page
    assert lab.get(f"{here}/payments.csv?which=approve").text == f"{ids[walked.finished]}\n"
    assert lab.get(f"{here}/payments.csv?which=reject").text == f"{ids[walked.fresh]}\n"
    assert lab.get(f"{here}/payments.csv?which=bonus&bonus=1,5").text == f"{ids[walked.finished]},1.50\n"
    for wrong in ("0.001", "", "much", "-1", "nan", "1e9"):
        assert lab.get(f"{here}/payments.csv?which=bonus&bonus={wrong}").status_code == 422
    rows = lab.get(f"{here}/payments.csv").text.splitlines()
    assert rows[0].startswith("platform_id,participant,state,completion_code")
    assert len(rows) == 4
    assert any(row.startswith("'=cmd()") for row in rows), "no formula in somebody's spreadsheet"
    with lab_services.database.session() as s:
        assert {"payments_seen", "payments_taken"} <= set(s.scalars(select(Audit.action)))


def test_an_id_that_got_in_all_the_same_writes_nothing_into_a_platforms_files(lab, lab_services, walked):
    send_from_prolific(lab_services, walked)
    here = f"/lab/studies/{walked.id}"
    with lab_services.database.transaction() as s:
        s.execute(
            update(RecruitingId)
            .where(RecruitingId.external_id == "prolific-1")
            .values(external_id="X,500.00\nY", platform="mturk")
        )
    for which in ("approve", "bonus&bonus=2", "reject"):
        told = lab.get(f"{here}/payments.csv?which={which}").text
        assert ("500" in told, "Y" in told) == (False, False), which
    page = lab.get(f"{here}/payments").text
    assert "are left out of the files" in page
    assert "platform=mturk" in page
    assert lab.get(f"{here}/payments.csv?which=reject&platform=mturk").text == ""
    assert lab.get(f"{here}/payments.csv?which=reject&platform=prolific").text == "prolific-3\n"
    rows = list(csv.reader(io.StringIO(lab.get(f"{here}/payments.csv").text)))
    assert len(rows) == 4
    assert {len(row) for row in rows} == {len(rows[0])}


def test_recruiting_says_when_a_placeholder_was_never_filled_in(lab, lab_services, walked):
    recruit = lab.get(f"/lab/studies/{walked.id}/recruit").text
    for link in (
        "?PROLIFIC_PID={{%PROLIFIC_PID%}}&amp;STUDY_ID=",
        "?survey_code=%SURVEY_CODE%",
        "?workerId=${workerId}",
    ):
        assert link in recruit
    assert "unfilled placeholder" not in recruit
    with lab_services.database.session() as s:
        token = s.get_one(Study, walked.id).recruiting_token
    visitor = TestClient(lab.app, follow_redirects=False)
    joined = visitor.post(f"/join/{token}", data={"language": "en", "PROLIFIC_PID": "{{%PROLIFIC_PID%}}"})
    assert joined.status_code == 303
    assert "1 person came with an unfilled placeholder" in lab.get(f"/lab/studies/{walked.id}/recruit").text
    assert "{{%" not in lab.get(f"/lab/studies/{walked.id}/payments").text


def test_who_may_not_pay_sees_no_id_and_no_button(as_role, lab_services, walked):
    send_from_prolific(lab_services, walked)
    here = f"/lab/studies/{walked.id}"
    for role in ("analyst", "viewer"):
        browser = as_role(role)
        for ending in ("", ".csv"):
            assert browser.get(f"{here}/payments{ending}").status_code == 403
    assert f"{here}/payments" in as_role("experimenter").get(f"{here}/recruit").text


def test_recruiting_warns_while_nothing_leads_back_to_the_platform(lab, walked):
    recruit = lab.get(f"/lab/studies/{walked.id}/recruit").text
    assert "No return address is set" in recruit
    page = lab.post(f"/lab/studies/{walked.id}/revise", data={"csrf": csrf(lab)})
    draft = page.headers["location"]
    yaml = (
        lab.get(f"/lab/studies/{walked.id}/protocol.yaml")
        .text.replace("version: 2\n", "version: 3\n")
        .replace("completion_code: random}", "completion_code: random, return_url: 'https://example.org/?cc={code}'}")
    )
    assert lab.post(draft, data={"csrf": csrf(lab), "yaml": yaml}).status_code == 303
    assert lab.post(f"{draft}/open", data={"csrf": csrf(lab)}).status_code == 303
    assert "No return address is set" not in lab.get(f"/lab/studies/{walked.id}/recruit").text
