"""Every page that participants see: accessible in both schemes and languages, nothing out of sight."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import expect

from tests.accessible import violations, violations_in_both_schemes
from tests.frontend.example_pages import STEPS

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

REFUSALS = (
    *("unknown", "expired", "closed", "full", "already_joined", "no_webgl", "other_device"),
    *("withdrawn", "not_found", "internal"),
)
ADDRESSES = ["/join", "/device", "/back", "/copy", "/help", "/refusal/unknown", *(f"/step/{kind}" for kind in STEPS)]
MEASURED_MS = 30_000  # within which even a busy machine has measured its frame rate

Open = Callable[..., "Page"]


@pytest.fixture
def opened(chromium: Browser, pages: str) -> Iterator[Open]:
    """Opens an example page in a window of its own: `opened("/join", width=..., scheme="dark", language="de")`."""
    contexts = []

    def opening(
        address: str,
        *,
        width: int = 1024,
        height: int = 640,
        scheme: str = "light",
        language: str = "en",
        touch: bool = False,
        gate: str = "",
    ) -> Page:
        context = chromium.new_context(
            viewport={"width": width, "height": height},
            screen={"width": width, "height": height},
            color_scheme=scheme,
            reduced_motion="reduce",  # nothing is looked at in the middle of a transition
            has_touch=touch,
            is_mobile=touch,
        )
        contexts.append(context)
        page = context.new_page()
        page.goto(f"{pages}{address}?language={language}&{gate}")
        if address.startswith("/step/"):
            page.locator(".step-body[data-live]").wait_for(state="attached")  # its kind's module has come
        return page

    yield opening
    for context in contexts:
        context.close()


@pytest.mark.parametrize("address", ADDRESSES)
def test_every_page_is_accessible_in_both_schemes_and_does_not_scroll_sideways(opened: Open, address: str) -> None:
    page = opened(address, language="de")
    if address != "/step/comparison":  # to axe the same as a trial
        assert violations_in_both_schemes(page) == []
    for width, height in ((1024, 640), (760, 1000), (400, 800)):
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_the_dialogs_are_accessible(opened: Open) -> None:
    page = opened("/step/instruction")
    page.click("#topbar [data-opens=help-dialog]")
    assert violations(page) == []
    page.keyboard.press("Escape")
    page.click("#topbar [data-opens=leave-dialog]")
    assert violations(page) == []
    page.click("[data-turn=confirm]")
    assert page.locator("[data-withdraw] >> visible=true").count() == 1
    assert violations(page) == []


@pytest.mark.parametrize("language", ["en", "de"])
@pytest.mark.parametrize(("width", "height"), [(1024, 640), (1180, 820), (1920, 1080)])
def test_nothing_scrolls_on_a_trial_and_all_of_it_is_in_sight(
    opened: Open, width: int, height: int, language: str
) -> None:
    page = opened("/step/trial", width=width, height=height, language=language)
    assert page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]") == [
        width,
        height,
    ]
    stage = page.locator("#stage").bounding_box()
    assert stage is not None
    assert stage["width"] == width
    assert stage["height"] >= 0.7 * height
    for selector in ("#start", "[data-choice=a]", "[data-choice=b]", "#start-hint", "[data-pause] >> nth=0"):
        box = page.locator(selector).bounding_box()
        assert box is not None
        assert 0 <= box["x"] <= box["x"] + box["width"] <= width
        assert 0 <= box["y"] <= box["y"] + box["height"] <= height


def test_a_and_b_differ_in_nothing_but_their_letter(opened: Open) -> None:
    page = opened("/step/trial")
    look = """button => { const style = getComputedStyle(button); const box = button.getBoundingClientRect();
        const names = ["color", "backgroundColor", "borderColor", "borderStyle", "borderWidth", "fontSize",
                       "fontWeight", "opacity", "boxShadow", "outlineStyle"];
        return [box.width, box.height, box.top, ...names.map((name) => style[name])]; }"""
    a, b = page.locator("[data-choice=a]"), page.locator("[data-choice=b]")
    assert a.evaluate(look) == b.evaluate(look)
    markup = [pick.evaluate("button => button.outerHTML") for pick in (a, b)]
    assert markup[0].replace(">A<", ">B<").replace('"a"', '"b"') == markup[1]
    middle = page.evaluate("innerWidth") / 2
    box_a, box_b = a.bounding_box(), b.bounding_box()
    assert box_a is not None
    assert box_b is not None
    assert middle - (box_a["x"] + box_a["width"]) == pytest.approx(box_b["x"] - middle)


def test_buttons_that_do_not_count_yet_say_why(opened: Open) -> None:
    page = opened("/step/trial")
    pick = page.locator("[data-choice=a]")
    assert pick.get_attribute("aria-disabled") == "true"
    assert page.locator(f"#{pick.get_attribute('aria-describedby')}").text_content() == (
        "You can choose as soon as you have watched both drives to the end."
    )
    page.keyboard.press("a")
    assert page.locator("#live").text_content() == "You can choose as soon as you have watched both drives to the end."


def test_nothing_is_preselected_and_open_questions_are_pointed_out(opened: Open) -> None:
    page = opened("/step/questionnaire")
    assert page.locator("input:checked").count() == 0
    page.get_by_role("button", name="Continue").click()
    assert page.locator("[data-missing]").count() == 5
    assert page.get_by_text("5 questions are still open.").is_visible()
    assert page.evaluate("document.activeElement.id") == "item-age"
    page.fill("#item-age", "7")
    page.get_by_role("radio", name="Well").check()
    for key in ("one", "two", "three"):
        page.locator(f"[name={key}][value='4']").check()
    page.get_by_role("button", name="Continue").click()
    assert page.get_by_text("Please give a whole number from 18 to 110.").is_visible()
    page.fill("#item-age", "70")
    page.get_by_role("button", name="Continue").click()
    assert page.get_by_text("Part 2 of 2").is_visible()
    assert page.locator("[name=four]").first.is_visible()
    page.get_by_role("button", name="Back").click()
    assert page.locator("[name=three][value='4']").is_checked()


def test_the_questionnaire_works_by_keyboard_alone(opened: Open) -> None:
    page = opened("/step/questionnaire")
    page.focus("#item-age")
    page.keyboard.type("44")
    for _ in range(4):
        page.keyboard.press("Tab")
        page.keyboard.press("Space")
    page.keyboard.press("ArrowRight")
    assert page.locator("input:checked").count() == 4
    assert page.locator("[name=three][value='2']").is_checked()
    page.keyboard.press("Enter")
    assert page.get_by_text("Part 2 of 2").is_visible()


def test_questions_come_after_the_answers_that_they_need(opened: Open) -> None:
    page = opened("/step/skipping")
    go_on = page.get_by_role("button", name="Continue")
    expect(go_on).to_be_enabled()
    assert page.get_by_text("Part 1 of 2").is_visible()  # nobody has said that they are 60
    assert not page.locator("#item-age").is_visible()
    page.get_by_role("radio", name="Well").check()
    go_on.click()
    assert page.get_by_text("One question is still open.").is_visible()
    page.fill("#item-age", "70")
    assert page.get_by_text("Part 1 of 3").is_visible()
    go_on.click()
    assert page.locator("[name=old]").first.is_visible()
    page.get_by_role("button", name="Back").click()
    page.get_by_role("radio", name="Badly").check()  # takes the question and what hung on it away
    assert not page.locator("#item-age").is_visible()
    go_on.click()
    assert page.get_by_text("Part 2 of 2").is_visible()
    assert page.locator("[name=all]").first.is_visible()
    page.get_by_role("button", name="Back").click()
    assert page.locator("[name=vision]").first.is_visible()


def places(page: Page, item: str) -> list[str]:
    return page.locator(f"[data-item={item}] [data-place]").evaluate_all(
        "places => places.map((place) => place.querySelector('[data-value]')?.dataset.value ?? '')"
    )


def test_a_ranking_works_by_keyboard_alone_and_knows_no_ties(opened: Open) -> None:
    page = opened("/step/ranking")
    assert places(page, "useful") == ["", "", ""]  # nothing stands anywhere before it is put there
    page.get_by_role("button", name="Continue").click()
    assert page.get_by_text("2 questions are still open.").is_visible()
    assert page.evaluate("document.activeElement.dataset.value") == "above"
    for _ in range(3):
        page.keyboard.press("Enter")  # the focus goes along to the place; the next stop is what has no place yet
        page.keyboard.press("Tab")
    assert places(page, "useful") == ["above", "eyes", "room"]
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowUp")
    assert places(page, "useful") == ["room", "above", "eyes"]
    assert page.locator("[data-item=useful] [data-said]").text_content() == "Room: place 1 of 3"
    page.keyboard.press("Enter")
    assert places(page, "useful") == ["", "above", "eyes"]
    page.keyboard.press("Enter")
    page.reload()
    assert places(page, "useful") == ["room", "above", "eyes"]


def test_a_ranking_works_by_dragging(opened: Open) -> None:
    page = opened("/step/ranking")

    def drag(card: str, to: str) -> None:
        page.locator("[data-item=easy]").scroll_into_view_if_needed()
        boxes = [page.locator(f"[data-item=easy] {one}").bounding_box() for one in (f"[data-value={card}]", to)]
        (x, y), (x_to, y_to) = ((b["x"] + b["width"] / 2, b["y"] + b["height"] / 2) for b in boxes if b)
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x_to, y_to)
        page.mouse.up()

    drag("eyes", "[data-place] >> nth=2")
    drag("above", "[data-place] >> nth=0")
    assert places(page, "easy") == ["above", "", "eyes"]
    drag("eyes", "[data-place] >> nth=0")  # onto an occupied place: the two change places
    assert places(page, "easy") == ["eyes", "", "above"]
    page.locator("[data-item=easy] [data-value=room]").click()
    assert places(page, "easy") == ["eyes", "room", "above"]
    drag("room", "[data-pool]")
    assert places(page, "easy") == ["eyes", "", "above"]


def test_what_was_answered_survives_a_reload(opened: Open) -> None:
    page = opened("/step/questionnaire")
    page.fill("#item-age", "70")
    page.locator("[name=two][value='6']").check()
    page.reload()
    assert page.input_value("#item-age") == "70"
    assert page.locator("[name=two][value='6']").is_checked()


def test_consent_wants_every_point_ticked(opened: Open) -> None:
    page = opened("/step/consent")
    sent: list[str] = []
    page.on("request", lambda request: sent.append(request.url) if request.method == "POST" else None)
    page.get_by_label("I am 18.").check()
    page.get_by_role("button", name="I agree and take part").click()
    assert page.get_by_text("Some points are not ticked yet.").is_visible()
    assert sent == []
    page.get_by_label("I agree.", exact=True).check()
    page.get_by_role("button", name="I agree and take part").click()
    assert page.locator("[data-missing]").count() == 2  # the other uses are decided one by one, either way
    assert sent == []
    page.get_by_role("group", name="Robots may learn from them?").get_by_label("Yes, I agree").check()
    page.get_by_role("group", name="Publish them?").get_by_label("No, I do not agree").check()
    with page.expect_request("**/steps/05-consent") as request:
        page.get_by_role("button", name="I agree and take part").click()
    purposes = {"training": True, "open_data": False}
    assert request.value.post_data_json["value"] == {"given": True, "version": "1", "purposes": purposes}


def test_the_waiting_page_promises_no_beginning_where_no_worker_lives(opened: Open) -> None:
    page = opened("/step/wait")
    told = page.evaluate(
        """async () => {
          const { readyWait } = await import("/static/js/wait.js");
          const news = readyWait(document.querySelector(".step"), (key) => key);
          return [null, 12].map((seconds) => {
            news({ progress: 0, before: 0, running: false, seconds, at_most: 600, done: false });
            return document.getElementById("wait-now").textContent; }); }"""
    )
    assert told == ["wait.silent", "wait.queued"]


def test_a_break_rests_as_long_as_the_protocol_says(opened: Open) -> None:
    page = opened("/step/break")
    assert page.get_by_role("button", name="Continue").is_disabled()
    page.get_by_text("You can go on in").wait_for()
    page.get_by_role("button", name="Continue", disabled=False).wait_for()
    assert page.get_by_text("Go on whenever you are ready.").is_visible()


def test_a_page_with_a_time_limit_says_what_is_left_and_sends_what_there_is(chromium: Browser, pages: str) -> None:
    context = chromium.new_context(viewport={"width": 1024, "height": 640})
    page = context.new_page()
    page.clock.install()
    page.goto(f"{pages}/step/comprehension")
    assert page.get_by_text("There are 1.5 minutes for this page.").or_(page.get_by_text("Time left")).is_visible()
    expect(page.get_by_role("button", name="Continue")).to_be_enabled()  # from here on the page counts
    page.get_by_label("Badly").check()
    page.clock.run_for(40_000)
    assert page.get_by_text("Time left for this page: 0 min").is_visible()
    with page.expect_request("**/steps/05-comprehension") as request:
        page.clock.run_for(60_000)
    assert request.value.post_data_json["value"] == {"vision": "badly", "timed_out": True}
    context.close()


def test_the_welcome_page_lets_a_good_device_in(opened: Open) -> None:
    page = opened("/join")
    expect(page.locator("[data-result=good]")).to_have_count(4, timeout=MEASURED_MS)
    expect(page.get_by_role("button", name="Continue")).to_be_enabled()
    with page.expect_request(lambda request: request.method == "POST") as request:
        page.get_by_role("button", name="Continue").click()
    posted = request.value.post_data or ""
    assert "language=en" in posted
    assert "PROLIFIC_PID=p1" in posted
    assert "webgl%22%3Atrue" in posted
    assert "frame_rate%22%3A" in posted


def test_a_slow_device_gets_a_simpler_picture_before_it_gets_a_refusal(opened: Open) -> None:
    simpler = opened("/join", gate="light_below=1000")
    expect(simpler.get_by_text("you will see a simpler picture")).to_be_visible(timeout=MEASURED_MS)
    expect(simpler.locator("#begin")).to_be_enabled()
    refused = opened("/join", gate="light_below=1000&min_frame_rate=1000")
    told = refused.get_by_role("alert").get_by_text("The pictures move too slowly on this device")
    expect(told).to_be_visible(timeout=MEASURED_MS)
    expect(refused.locator("#begin")).to_be_disabled()


def test_one_busy_second_is_no_slow_device(chromium: Browser, pages: str) -> None:
    """Something else kept the computer busy while the welcome page measured: "The pictures move slowly"."""
    context = chromium.new_context(viewport={"width": 1024, "height": 640})
    page = context.new_page()
    page.add_init_script(
        "const next = requestAnimationFrame.bind(window), began = performance.now();"
        "window.requestAnimationFrame = (f) =>"
        " performance.now() - began < 3500 ? setTimeout(() => next(f), 700) : next(f);"
    )
    page.goto(f"{pages}/join?min_frame_rate=2")
    expect(page.locator("#begin")).to_be_enabled(timeout=MEASURED_MS)
    with page.expect_request(lambda request: request.method == "POST") as request:
        page.get_by_role("button", name="Continue").click()
    (rate,) = re.findall(r"frame_rate%22%3A([0-9.]+)", request.value.post_data or "")
    assert float(rate) > 2  # 1.4 while it was busy
    context.close()


def test_a_phone_that_goes_on_with_a_session_is_refused_kindly(opened: Open) -> None:
    page = opened("/device", width=390, height=844, touch=True)
    alert = page.get_by_role("alert")
    assert alert.get_by_text("This study needs a larger screen").is_visible()
    assert alert.get_by_text("Your answers so far are kept.").is_visible()
    assert page.get_by_text("Nothing about you").count() == 0


def test_a_browser_without_webgl_is_told_before_anything_else(chromium: Browser, pages: str) -> None:
    context = chromium.new_context(viewport={"width": 1024, "height": 640})
    page = context.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(f"{pages}/join")
    assert page.get_by_role("alert").get_by_text("The room cannot be shown in this browser").is_visible()
    assert page.get_by_text("ada@example.org").is_visible()
    assert page.get_by_role("button", name="Continue").is_disabled()
    context.close()


def test_a_phone_is_refused_kindly_and_a_tablet_is_asked_to_turn(opened: Open) -> None:
    phone = opened("/join", width=400, height=800, touch=True)
    assert phone.get_by_role("alert").get_by_text("This study needs a larger screen").is_visible()
    assert phone.locator("#begin").is_disabled()
    tablet = opened("/join", width=720, height=1100, touch=True)
    assert tablet.get_by_text("please turn the device sideways").is_visible()
    assert tablet.get_by_role("alert").count() == 0
    tablet.set_viewport_size({"width": 1100, "height": 720})
    tablet.locator("#begin:enabled").wait_for()


@pytest.mark.parametrize("address", ["/join", "/device"])
def test_what_a_device_lacks_is_the_first_line_of_the_first_page(opened: Open, address: str) -> None:
    page = opened(address, width=390, height=844, touch=True)
    first = page.locator("main .content > :visible").first
    assert first.get_attribute("role") == "alert"
    words = "This study needs a larger screen. Please open the same link on a computer or a tablet."
    assert first.inner_text().startswith(words)
    mouse = opened(address, width=1024, height=768, touch=True, gate="pointers=fine")
    assert "on a computer with a mouse" in mouse.get_by_role("alert").inner_text()


@pytest.mark.parametrize("language", ["en", "de"])
@pytest.mark.parametrize(("width", "height"), [(390, 844), (390, 664), (360, 560)])
def test_on_a_phone_the_bar_is_one_line_and_the_room_keeps_its_size(
    opened: Open, width: int, height: int, language: str
) -> None:
    page = opened("/step/trial", width=width, height=height, touch=True, language=language)
    bar = page.locator("#topbar").bounding_box()
    assert bar is not None
    assert bar["height"] <= 56
    assert page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]") == [
        width,
        height,
    ]
    heights = page.evaluate(
        """names => names.map((name) => {
            for (const part of document.querySelectorAll("[data-phase]")) part.hidden = part.dataset.phase !== name;
            return document.getElementById("stage").offsetHeight; })""",
        ["ready", "playing", "choosing", "sending"],
    )
    assert len(set(heights)) == 1


def test_on_a_phone_the_one_main_button_is_always_in_sight(opened: Open, pages: str) -> None:
    page = opened("/join", width=390, height=844, touch=True)
    for address in ("/join", *(f"/step/{kind}" for kind in STEPS)):
        page.goto(f"{pages}{address}?language=de")
        for height in (844, 664):
            page.set_viewport_size({"width": 390, "height": height})
            for part in page.locator(".bottombar .main:visible, .bottombar > .next:visible").all():
                box = part.bounding_box()
                assert box is not None
                assert 0 <= box["y"] <= box["y"] + box["height"] <= height, address
                assert abs(box["x"] + box["width"] / 2 - 195) <= 8, address


def test_on_a_phone_the_words_of_a_scale_stand_below_its_points(opened: Open) -> None:
    page = opened("/step/questionnaire", width=390, height=844, touch=True)
    page.evaluate("document.querySelectorAll('.scale-point:nth-of-type(n + 6)').forEach((point) => point.remove())")
    scale = page.locator(".scale").first
    assert scale.locator(".scale-point").count() == 5
    points = [point.bounding_box() for point in scale.locator(".scale-point").all()]
    assert all(box["width"] >= 44 for box in points)
    for words in (".scale-low", ".scale-high"):
        assert scale.locator(words).bounding_box()["y"] >= points[0]["y"] + points[0]["height"]


@pytest.mark.parametrize("kind", ["tuning", "triangle", "words", "meet_your_robot"])
def test_a_finger_hits_what_sets_the_weights(opened: Open, kind: str) -> None:
    page = opened(f"/step/{kind}", width=390, height=844, touch=True)
    page.evaluate("document.getElementById('words-found')?.removeAttribute('hidden')")
    parts = page.locator("#live-panel :is(button:not(.triangle-handle), input[type=range]):visible")
    expect(parts.first).to_be_visible()
    heights = parts.evaluate_all("parts => parts.map((part) => [part.getBoundingClientRect().height, part.outerHTML])")
    shown = [(height, part) for height, part in heights if height]  # the page hides parts while it gets ready
    assert shown
    assert [part for height, part in shown if height < 44] == []


def test_the_menu_of_a_phone_gives_the_focus_back(opened: Open) -> None:
    page = opened("/step/instruction", width=390, height=844, touch=True)
    assert not page.locator("#menu [data-pause]").is_visible()
    page.locator(".menu-button").click()
    assert page.locator("#menu [data-pause]").is_visible()
    assert violations(page) == []
    page.locator("#menu [data-opens=help-dialog]").click()
    assert page.locator("#help-dialog").is_visible()
    assert not page.locator("#menu").is_visible()
    page.keyboard.press("Escape")
    assert page.evaluate("document.activeElement.className") == "plain menu-button"


def test_a_phone_is_let_in_where_the_protocol_asks_for_less(opened: Open) -> None:
    phone = opened("/join", width=400, height=800, touch=True, gate="min_width=360&min_height=600")
    phone.locator("[data-check=size][data-result=good]").wait_for()
    assert phone.get_by_role("alert").count() == 0


def test_a_small_window_is_asked_to_grow(chromium: Browser, pages: str) -> None:
    context = chromium.new_context(viewport={"width": 600, "height": 600}, screen={"width": 1440, "height": 900})
    page = context.new_page()
    page.goto(f"{pages}/join")
    assert page.get_by_text("The window is too small").is_visible()
    assert page.locator("#begin").is_disabled()
    page.set_viewport_size({"width": 1100, "height": 720})
    page.locator("#begin:enabled").wait_for()
    context.close()


@pytest.mark.parametrize("code", REFUSALS)
def test_refusals_say_what_happened_what_to_do_and_whom_to_ask(opened: Open, code: str) -> None:
    page = opened(f"/refusal/{code}")
    assert page.locator("main p").count() == 3
    assert page.get_by_text("ada@example.org").is_visible()


def test_an_unknown_refusal_is_shown_as_our_own_fault(opened: Open) -> None:
    assert opened("/refusal/moon_phase").get_by_text("Something went wrong on our side").is_visible()
