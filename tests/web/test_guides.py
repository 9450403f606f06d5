"""The guides inside the lab: every page leads to the part that fits it, and no link leads nowhere."""

from __future__ import annotations

import re

import pytest

from desirepath.installed import DOCS
from desirepath.web.application import create_application
from desirepath.web.core.guides import FITTING, GUIDES, HERE, fitting_guide, guide
from tests.web.lab_services import Walked


def test_every_link_of_a_guide_leads_to_something_that_is_there():
    for name in GUIDES:
        for address in re.findall(r'href="([^"]+)"', guide(name).html):
            if "://" in address:
                continue
            to, _, part = address.removeprefix(f"{HERE}/").partition("#")
            to = to or name
            assert to in GUIDES, (name, address)
            assert not part or part in guide(to).anchors, (name, address)


def test_every_page_leads_to_a_part_that_exists(lab_services):
    for where in FITTING.values():
        name, _, part = where.partition("#")
        assert name in GUIDES
        assert not part or part in guide(name).anchors, where
    routes = create_application(lab_services).openapi()["paths"]
    assert all(any(route == one or route.startswith(f"{one}/") for route in routes) for one in FITTING)
    assert fitting_guide("/lab/studies/{study_id}/recruit").endswith("#recruiting-and-paying")
    assert fitting_guide("/lab/password") == HERE


@pytest.mark.parametrize(
    ("page", "part"),
    [
        ("/lab/new", "experimenters-guide#a-new-study"),
        ("/lab/studies/STUDY/recruit", "experimenters-guide#recruiting-and-paying"),
        ("/lab/studies/STUDY/protocol", "protocol-reference"),
        ("/lab/jobs", "analysts-guide#jobs"),
    ],
)
def test_who_needs_a_guide_is_led_to_its_part(lab, walked: Walked, page, part):
    assert f'href="{HERE}/{part}"' in lab.get(page.replace("STUDY", walked.id)).text


def test_guides_are_read_by_who_is_signed_in(lab, visitor):
    listed = lab.get(HERE).text
    for name in GUIDES:
        shown = lab.get(f"{HERE}/{name}")
        assert shown.status_code == 200
        title = (DOCS / f"{name}.md").read_text().partition("\n")[0].removeprefix("# ")
        assert title.replace("'", "’") in shown.text.replace("&#39;", "’").replace("'", "’")
        assert f'href="{HERE}/{name}"' in listed
    assert lab.get(f"{HERE}/../secrets").status_code == 404
    assert lab.get(f"{HERE}/architecture").status_code == 404
    visitor.cookies.clear()
    assert visitor.get(f"{HERE}/data-dictionary").status_code in (303, 401)


def test_the_data_dictionary_of_an_export_stands_among_the_guides(lab, walked: Walked):
    assert 'href="/lab/guides/data-dictionary"' in lab.get(f"/lab/studies/{walked.id}/data").text
    assert lab.get("/lab/data-dictionary").headers["location"] == "/lab/guides/data-dictionary"
