"""Signing in with a university's account: who is let in, as whom, and every answer that is not to be believed."""

from __future__ import annotations

import re
import time
from urllib.parse import parse_qsl, urlsplit

import pyotp
import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select, update

from desirepath.settings import Settings, SettingsError
from desirepath.store.models import Audit, Identity, Invitation, SecondFactor, SignInUnderWay, User, utc_now
from desirepath.web.application import create_application
from desirepath.web.core import openid, second_factor
from desirepath.web.core.admission_by_openid import INVITED_ROLES, free_name, is_admitted
from desirepath.web.core.openid import OpenId, is_safe
from desirepath.web.core.sign_ins import COOKIE
from tests.web import openid_provider
from tests.web.lab_services import PASSWORD, csrf, sign_in
from tests.web.openid_provider import CLIENT, SECRET, Provider

ADA = {"sub": "4711", "email": "Ada@Uni.Example", "email_verified": True}


@pytest.fixture(scope="module")
def started():
    provider, server = openid_provider.start()
    yield provider
    server.shutdown()


@pytest.fixture
def provider(started, lab_services) -> Provider:
    """The lab's provider, at which Ada signs in; nobody may come in yet."""
    fresh = Provider(started.issuer, started.key)
    for name in vars(fresh):
        setattr(started, name, getattr(fresh, name))
    started.claims = dict(ADA)
    settings = lab_services.settings
    settings.openid_issuer, settings.openid_client_id = started.issuer, CLIENT
    settings.openid_client_secret, settings.openid_name = SECRET, "university account"
    lab_services.openid = OpenId(settings)
    return started


@pytest.fixture
def browser(lab_services) -> TestClient:
    return new_browser(lab_services)


def new_browser(services) -> TestClient:
    return TestClient(create_application(services), follow_redirects=False, base_url="http://localhost:8000")


def come(browser: TestClient, provider: Provider, begin: str = "/lab/sign-in/openid?next=/lab/jobs"):
    """The whole way there and back."""
    there = browser.get(begin)
    assert there.status_code == 303, there.text
    return browser.get(provider.visit(there.headers["location"]))


def names(services) -> dict[str, str]:
    with services.database.session() as s:
        return {user.name: user.role for user in s.scalars(select(User))}


def test_an_allowed_domain_gets_an_account_without_any_role_and_finds_it_again(provider, browser, lab_services):
    lab_services.settings.openid_admits = "uni.example, someone@elsewhere.example"
    said = come(browser, provider)
    assert (said.status_code, said.headers["location"]) == (303, "/lab/jobs")
    assert "You have no role in any study yet" in browser.get("/lab/studies").text
    assert names(lab_services) == {"experimenter": "owner", "ada": "member"}
    provider.claims |= {"email": "married@other.example"}  # the person is who the subject says, whatever the address
    again = new_browser(lab_services)
    assert come(again, provider).headers["location"] == "/lab/jobs"
    assert names(lab_services) == {"experimenter": "owner", "ada": "member"}
    assert "This account has no password" in again.get("/lab/account").text
    with lab_services.database.session() as s:
        assert [(one.subject, one.email) for one in s.scalars(select(Identity))] == [("4711", "ada@uni.example")]
        done = s.execute(select(Audit.action, Audit.by, Audit.data).order_by(Audit.id)).all()
    assert [tuple(one) for one in done] == [
        ("account_added", "ada", {"name": "ada", "method": "openid"}),
        ("signed_in", "ada", {"method": "openid"}),
        ("signed_in", "ada", {"method": "openid"}),
    ]
    assert SECRET not in "".join(provider.heard)  # said in the header, percent-encoded
    passwordless = new_browser(lab_services).post("/lab/sign-in", data={"name": "ada", "password": ""})
    assert passwordless.status_code == 401


@pytest.mark.parametrize(
    "claims",
    [
        {"email_verified": False},
        {"email_verified": None},
        {"email_verified": "true"},
        {"email": "ada@uni.example.evil.example"},
        {"email": "ada@sub.uni.example"},
        {"email": "eve@evil.example@uni.example"},
        {"email": None},
        {"email": "experimenter"},
    ],
    ids=str,
)
def test_who_is_neither_invited_nor_of_an_allowed_domain_is_told_so(provider, browser, lab_services, claims):
    lab_services.settings.openid_admits = "uni.example"
    provider.claims |= claims
    said = come(browser, provider)
    assert said.status_code == 403
    assert "Ask an owner of this installation" in said.text
    assert COOKIE not in browser.cookies
    assert names(lab_services) == {"experimenter": "owner"}


