"""Second factor: an app's code after the password, each once; recovery codes; who has to have one."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from datetime import timedelta

import pyotp
import pytest
from fastapi.testclient import TestClient
from limits import parse
from sqlalchemy import select, update

from desirepath.store.models import Audit, RecoveryCode, SecondFactor, SignInUnderWay, utc_now
from desirepath.web.application import create_application
from desirepath.web.core import second_factor
from desirepath.web.core.auth import change_password
from desirepath.web.core.second_factor import STEP_S, matching_step
from desirepath.web.core.sign_ins import COOKIE
from desirepath.web.core.throttle import limiter_for
from desirepath.web.lab import account_pages
from tests.web.lab_services import PASSWORD, csrf, sign_in

HERE = "/lab/account/second-factor"


def code_of(secret: str, later_steps: int = 0) -> str:
    return pyotp.TOTP(secret).at(utc_now() + timedelta(seconds=STEP_S * later_steps))


def forget_used(services) -> None:
    """As if the last code had been used some minutes ago."""
    with services.database.transaction() as s:
        s.execute(update(SecondFactor).values(last_step=0))


def recovery_codes(page: str) -> list[str]:
    return re.findall(r"<code[^>]*>([a-z0-9-]{19})</code>", page)


@pytest.fixture
def factor(lab, lab_services):
    """The experimenter's app; its secret and the recovery codes."""
    assert lab.post(f"{HERE}/begin", data={"csrf": csrf(lab), "password": PASSWORD}).status_code == 303
    page = lab.get(HERE).text
    secret = re.search(r'id="secret" value="([A-Z2-7]{32})"', page).group(1)
    assert "<svg" in page
    done = lab.post(f"{HERE}/confirm", data={"csrf": csrf(lab), "code": code_of(secret)})
    assert done.status_code == 200
    forget_used(lab_services)
    return secret, recovery_codes(done.text)


@pytest.fixture
def browser(lab_services):
    return TestClient(create_application(lab_services), follow_redirects=False)


def user_id(services) -> str:
    with services.database.session() as s:
        return s.scalars(select(SecondFactor.user_id)).one()


def half_in(browser) -> TestClient:
    said = browser.post("/lab/sign-in", data={"name": "experimenter", "password": PASSWORD, "next": "/lab/jobs"})
    assert (said.status_code, said.headers["location"]) == (303, "/lab/sign-in/code")
    return browser


def enter(browser, code: str) -> int:
    return browser.post("/lab/sign-in/code", data={"code": code}).status_code


def test_the_codes_are_those_of_rfc_6238():
    """Appendix B's secret and time 59 s; apps show the last six of its eight digits."""
    secret = "GEZDGNBVGY3TQOJQGEZDGNBVGY3TQOJQ"
    at = utc_now().fromtimestamp(59, tz=utc_now().tzinfo)
    assert matching_step(secret, "287 082", at) == 1
    assert matching_step(secret, "287083", at) is None


def test_the_password_alone_opens_nothing_any_more(factor, browser):
    half_in(browser)
    assert COOKIE not in browser.cookies
    assert browser.get("/lab/studies").headers["location"].startswith("/lab/sign-in")
    assert enter(browser, "000000") == 401
    said = browser.post("/lab/sign-in/code", data={"code": code_of(factor[0])})
    assert (said.status_code, said.headers["location"]) == (303, "/lab/jobs")
    assert browser.get("/lab/studies").status_code == 200


def test_a_code_opens_once_and_an_earlier_one_not_after_it(factor, browser, lab_services):
    secret, _ = factor
    now = code_of(secret)
    assert enter(half_in(browser), now) == 303
    watcher = half_in(TestClient(create_application(lab_services), follow_redirects=False))
    assert enter(watcher, now) == 401
    assert enter(watcher, code_of(secret, -1)) == 401
    assert COOKIE not in watcher.cookies
    assert enter(watcher, code_of(secret, 1)) == 303  # the next one does


