"""One contract: what is sent is bounded and refused in words, what is published is true and for signed-in people."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path

import pytest
from pydantic import ValidationError
from sqlalchemy import select

from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Session
from desirepath.store.plain_data import is_deeper
from desirepath.study.drawing.strokes import MOST_POINTS
from desirepath.study.drawing.walks import MOST_POSES
from desirepath.study.kind import KINDS
from desirepath.study.kinds.live import MOST_CHANGES, LiveAnswer
from desirepath.study.links import token_hash
from desirepath.web.core.contract import DEEPEST, MOST_CONTAINERS, MOST_VALUES
from desirepath.web.core.published import types_now
from desirepath.web.participant.sent import RolloutSeen, StrokeSent
from tests.study.walking import VALUES
from tests.web.participant_services import submit, to_first_trial

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


@pytest.mark.parametrize(
    "kind", ["application/JSON", "APPLICATION/json; charset=utf-16", "application/vnd.api+JSON", "application/x+json"]
)
def test_json_is_bounded_by_whatever_name_the_framework_takes_it_for_json(client, link, token, kind):
    deep = b'{"kind": "viewed", "data": {"x": %b}}' % (b"[" * 450 + b"]" * 450)
    headers = {"content-type": kind}
    for path in (f"/api/session/{token}/events", f"/join/{link}", f"/api/session/{token}/steps/information"):
        error = refused(client.post(path, content=deep, headers=headers))
        assert (error["field"], str(DEEPEST) in error["message"]) == ("body", True)
    flat = client.post(f"/api/session/{token}/events", content=b'{"kind": "viewed"}', headers=headers)
    assert flat.status_code == 204


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-32", "utf-32-be"])
def test_json_in_another_encoding_hides_no_brackets(client, token, encoding):
    """In UTF-16 a letter may have the byte of a quotation mark, behind which brackets would count as text."""
    hidden = '{"kind": "viewed", "data": {"\u2222": %s}}' % ("[" * 450 + "]" * 450)
    error = refused(client.post(f"/api/session/{token}/events", content=hidden.encode(encoding), headers=JSON))
    assert (error["field"], "UTF-8" in error["message"]) == ("body", True)


@pytest.mark.parametrize(
    "worst", [b'"' + b'\\"' * 2**19, b'""' * 2**19, b"[]" * 2**19, b'"["[' * 2**18, b"\\" * 2**20, b"[" * 2**20]
)
def test_a_megabyte_of_anything_is_looked_through_at_once(worst):
    began = time.thread_time()
    is_deeper(b"[]" * DEEPEST + worst, DEEPEST)
    assert time.thread_time() - began < 0.2, "seconds per kB, before anybody was asked who they are"


def test_depth_is_what_a_reader_finds():
    for written, depth in (
        ('[{"[[[": ["\\\\", "]", "\\"["]}]', 3),
        ('["\\\\\\"[", [1]]', 2),
        ('{"a": {"b": {}}, "c": [[[[1]]]]}', 5),
        ("[] [] []", 1),
        ('"[[["', 0),
        ('["[[[', 1),
    ):
        assert not is_deeper(written.encode(), depth), written
        assert depth == 0 or is_deeper(written.encode(), depth - 1), written


def test_brackets_in_a_text_are_no_depth(client, token):
    told = {"kind": "viewed", "data": {"message": "[" * 100 + '\\"{' * 100}}
    assert client.post(f"/api/session/{token}/events", json=told).status_code == 204
    long = {"request_id": ID, "value": {"own_words": '[,{"\\' * 30_000}}
    assert client.post(f"/api/session/{token}/steps/information", json=long).json()["accepted"] is True


@pytest.mark.parametrize("kind", ["application/json", "application/JSON", "application/vnd.api+json"])
@pytest.mark.parametrize(
    ("one", "bound"),
    [
        *((b"[]", MOST_CONTAINERS), (b"{}", MOST_CONTAINERS), (b"[" * 9 + b"]" * 9, MOST_CONTAINERS)),
        *((b'["\\\\"]', MOST_CONTAINERS), (b"0", MOST_VALUES), (b'"\\",\\"["', MOST_VALUES)),
    ],
)
def test_json_of_more_things_than_anything_we_ask_for_is_not_parsed(client, link, token, one, bound, kind):
    """256 kB of `[]` held up everybody for 0.17 s, nested ones for 0.34 s, before they were refused."""
    many = b'{"kind": "viewed", "data": {"x": [%b]}}' % b",".join([one] * (bound + 1))
    for path in (f"/api/session/{token}/events", f"/join/{link}", f"/api/session/{token}/steps/information"):
        error = refused(client.post(path, content=many, headers={"content-type": kind}))
        assert (error["field"], str(bound) in error["message"]) == ("body", True)


@pytest.mark.parametrize("separator", [b"&", b"a&", b"a=&"])
def test_a_form_of_more_fields_than_anything_we_ask_for_is_not_parsed(client, link, separator):
    """Empty fields are counted by nobody else: 256 kB of `&` took 0.06 s."""
    form = {"content-type": "application/X-WWW-form-urlencoded; charset=utf-8"}
    answered = client.post(f"/join/{link}", content=separator * 1_001, headers=form)
    assert (answered.status_code, answered.url.path) == (422, f"/join/{link}")
    assert client.post(f"/join/{link}", content=b"language=en" + separator * 900, headers=form).status_code == 303


def test_the_longest_stroke_and_walk_are_read(client, token):
    points, numbers, poses = [[-1.2345, -2.3456]] * MOST_POINTS, [123.456] * MOST_POINTS, [[1.2345] * 3] * MOST_POSES
    stroke = {"request_id": ID, "points": points, "speeds": numbers, "times_s": numbers, "walk": 1}
    walk = {"playback_id": ID, "walk": {"times_s": [1.234] * MOST_POSES, "poses": poses}}
    for path, body in (("stroke", stroke), ("rollout-seen", walk)):
        answered = client.post(f"/api/session/{token}/drawing/information/{path}", json=body)
        assert (answered.status_code, answered.json()["error"]["code"]) == (409, "not_current_step")
    moved = {"seconds": 1234.567, "place": 2, "by": "mouse", "objective": "slower_near_person", "weight": 0.123}
    history = {"weights": {}, "history": [moved] * MOST_CHANGES}  # of sliders that were dragged for minutes
    answered = client.post(f"/api/session/{token}/steps/tuning", json={"request_id": ID, "value": history})
    assert (answered.status_code, answered.json()["error"]["code"]) == (404, "unknown_step")  # read, but not asked for
    LiveAnswer.model_validate(history)


def test_thousands_of_mistakes_are_told_by_their_first():
    wrong, nothing = [None] * MOST_POINTS, [[None, None, None]] * MOST_POSES
    for model, body in (
        (StrokeSent, {"request_id": ID, "points": nothing, "speeds": wrong, "times_s": wrong}),
        (RolloutSeen, {"walk": {"times_s": wrong, "poses": nothing}}),
    ):
        with pytest.raises(ValidationError) as told:
            model.model_validate(body)
        assert told.value.error_count() <= 3


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
        if path.startswith("/api/") and not path.endswith(("/stream", "/video/{side}", "/robot/bundle")):
            for operation in item.values():
                answers = [one.get("content", {}) for status, one in operation["responses"].items() if status == "200"]
                assert all("$ref" in one["application/json"]["schema"] for one in answers), path
    page = lab.get("/api/docs").text
    assert "POST /api/session/{token}/steps/{key}" in page
    assert "export type AnswerSent = " in page
    lab.cookies.clear()
    assert visitor.get("/api/docs/openapi.json").status_code == 401
    assert visitor.get("/api/docs").status_code in (303, 401)


def test_steps_and_answers_are_unions_by_kind_made_of_what_the_kinds_say(lab):
    """Whoever adds a kind touches no list: it is published because its file is there."""
    schemas = lab.get("/api/docs/openapi.json").json()["components"]["schemas"]
    steps, answers = schemas["StepNow"]["discriminator"]["mapping"], schemas["AnswerSent"]["discriminator"]["mapping"]
    assert set(answers) == set(KINDS)
    assert set(steps) == {*KINDS, "paused", "withdrawn", "expired", "screened_out", "too_soon"}
    for name, kind in KINDS.items():
        sent, told = (schemas[one[name].rpartition("/")[2]]["properties"] for one in (answers, steps))
        assert sent["value"]["$ref"] == f"#/components/schemas/{kind.answers.__name__}"
        progress = kind.progress_model
        shown = json.dumps(told["trial"])
        assert (progress.__name__ in shown) if progress else told["trial"]["type"] == "null"
        assert set(kind.besides.model_fields) <= set(told)
    rating = schemas["RatingAnswer"]
    assert (rating["properties"]["rating"]["type"], rating["required"]) == ("integer", ["rating"])
    own = [schemas[of.rpartition("/")[2]] for of in (*steps.values(), *answers.values())]
    assert [name for one in own for name, of in one["properties"].items() if is_open(of)] == []


def is_open(schema):
    """Whether anything at all would fit."""
    open_object = (
        schema.get("type") == "object" and not schema.get("properties") and "additionalProperties" not in schema
    )
    return open_object or not set(schema) & {"type", "$ref", "anyOf", "oneOf", "enum", "const"}


@pytest.mark.parametrize(
    ("step", "sent", "field", "value", "told"),
    [
        ("consent", {}, "value.given", None, "must be true; who does not agree leaves the study"),
        ("consent", {"given": "yes"}, "value.given", "yes", "must be true; who does not agree leaves the study"),
        ("consent", {"given": True, "purposes": [1]}, "value.purposes", None, "true or false"),
        ("demographics", {"age": 3.5}, "value.age", 3.5, "must be a whole number"),
        ("block.01", {}, "value.choice", None, "must be 'a' or 'b'"),
        ("block.01", {"choice": "c"}, "value.choice", "c", "must be 'a' or 'b'"),
    ],
)
def test_what_does_not_fit_the_kinds_answer_is_refused_with_field_value_and_what_would_work(
    client, link, step, sent, field, value, told
):
    token = client.post(f"/join/{link}", json={"language": "en", "simulated": True}).json()["token"]
    api = f"/api/session/{token}"
    for key in ("information", "consent", "demographics", "instruction"):
        if key == step:
            break
        assert submit(client, token, key, VALUES[key]).status_code == 200
    if step == "block.01":
        trial = client.post(f"{api}/trials/{step}/start", json={}).json()["step"]["trial"]
        for side in "ab":
            body = {"side": side, "playback_id": trial["playback_id"]}
            trial = client.post(f"{api}/trials/{step}/seen", json=body).json()["step"]["trial"]
    if step == "demographics":
        sent = VALUES[step] | sent
    error = refused(submit(client, token, step, sent))
    assert (error["code"], error["field"], error["value"]) == ("bad_value", field, value)
    assert told in error["message"]
    assert client.get(api).json()["step"]["key"] == step


def test_an_answer_may_say_its_kind_and_then_it_must_be_the_steps(client, token):
    body = {"request_id": ID, "kind": "rating", "value": {"rating": 3}}
    error = refused(client.post(f"/api/session/{token}/steps/information", json=body))
    assert (error["field"], error["value"]) == ("kind", "rating")
    assert "information" in error["message"]
    body = {"request_id": ID, "kind": "information", "value": {"of": "an older page"}}
    assert client.post(f"/api/session/{token}/steps/information", json=body).json()["accepted"] is True


def test_the_modules_of_kinds_are_checked_against_their_own_answers():
    """`make lint` makes these types and checks the modules; the file is not kept, as it names every kind."""
    types = types_now()
    assert "export interface AnswerSent" not in types
    assert "export type AnswerSent = AppointmentAnswerSent | " in types
    assert "export interface RatingAnswer {\n  /** 1 to the scale's points */\n  rating: number;\n}" in types
    kept = subprocess.run(["git", "ls-files", "frontend/static/js/contract.d.ts"], cwd=ROOT, capture_output=True)
    assert kept.stdout == b""
    for name in KINDS:
        module = (ROOT / "frontend/static/js/kinds" / f"{name}.js").read_text()
        assert f'KindPage<"{name}">' in module or "export { mount } from" in module
