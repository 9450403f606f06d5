"""The address that signs the first account in once, attacked: stolen, used twice, relayed, followed from elsewhere."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import delete, select, update
from structlog.testing import capture_logs

from desirepath.settings import Settings
from desirepath.store.models import Audit, Setting, SignIn, SignInUnderWay, User, utc_now
from desirepath.web.application import build_services, create_application
from desirepath.web.core.auth import add_user
from desirepath.web.core.dependencies import Application, Services
from desirepath.web.core.opening_link import RELAYED, link_path
from desirepath.web.core.sign_ins import COOKIE
from desirepath.web.core.throttle import limiter_for
from desirepath.web.lab.settings_pages import _put
from tests.web.lab_services import csrf, sign_in

STUDIES = "/lab/studies"
HERE = ("127.0.0.1", 50_000)


@pytest.fixture(scope="module")
def installation(fresh_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Services, Application]]:
    """One for all attacks here; what a test changes of it, `closed` puts back."""
    data = shutil.copytree(fresh_data, tmp_path_factory.mktemp("closed") / "data")
    services = build_services(Settings(data=data, _env_file=None))
    yield services, create_application(services)
    services.database.close()


@pytest.fixture
def closed(installation: tuple[Services, Application]) -> Services:
    """On loopback, the first account without a password, as `desirepath serve` makes it."""
    services, _ = installation
    services.limiter = limiter_for(None)
    with services.database.transaction() as s:
        for table in (SignIn, SignInUnderWay, Setting):
            s.execute(delete(table))
        s.execute(delete(User).where(User.name != "experimenter"))
        s.execute(update(User).values(password_hash="", role="owner", must_change_password=False))
    return services


@pytest.fixture
def once(closed: Services) -> str:
    with closed.database.transaction() as s:
        path = link_path(s, closed.settings)
    assert path is not None
    return path


@pytest.fixture
def browser(closed: Services, installation: tuple[Services, Application]) -> Callable[..., TestClient]:
    """A browser of its own, by default on this machine."""

    def opened(base: str = "http://127.0.0.1:8000", client: tuple[str, int] = HERE) -> TestClient:
        return TestClient(installation[1], base, follow_redirects=False, client=client)

    return opened


def goes_in(client: TestClient, path: str, **headers: str) -> bool:
    answered = client.get(path, headers=headers)
    assert answered.status_code in (303, 403)
    if answered.status_code == 403:
        assert COOKIE not in client.cookies
    return answered.status_code == 303


@pytest.mark.parametrize("base", ["http://127.0.0.1:8000", "http://localhost:8000", "http://[::1]:8000"])
def test_it_signs_in_and_the_token_leaves_the_address(once, browser, base):
    here = browser(base)
    answered = here.get(once)
    assert (answered.status_code, answered.headers["location"]) == (303, STUDIES)
    assert answered.headers["referrer-policy"] == "no-referrer"
    assert "httponly" in answered.headers["set-cookie"].lower()
    assert here.get(STUDIES).status_code == 200


def test_a_used_one_is_refused_elsewhere_with_words_and_opens_the_page_where_it_was_used(once, browser, closed):
    first, second = browser(), browser()
    assert goes_in(first, once)
    refused = second.get(once)
    assert (refused.status_code, "desirepath link" in refused.text, COOKIE in second.cookies) == (403, True, False)
    assert first.get(once).headers["location"] == STUDIES
    with closed.database.session() as s:
        logged = [(entry.action, entry.outcome) for entry in s.scalars(select(Audit).order_by(Audit.id))]
    assert logged[-2:] == [("signed_in", "done"), ("sign_in_refused", "refused")]


def test_of_many_at_once_one_gets_in(once, browser):
    browsers = [browser() for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        assert sum(pool.map(lambda one: goes_in(one, once), browsers)) == 1


@pytest.mark.parametrize("wrong", ["", "x", "\x00", "0" * 43, "ü" * 43, "A" * 10_000])
def test_a_wrong_one_opens_nothing_and_uses_nothing_up(once, browser, wrong):
    path = once.partition("=")[0]
    assert browser().get(path, params={"token": wrong}).status_code in (403, 422)
    assert not goes_in(browser(), path)
    assert not goes_in(browser(), once[:-1])
    assert goes_in(browser(), once)


def test_guesses_are_counted(once, browser):
    here = browser()
    answers = [here.get(f"{once}x").status_code for _ in range(101)]
    assert (set(answers[:-1]), answers[-1]) == ({403}, 429)


def test_an_old_one_is_refused(once, browser, closed):
    with closed.database.transaction() as s:
        s.execute(update(SignInUnderWay).values(expires_at=utc_now() - timedelta(seconds=1)))
    assert not goes_in(browser(), once)


@pytest.mark.parametrize("address", ["198.51.100.7", "203.0.113.9", "::ffff:203.0.113.9", "fe80::1%eth0", "unknown"])
def test_from_another_machine_it_is_refused_and_still_good_here(once, browser, address):
    assert not goes_in(browser(client=(address, 4000)), once)
    assert goes_in(browser(), once)


def test_a_relayed_request_is_refused_whoever_it_says_it_is_from(once, browser):
    here = browser()
    for name in RELAYED:
        assert not goes_in(here, once, **{name: "127.0.0.1"}), name
        assert not goes_in(here, once, **{name: "for=127.0.0.1;host=localhost"}), name
    assert goes_in(here, once)


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1.evil.example", "198.51.100.7:8000", "localhost.evil.example"]
)
def test_under_a_name_that_somebody_else_may_own_it_is_refused(once, browser, host):
    """A page elsewhere whose name was turned to 127.0.0.1 while it was open (DNS rebinding)."""
    assert not goes_in(browser(f"http://{host}"), once)


@pytest.mark.parametrize(
    "headers",
    [{"Sec-Fetch-Site": "cross-site"}, {"Sec-Fetch-Site": "same-site"}, {"Origin": "http://127.0.0.1:8001"}],
)
def test_another_site_or_port_cannot_have_it_followed(once, browser, headers):
    assert not goes_in(browser(), once, **headers)
    assert goes_in(browser(), once, **{"Sec-Fetch-Site": "none"})


def test_looking_ahead_and_asking_for_the_head_use_nothing_up(once, browser):
    assert not goes_in(browser(), once, **{"Sec-Purpose": "prefetch;prerender"})
    for method in ("HEAD", "POST", "OPTIONS"):
        assert browser().request(method, once).status_code in (403, 405)
    assert goes_in(browser(), once)


def test_it_stands_in_no_log(once, browser):
    with capture_logs() as lines:
        browser().get(f"{once}x")
        browser().get(once)
    assert lines
    assert once.partition("=")[2] not in str(lines)


def test_a_browser_that_came_by_it_is_out_once_others_can_reach_the_pages(once, browser, closed):
    here = browser()
    assert goes_in(here, once)
    assert here.get(STUDIES, headers={"X-Forwarded-For": "127.0.0.1"}).status_code == 303
    elsewhere = browser("http://198.51.100.7:8000", ("198.51.100.7", 4000))
    elsewhere.cookies.set(COOKIE, here.cookies[COOKIE])
    assert elsewhere.get(STUDIES).status_code == 303
    assert here.get(STUDIES).status_code == 200
    saved = here.post("/lab/settings", data={"csrf": csrf(here), "address": "https://study.example.org"})
    assert (saved.status_code, "Set a password first" in saved.text) == (422, True)
    with closed.database.transaction() as s:
        _put(s, "public_url", "url", "https://study.example.org")
    assert here.get(STUDIES).status_code == 303
    with closed.database.transaction() as s:
        assert link_path(s, closed.settings) is None


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "198.51.100.7", "lab.example.org"])
def test_where_the_server_listens_for_others_there_is_none(closed, browser, once, host, monkeypatch):
    monkeypatch.setattr(closed, "settings", closed.settings.model_copy(update={"host": host}))
    with closed.database.transaction() as s:
        assert link_path(s, closed.settings) is None
    assert not goes_in(browser(), once)


def test_who_sets_a_password_stays_in_and_the_address_stops(once, browser, closed):
    here = browser()
    assert goes_in(here, once)
    with closed.database.transaction() as s:
        later = link_path(s, closed.settings)
    page = here.get("/lab/password").text
    assert 'name="current"' not in page
    form = {"csrf": csrf(here), "new": "seven quiet robots", "again": "seven quiet robots"}
    assert here.post("/lab/password", data=form).status_code == 303
    assert here.get(STUDIES, headers={"X-Forwarded-For": "203.0.113.9"}).status_code == 200
    assert not goes_in(browser(), str(later))
    form["new"] = form["again"] = "eight quiet robots"
    assert here.post("/lab/password", data=form).status_code == 422, "now the current one is asked for"


def test_it_opens_no_other_account_and_no_other_account_can_make_use_of_it(once, browser, closed):
    """A colleague's account has a password from its beginning."""
    password = add_user(closed.database, "colleague", "viewer")
    theirs = sign_in(browser(), "colleague", password)
    assert theirs.get("/lab/settings").status_code in (303, 403)
    assert browser().post("/lab/sign-in", data={"name": "experimenter", "password": ""}).status_code == 401
    with closed.database.transaction() as s:
        s.execute(update(User).where(User.name == "experimenter").values(role="viewer"))
        assert link_path(s, closed.settings) is None
    assert not goes_in(browser(), once)


def test_a_second_factor_is_asked_for_here_too(once, browser, closed, monkeypatch):
    monkeypatch.setattr("desirepath.web.core.second_factor.has_second_factor", lambda s, user: True)
    here = browser()
    assert here.get(once).headers["location"] == "/lab/sign-in/code"
    assert here.get(STUDIES).headers["location"].startswith("/lab/sign-in")
    with closed.database.session() as s:
        assert s.scalars(select(SignIn)).all() == []
