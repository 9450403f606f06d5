"""Rules told on their page: a card with a picture of the floor, a zone drawn on it, an order where two collide."""

from __future__ import annotations

import json
from typing import Any

from playwright.sync_api import Browser, Page, Route, expect

from desirepath.learning.rules.rule import Rule
from desirepath.study.personalising import rule_pictures
from tests.frontend.empty_room import room_says


def answered(route: Route) -> None:
    """As the server does: the page's language is English."""
    asked = json.loads(route.request.post_data or "{}")
    rules = [Rule.model_validate(rule) for rule in asked["rules"]]
    reply = rule_pictures.picture(rules, asked["place"])
    if asked.get("sentence"):
        reply["read"] = rule_pictures.read(asked["sentence"], "en")
    pair = rule_pictures.paths_of(rules[asked["check"]], asked["place"]) if asked.get("check") is not None else None
    route.fulfill(json=reply | {"pair": [rule_pictures.told(one) for one in pair] if pair else None})


def test_a_rule_is_told_drawn_ordered_and_seen_obeyed_and_broken(chromium: Browser, pages: str) -> None:
    page = chromium.new_page()
    sent: list[dict[str, Any]] = []

    def submitted(route: Route) -> None:
        sent.append(json.loads(route.request.post_data or "{}"))
        route.abort()

    page.route("**/live/*/rules", answered)
    page.route("**/steps/*", submitted)
    page.goto(f"{pages}/step/rules")
    expect(page.locator(".step-body[data-live]")).to_be_attached()
    room_says(page, "ready")

    def tell(sentence: str) -> None:
        page.locator("#rules-sentence").fill(sentence)
        page.locator("[data-tell][aria-disabled=false]").click()
        expect(page.locator("#rules-sentence")).to_have_value("")

    tell("When I sit, keep behind me")
    card = page.locator("[data-card='0']")
    expect(card.locator(".rule-when")).to_have_text("When: you sit")
    expect(card.locator(".rule-then")).to_have_text("Then: not in front of you")
    expect(card.locator(".floor-picture .zone")).to_have_count(1)

    tell("Not here")
    drawable = page.locator("[data-card='1'] .drawable")
    drawable.focus()
    drawable.press("ArrowUp")
    expect(page.locator("[data-card='1'] .floor-picture.drawable .zone")).to_have_count(1)
    expect(page.locator("[data-does='zone-1']")).to_be_focused()
    page.locator("[data-does='remove-1']").click()
    expect(page.locator("[data-card]")).to_have_count(1)

    tell("When I sit, come closer")
    tell("In the kitchen keep your distance")
    clash = page.locator("#rules-clashes")
    expect(clash).to_contain_text("contradict each other")
    clash.locator("[data-does='first-2']").click()
    expect(clash).to_be_empty()
    expect(page.locator("[data-card='1'] .rule-words")).to_contain_text("In the kitchen")
    page.locator("[data-does='on-1']").click()
    expect(page.locator("[data-card='1']")).to_have_attribute("data-off", "")

    for number in range(3):
        page.locator(f"[data-does='look-{number}']").click()
        chosen = page.locator(f"[data-does='pick-a-{number}']")
        chosen.or_(page.locator(f"[data-card='{number}'] .rule-pair > p")).first.wait_for()
        if chosen.count():
            chosen.click()
    page.locator("[data-done][aria-disabled=false]").click()
    while not sent:
        page.wait_for_timeout(20)
    value = sent[0]["value"]
    assert [(rule["words"], rule["on"]) for rule in value["rules"]] == [
        ("When I sit, keep behind me", True),
        ("In the kitchen keep your distance", False),
        ("When I sit, come closer", True),
    ]
    assert [change["do"] for change in value["history"]] == [
        *("told", "told", "drawn", "revoked", "told", "told", "moved", "off"),
    ]
    assert value["picked"][0] == {"rule": 0, "place": 0, "side": "a"}
    page.close()


def opened(page: Page, pages: str) -> None:
    page.route("**/live/*/rules", answered)
    page.goto(f"{pages}/step/rules")
    ready(page)


def ready(page: Page) -> None:
    expect(page.locator(".step-body[data-live]")).to_be_attached()
    room_says(page, "ready")


def tell(page: Page, sentence: str) -> None:
    page.locator("#rules-sentence").fill(sentence)
    page.locator("[data-tell][aria-disabled=false]").click()
    expect(page.locator("#rules-sentence")).to_have_value("")


