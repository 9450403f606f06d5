"""Accounts: who gets in, who does not, and what a browser may do for somebody who is signed in."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from types import SimpleNamespace

import pytest
from argon2 import PasswordHasher
from fastapi.testclient import TestClient
from sqlalchemy import select, update

from desirepath.settings import Settings
from desirepath.store.models import Event, Setting, SignIn, User, utc_now
from desirepath.web.application import build_services, create_application
from desirepath.web.core import auth
from desirepath.web.core.auth import (
    AccountError,
    add_user,
    check_owner_left,
    ensure_first_user,
    safe_next,
    set_role,
)
from desirepath.web.core.sign_ins import COOKIE, DEVICE_COOKIE, find_device
from desirepath.web.core.throttle import limiter_for
from tests.web.lab_services import PASSWORD, csrf, sign_in

OPEN_TO_ALL = {
    *("/lab/sign-in", "/lab/sign-in/code", "/lab/sign-in/once", "/lab/language/{code}"),
    *("/lab/sign-in/openid", "/lab/sign-in/openid/return"),
}


def test_first_start_makes_one_user_with_a_random_password_that_is_told_once(tmp_path):
    installations = [build_services(Settings(data=tmp_path / name, _env_file=None)) for name in ("one", "two")]
    first, second = (ensure_first_user(services.database) for services in installations)
    assert len({first, second}) == 2
    assert len(first) >= 20
    assert ensure_first_user(installations[0].database) is None
    with installations[0].database.session() as s:
        user = s.scalars(select(User)).one()
    assert user.name == "experimenter"
    assert user.password_hash.startswith("$argon2id$")
    assert first not in user.password_hash


def test_passwords_are_hashed_at_the_cost_that_rfc_9106_names_for_little_memory(cheap_passwords):
    assert cheap_passwords.hash("seven quiet robots").startswith("$argon2id$v=19$m=65536,t=3,p=4$")


def test_printed_password_opens_nothing_but_the_page_that_changes_it(tmp_path):
    services = build_services(Settings(data=tmp_path, _env_file=None))
    printed = ensure_first_user(services.database)
    with TestClient(create_application(services), follow_redirects=False) as browser:
        sign_in(browser, password=printed)
        assert browser.get("/lab/studies").headers["location"] == "/lab/password"
        assert browser.get("/api/lab/studies/x/monitor").status_code == 403
        token = csrf(browser)

        def change(new: str, again: str | None = None, current: str = printed) -> int:
            form = {"csrf": token, "current": current, "new": new, "again": again or new}
            return browser.post("/lab/password", data=form).status_code

        assert change("short") == 422
        assert change(PASSWORD, again="another long one") == 422
        assert change(PASSWORD, current="not the current one") == 422
        assert change(printed) == 422
        assert browser.get("/lab/studies").status_code == 303
        assert change(PASSWORD) == 303
        assert browser.get("/lab/studies").status_code == 200
        assert browser.post("/lab/sign-in", data={"name": "experimenter", "password": printed}).status_code == 401


def test_changing_the_password_signs_other_browsers_out(lab, lab_services):
    with TestClient(create_application(lab_services), follow_redirects=False) as other:
        sign_in(other)
        form = {"csrf": csrf(lab), "current": PASSWORD, "new": "eight quiet robots", "again": "eight quiet robots"}
        assert lab.post("/lab/password", data=form).status_code == 303
        assert lab.get("/lab/studies").status_code == 200
        assert other.get("/lab/studies").status_code == 303


def test_wrong_password_and_unknown_name_get_the_same_answer(visitor, lab_services):
    wrong = visitor.post("/lab/sign-in", data={"name": "experimenter", "password": "not it at all"})
    unknown = visitor.post("/lab/sign-in", data={"name": "nobody", "password": "not it at all"})
    assert (wrong.status_code, unknown.status_code) == (401, 401)
    assert wrong.text.replace('value="experimenter"', 'value="nobody"') == unknown.text
    assert COOKIE not in visitor.cookies
    with lab_services.database.session() as s:
        refused = list(s.scalars(select(Event).where(Event.kind == "sign_in_refused")))
    assert [event.data for event in refused] == [{}, {}]


def test_too_many_wrong_passwords_are_stopped_and_told_how_long(visitor, lab_services):
    answers = [visitor.post("/lab/sign-in", data={"name": "experimenter", "password": "guess"}) for _ in range(11)]
    assert [a.status_code for a in answers] == [401] * 10 + [429]
    assert 0 < int(answers[-1].headers["retry-after"]) <= 300
    even_the_right_one = visitor.post("/lab/sign-in", data={"name": "experimenter", "password": PASSWORD})
    assert even_the_right_one.status_code == 429
    lab_services.limiter = limiter_for(None)  # as after a restart
    sign_in(visitor)


def test_guesses_at_the_same_moment_are_no_more_than_one_after_the_other(visitor):
    """35 of 60 got through where 10 should: each was checked before any of them had been counted."""

    def guess(k):
        return visitor.post("/lab/sign-in", data={"name": "experimenter", "password": f"guess {k}"}).status_code

    with ThreadPoolExecutor(20) as pool:
        answers = list(pool.map(guess, range(30)))
    assert (answers.count(401), answers.count(429)) == (10, 20)


def test_of_an_ipv6_network_all_addresses_are_one(lab_services):
    """Everybody there chooses the other half anew for every guess."""
    application = create_application(lab_services)

    def guess(address, name="experimenter"):
        there = TestClient(application, follow_redirects=False, client=(address, 4000))
        return there.post("/lab/sign-in", data={"name": name, "password": "guess"}).status_code

    assert [guess(f"2001:db8:1:2::{k:x}") for k in range(11)] == [401] * 10 + [429]
    assert guess("2001:db8:1:3::1") == 401
    assert [guess("::ffff:198.51.100.1", "nobody"), guess("198.51.100.1", "nobody")] == [401, 401]


def test_the_current_password_cannot_be_guessed_by_a_stolen_sign_in(lab, lab_services):
    """It was checked without limit: all at the same moment, by two browsers of the account, and on every page that asks
    for it."""
    other = sign_in(TestClient(create_application(lab_services), follow_redirects=False))
    forms = [
        (one, {"csrf": csrf(one), "new": "a new long password", "again": "a new long password"}) for one in (lab, other)
    ]

    def guess(k):
        browser, form = forms[k % 2]
        return browser.post("/lab/password", data={**form, "current": f"guess {k}"}).status_code

    with ThreadPoolExecutor(20) as pool:
        answers = list(pool.map(guess, range(30)))
    assert (answers.count(422), answers.count(429)) == (10, 20)
    browser, form = forms[0]
    begin = browser.post("/lab/account/second-factor/begin", data={"csrf": form["csrf"], "password": PASSWORD})
    assert begin.status_code == 429  # the same count
    right = {**form, "current": PASSWORD}
    refused = browser.post("/lab/password", data=right)
    assert refused.status_code == 429
    assert "too many passwords or codes. Nothing was changed. Try again in" in refused.text
    lab_services.limiter = limiter_for(None)  # as after a restart
    assert browser.post("/lab/password", data=right).status_code == 303


def test_a_password_given_meanwhile_is_not_replaced_by_who_knew_the_one_before(lab, lab_services, monkeypatch):
    given = []

    def checked_slowly(known, password):
        right = auth._hasher.verify(known, password)
        given.append(auth.reset_password(lab_services.database, "experimenter"))
        return right

    with lab_services.database.session() as s:
        user_id = s.scalars(select(User.id).where(User.name == "experimenter")).one()
    monkeypatch.setattr(auth, "verify_password", checked_slowly)
    with pytest.raises(AccountError):
        auth.change_password(lab_services.database, user_id, PASSWORD, "a new long password")
    monkeypatch.undo()
    sign_in(lab, password=given[0])


def test_strangers_who_guess_from_many_addresses_lock_nobody_out_who_was_here_before(lab_services):
    """About 50 wrong passwords from many addresses made the right one wait for an hour."""
    application = create_application(lab_services)
    own = TestClient(application, follow_redirects=False, client=("203.0.113.7", 4000))
    sign_in(own)
    own.post("/lab/sign-out", data={"csrf": csrf(own)})
    stranger = {"name": "experimenter", "password": "guess"}
    for k in range(60):
        from_there = TestClient(application, follow_redirects=False, client=(f"198.51.100.{k}", 4000))
        told = from_there.post("/lab/sign-in", data=stranger).status_code
    assert told == 429  # the account's own count is full: new devices wait
    sign_in(own)
    for _ in range(11):
        stolen = own.post("/lab/sign-in", data=stranger).status_code
    assert stolen == 429  # a device that is known has a count of its own


def test_a_device_is_known_until_the_password_changes_and_for_its_account_only(lab_services, lab):
    kept = lab.cookies[DEVICE_COOKIE]
    with lab_services.database.session() as s:
        user = s.scalars(select(User)).one()
    asked = SimpleNamespace(cookies={DEVICE_COOKIE: kept})
    assert find_device(asked, "experimenter", user.password_hash)
    assert find_device(asked, "someone", user.password_hash) is None
    assert find_device(asked, "experimenter", user.password_hash + "x") is None


def test_a_device_is_known_also_where_the_password_was_hashed_anew_at_signing_in(lab_services, visitor):
    with lab_services.database.transaction() as s:
        user = s.scalars(select(User)).one()
        user.password_hash = older = PasswordHasher(time_cost=2, memory_cost=16, parallelism=1).hash(PASSWORD)
    sign_in(visitor)
    with lab_services.database.session() as s:
        renewed = s.scalars(select(User.password_hash)).one()
    assert renewed != older
    asked = SimpleNamespace(cookies={DEVICE_COOKIE: visitor.cookies[DEVICE_COOKIE]})
    assert find_device(asked, "experimenter", renewed)


def test_cookie_is_kept_from_scripts_and_other_sites_and_only_its_hash_is_stored(visitor, lab_services):
    answered = visitor.post("/lab/sign-in", data={"name": "experimenter", "password": PASSWORD})
    cookie = next(one for one in answered.headers.get_list("set-cookie") if one.startswith(f"{COOKIE}="))
    assert "HttpOnly" in cookie
    assert "SameSite=lax" in cookie
    assert "Secure" not in cookie
    token = visitor.cookies[COOKIE]
    with lab_services.database.session() as s:
        stored = s.scalars(select(SignIn)).one()
    assert len(stored.token_hash) == 32
    assert token.encode() not in stored.token_hash


def test_cookie_needs_tls_where_the_public_address_has_it(visitor, lab_services):
    with lab_services.database.transaction() as s:
        s.add(Setting(key="public_url", value={"url": "https://study.example.org"}))
    answered = visitor.post("/lab/sign-in", data={"name": "experimenter", "password": PASSWORD})
    assert "Secure" in answered.headers["set-cookie"]


def test_signing_out_and_time_end_a_sign_in(lab, lab_services):
    token = lab.cookies[COOKIE]
    assert lab.post("/lab/sign-out", data={"csrf": csrf(lab)}).status_code == 303
    lab.cookies.set(COOKIE, token)
    assert lab.get("/lab/studies").headers["location"].startswith("/lab/sign-in")
    lab.cookies.clear()
    sign_in(lab)
    with lab_services.database.transaction() as s:
        s.scalars(select(SignIn)).one().expires_at = utc_now() - timedelta(seconds=1)
    assert lab.get("/lab/studies").status_code == 303


@pytest.mark.parametrize(
    "address",
    [
        "https://evil.example/lab",
        "//evil.example/lab",
        "/\\evil.example",
        "/lab\\..\\evil",
        "/labevil",
        "/p/token",
        "javascript:alert(1)",
        "/lab/../p/token",
        "/lab/\nSet-Cookie: a=b",
        "",
    ],
)
def test_after_signing_in_nobody_is_sent_elsewhere(address):
    assert safe_next(address) == "/lab/studies"


def test_after_signing_in_one_lands_where_one_wanted_to_go(visitor):
    form = {"name": "experimenter", "password": PASSWORD, "next": "//evil.example/lab"}
    assert visitor.post("/lab/sign-in", data=form).headers["location"] == "/lab/studies"
    visitor.cookies.clear()
    asked = visitor.get("/lab/studies/abc/answers?kind=preference&page=2")
    form = visitor.get(asked.headers["location"]).text
    assert 'value="/lab/studies/abc/answers?kind=preference&amp;page=2"' in form


def test_changing_requests_need_this_sign_ins_token_and_our_own_origin(lab, lab_services):
    form = {"address": "", "help_contact": "Ada"}
    assert lab.post("/lab/settings", data=form).status_code == 403
    assert lab.post("/lab/settings", data={**form, "csrf": "x"}).status_code == 403
    with TestClient(create_application(lab_services), follow_redirects=False) as other:
        foreign = csrf(sign_in(other))
    assert lab.post("/lab/settings", data={**form, "csrf": foreign}).status_code == 403
    own = csrf(lab)
    for headers in (
        {"Origin": "http://evil.example"},
        {"Origin": "http://["},
        {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "cross-site"},
    ):
        assert lab.post("/lab/settings", data={**form, "csrf": own}, headers=headers).status_code == 403
        refused = lab.post("/lab/sign-in", data={"name": "experimenter", "password": PASSWORD}, headers=headers)
        assert refused.status_code == 403
    with lab_services.database.session() as s:
        assert s.get(Setting, "contact") is None
    same_origin = {"Origin": "null", "Sec-Fetch-Site": "same-origin"}  # what a browser sends under our referrer policy
    assert lab.post("/lab/settings", data={**form, "csrf": own}, headers=same_origin).status_code == 303
    assert lab.post("/lab/settings", data=form, headers={"X-CSRF": own}).status_code == 303


def test_every_page_and_call_behind_the_sign_in_asks_for_it(visitor):
    paths = visitor.app.openapi()["paths"]
    guarded = {path: methods for path, methods in paths.items() if path.startswith(("/lab", "/api/lab"))}
    assert len(guarded) > 25
    for path, methods in guarded.items():
        if path in OPEN_TO_ALL:
            continue
        address = re.sub(r"\{[^}]*\}", "1", path)
        for method in methods:
            answered = visitor.request(method, address)
            if path.startswith("/api/"):
                assert answered.status_code == 401, (method, path)
            else:
                assert answered.status_code == 303, (method, path)
                assert answered.headers["location"].startswith("/lab/sign-in?next="), (method, path)


def test_colleagues_get_accounts_new_passwords_and_lose_them(lab, lab_services):
    token = csrf(lab)

    def post(path: str, **form: str) -> tuple[int, str]:
        answered = lab.post(f"/lab/settings/accounts{path}", data={"csrf": token, **form})
        return answered.status_code, answered.text

    def password_in(text: str) -> str:
        return text.split('id="made" value="')[1].split('"')[0]

    assert post("", name="No Spaces Please", role="viewer")[0] == 422
    assert post("", name="Ada", role="")[0] == 422
    status, text = post("", name="Ada", role="viewer")
    assert status == 200
    assert post("", name="ada", role="viewer")[0] == 422
    first = password_in(text)
    with TestClient(create_application(lab_services), follow_redirects=False) as ada:
        sign_in(ada, "ada", first)
        assert ada.get("/lab/studies").headers["location"] == "/lab/password"
        second = password_in(post("/ada/reset")[1])
        assert ada.get("/lab/studies").headers["location"].startswith("/lab/sign-in")
        assert ada.post("/lab/sign-in", data={"name": "ada", "password": first}).status_code == 401
        sign_in(ada, "ada", second)
        assert post("/ada/remove")[0] == 303
        assert ada.get("/lab/studies").headers["location"].startswith("/lab/sign-in")
        assert ada.post("/lab/sign-in", data={"name": "ada", "password": second}).status_code == 401
    assert post("/ada/remove")[0] == 404
    assert post("/experimenter/remove")[0] == 422
    assert post("/experimenter/role", role="viewer")[0] == 422


def test_pages_speak_german_where_it_is_asked_for(visitor):
    assert "Anmelden" in visitor.get("/lab/sign-in", headers={"Accept-Language": "de-AT,de;q=0.9,en;q=0.5"}).text
    visitor.get("/lab/language/de")
    assert '<html lang="de">' in visitor.get("/lab/sign-in", headers={"Accept-Language": "en"}).text


def test_forgotten_password_is_replaced_where_the_server_runs(visitor, lab_services):
    def command(*name: str) -> tuple[int, dict[str, str]]:
        environment = {**os.environ, "DESIREPATH_DATA": str(lab_services.settings.data)}
        line = [sys.executable, "-m", "desirepath", "password", *name, "--json"]
        done = subprocess.run(line, env=environment, capture_output=True, text=True, check=False)
        return done.returncode, json.loads(done.stdout)

    assert command("nobody")[0] == 1
    status, told = command()
    assert status == 0
    assert visitor.post("/lab/sign-in", data={"name": "experimenter", "password": PASSWORD}).status_code == 401
    sign_in(visitor, password=told["password"])
    assert visitor.get("/lab/studies").headers["location"] == "/lab/password"


def test_two_owners_who_take_the_role_from_each_other_at_once_leave_one(lab_services):
    """What each of them clicked was allowed; whoever comes second finds nobody else who owns the installation."""
    add_user(lab_services.database, "ada", "owner")
    clicks = [("ada", "viewer"), ("experimenter", "viewer")]

    def click(one):
        try:
            set_role(lab_services.database, *one)
        except AccountError as refused:
            return refused.code
        return "done"

    with ThreadPoolExecutor(2) as both:
        assert sorted(both.map(click, clicks)) == ["done", "last_owner"]
    with lab_services.database.session() as s:
        assert sorted(s.scalars(select(User.role))) == ["owner", "viewer"]


def test_the_last_owner_is_not_removed_by_who_was_one_a_moment_ago(lab, lab_services):
    token, own = csrf(lab), lab_services.database
    add_user(own, "ada", "owner")
    with own.transaction() as s:  # ada took it away between the experimenter's look at the page and their click
        s.execute(update(User).where(User.name == "experimenter").values(role="viewer"))
    with own.transaction() as s, pytest.raises(AccountError):
        check_owner_left(s, "ada")
    assert lab.post("/lab/settings/accounts/ada/remove", data={"csrf": token}).status_code == 403