def test_nobody_comes_in_where_nothing_was_allowed(provider, browser, lab_services):
    assert come(browser, provider).status_code == 403
    with lab_services.database.session() as s:
        refused = s.scalars(select(Audit).where(Audit.action == "sign_in_refused")).one()
    assert (refused.by, refused.outcome, refused.data) == ("-", "refused", {"method": "openid"})


def test_an_address_like_an_accounts_name_opens_nothing_of_it(provider, browser, lab_services):
    lab_services.settings.openid_admits = "uni.example"
    provider.claims |= {"email": "experimenter@uni.example", "preferred_username": "experimenter"}
    come(browser, provider)
    assert names(lab_services) == {"experimenter": "owner", "experimenter-2": "member"}


def test_an_invitation_opens_once_with_its_role_which_is_never_owner(provider, browser, lab, lab_services):
    token = csrf(lab)

    def invite(email: str, role: str) -> int:
        form = {"csrf": token, "email": email, "role": role}
        return lab.post("/lab/settings/invitations", data=form).status_code

    assert "owner" not in INVITED_ROLES
    assert [invite("ada@uni.example", "owner"), invite("no address", "viewer")] == [422, 422]
    assert invite("ADA@uni.example", "analyst") == 303
    assert "ada@uni.example" in lab.get("/lab/settings").text
    assert come(browser, provider).status_code == 303
    assert names(lab_services)["ada"] == "analyst"
    provider.claims |= {"sub": "another"}  # the address was given to somebody else
    assert come(new_browser(lab_services), provider).status_code == 403
    assert invite("bob@uni.example", "viewer") == 303
    with lab_services.database.transaction() as s:
        waiting = s.scalars(select(Invitation)).one()
        waiting.expires_at = utc_now()
    provider.claims |= {"email": "bob@uni.example"}
    assert come(new_browser(lab_services), provider).status_code == 403  # too late
    assert lab.post(f"/lab/settings/invitations/{waiting.id}/withdraw", data={"csrf": token}).status_code == 303
    assert "bob@uni.example" not in lab.get("/lab/settings").text


@pytest.mark.parametrize(
    "bad",
    [
        {"claims": {"nonce": "another"}},
        {"claims": {"nonce": None}},
        {"claims": {"aud": "another-client"}},
        {"claims": {"aud": [CLIENT, "another-client"], "azp": "another-client"}},
        {"claims": {"iss": "https://evil.example"}},
        {"claims": {"exp": int(time.time()) - 3600}},
        {"claims": {"exp": None}},
        {"claims": {"sub": None}},
        {"claims": {"sub": ""}},
        {"signs_with": openid_provider.another_key()},
        {"signs_with": openid_provider.shared_key(), "algorithm": "HS256"},
    ],
    ids=[
        "another nonce",
        "no nonce",
        "for another client",
        "for two clients, used by the other",
        "of another issuer",
        "ended an hour ago",
        "without an end",
        "of nobody",
        "of an empty name",
        "signed with another key",
        "signed with the shared secret",
    ],
)
def test_an_id_token_that_is_not_right_in_everything_opens_nothing(provider, browser, lab_services, bad):
    lab_services.settings.openid_admits = "uni.example"
    provider.claims |= bad.get("claims", {})
    provider.signs_with, provider.algorithm = bad.get("signs_with"), bad.get("algorithm", "RS256")
    said = come(browser, provider)
    assert said.status_code == 401
    assert "was not valid" in said.text
    assert COOKIE not in browser.cookies
    assert names(lab_services) == {"experimenter": "owner"}


def test_an_answer_is_taken_once_by_the_browser_that_asked_and_with_its_state(provider, browser, lab_services):
    lab_services.settings.openid_admits = "uni.example"
    back = provider.visit(browser.get("/lab/sign-in/openid").headers["location"])
    stranger = new_browser(lab_services)
    assert stranger.get(back).status_code == 400  # somebody else's link opens nothing in this browser
    forged = re.sub(r"state=[^&]+", "state=guess", back)
    own = provider.visit(stranger.get("/lab/sign-in/openid").headers["location"])
    assert stranger.get(forged).status_code == 400
    assert stranger.get(own).status_code == 303  # what was forged used nothing up
    assert stranger.get(own).status_code == 400
    other = browser.get(re.sub(r"iss=[^&]+", "iss=https://evil.example", back))
    assert (other.status_code, COOKIE in browser.cookies) == (401, False)
    browser.get("/lab/sign-in/openid")
    with lab_services.database.transaction() as s:
        s.execute(update(SignInUnderWay).values(expires_at=utc_now()))
    assert browser.get(back).status_code == 400


