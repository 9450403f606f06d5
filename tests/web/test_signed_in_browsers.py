"""One's own account: which browsers are signed in, and ending them."""

from __future__ import annotations

import re
from datetime import timedelta

from fastapi.testclient import TestClient
from sqlalchemy import select, update

from desirepath.store.models import Audit, SignIn, User, utc_now
from desirepath.web.application import create_application
from desirepath.web.core.auth import add_user
from desirepath.web.core.sign_ins import COOKIE, SEEN_EVERY, browser_name
from tests.web.lab_services import csrf, sign_in

FIREFOX = "Mozilla/5.0 (X11; Linux x86_64; rv:140.0) Gecko/20100101 Firefox/140.0"
PHONE = "Mozilla/5.0 (iPhone; CPU iPhone OS 18_0 like Mac OS X) AppleWebKit/605.1 Version/18.0 Mobile Safari/604.1"


def from_elsewhere(services, address: str = "198.51.100.7", agent: str = FIREFOX) -> TestClient:
    application = create_application(services)
    client = TestClient(application, follow_redirects=False, client=(address, 4000), headers={"User-Agent": agent})
    return sign_in(client)


def ends(page: str) -> list[str]:
    return re.findall(r"/lab/account/sign-ins/([0-9a-f]+)/end", page)


def test_my_page_says_where_i_am_signed_in_and_ends_one_of_them(lab, lab_services):
    other = from_elsewhere(lab_services)
    page = lab.get("/lab/account").text
    assert "Firefox, Linux" in page
    assert "198.51.100.7" in page
    assert page.count("this one") == 1
    (one,) = ends(page)  # none for the browser that asks
    assert lab.post(f"/lab/account/sign-ins/{one}/end", data={"csrf": csrf(lab)}).status_code == 303
    assert other.get("/lab/studies").headers["location"].startswith("/lab/sign-in")
    assert lab.get("/lab/studies").status_code == 200
    assert lab.post(f"/lab/account/sign-ins/{one}/end", data={"csrf": csrf(lab)}).status_code == 404
    with lab_services.database.session() as s:
        done = s.scalars(select(Audit).where(Audit.action == "sign_in_ended")).one()
        assert (done.by, done.data) == ("experimenter", {"sign_in_id": one})


def test_all_others_end_at_once_and_mine_stays(lab, lab_services):
    others = [from_elsewhere(lab_services, f"198.51.100.{k}") for k in range(2)]
    assert lab.post("/lab/account/sign-ins-elsewhere/end", data={"csrf": csrf(lab)}).status_code == 303
    assert [one.get("/lab/studies").status_code for one in (*others, lab)] == [303, 303, 200]


def test_nobody_ends_or_sees_the_sign_ins_of_somebody_else(lab, lab_services, as_role):
    ada = as_role("viewer")
    from_elsewhere(lab_services)
    (mine,) = ends(lab.get("/lab/account").text)
    assert "198.51.100.7" not in ada.get("/lab/account").text
    assert ada.post(f"/lab/account/sign-ins/{mine}/end", data={"csrf": csrf(ada)}).status_code == 404
    assert ends(lab.get("/lab/account").text) == [mine]


def test_an_owner_signs_a_colleague_out_everywhere(lab, lab_services, as_role):
    ada = as_role("viewer")
    assert lab.post("/lab/settings/accounts/a-viewer/sign-out", data={"csrf": csrf(lab)}).status_code == 303
    assert ada.get("/lab/studies").status_code == 303
    assert lab.post("/lab/settings/accounts/nobody/sign-out", data={"csrf": csrf(lab)}).status_code == 404


def test_what_a_list_shows_opens_nothing_and_is_gone_with_the_sign_in(lab, lab_services):
    other = from_elsewhere(lab_services)
    (one,) = ends(lab.get("/lab/account").text)
    stranger = TestClient(create_application(lab_services), follow_redirects=False, cookies={COOKIE: one})
    assert stranger.get("/lab/studies").status_code == 303
    assert other.post("/lab/sign-out", data={"csrf": csrf(other)}).status_code == 303
    with lab_services.database.session() as s:
        assert [row.address for row in s.scalars(select(SignIn))] == ["testclient"]


def test_last_used_moves_on_but_not_with_every_page(lab, lab_services):
    def seen():
        with lab_services.database.session() as s:
            return s.scalars(select(SignIn.seen_at)).one()

    first = seen()
    lab.get("/lab/studies")
    assert seen() == first
    earlier = utc_now() - 2 * SEEN_EVERY
    with lab_services.database.transaction() as s:
        s.execute(update(SignIn).values(seen_at=earlier))
    lab.get("/lab/studies")
    assert seen() > earlier + timedelta(seconds=1)


def test_a_sign_in_from_before_these_columns_is_listed_too(lab, lab_services):
    with lab_services.database.transaction() as s:
        s.execute(update(SignIn).values(seen_at=None, address=None, browser=None))
    assert "Unknown browser" in lab.get("/lab/account").text


def test_browsers_are_named_in_a_word():
    assert browser_name(PHONE) == "Safari, iOS"
    assert browser_name("Mozilla/5.0 (Windows NT 10.0) AppleWebKit Chrome/140 Safari/537 Edg/140") == "Edge, Windows"
    assert browser_name("curl/8") == ""


def test_an_account_with_everything_of_it_is_removed(lab, lab_services):
    add_user(lab_services.database, "ada", "viewer")
    assert lab.post("/lab/settings/accounts/ada/remove", data={"csrf": csrf(lab)}).status_code == 303
    with lab_services.database.session() as s:
        assert s.scalars(select(User.name)).all() == ["experimenter"]
