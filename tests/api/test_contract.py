"""One contract: what is sent is bounded and refused in words, what is published is true and for signed-in people."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from sqlalchemy import select

from backend.api.core.contract import DEEPEST
from backend.store.dataset.writing import export_study
from backend.store.models import Session
from backend.study.links import token_hash
from tests.api.participant_services import to_first_trial

ROOT = Path(__file__).resolve().parents[2]
JSON = {"content-type": "application/json"}
ID = "one-request-id"


def refused(answered):
    assert answered.status_code == 422, answered.text
    return answered.json()["error"]


@pytest.mark.parametrize(
    ("path", "body", "field", "told"),
    [
        ("steps/information", {"request_id": ID, "value": [1]}, "value", "object"),
        ("steps/information", {"request_id": ID, "value": "x"}, "value", "object"),
        ("steps/information", {"request_id": 7}, "request_id", "string"),
        ("steps/information", {"request_id": "short"}, "request_id", "8"),
        ("steps/information", {"value": {}}, "request_id", "must be given"),
        ("steps/information", {"request_id": ID, "client_time": "0001-01-01T00:00:00+14:00"}, "client_time", "1970"),
        ("steps/information", {"request_id": ID, "client_time": "yesterday"}, "client_time", "zone"),
        ("events", {"kind": {}}, "kind", "viewed"),
        ("events", {"kind": "viewed", "data": {"long": "x" * 5000}}, "data", "4000"),
        ("events", {"kind": "viewed", "data": [1]}, "data", "object"),
        ("problem", {"text": "x" * 4001}, "text", "4000"),
        ("trials/block.01/seen", {"side": "c"}, "side", "'a' or 'b'"),
        ("trials/block.01/interrupted", {"reason": "tired"}, "reason", "hidden"),
        ("drawing/path/stroke", {"request_id": ID, "points": [[0]], "speeds": [], "times_s": []}, "points.0", "2"),
        ("drawing/path/stroke", {"request_id": ID, "points": [[0, 1e999]], "speeds": [], "times_s": []}, "points", ""),
        ("drawing/path/rollout-seen", {"walk": {"times_s": 1, "poses": []}}, "walk.times_s", "list"),
    ],
)
def test_what_no_page_sends_is_refused_with_field_value_and_what_would_work(client, token, path, body, field, told):
    content = json.dumps(body).encode()
    error = refused(client.post(f"/api/session/{token}/{path}", content=content, headers=JSON))
    assert error["code"] == "bad_value"
    assert error["field"].startswith(field)
    assert told in error["message"]


@pytest.mark.parametrize("depth", [DEEPEST + 1, 600, 100_000])
def test_json_deeper_than_anything_we_ask_for_is_not_parsed(client, link, token, depth):
    deep = b'{"kind": "viewed", "data": {"x": %b}}' % (b"[" * depth + b"]" * depth)
    for path in (f"/api/session/{token}/events", f"/join/{link}", f"/api/session/{token}/steps/information"):
        error = refused(client.post(path, content=deep, headers=JSON))
        assert (error["field"], str(DEEPEST) in error["message"]) == ("body", True)


def test_brackets_in_a_text_are_no_depth(client, token):
    told = {"kind": "viewed", "data": {"message": "[" * 100 + '\\"{' * 100}}
    assert client.post(f"/api/session/{token}/events", json=told).status_code == 204


@pytest.mark.parametrize("body", [b"", b"[1]", b"null", b'"text"', b"{", b"\xff\xfe", b"1" * 5000])
def test_what_is_no_object_is_refused_in_words(client, link, token, body):
    for path in (f"/api/session/{token}/events", f"/join/{link}"):
        answered = client.post(path, content=body, headers=JSON)
        assert answered.status_code in (400, 422)
        assert answered.json()["error"]["message"]


def test_a_browsers_clock_that_was_never_set_loses_no_answer(client, token):
    for answered in (
        client.post(
            f"/api/session/{token}/steps/information",
            json={"request_id": ID, "client_time": "1970-01-01T00:00:03.000Z"},
        ),
        client.post(f"/api/session/{token}/steps/consent", json={"request_id": ID + "2", "value": {"given": True}}),
    ):
        assert answered.json()["accepted"] is True


def test_numbers_that_no_table_holds_never_stop_an_export(client, services, token, tmp_path):
    told = b'{"kind": "viewed", "data": {"n": %b, "m": -%b}}' % (b"9" * 4000, b"9" * 300)
    assert client.post(f"/api/session/{token}/events", content=told, headers=JSON).status_code == 204
    with services.database.session() as s:
        study = s.scalars(select(Session.study_id).where(Session.token_hash == token_hash(token))).one()
    export_study(services.database, services.files, study, tmp_path / "out")
    assert "page_viewed" in (tmp_path / "out" / "events.csv").read_text()


def test_addresses_with_nul_lead_nowhere(client, token):
    assert client.get("/p/a%00b").status_code == 404
    assert client.get(f"/api/session/{token}%00").status_code == 404
    assert client.get("/lab/studies/x%00/now").status_code == 404
    assert client.get("/lab/sign-in?next=%00").status_code == 422


def test_what_a_session_is_told_is_what_is_published(client, token):
    to_first_trial(client, token)
    state = client.get(f"/api/session/{token}").json()
    assert set(state) == {"state", "step", "language", "stage_url"}
    assert set(state["step"]) == {"key", "kind", "index", "total", "trial"}


def test_the_contract_is_published_for_signed_in_people_only(visitor, lab):
    document = lab.get("/api/docs/openapi.json").json()
    assert document["openapi"].startswith("3.1")
    answer = document["paths"]["/api/session/{token}/steps/{key}"]["post"]
    sent = answer["requestBody"]["content"]["application/json"]["schema"]
    assert sent == {"$ref": "#/components/schemas/AnswerSent"}
    for status, schema in (("200", "Answered"), ("422", "Refusal")):
        told = answer["responses"][status]["content"]["application/json"]["schema"]
        assert told == {"$ref": f"#/components/schemas/{schema}"}
    for path, item in document["paths"].items():
        if path.startswith("/api/") and not path.endswith("/stream"):
            for operation in item.values():
                answers = [one.get("content", {}) for status, one in operation["responses"].items() if status == "200"]
                assert all("$ref" in one["application/json"]["schema"] for one in answers), path
    page = lab.get("/api/docs").text
    assert "POST /api/session/{token}/steps/{key}" in page
    assert "export interface AnswerSent" in page
    lab.cookies.clear()
    assert visitor.get("/api/docs/openapi.json").status_code == 401
    assert visitor.get("/api/docs").status_code in (303, 401)


def test_the_pages_types_are_made_from_the_models_and_up_to_date():
    checked = subprocess.run(
        [sys.executable, "-m", "backend.api.core.published", "--check"], cwd=ROOT, capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stderr