def test_a_recovery_code_opens_once(factor, browser, lab_services, lab):
    codes = factor[1]
    assert (len(codes), len(set(codes))) == (8, 8)
    assert enter(half_in(browser), codes[0].upper().replace("-", " ")) == 303
    assert "7 recovery codes are left" in browser.get("/lab/account").text
    again = half_in(TestClient(create_application(lab_services), follow_redirects=False))
    assert enter(again, codes[0]) == 401
    with lab_services.database.session() as s:
        assert all(len(one) == 32 for one in s.scalars(select(RecoveryCode.code_hash)))
        entered = s.scalars(select(Audit).where(Audit.action == "signed_in").order_by(Audit.id.desc())).first()
        assert entered.data == {"method": "password", "second_factor": "recovery_code"}
        refused = s.scalars(select(Audit).where(Audit.action == "code_refused")).one()
        assert (refused.by, refused.outcome, refused.data) == ("experimenter", "refused", {})


def test_guessing_codes_is_stopped_though_the_password_is_right_each_time(factor, browser, lab_services):
    for _ in range(5):
        assert enter(half_in(browser), "000000") == 401
    stopped = half_in(browser).post("/lab/sign-in/code", data={"code": code_of(factor[0])})
    assert (stopped.status_code, int(stopped.headers["retry-after"]) > 0) == (429, True)
    lab_services.limiter = limiter_for(None)  # as after a restart
    assert enter(browser, code_of(factor[0])) == 303


def test_a_sign_in_under_way_is_this_browsers_and_ends(factor, browser, lab_services):
    half_in(browser)
    stranger = TestClient(create_application(lab_services), follow_redirects=False)
    assert stranger.get("/lab/sign-in/code").headers["location"] == "/lab/sign-in"
    said = stranger.post("/lab/sign-in/code", data={"code": code_of(factor[0])})
    assert (said.headers["location"], COOKIE in stranger.cookies) == ("/lab/sign-in", False)
    assert browser.get("/lab/sign-in/code").status_code == 200
    foreign = {"Sec-Fetch-Site": "cross-site"}
    refused = browser.post("/lab/sign-in/code", data={"code": code_of(factor[0])}, headers=foreign)
    assert refused.status_code == 403
    with lab_services.database.transaction() as s:
        s.execute(update(SignInUnderWay).values(expires_at=utc_now() - timedelta(seconds=1)))
    said = browser.post("/lab/sign-in/code", data={"code": code_of(factor[0])})
    assert (said.headers["location"], COOKIE in browser.cookies) == ("/lab/sign-in", False)


def test_a_new_password_and_signing_out_everywhere_end_what_waits_for_a_code(
    factor, lab, lab_services, as_role, browser
):
    def waiting():
        return half_in(TestClient(create_application(lab_services), follow_redirects=False))

    thief, ada = waiting(), as_role("owner")
    ada.post("/lab/settings/accounts/experimenter/sign-out", data={"csrf": csrf(ada)})
    changed, code = waiting(), code_of(factor[0])
    change_password(lab_services.database, user_id(lab_services), PASSWORD, "another long password")
    for one in (thief, changed):
        said = one.post("/lab/sign-in/code", data={"code": code})
        assert (said.headers["location"], COOKIE in one.cookies) == ("/lab/sign-in", False)


def test_setting_it_up_needs_the_password_and_a_right_code_and_signs_others_out(lab, lab_services, browser):
    sign_in(browser)
    token = csrf(lab)
    assert lab.post(f"{HERE}/begin", data={"csrf": token, "password": "guess"}).status_code == 422
    assert lab.post(f"{HERE}/confirm", data={"csrf": token, "code": "000000"}).status_code == 422  # nothing begun
    assert lab.post(f"{HERE}/begin", data={"csrf": token, "password": PASSWORD}).status_code == 303
    assert lab.post(f"{HERE}/confirm", data={"csrf": token, "code": "000000"}).status_code == 422
    with lab_services.database.session() as s:
        waiting = s.scalars(select(SecondFactor)).one()
        assert not second_factor.has_second_factor(s, waiting.user_id)
    assert browser.get("/lab/studies").status_code == 200
    done = lab.post(f"{HERE}/confirm", data={"csrf": token, "code": code_of(waiting.secret)})
    assert len(recovery_codes(done.text)) == 8
    assert browser.get("/lab/studies").status_code == 303
    assert lab.get("/lab/studies").status_code == 200
    page = lab.get(HERE).text
    assert waiting.secret not in page  # told once
    assert recovery_codes(page) == []
    assert lab.post(f"{HERE}/begin", data={"csrf": token, "password": PASSWORD}).status_code == 422


