"""The editor in a real Chromium: somebody who knows no YAML makes a study; somebody who does is helped while typing."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from desirepath.installed import FRONTEND
from desirepath.study.protocol.freezing import find_shipped_protocols
from desirepath.web.application import create_application
from desirepath.web.core.dependencies import Services
from tests.accessible import violations, violations_in_both_schemes
from tests.running import served
from tests.web.protocol_writing import write_yaml
from tests.web.test_lab_in_browser import signed_in_page

CODE_MIRROR = (FRONTEND / "static" / "npm").is_dir()
needs_code_mirror = pytest.mark.skipif(not CODE_MIRROR, reason="npm was not there at installation")


@pytest.fixture
def address(lab_services: Services) -> Iterator[str]:
    with served(create_application(lab_services)) as url:
        yield url


def written(page: Page) -> str:
    """The YAML once nothing is under way."""
    page.wait_for_timeout(300)
    expect(page.locator("#editor-state")).not_to_be_empty()
    return page.locator("textarea[name=yaml]").input_value()


def expect_stages(page: Page, *names: str) -> None:
    """In this order."""
    shown = page.locator(".timeline > li > details > summary > span:first-child")
    expect(shown).to_have_text([f"{number}. {name}" for number, name in enumerate(names, 1)])


def start_empty(page: Page, address: str, title: str, action: str, field: str) -> None:
    page.goto(f"{address}/lab/new")
    page.get_by_label(field).fill(title)
    page.get_by_role("button", name=action).click()
    expect(page.locator("#editor-state")).not_to_be_empty()


def add(page: Page, kind: str, label: str = "New stage", action: str = "Add stage") -> None:
    before = page.locator(".timeline > li[data-index]").count()
    page.get_by_label(label).select_option(kind)
    page.get_by_role("button", name=action).click()
    expect(page.locator(".timeline > li[data-index]")).to_have_count(before + 1)


def test_somebody_who_knows_no_yaml_makes_a_study(chromium: Browser, address: str) -> None:
    page = signed_in_page(chromium, address)
    start_empty(page, address, "Which drive?", "Start with an empty protocol", "Title that participants see")
    for kind in ("consent", "instruction", "block", "questionnaire"):
        add(page, kind)
    expect(page.locator("#editor-part .notice.error")).to_contain_text("debriefing")
    add(page, "debriefing")
    expect(page.get_by_text("The protocol is valid")).to_be_visible()
    # a field of the form changes its line
    page.locator(".timeline > li").nth(2).locator("summary").first.click()
    page.get_by_label("Number").fill("8")
    page.get_by_label("Number").press("Tab")
    expect(page.locator(".timeline > li").nth(2).locator("summary .cost").first).to_have_text("3.6 min")
    assert "count: 8" in written(page)
    # by pointer, then by keyboard
    handle = page.locator(".timeline > li").nth(3).locator(".handle")
    to = page.locator(".timeline > li").nth(1).locator("summary").first
    handle.hover()
    page.mouse.down()
    box = to.bounding_box()
    assert box is not None
    page.mouse.move(box["x"], box["y"] + 2, steps=6)
    page.mouse.up()
    expect_stages(page, "Consent", "Questionnaire", "Instruction", "Block of trials", "Debriefing")
    down = page.get_by_role("button", name="Questionnaire down")
    down.focus()
    down.press("Enter")
    expect(page.locator("#editor-state")).to_have_text("Questionnaire is now stage 3 of 5.")
    expect_stages(page, "Consent", "Instruction", "Questionnaire", "Block of trials", "Debriefing")
    # a step as participants see it
    page.get_by_role("link", name=re.compile("Preview ?: Consent")).click()
    shown = page.frame_locator("#preview iframe")
    expect(shown.get_by_role("heading", level=1)).to_be_visible()
    page.get_by_role("button", name="Close").click()
    page.get_by_label("Name of the study").fill("Made without YAML")
    page.get_by_role("button", name="Open the study").click()
    expect(page.get_by_label("Link for participants")).to_have_value(re.compile(r"/join/"))
    page.context.close()


@needs_code_mirror
def test_errors_stand_at_their_line_and_what_a_form_changed_is_taken_back(chromium: Browser, address: str) -> None:
    page = signed_in_page(chromium, address)
    page.goto(f"{address}/lab/new")
    page.locator("input[value='shipped:quick_preference_study']").check()
    page.get_by_role("button", name="Check it").first.click()
    right = page.locator("textarea[name=yaml]").input_value()
    write_yaml(page, right.replace("view: top_down", "view: from_above", 1))
    expect(page.locator(".cm-lint-marker-error")).to_have_count(1)
    expect(page.locator(".timeline > li.wrong")).to_have_count(1)
    page.locator(".timeline > li.wrong summary").first.click()
    page.locator(".timeline > li.wrong").get_by_label("View").first.select_option("first_person")
    expect(page.get_by_text("The protocol is valid")).to_be_visible()
    assert written(page) == right.replace("view: top_down", "view: first_person", 1)
    page.locator(".cm-content").click()
    page.keyboard.press("Control+z")
    expect(page.locator(".cm-lint-marker-error")).to_have_count(1)
    write_yaml(page, right.replace("stages:", "stages: [", 1))
    expect(page.locator("#editor-part")).to_have_attribute("inert", "")
    write_yaml(page, right)
    expect(page.locator("#editor-part")).not_to_have_attribute("inert", "")
    page.context.close()


@needs_code_mirror
def test_keys_and_values_are_completed(chromium: Browser, address: str) -> None:
    page = signed_in_page(chromium, address)
    start_empty(page, address, "Completed", "Start with an empty protocol", "Title that participants see")
    code = page.locator(".cm-content")
    code.click()
    page.keyboard.press("Control+End")
    page.keyboard.type("partic")
    expect(page.locator(".cm-completionLabel").first).to_have_text("participants")
    page.wait_for_timeout(200)  # a list that has only just opened takes no key yet
    page.keyboard.press("Enter")
    page.keyboard.type("24")
    assert written(page).endswith("stages: []\nparticipants: 24")
    page.context.close()


LEARN = """async () => {
  const known = await fetch(location.pathname + "/schema.json").then((answer) => answer.json());
  const { suggest } = await import("/static/js/yaml-completion.js");
  window.suggested = (before) => (suggest(before, known)?.options ?? []).map((one) => one.label);
}"""
SUGGESTED = "(several) => several.map(window.suggested)"


def test_what_is_suggested_fits_the_place(chromium: Browser, address: str) -> None:
    page = signed_in_page(chromium, address)
    start_empty(page, address, "Completed", "Start with an empty protocol", "Title that participants see")
    page.evaluate(LEARN)

    def suggested(before: str) -> set[str]:
        return set(page.evaluate(SUGGESTED, [before])[0])

    assert {"participants", "stages"} <= suggested("protocol: x\n")
    assert "protocol" not in suggested("protocol: x\n")
    assert {"consent", "block"} <= suggested("stages:\n  - ")
    assert {"consent", "block"} <= suggested("stages:\n- ")
    assert suggested("stages:\n  - block:\n      view: ") == {"top_down", "first_person", "immersive"}
    assert {"trials", "viewing"} <= suggested("stages:\n  - block:\n      view: top_down\n      ")
    assert "count" not in suggested("stages:\n  - block:\n      view: top_down\n      ")
    deep = "stages:\n  - block:\n      trials:\n        # some\n        - queries: {count: 15, "
    assert {"choose", "role"} <= suggested(deep)
    assert "information" in suggested(f"{deep}choose: ")
    assert "texts/consent.md" in suggested("stages:\n  - consent: {text: ")
    assert "demographics" in suggested("stages:\n  - questionnaire:\n      use: ")
    assert "study_room/queries_500" in suggested("query_set: ")
    assert {"true", "false"} <= suggested("stages:\n  - block:\n      same_queries: ")
    assert {"base", "own"} <= suggested("stages:\n  - comparison: {arms: [base, ")
    assert suggested("# min") == set()
    # every place of every shipped protocol: the key that stands there is among those suggested
    for file in find_shipped_protocols():
        lines = file.read_text().splitlines()
        places = [(n, line, re.match(r"(\s*(?:- )*)(\w+):", line)) for n, line in enumerate(lines)]
        keys = [(n, line, key) for n, line, key in places if key and key[2] not in ("en", "de")]
        offered = page.evaluate(SUGGESTED, ["\n".join([*lines[:n], key[1]]) for n, _, key in keys])
        for (n, line, key), words in zip(keys, offered, strict=True):
            assert key[2] in words, (file.stem, n + 1, line, words)
    page.context.close()


def test_the_editor_is_accessible_and_fits(chromium: Browser, address: str) -> None:
    page = signed_in_page(chromium, address, reduced_motion="reduce")
    page.goto(f"{address}/lab/new")
    page.locator("input[value='shipped:quick_preference_study']").check()
    page.get_by_role("button", name="Check it").first.click()
    expect(page.locator("#editor-state")).not_to_be_empty()
    page.locator(".timeline > li > details > summary").nth(4).click()
    for width, wrong_in in ((1440, violations), (1024, violations), (390, violations_in_both_schemes)):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert wrong_in(page, None) == [], width
    page.context.close()


def test_without_codemirror_the_plain_field_does(chromium: Browser, address: str) -> None:
    page = signed_in_page(chromium, address)
    page.route("**/static/npm/**", lambda route: route.abort())
    start_empty(page, address, "Plain", "Start with an empty protocol", "Title that participants see")
    plain = page.get_by_label("Edit the protocol")
    expect(plain).to_be_visible()
    add(page, "consent")
    assert "consent" in plain.input_value()
    plain.fill(plain.input_value().replace("minutes: 15", "minutes: soon"))
    expect(page.locator(".problems")).to_contain_text("minutes")
    page.context.close()


def test_a_german_lab_makes_a_study_in_german(chromium: Browser, address: str) -> None:
    page = signed_in_page(chromium, address)
    page.goto(f"{address}/lab/language/de?next=/lab/studies")
    start_empty(page, address, "Welche Fahrt?", "Mit leerem Protokoll beginnen", "Titel, den Teilnehmende sehen")
    for kind in ("consent", "block", "debriefing"):
        add(page, kind, "Neuer Abschnitt", "Abschnitt hinzufügen")
    expect_stages(page, "Einwilligung", "Block von Durchgängen", "Abschluss")
    expect(page.get_by_text("Das Protokoll ist gültig")).to_be_visible()
    page.context.close()