def test_who_cancels_there_is_told_so_and_the_password_still_opens(provider, browser):
    state = dict(parse_qsl(urlsplit(browser.get("/lab/sign-in/openid").headers["location"]).query))["state"]
    said = browser.get(f"/lab/sign-in/openid/return?error=access_denied&state={state}")
    assert "was cancelled there" in said.text
    sign_in(browser)


def test_a_provider_that_is_away_or_says_what_it_may_not_is_not_used(provider, browser, lab_services):
    for discovery in (
        {"issuer": "https://evil.example"},
        {"token_endpoint": "http://evil.example/token"},
        {"jwks_uri": "file:///etc/passwd"},
    ):
        provider.discovery = discovery
        assert browser.get("/lab/sign-in/openid").status_code == 503, discovery
    provider.discovery, provider.away = {}, True
    said = browser.get("/lab/sign-in/openid")
    assert (said.status_code, "does not answer properly" in said.text) == (503, True)
    provider.away = False
    assert browser.get("/lab/sign-in/openid").status_code == 303


def test_a_provider_that_answers_nothing_holds_one_click_and_not_all_of_them(provider, browser, monkeypatch):
    monkeypatch.setattr(openid, "SLOW_S", 0.0)
    provider.away = True
    assert browser.get("/lab/sign-in/openid").status_code == 503
    provider.away = False
    assert browser.get("/lab/sign-in/openid").status_code == 503  # not asked again yet
    monkeypatch.setattr(openid, "AWAY_FOR_S", 0.0)
    assert browser.get("/lab/sign-in/openid").status_code == 303


def test_keys_that_the_provider_changed_are_asked_for_again(provider, browser, lab_services):
    lab_services.settings.openid_admits = "uni.example"
    assert come(browser, provider).status_code == 303
    provider.key = openid_provider.another_key()
    assert come(new_browser(lab_services), provider).status_code == 303


def test_my_account_is_linked_only_after_i_said_so_and_never_with_two(provider, lab, lab_services, as_role):
    there = lab.get("/lab/account/identity/begin").headers["location"]
    asked = lab.get(provider.visit(there))
    assert asked.headers["location"] == "/lab/account/identity"
    assert "ada@uni.example" in lab.get("/lab/account/identity").text
    with lab_services.database.session() as s:
        assert s.scalars(select(Identity)).all() == []
    assert lab.post("/lab/account/identity/link").status_code == 403  # without this page's token
    for wrong in ({}, {"password": "guess"}):  # a browser left open is not enough for a way in that stays
        refused = lab.post("/lab/account/identity/link", data={"csrf": csrf(lab), **wrong})
        assert (refused.status_code, "The password is not right" in refused.text) == (422, True)
    assert lab.post("/lab/account/identity/link", data={"csrf": csrf(lab), "password": PASSWORD}).status_code == 303
    browser = new_browser(lab_services)
    assert come(browser, provider).headers["location"] == "/lab/jobs"
    assert browser.get("/lab/settings").status_code == 200  # it is the owner's account
    colleague = as_role("viewer")
    with lab_services.database.transaction() as s:
        owner = s.scalars(select(User.password_hash).where(User.name == "experimenter")).one()
        s.execute(update(User).where(User.name == "a-viewer").values(password_hash=owner))
    colleague.get(provider.visit(colleague.get("/lab/account/identity/begin").headers["location"]))
    taken = colleague.post("/lab/account/identity/link", data={"csrf": csrf(colleague), "password": PASSWORD})
    assert (taken.status_code, "opens an account already" in taken.text) == (422, True)
    linked = re.search(r"/lab/account/identity/([0-9a-f]+)/remove", lab.get("/lab/account").text).group(1)
    assert colleague.post(f"/lab/account/identity/{linked}/remove", data={"csrf": csrf(colleague)}).status_code == 404
    assert lab.post(f"/lab/account/identity/{linked}/remove", data={"csrf": csrf(lab)}).status_code == 303
    assert come(new_browser(lab_services), provider).status_code == 403


