"""Logs as JSON: every line is one object, and nothing in any of them opens a door."""

from __future__ import annotations

import io
import json
import logging
import sys

import pytest
import structlog

from desirepath.cli.output import log_to_stderr
from desirepath.store.scrubbing import TAKEN_OUT
from desirepath.web.core.sign_ins import COOKIE
from tests.web.lab_services import PASSWORD, csrf


@pytest.fixture
def recorded(monkeypatch):
    """Call it in the test (before, pytest's own capture takes the stream back); then a function that reads what was
    logged since, a dictionary per line."""
    stream, root, before = io.StringIO(), logging.getLogger(), structlog.get_config()
    handlers = list(root.handlers)

    def begin():
        monkeypatch.setenv("DESIREPATH_LOGS", "json")
        monkeypatch.setattr(sys, "stderr", stream)
        root.handlers.clear()
        log_to_stderr()
        return lambda: [json.loads(line) for line in stream.getvalue().splitlines()]

    yield begin
    root.handlers[:] = handlers
    structlog.configure(**before)


def test_no_token_password_or_cookie_of_a_whole_visit_is_in_the_log(recorded, visitor, lab_services):
    lines = recorded()
    visitor.post("/lab/sign-in", data={"name": "experimenter", "password": "not the right one"})
    visitor.post("/lab/sign-in", data={"name": "experimenter", "password": PASSWORD})
    cookie, form = visitor.cookies[COOKIE], csrf(visitor)
    visitor.get(f"/lab/studies?token={cookie}")
    visitor.get(f"/p/{cookie}")  # as a participant's link, which is a token of the same form
    visitor.get(f"/api/session/{cookie}", headers={"Authorization": f"Bearer {cookie}"})
    visitor.post("/lab/password", data={"csrf": form, "current": "not the right one", "new": PASSWORD, "again": "x"})
    found = lines()
    assert [one["route"] for one in found if one["event"] == "request"].count("/lab/sign-in") == 2
    for hidden in (PASSWORD, "not the right one", cookie, form):
        assert hidden not in json.dumps(found)


def test_what_a_careless_line_or_another_library_says_is_taken_out(recorded):
    lines = recorded()
    secret = "gR7k2p0Zq-4fXwT1"
    log = structlog.get_logger("desirepath.web")
    log.info("careless", password=secret, recovery_codes=[secret], headers={"Cookie": secret}, route=f"/p/{secret}")
    log.info(
        f"GET /join/{secret}?csrf={secret}", problem=f"postgresql://web:{secret}@db/x", jwt=f"eyJhbGciOiJ9.{secret}.x"
    )
    logging.getLogger("httpx").warning("Authorization: Bearer %s, cookie desirepath_sign_in=%s;", secret, secret)
    try:
        raise RuntimeError(f"cannot reach postgresql://web:{secret}@db")
    except RuntimeError:
        log.exception("broke")
        logging.getLogger("other").exception("broke")
    log.info(
        "further", at=f"1HTTP://web:{secret}@db", cookie_of=f"desirepath_joined_1a2b3c4d={secret}", by=f"-eyJ{secret}"
    )
    found = lines()
    last = found.pop()
    assert all(TAKEN_OUT in last[name] and secret not in last[name] for name in ("at", "cookie_of", "by"))
    assert len(found) == 5
    assert secret not in json.dumps(found)
    assert json.dumps(found).count(TAKEN_OUT) >= 10
    assert [one["level"] for one in found] == ["info", "info", "warning", "error", "error"]
    assert all("timestamp" in one for one in found)
