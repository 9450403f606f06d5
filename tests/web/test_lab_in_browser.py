"""The experimenters' pages in a real Chromium: forms, live parts, typed confirmation, accessibility in both schemes."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from desirepath.store.models import Study
from desirepath.study.session.joining import join_study
from desirepath.web.application import create_application
from desirepath.web.core.dependencies import Services
from tests.accessible import violations_in_both_schemes
from tests.running import served
from tests.web.lab_services import NAME, PASSWORD, Walked
from tests.web.protocol_writing import write_yaml


@pytest.fixture
def address(lab_services: Services) -> Iterator[str]:
    """The pages, served for real; without a stage."""
    with served(create_application(lab_services)) as url:
        yield url


def signed_in_page(chromium: Browser, address: str, **context: object) -> Page:
    page = chromium.new_context(viewport={"width": 1280, "height": 800}, **context).new_page()
    page.goto(f"{address}/lab/sign-in")
    page.get_by_label("Name").fill("experimenter")
    page.get_by_label("Password").fill(PASSWORD)
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("Studies")
    return page


def test_experimenter_makes_a_study_corrects_a_mistake_and_gets_the_link(chromium, address):
    page = signed_in_page(chromium, address)
    page.get_by_role("link", name="New study").click()
    page.locator("input[value='shipped:quick_preference_study']").check()
    page.get_by_role("button", name="Check it").first.click()
    right = page.locator("textarea[name=yaml]").input_value()
    write_yaml(page, right.replace("top_down", "from_above", 1))
    expect(page.locator("#editor-part .notice.error")).to_contain_text("Fix 1 error first")
    expect(page.locator(".problems")).to_contain_text("stages[4].block.view")
    write_yaml(page, right)
    page.get_by_role("button", name="Save and check again").click()
    page.get_by_label("Name of the study").fill(NAME)
    page.get_by_role("button", name="Open the study").click()
    expect(page.get_by_label("Link for participants")).to_have_value(
        re.compile(re.escape(address) + r"/join/[\w-]{20,}$")
    )
    page.context.close()


def test_now_shows_who_joins_without_a_reload(chromium, address, lab_services, walked: Walked):
    page = signed_in_page(chromium, address)
    page.goto(f"{address}/lab/studies/{walked.id}/now")
    page.evaluate("window.notReloaded = true")
    with lab_services.database.transaction() as s:
        session, _ = join_study(s, s.get_one(Study, walked.id), language="de", files=lab_services.files)
        code = session.participant.code
    expect(page.get_by_role("link", name=code)).to_be_visible(timeout=15_000)
    assert page.evaluate("window.notReloaded")
    page.context.close()


def test_erasing_waits_until_the_studys_name_is_typed(chromium, address, walked: Walked):
    page = signed_in_page(chromium, address)
    page.goto(f"{address}/lab/studies/{walked.id}/people/{walked.fresh}")
    erase = page.get_by_role("button", name=f"Erase {walked.fresh}")
    expect(erase).to_be_disabled()
    page.get_by_label("Type the study’s name to erase").fill("Corridor")
    expect(erase).to_be_disabled()
    page.get_by_label("Type the study’s name to erase").fill(NAME)
    expect(erase).to_be_enabled()
    page.context.close()


def test_pages_are_accessible_and_fit(chromium, address, walked: Walked):
    page = signed_in_page(chromium, address, reduced_motion="reduce")
    study = f"/lab/studies/{walked.id}"
    pages = [
        "/lab/studies",
        "/lab/new",
        "/lab/settings",
        "/lab/settings/setups",
        "/lab/audit",
        "/lab/password",
        *(f"{study}/{tab}" for tab in ("now", "people", "protocol", "recruit", "data", "report")),
        *(f"{study}/{rows}" for rows in ("answers", "events", "problems", "erased")),
        f"{study}/people/{walked.half_way}",
        f"{study}/preview/3",
        f"{study}/power",
        "/lab/guides",
        "/lab/guides/protocol-reference",  # of the data dictionary's kind, which the next test opens
    ]
    for path in pages:
        page.goto(address + path)
        assert violations_in_both_schemes(page, None) == [], path
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), path
    page.context.close()


def test_no_page_is_wider_than_a_phone(chromium, address, walked: Walked):
    page = signed_in_page(chromium, address)
    page.set_viewport_size({"width": 390, "height": 844})
    here = f"{address}/lab/studies/{walked.id}"
    for shown in (
        f"{address}/lab/studies",
        f"{address}/lab/new",
        f"{address}/lab/settings",
        f"{address}/lab/settings/setups",
        f"{address}/lab/jobs/new/align",
        *(f"{here}/{tab}" for tab in ("now", "people", "protocol", "recruit", "data", "report", "answers", "payments")),
        f"{here}/people/{walked.finished}",
        f"{here}/power",
        f"{address}/lab/guides/data-dictionary",
    ):
        page.goto(shown)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, shown


def test_lists_are_not_pushed_sideways_on_a_tablet_or_a_phone(chromium, address, walked: Walked):
    page = signed_in_page(chromium, address)
    page.goto(f"{address}/lab/language/de?next=/lab/studies")
    here = f"{address}/lab/studies/{walked.id}"
    lists = (f"{address}/lab/studies", f"{here}/answers", f"{here}/people/{walked.finished}")
    seen = "[...document.querySelectorAll('.table')].filter((table) => table.checkVisibility())"
    pushed = f"{seen}.filter((table) => table.scrollWidth > table.clientWidth).map((table) => table.innerText)"
    for width, shown in [(1024, lists), (390, (*lists, f"{here}/people"))]:
        page.set_viewport_size({"width": width, "height": 800})
        for one in shown:
            page.goto(one)
            assert page.evaluate(pushed) == [], (width, one)
    page.context.close()