def test_it_is_removed_and_codes_are_renewed_only_with_a_code(factor, lab, lab_services, browser):
    secret, before = factor
    token = csrf(lab)
    for what in ("remove", "codes"):
        assert lab.post(f"{HERE}/{what}", data={"csrf": token, "code": "000000"}).status_code == 422
    renewed = lab.post(f"{HERE}/codes", data={"csrf": token, "code": code_of(secret)})
    codes = recovery_codes(renewed.text)
    assert len(codes) == 8
    assert lab.post(f"{HERE}/remove", data={"csrf": token, "code": before[0]}).status_code == 422
    assert lab.post(f"{HERE}/remove", data={"csrf": token, "code": codes[0]}).status_code == 303
    sign_in(browser)
    with lab_services.database.session() as s:
        done = [one.action for one in s.scalars(select(Audit).where(Audit.outcome == "done").order_by(Audit.id))]
    assert [a for a in done if "factor" in a or "codes" in a] == [
        "second_factor_set",
        "recovery_codes_renewed",
        "second_factor_removed",
    ]


def test_a_signed_in_browser_cannot_guess_for_days(factor, lab, lab_services, monkeypatch):
    monkeypatch.setattr(account_pages, "PROOFS", parse("1000 per 1 minute"))
    monkeypatch.setattr(account_pages, "PROOFS_A_DAY", parse("3 per 1 day"))
    token = csrf(lab)
    guessed = [lab.post(f"{HERE}/remove", data={"csrf": token, "code": "000000"}).status_code for _ in range(3)]
    assert guessed == [422, 422, 422]
    stopped = lab.post(f"{HERE}/remove", data={"csrf": token, "code": code_of(factor[0])})
    assert stopped.status_code == 429
    assert "Try again in 24 h." in stopped.text


@pytest.mark.parametrize(
    ("policy", "viewer", "owner"), [("offered", 200, 200), ("owners", 200, 303), ("everybody", 303, 303)]
)
def test_who_has_to_have_one_is_led_there_before_anything_else(lab, lab_services, as_role, policy, viewer, owner):
    ada = as_role("viewer")
    lab_services.settings.second_factor = policy
    assert (ada.get("/lab/studies").status_code, lab.get("/lab/studies").status_code) == (viewer, owner)
    if owner == 303:
        assert lab.get("/lab/settings").headers["location"] == HERE
        assert lab.get("/api/lab/studies/x/monitor").status_code == 403
        assert lab.post("/lab/settings", data={"csrf": csrf(lab, HERE)}).headers["location"] == HERE
        assert lab.get(HERE).status_code == 200


def test_owners_of_one_study_count_as_owners(colleague, lab_services):
    owner, analyst = colleague("member", "owner"), colleague("member", "analyst")
    lab_services.settings.second_factor = "owners"
    assert owner.get("/lab/studies").headers["location"] == HERE
    assert analyst.get("/lab/studies").status_code == 200


def test_who_lost_everything_is_helped_by_an_owner_or_where_the_server_runs(
    factor, lab, lab_services, as_role, browser
):
    ada = as_role("owner")
    removed = ada.post("/lab/settings/accounts/experimenter/second-factor/remove", data={"csrf": csrf(ada)})
    assert removed.status_code == 303
    sign_in(browser)
    assert (
        lab.post("/lab/settings/accounts/experimenter/second-factor/remove", data={"csrf": csrf(lab)}).status_code
        == 422
    )
    assert browser.post(f"{HERE}/begin", data={"csrf": csrf(browser), "password": PASSWORD}).status_code == 303
    with lab_services.database.transaction() as s:
        second_factor.confirm(
            s, s.scalars(select(SecondFactor.user_id)).one(), code_of(s.scalars(select(SecondFactor.secret)).one())
        )
    line = [sys.executable, "-m", "desirepath", "password", "--without-second-factor", "--json"]
    environment = {**os.environ, "DESIREPATH_DATA": str(lab_services.settings.data)}
    told = json.loads(subprocess.run(line, env=environment, capture_output=True, text=True, check=True).stdout)
    sign_in(browser, password=told["password"])