def test_nothing_beside_an_open_pair_tells_which_way_keeps_the_rule(chromium: Browser, pages: str) -> None:
    page = chromium.new_page()
    opened(page, pages)
    tell(page, "When I walk, keep behind me")
    tell(page, "In the kitchen go slower")
    expect(page.locator("[data-card] > .floor-picture .way")).to_have_count(2)
    page.locator("[data-does='look-0']").click()
    expect(page.locator(".rule-pair .way")).to_have_count(2)
    expect(page.locator("[data-card] > .floor-picture .way")).to_have_count(0)
    expect(page.locator("[data-card='0'] .zone")).to_have_count(0)
    expect(page.locator("[data-drive]")).to_have_attribute("aria-disabled", "true")
    shown = "[...document.querySelectorAll('.rule-pair svg')].map((one) => one.outerHTML)"
    before = page.evaluate(shown)

    page.locator("[data-does='down-0']").click()
    page.locator("[data-card='1'] [data-does='pick-a-1']").wait_for()
    assert page.evaluate(shown) == before
    page.reload()
    ready(page)
    expect(page.locator(".rule-pair .way")).to_have_count(2)
    assert page.evaluate(shown) == before
    expect(page.locator("[data-drive]")).to_have_attribute("aria-disabled", "true")

    page.locator("[data-does='pick-b-1']").click()
    expect(page.locator("[data-card] > .floor-picture .way")).to_have_count(2)
    expect(page.locator("[data-drive]")).to_have_attribute("aria-disabled", "false")
    page.locator("[data-does='pick-a-1']").click(force=True)
    expect(page.locator("[data-does='pick-b-1']")).to_have_attribute("aria-pressed", "true")
    page.close()


def test_the_rule_that_is_edited_is_changed_wherever_it_was_moved(chromium: Browser, pages: str) -> None:
    page = chromium.new_page()
    opened(page, pages)
    tell(page, "When I sit, keep behind me")
    tell(page, "In the kitchen go slower")
    page.locator("[data-does='edit-0']").click()
    page.locator("[data-does='down-0']").click()
    tell(page, "When I sit, keep your distance")
    words = page.locator(".rule-words")
    expect(words.nth(0)).to_contain_text("In the kitchen go slower")
    expect(words.nth(1)).to_contain_text("When I sit, keep your distance")
    page.close()


def test_keys_that_draw_one_zone_are_one_change_and_a_refused_answer_loses_nothing(
    chromium: Browser, pages: str
) -> None:
    page = chromium.new_page()
    sent: list[dict[str, Any]] = []

    def refused(route: Route) -> None:
        sent.append(json.loads(route.request.post_data or "{}"))
        route.fulfill(status=422, json={"detail": {"code": "bad_value"}})

    page.route("**/steps/*", refused)
    opened(page, pages)
    tell(page, "When I sit, keep behind me")
    tell(page, "Not here")
    for _ in range(5):
        page.locator("[data-card='1'] .drawable").press("ArrowUp")
    page.locator("[data-does='down-0']").click()
    for number in range(2):
        page.locator(f"[data-does='look-{number}']").click()
        page.locator(f"[data-card='{number}'] [data-does='look-{number}']").wait_for(state="detached")
        neither = page.locator(f"[data-does='pick-neither-{number}']")
        if neither.count():
            neither.click()
    page.locator("[data-done][aria-disabled=false]").click()
    expect(page.locator("#banner")).to_be_visible()
    history = sent[0]["value"]["history"]
    assert [change["do"] for change in history] == ["told", "told", "drawn", "moved"]
    assert (history[-1]["rule"], history[-1]["to"]) == (0, 1)
    page.reload()
    ready(page)
    expect(page.locator("[data-card]")).to_have_count(2)
    page.close()


def test_a_question_back_offers_both_ways_and_none_and_the_page_says_what_is_new(chromium: Browser, pages: str) -> None:
    page = chromium.new_page()
    opened(page, pages)
    page.locator("[data-done]").click(force=True)
    expect(page.locator("#live")).to_have_text("Please tell your rules first: 0 of at least 1.")
    tell(page, "When I sit, drive less smoothly")
    expect(page.locator("#rules-list")).not_to_have_attribute("aria-live", "polite")
    expect(page.locator("#live")).to_contain_text("When: you sit")
    page.locator("[data-does='meant-0-smoother-less']").click()
    expect(page.locator(".rule-then")).to_contain_text("less:")
    tell(page, "In the kitchen drive carefully")
    expect(page.locator("[data-does^='meant-1']").first).to_be_visible()
    page.evaluate("document.querySelector('#live-panel').dataset.mostWishes = 0")  # a rule with all its wishes
    page.locator("[data-does='on-1']").click()
    expect(page.locator("[data-does^='meant-1']")).to_have_count(0)
    page.locator("[data-does='none-1']").click()
    expect(page.locator("#rules-sentence")).to_have_value("In the kitchen drive carefully")
    page.close()


def test_a_zone_that_was_drawn_in_another_home_is_said_to_be(chromium: Browser, pages: str) -> None:
    page = chromium.new_page()
    page.route("**/live/*/place", lambda route: route.fulfill(json={}))
    opened(page, pages)
    tell(page, "Not here")
    page.locator("[data-card='0'] .drawable").press("ArrowUp")
    expect(page.locator("[data-card='0'] .drawable .zone")).to_have_count(1)
    page.locator("[data-place][aria-disabled=false]").click()
    room_says(page, "ready")
    expect(page.locator("[data-card='0']")).to_contain_text("You drew this place in home 1")
    page.close()