def test_the_only_way_in_is_not_removed_and_goes_with_the_account(provider, browser, lab, lab_services):
    lab_services.settings.openid_admits = "uni.example"
    come(browser, provider)
    linked = re.search(r"/lab/account/identity/([0-9a-f]+)/remove", browser.get("/lab/account").text).group(1)
    refused = browser.post(f"/lab/account/identity/{linked}/remove", data={"csrf": csrf(browser, "/lab/account")})
    assert refused.status_code == 422
    assert lab.post("/lab/settings/accounts/ada/remove", data={"csrf": csrf(lab)}).status_code == 303
    with lab_services.database.session() as s:
        assert s.scalars(select(Identity)).all() == []


def test_an_owner_closes_a_colleagues_way_in_from_elsewhere(provider, browser, lab, lab_services):
    lab_services.settings.openid_admits = "uni.example"
    come(browser, provider)
    page = lab.get("/lab/settings").text
    assert "Remove sign-in as ada@uni.example" in page
    closing = re.search(r"/lab/settings/accounts/ada/identities/[0-9a-f]+/remove", page).group()
    another = closing.replace("/ada/", "/experimenter/")
    assert lab.post(another, data={"csrf": csrf(lab)}).status_code == 422  # one's own, where the password is asked for
    assert browser.post(closing, data={"csrf": csrf(browser, "/lab/account")}).status_code == 403  # not an owner
    assert lab.post(closing, data={"csrf": csrf(lab)}).status_code == 303
    assert browser.get("/lab/account").status_code == 303  # signed out
    lab_services.settings.openid_admits = ""
    assert come(new_browser(lab_services), provider).status_code == 403
    assert lab.post(closing, data={"csrf": csrf(lab)}).status_code == 404


def test_the_second_factor_is_asked_for_after_this_sign_in_too(provider, browser, lab_services):
    lab_services.settings.openid_admits = "uni.example"
    come(browser, provider)
    with lab_services.database.transaction() as s:
        ada = s.scalars(select(User).where(User.name == "ada")).one()
        second_factor.begin(s, ada.id)
        s.flush()
        secret = s.get_one(SecondFactor, ada.id).secret
        second_factor.confirm(s, ada.id, pyotp.TOTP(secret).now())
        s.get_one(SecondFactor, ada.id).last_step = 0
    again = new_browser(lab_services)
    assert come(again, provider).headers["location"] == "/lab/sign-in/code"
    assert again.get("/lab/studies").status_code == 303
    entered = again.post("/lab/sign-in/code", data={"code": pyotp.TOTP(secret).now()})
    assert entered.headers["location"] == "/lab/jobs"


def test_without_a_provider_there_is_no_such_door(visitor, lab):
    assert "/lab/sign-in/openid" not in lab.get("/lab/sign-in").text
    assert lab.get("/lab/sign-in/openid").status_code == 404


def test_settings_are_read_and_a_secret_may_stand_in_a_file(tmp_path):
    file = tmp_path / "secret"
    file.write_text("from a file\n")
    settings = Settings(openid_client_secret_file=file, openid_admits=" @Uni.Example , a@b.example", _env_file=None)
    assert settings.openid_secret == "from a file"
    assert settings.openid_allowed == {"uni.example", "a@b.example"}
    with pytest.raises(SettingsError, match="openid_client_secret_file"):
        _ = Settings(openid_client_secret_file=tmp_path / "none", _env_file=None).openid_secret


@pytest.mark.parametrize(
    ("address", "safe"),
    [
        ("https://login.uni.example/t", True),
        ("http://127.0.0.1:80/t", True),
        ("http://uni.example", False),
        ("", False),
    ],
)
def test_tokens_go_over_tls_or_stay_on_this_machine(address, safe):
    assert is_safe(address) is safe


def test_names_and_addresses_are_taken_as_they_may_be(lab_services):
    assert is_admitted("a@uni.example", {"uni.example"})
    assert not is_admitted("a@UNI.example\n", {"uni.example"})
    with lab_services.database.session() as s:
        assert [free_name(s, one) for one in ("Ada L.", "", "<b>", "ß", "x")] == [
            "adal.",
            "user",
            "b-user",
            "user",
            "x-user",
        ]
