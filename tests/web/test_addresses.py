"""Under which address people are sent to this server: a request's `Host` does not get into what is handed on."""

from __future__ import annotations

import socket

import pytest
from fastapi.testclient import TestClient

from desirepath.store.models import Setting
from desirepath.web.application import create_application
from desirepath.web.core.dependencies import Services
from tests.web.lab_services import PASSWORD, Walked, sign_in

IN_OUR_NETWORK = ".".join(("192", "168", "1", "20")) + ":8000"  # apart: no file holds a private address
LISTENING = "http://testserver"  # where the test client's server says that it listens


def link_at(services: Services, study_id: str, base_url: str, host: str) -> str:
    """The recruiting link that somebody sees who came by that `Host`."""
    with TestClient(create_application(services), base_url=base_url, follow_redirects=False) as client:
        client.headers["Host"] = host
        sign_in(client, password=PASSWORD)
        page = client.get(f"/lab/studies/{study_id}/recruit")
        assert page.status_code == 200
        return page.text.split("/join/")[0].rpartition('"')[2]


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8000", "203.0.114.9", "localhost.evil.example", "[::g]"]
)
def test_a_foreign_host_is_not_in_the_recruiting_link(lab_services: Services, walked: Walked, host: str) -> None:
    assert link_at(lab_services, walked.id, LISTENING, host).startswith(LISTENING)


@pytest.mark.parametrize("host", ["localhost:8000", "127.0.0.1:8000", IN_OUR_NETWORK, socket.gethostname()])
def test_names_that_can_only_be_ours_are_kept(lab_services: Services, walked: Walked, host: str) -> None:
    assert link_at(lab_services, walked.id, LISTENING, host) == f"http://{host}"


def test_what_is_set_counts_whatever_is_asked(lab_services: Services, walked: Walked) -> None:
    with lab_services.database.transaction() as s:
        s.add(Setting(key="public_url", value={"url": "https://study.example.org"}))
    assert link_at(lab_services, walked.id, "https://testserver", "evil.example") == "https://study.example.org"


def test_browsers_that_came_by_tls_are_told_to_stay_there(lab_services: Services) -> None:
    def told(base_url: str) -> str | None:
        with TestClient(create_application(lab_services), base_url=base_url) as client:
            return client.get("/lab/sign-in").headers.get("Strict-Transport-Security")

    assert told("https://study.example.org") == "max-age=31536000"
    assert told("http://study.example.org") is None, "a browser would not heed it, and a laptop has no TLS"
    assert told("https://localhost") is None, "other ports of localhost serve other things"
