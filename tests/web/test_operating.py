"""Pilots kept apart, several studies at once, and how long data are kept, as experimenters do it on the pages."""

from __future__ import annotations

import io
import zipfile
from datetime import timedelta

from sqlalchemy import select

from desirepath.store.models import Participant, Study, utc_now
from desirepath.study.protocol.freezing import freeze
from desirepath.study.session.joining import join_study
from desirepath.study.studies import create_study
from desirepath.web.core.dependencies import Services
from tests.web.lab_services import QUICK, Walked, csrf


def join(services: Services, study_id: str) -> str:
    """Somebody follows the link; their code."""
    with services.database.transaction() as s:
        session, _ = join_study(s, s.get_one(Study, study_id), language="en", files=services.files)
        return session.participant.code


def codes_in_export(lab, study_id: str, **form: str) -> set[str]:
    answered = lab.post(f"/lab/studies/{study_id}/export", data={"csrf": csrf(lab), **form})
    with zipfile.ZipFile(io.BytesIO(answered.content)) as packed:
        name = next(n for n in packed.namelist() if n.endswith("/participants.csv"))
        return {line.split(",")[0] for line in packed.read(name).decode().splitlines()[1:]}


def test_who_joins_during_a_pilot_stays_a_pilot_participant_and_out_of_the_numbers(lab, lab_services, walked: Walked):
    here = f"/lab/studies/{walked.id}"
    before = lab.get(f"/api{here}/report").json()["joined"]
    assert lab.post(f"{here}/pilot", data={"csrf": csrf(lab), "pilot": "1"}).status_code == 303
    pilot = join(lab_services, walked.id)
    assert "Pilot" in lab.get(f"{here}/now").text
    assert lab.post(f"{here}/pilot", data={"csrf": csrf(lab), "pilot": ""}).status_code == 303
    live = join(lab_services, walked.id)
    with lab_services.database.session() as s:
        marks = dict(s.execute(select(Participant.code, Participant.pilot)).all())
    assert (marks[pilot], marks[live]) == (True, False)
    assert lab.get(f"/api{here}/report").json()["joined"] == before + 1
    assert lab.get(f"/api{here}/report?who=pilot").json()["joined"] == 1
    listed = lab.get(f"{here}/people?show=pilot").text
    assert f"/people/{pilot}" in listed
    assert f"/people/{live}" not in listed
    everyone = {walked.finished, walked.half_way, walked.fresh, walked.bot, live}
    assert codes_in_export(lab, walked.id) == everyone
    assert codes_in_export(lab, walked.id, pilots="1") == everyone | {pilot}


def test_a_promised_day_is_kept_and_reminded_of_once_it_is_over(lab, lab_services, walked: Walked):
    here = f"/lab/studies/{walked.id}"
    for wrong in ("soon", "2020-01-01"):
        refused = lab.post(f"{here}/retention", data={"csrf": csrf(lab), "until": wrong})
        assert (refused.status_code, wrong in refused.text) == (422, True)
    tomorrow = (utc_now() + timedelta(days=1)).date().isoformat()
    assert lab.post(f"{here}/retention", data={"csrf": csrf(lab), "until": tomorrow}).status_code == 303
    assert f'value="{tomorrow}"' in lab.get(f"{here}/data").text
    assert "kept until" not in lab.get("/lab/studies").text
    with lab_services.database.transaction() as s:
        s.get_one(Study, walked.id).retain_until = utc_now() - timedelta(days=1)
    assert "kept until" in lab.get("/lab/studies").text
    assert f"desirepath studies erase-overdue {walked.id}" in lab.get(f"{here}/data").text
    assert lab.post(f"{here}/retention", data={"csrf": csrf(lab), "until": ""}).status_code == 303
    assert "kept until" not in lab.get("/lab/studies").text


def test_studies_at_the_same_time_see_only_their_own_participants(lab, lab_services, walked: Walked):
    with lab_services.database.transaction() as s:
        other = create_study(s, lab_services.files, freeze(QUICK), name="Second study", created_by=None).id
    code = join(lab_services, other)
    first, second = (lab.get(f"/api/lab/studies/{study}/monitor").json()["people"] for study in (walked.id, other))
    assert [one["code"] for one in second] == [code]
    assert code not in {one["code"] for one in first}
    assert lab.get(f"/lab/studies/{walked.id}/people/{code}").status_code == 404
    assert codes_in_export(lab, other) == {code}
