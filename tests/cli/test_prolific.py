"""Places, approvals and bonuses at Prolific, whose interface stands here on loopback as its description has it."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest
from sqlalchemy import select
from typer.testing import CliRunner, Result

from desirepath.cli.main import app
from desirepath.cli.study import open_store
from desirepath.installed import PROTOCOLS
from desirepath.settings import get_settings
from desirepath.store.models import Audit, Participant, RecruitingId, Session, utc_now

TOKEN, THERE = "kept-secret-token", "60f6acb180a7b59ac0621f9e"
STATES = {"done-1": "completed", "done-2": "completed", "gone-3": "withdrawn"}
RUN = CliRunner()


@dataclass
class Stub:
    """What docs.prolific.com says of these requests. `heard`: method, path and body of each; answers: path -> what is
    answered instead, as (status, body)."""

    places: int = 10
    status: dict[str, str] = field(
        default_factory=lambda: {"done-1": "AWAITING REVIEW", "done-2": "APPROVED", "else-9": "AWAITING REVIEW"}
    )
    heard: list[tuple[str, str, Any]] = field(default_factory=list)
    answers: dict[str, tuple[int, bytes]] = field(default_factory=dict)

    def answer(self, method: str, path: str, body: Any) -> tuple[int, Any]:
        query = {name: values[0] for name, values in parse_qs(urlsplit(path).query).items()}
        self.heard.append((method, path, body))
        match method, urlsplit(path).path:
            case "GET", "/api/v1/submissions/" if query["study"] == THERE:
                size, page = int(query["page_size"]), int(query["page"])
                rows = [
                    {"id": f"submission-of-{who}", "participant_id": who, "status": of, "study_id": THERE}
                    for who, of in self.status.items()
                ]
                return 200, {"results": rows[(page - 1) * size : page * size]}
            case "GET", path if path == f"/api/v1/studies/{THERE}/":
                return 200, {"id": THERE, "total_available_places": self.places}
            case "PATCH", path if path == f"/api/v1/studies/{THERE}/":
                self.places = body["total_available_places"]
                return 200, {"id": THERE, "total_available_places": self.places}
            case "POST", "/api/v1/submissions/bulk-approve/":
                return 200, "The request to bulk approve has been made successfully."
            case "POST", "/api/v1/submissions/bonus-payments/":
                amount = sum(float(line.split(",")[1]) for line in body["csv_bonuses"].splitlines()) * 100
                told = {"id": "bulk-1", "study": body["study_id"], "amount": amount, "fees": 10, "vat": 2}
                return 201, told | {"total_amount": amount + 12}
            case "POST", "/api/v1/bulk-bonus-payments/bulk-1/pay/":
                return 202, "Bulk bonus payment is being processed asynchronously."
        return 404, {"error": {"detail": "Not found"}}


@pytest.fixture
def stub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stub]:
    told = Stub()

    class Handler(BaseHTTPRequestHandler):
        def _any(self) -> None:
            length = int(self.headers.get("Content-Length") or 0)
            body = json.loads(self.rfile.read(length)) if length else None
            status, answer = told.answers.get(urlsplit(self.path).path) or told.answer(self.command, self.path, body)
            if self.headers["Authorization"] != f"Token {TOKEN}":
                status, answer = 401, {"error": {"detail": "Authentication credentials were not provided."}}
            content = answer if isinstance(answer, bytes) else json.dumps(answer).encode()
            self.send_response(status)
            if status == 302:
                self.send_header("Location", "http://127.0.0.1:9/")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        do_GET = do_POST = do_PATCH = _any

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    monkeypatch.setenv("DESIREPATH_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("DESIREPATH_PROLIFIC_URL", f"http://127.0.0.1:{server.server_port}")
    monkeypatch.setenv("DESIREPATH_PROLIFIC_TOKEN_FILE", str(file))
    get_settings.cache_clear()
    yield told
    server.shutdown()
    server.server_close()
    get_settings.cache_clear()


@pytest.fixture
def study(stub: Stub) -> str:
    """A live study with three people whom Prolific sent, and a pilot."""
    protocol = str(PROTOCOLS / "quick_demonstration_study.yaml")
    made = json.loads(RUN.invoke(app, ["studies", "create", protocol, "--live", "--json"]).stdout)["study"]
    database, _ = open_store()
    with database.transaction() as s:
        for k, (who, state) in enumerate([*STATES.items(), ("pilot-4", "completed")]):
            person = Participant(study_id=made, code=f"P{k}", pilot=who.startswith("pilot"))
            s.add(person)
            s.flush()
            mine = {"participant_id": person.id, "study_id": made}
            s.add(Session(**mine, plan=[], seed=k, state=state, token_hash=f"{k}" * 64, expires_at=utc_now()))
            details = {"study": THERE, "session": f"submission-of-{who}"}
            s.add(RecruitingId(**mine, platform="prolific", external_id=who, details=details))
    return made


def ask(*words: str) -> Result:
    told = RUN.invoke(app, ["prolific", *words, "--json"])
    assert TOKEN not in told.stdout + told.stderr
    return told


def test_nothing_is_sent_until_it_is_said(stub: Stub, study: str):
    for words in (["list", study], ["places", study, "20"], ["approve", study], ["bonus", study, "--amount", "1.5"]):
        told = ask(*words)
        assert told.exit_code == 0, told.stderr
        assert json.loads(told.stdout)["sent"] is False
        assert "Nothing was sent" in told.stderr
    (call,) = json.loads(ask("bonus", study, "--amount", "1.5").stdout)["would_send"]
    assert call["body"] == {"study_id": THERE, "csv_bonuses": "done-1,1.50\ndone-2,1.50"}
    (call,) = json.loads(ask("approve", study).stdout)["would_send"]
    assert call["body"] == {"submission_ids": ["submission-of-done-1", "submission-of-done-2"]}
    assert json.loads(ask("pay", study, "bulk-1").stdout)["sent"] is False
    assert stub.heard == []


def test_who_completed_here_and_waits_there_is_approved(stub: Stub, study: str):
    told = json.loads(ask("approve", study, "--send").stdout)
    assert told == {"study": study, "approved": 1, "completed_here": 2}
    assert stub.heard[-1] == (
        "POST",
        "/api/v1/submissions/bulk-approve/",
        {"submission_ids": ["submission-of-done-1"]},
    )
    listed = {row["participant"]: row for row in json.loads(ask("list", study, "--send").stdout)["participants"]}
    assert {who: (row["here"], row["there"]) for who, row in listed.items()} == {
        "done-1": ("completed", "AWAITING REVIEW"),
        "done-2": ("completed", "APPROVED"),
        "gone-3": ("withdrawn", None),
        "else-9": (None, "AWAITING REVIEW"),
    }
    stub.status = {f"other-{k}": "ACTIVE" for k in range(230)}
    assert len(json.loads(ask("list", study, "--send").stdout)["participants"]) == 233
    assert [path.partition("page=")[2] for method, path, _ in stub.heard[-3:] if method == "GET"] == [
        f"{page}&page_size=100" for page in (1, 2, 3)
    ]


def test_places_only_become_more(stub: Stub, study: str):
    assert json.loads(ask("places", study, "12", "--send").stdout) == {"study": study, "places": 12, "before": 10}
    refused = ask("places", study, "12", "--send")
    assert refused.exit_code == 1
    assert "there are 12 places already" in json.loads(refused.stdout)["error"]


def test_a_bonus_is_set_up_then_paid_once(stub: Stub, study: str):
    (set_up,) = json.loads(ask("bonus", study, "--amount", "1,5", "--send").stdout)["set_up_amounts_in_cents"]
    assert set_up == {"id": "bulk-1", "amount": 300.0, "fees": 10, "vat": 2, "total_amount": 312.0}
    assert json.loads(ask("pay", study, "bulk-1", "--send").stdout) == {"study": study, "paid": "bulk-1"}
    refused = ask("pay", study, "bulk-1", "--send")
    assert refused.exit_code == 1
    assert "was sent before" in json.loads(refused.stdout)["error"]
    assert sum(path.endswith("/pay/") for _, path, _ in stub.heard) == 1
    database, _ = open_store()
    with database.session() as s:
        noted = [(one.action, one.data) for one in s.scalars(select(Audit).where(Audit.action.like("prolific%")))]
    assert sorted(action for action, _ in noted) == ["prolific_bonus_paid", "prolific_bonus_set_up"]
    assert "done-1" not in json.dumps(noted)


def test_a_payment_that_was_lost_on_the_way_is_not_sent_again(stub: Stub, study: str):
    stub.answers["/api/v1/bulk-bonus-payments/bulk-1/pay/"] = (500, b"oh")
    assert "answered 500: oh" in json.loads(ask("pay", study, "bulk-1", "--send").stdout)["error"]
    assert "was sent before" in json.loads(ask("pay", study, "bulk-1", "--send").stdout)["error"]
    del stub.answers["/api/v1/bulk-bonus-payments/bulk-1/pay/"]
    assert ask("pay", study, "bulk-1", "--send", "--again").exit_code == 0


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ((200, b"x" * 3_000_000), "more than 2097152 bytes"),
        ((200, b"<html>"), "no JSON"),
        ((200, b"[" * 100_000), "no JSON"),
        ((200, b"[]"), "no JSON object"),
        ((200, b'{"results": 3}'), "no list `results`"),
        ((302, b""), "answered 302"),
        ((401, f"no: Token {TOKEN} \x1b[31m".encode()), "answered 401: no: Token ***"),
    ],
)
def test_a_bad_answer_is_refused_and_repeats_no_token(stub: Stub, study: str, answer: tuple[int, bytes], says: str):
    stub.answers["/api/v1/submissions/"] = answer
    told = ask("approve", study, "--send")
    assert told.exit_code == 1
    assert says in json.loads(told.stdout)["error"]
    assert "\x1b" not in json.loads(told.stdout)["error"]
    assert not any(method == "POST" for method, _, _ in stub.heard)


def test_what_cannot_be_asked_is_said_before_anything_is_sent(
    stub: Stub, study: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    for words, says in (
        (["bonus", study, "--amount", "1e9"], "amount = '1e9'"),
        (["bonus", study, "--amount", "0"], "amount = '0'"),
        (["pay", study, "../../users/me"], "bulk payment = '../../users/me'"),
        (["list", study, "--there", "a/b", "--send"], "study = 'a/b'"),
        (["approve", "nope"], "no study with id 'nope'"),
    ):
        assert says in json.loads(ask(*words).stdout)["error"]
    database, _ = open_store()
    with database.transaction() as s:
        one = s.scalars(select(RecruitingId).where(RecruitingId.external_id == "gone-3")).one()
        one.details = {"study": "another"}
    assert "came from 2 studies there" in json.loads(ask("approve", study).stdout)["error"]
    for name, value, says in (
        ("DESIREPATH_PROLIFIC_URL", "http://api.example", "must begin with https://"),
        ("DESIREPATH_PROLIFIC_TOKEN_FILE", str(tmp_path / "none"), "cannot be read"),
    ):
        with monkeypatch.context() as changed:
            changed.setenv(name, value)
            get_settings.cache_clear()
            told = ask("approve", study, "--there", THERE, "--send")
            assert says in json.loads(told.stdout)["error"], told.stdout
    get_settings.cache_clear()
    assert TOKEN not in repr(get_settings())
    assert stub.heard == []
