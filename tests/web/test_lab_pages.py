"""The experimenters' pages: make a study, watch it, exclude and erase people, take the data away."""

from __future__ import annotations

import html
import io
import json
import re
import zipfile
from datetime import timedelta
from urllib.parse import urljoin

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import func, select, true, update

from desirepath.installed import PROTOCOLS
from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.queries.queries import QuerySet
from desirepath.store.artefacts import load_trajectory
from desirepath.store.models import Base, Event, Participant, Response, Session, Study, Trial, utc_now
from desirepath.store.query_sets import import_query_set, save_query_set
from desirepath.study.protocol.freezing import freeze, freeze_text
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import create_study
from desirepath.web.application import create_application
from desirepath.web.core.dependencies import Services
from desirepath.web.lab import drafts, monitoring
from desirepath.web.lab.preview import example_query, preview_steps
from desirepath.web.lab.protocol_cards import find_card, protocol_cards
from desirepath.web.lab.study_rows import study_lines
from tests.study.small_protocol import small_protocol
from tests.web.lab_services import NAME, QUICK, Walked, csrf, sign_in

STAGE_SHOWN = 'id="stage-cover" hidden'
LINKED_NUMBER = re.compile(r'<a class="number" href="([^"]+)">(\d+)</a>')


def draft_of(lab: TestClient, **form: str) -> str:
    """Choose or paste a protocol; the draft's address."""
    answered = lab.post("/lab/new", data={"csrf": csrf(lab), **form})
    assert answered.status_code == 303, answered.text
    return answered.headers["location"]


def row_counts(services: Services) -> dict[str, int]:
    with services.database.session() as s:
        return {t.name: s.scalar(select(func.count()).select_from(t)) or 0 for t in Base.metadata.sorted_tables}


def rows_shown(page: str) -> int:
    """How many rows a page of rows says or shows that it has."""
    text = html.unescape(re.sub(r"<[^>]+>", " ", page))
    counted = re.search(r"\b(\d+) (?:answers?|events?)\b", text)
    if counted and ("Everything that happened" in text or "Decision time" in text or "No answer." in text):
        return int(counted.group(1))
    if 'href="?show=all"' in page:
        return len(re.findall(r'<th scope="row"><a', page))
    return len(re.findall(r"<blockquote", page)) or len(re.findall(r"<tr>", page)) - 1


# ---- a new study ----


def test_empty_list_teaches_the_three_steps(lab):
    page = lab.get("/lab/studies").text
    assert page.count("<li>") >= 3
    assert 'href="/lab/new"' in page


def test_the_studies_list_counts_people_and_shows_simulated_ones_apart(lab_services: Services, walked: Walked) -> None:
    def counted() -> tuple[int, int]:
        with lab_services.database.session() as s:
            line = study_lines(s, true())[0]
        return line.completed, line.completed_simulated

    assert counted() == (1, 0)
    with lab_services.database.transaction() as s:
        bot = s.scalars(select(Participant).where(Participant.code == walked.bot)).one()
        s.execute(update(Session).where(Session.participant_id == bot.id).values(state="completed"))
    assert counted() == (1, 1)


def test_three_questions_lead_to_one_card_and_every_card_is_led_to(lab):
    cards = protocol_cards()
    anywhere = {card for card in cards if card.frozen.protocol.asked_of_devices.headset != "required"}
    assert {find_card(card.answers, cards) for card in cards} == anywhere, "nobody is led to what needs a headset"
    assert all("<polyline" in card.picture and len(card.picture) < 4_000 for card in cards)
    walked = {"does": "rank", "moves": "people", "minutes": "30"}
    page = lab.get("/lab/new", params=walked).text
    first = page[page.index('class="card"') :].partition("</label>")[0]
    assert "data-fits" in first
    assert 'value="shipped:crowd_explanation_study" checked' in first
    assert "No shipped protocol matches" not in page
    told = lab.get("/lab/new", params=walked | {"moves": "self", "minutes": "60"}).text
    assert re.findall(r"Asked for: ([^;]+);", told) == ["participants walk themselves"], "a shorter one is no other"
    assert "data-fits" not in lab.get("/lab/new", params={"does": "rank"}).text


def test_shipped_protocol_becomes_a_study_in_three_steps(lab, lab_services):
    before = row_counts(lab_services)
    draft = draft_of(lab, source="shipped:quick_preference_study")
    check = lab.get(draft).text
    assert "The protocol is valid" in check
    assert "15 queries" in check
    assert row_counts(lab_services) == before
    opened = lab.post(f"{draft}/open", data={"csrf": csrf(lab), "name": "  Corridor   pilot "})
    assert opened.status_code == 303
    with lab_services.database.session() as s:
        study = s.scalars(select(Study)).one()
    assert study.name == NAME
    assert study.protocol_hash == freeze(QUICK).hash
    page = lab.get(opened.headers["location"]).text
    link = re.search(r'value="(http://[^"]+/join/[^"?]+)"', page)
    assert link
    assert lab.get(link.group(1)).status_code == 200
    assert lab.get(draft).status_code == 404


def test_broken_protocol_is_shown_with_line_and_field_and_cannot_be_opened(lab, lab_services):
    lines = QUICK.read_text(encoding="utf-8").splitlines()
    where = next(n for n, line in enumerate(lines, 1) if "view: top_down" in line)
    lines[where - 1] = lines[where - 1].replace("top_down", "topdown")
    draft = draft_of(lab, source="paste", yaml="\n".join(lines))
    page = lab.get(draft).text
    assert f'href="#line-{where}"' in page
    assert "stages[4].block.view" in page
    assert "first_person" in page
    assert f'class="line wrong" id="line-{where}"' in page
    assert lab.post(f"{draft}/open", data={"csrf": csrf(lab), "name": "x"}).status_code == 422
    assert lab.get(f"{draft}/preview/1").status_code == 200  # of the stages in which nothing is wrong
    lines[where - 1] = lines[where - 1].replace("topdown", "first_person")
    lab.post(draft, data={"csrf": csrf(lab), "yaml": "\n".join(lines)})
    assert "The protocol is valid" in lab.get(draft).text
    assert row_counts(lab_services)["study"] == 0


def test_unreadable_query_set_refuses_to_open_and_says_what_is_there(lab, lab_services):
    yaml = QUICK.read_text(encoding="utf-8").replace("study_room/queries_varied_200", "study_room/queries_none")
    draft = draft_of(lab, source="paste", yaml=yaml)
    refused = lab.post(f"{draft}/open", data={"csrf": csrf(lab), "name": "x"})
    assert refused.status_code == 422
    assert "study_room/queries_500" in refused.text
    assert row_counts(lab_services)["study"] == 0


def test_query_set_made_here_is_previewed_and_opened_by_its_id(lab, lab_services):
    shipped = load_queries("study_room/queries_500")
    with lab_services.database.transaction() as s:
        few = QuerySet(shipped.setup, shipped.queries[:20], {})
        made = save_query_set(s, lab_services.files, few, name="20 queries, seed 3", card={}).id
    yaml = QUICK.read_text(encoding="utf-8").replace("study_room/queries_varied_200", made)
    draft = draft_of(lab, source="paste", yaml=yaml)
    assert "The protocol is valid" in lab.get(draft).text
    step = 1 + next(n for n, one in enumerate(preview_steps(freeze(QUICK))) if one.kind == "trial")
    assert STAGE_SHOWN in lab.get(f"{draft}/preview/{step}").text
    assert lab.post(f"{draft}/open", data={"csrf": csrf(lab), "name": "Own queries"}).status_code == 303
    with lab_services.database.session() as s:
        study = s.scalars(select(Study)).one()
    assert study.protocol["materials"]["query_set"] == made
    assert STAGE_SHOWN in lab.get(f"/lab/studies/{study.id}/preview/{step}").text
    wrong = draft_of(lab, source="paste", yaml=yaml.replace(made, "c" * 64))
    assert f"{made}: 20 queries, seed 3" in lab.get(wrong).text


def test_an_order_is_previewed_where_nothing_drives_in_other_ways_and_where_the_queries_are_gone(lab, lab_services):
    with lab_services.database.transaction() as s:
        made = import_query_set(s, lab_services.files, "home/queries_depth_12").id
    order = "  - order: {view: top_down, count: 1, of: 4}\n  - block:"
    yaml = QUICK.read_text(encoding="utf-8").replace("  - block:", order, 1)
    draft = draft_of(lab, source="paste", yaml=yaml.replace("study_room/queries_varied_200", made))
    frozen = freeze_text(yaml, folder=PROTOCOLS)
    step = 1 + next(n for n, one in enumerate(preview_steps(frozen)) if one.kind == "order")
    page = lab.get(f"{draft}/preview/{step}").text
    assert STAGE_SHOWN in page
    assert re.findall(r'data-drive="(\d)"', page) == ["1", "2"]
    assert "needs a conditioned policy of home" in html.unescape(
        lab.post(f"{draft}/open", data={"csrf": csrf(lab), "name": "x"}).text
    )

    lab_services.files.delete(made)
    example_query.cache_clear()
    assert 'data-durations="[]"' in lab.get(f"{draft}/preview/{step}").text


def test_uploaded_texts_replace_the_shipped_ones_in_this_study_only(lab, lab_services):
    own = b"# Welcome\n\nThis is **our** own text."
    answered = lab.post(
        "/lab/new",
        data={"csrf": csrf(lab), "source": "upload"},
        files=[
            ("protocol", ("mine.yaml", QUICK.read_bytes())),
            ("texts", ("information.en.md", own)),
        ],
    )
    draft = answered.headers["location"]
    assert "<strong>our</strong> own text" in lab.get(f"{draft}/preview/1?language=en").text
    lab.post(f"{draft}/open", data={"csrf": csrf(lab), "name": "Own text"})
    with lab_services.database.session() as s:
        study = s.scalars(select(Study)).one()
    assert study.files["texts/information.en.md"] == own.decode()
    assert study.protocol_hash != freeze(QUICK).hash


def test_a_byte_order_mark_is_left_out_on_every_way_in(lab, lab_services):
    """Uploaded, pasted and edited: the study is the one without it."""
    mark, text = "\ufeff", QUICK.read_text()
    own = mark.encode() + (PROTOCOLS / "texts" / "information.en.md").read_bytes()
    files = [("protocol", ("mine.yaml", mark.encode() + QUICK.read_bytes())), ("texts", ("information.en.md", own))]
    uploaded = lab.post("/lab/new", data={"csrf": csrf(lab), "source": "upload"}, files=files)
    pasted = lab.post("/lab/new", data={"csrf": csrf(lab), "source": "paste", "yaml": mark + text})
    edited = lab.post("/lab/new", data={"csrf": csrf(lab), "source": "paste", "yaml": "protocol: x"})
    lab.post(edited.headers["location"], data={"csrf": csrf(lab), "yaml": mark + text.replace("\n", "\r\n")})
    for answered in (uploaded, pasted, edited):
        lab.post(f"{answered.headers['location']}/open", data={"csrf": csrf(lab), "name": "Marked"})
    with lab_services.database.session() as s:
        assert [study.protocol_hash for study in s.scalars(select(Study))] == [freeze(QUICK).hash] * 3


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("information.exe", b"x", "file_name"),
        ("..", b"x", "file_name"),
        ("a b.md", b"x", "file_name"),
        ("latin.md", b"\xe4\xf6", "not_text"),
        ("nothing.md", b"  \n", "empty"),
        ("huge.md", b"x" * (drafts.LARGEST_FILE + 1), "too_large"),
    ],
)
def test_files_that_cannot_be_texts_are_refused(tmp_path, name, content, code):
    with pytest.raises(drafts.DraftError) as refused:
        drafts.draft_from_text(tmp_path, QUICK.read_text(encoding="utf-8"), {name: content})
    assert refused.value.code == code
    assert not (tmp_path / "drafts").exists()


@pytest.mark.parametrize("path", ["../../texts/out.md", "/out.md"])
def test_a_frozen_file_cannot_lie_outside_its_draft(tmp_path, path):
    with pytest.raises(drafts.DraftError, match="file_name"):
        drafts.draft_from_text(tmp_path, QUICK.read_text(encoding="utf-8"), own={path: "# Out\n"})
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == []


def test_uploaded_names_cannot_leave_the_drafts_folder(tmp_path):
    draft = drafts.draft_from_text(tmp_path, "a: b", {"../../../escape.md": b"text", "C:\\temp\\other.md": b"text"})
    assert (draft.folder / "texts" / "escape.md").is_file()
    assert (draft.folder / "texts" / "other.md").is_file()
    assert not list(tmp_path.glob("*.md"))
    assert drafts.find_draft(tmp_path, "../" + draft.id) is None


def test_every_step_can_be_looked_at_in_both_languages_and_nothing_is_stored(lab, lab_services):
    draft = draft_of(lab, source="shipped:quick_preference_study")
    before = row_counts(lab_services)
    steps = preview_steps(freeze(QUICK))
    kinds = [step.kind for step in steps]
    assert {"information", "consent", "questionnaire", "instruction", "trial", "wait", "comparison", "guess"} <= set(
        kinds
    )
    for number, step in enumerate(steps, 1):
        for language in ("en", "de"):
            page = lab.get(f"{draft}/preview/{number}?language={language}")
            assert page.status_code == 200
            assert f'data-kind="{step.kind}"' in page.text
            assert f'<html lang="{language}">' in page.text
        data = json.loads(re.search(r'id="page-data">(.*?)</script>', page.text, re.DOTALL).group(1))
        assert bool(data["stage_token"]) == (step.kind in ("trial", "comparison"))
    assert lab.get(f"{draft}/preview/{len(steps) + 1}").status_code == 404
    assert row_counts(lab_services) == before


# ---- one study ----


def test_monitor_says_who_is_where_and_who_was_lost(lab, lab_services, walked: Walked):
    with lab_services.database.transaction() as s:  # they walked when the first test of this process asked for them
        s.execute(update(Session).values(last_seen_at=utc_now() - timedelta(minutes=1)))
    seen = lab.get(f"/api/lab/studies/{walked.id}/monitor").json()
    people = {p["code"]: p for p in seen["people"]}
    assert people[walked.finished]["presence"] == "here" or people[walked.finished]["presence"] == "completed"
    assert people[walked.half_way]["stage"] == "block"
    assert people[walked.half_way]["step"] == "block.09"
    assert set(people[walked.half_way]["flags"]) == {"problem"}
    assert people[walked.bot]["simulated"]
    stages = {stage["stage"]: stage for stage in seen["stages"]}
    assert list(stages) == [
        e.kind if e.kind != "questionnaire" else "demographics" for e in freeze(QUICK).protocol.stages
    ]
    assert stages["block"]["under_way"] == 2
    page = lab.get(f"/lab/studies/{walked.id}/now", headers={"X-Fragment": "1"}).text
    assert "<html" not in page
    assert walked.half_way in page


@pytest.mark.parametrize("tab", ["now", "data", "report", "report?who=simulated"])
def test_every_number_links_to_as_many_rows(lab, walked: Walked, tab):
    page = lab.get(f"/lab/studies/{walked.id}/{tab}").text
    numbers = LINKED_NUMBER.findall(page)
    assert len(numbers) > 5
    for href, number in numbers:
        address = urljoin(f"/lab/studies/{walked.id}/now", html.unescape(href))
        if "Interrupted trajectories" in page and address.endswith(("#events", ",kept")):
            continue  # restarts are counted per trial; their link leads to whose they are
        shown = lab.get(address)
        assert shown.status_code == 200, address
        assert rows_shown(shown.text) == int(number), (number, address)


def test_report_counts_what_the_participants_chose(lab, lab_services, walked: Walked):
    report = lab.get(f"/api/lab/studies/{walked.id}/report").json()
    with lab_services.database.session() as s:
        stored = s.scalar(
            select(func.count())
            .select_from(Response)
            .where(Response.kind == "preference", Response.step_key != "block.01")
            .where(Response.session_id.in_(_sessions_of_people()))
        )
    assert (report["joined"], report["completed"]) == (3, 1)
    assert report["preferences"] == stored == 15 + 7
    assert (report["second_chosen"]["hits"], report["second_chosen"]["n"]) == (7 + 5, 22)
    assert report["decision_s"]["median"] == pytest.approx(1.5)
    assert report["own_chosen"]["n"] == 6
    assert report["people_mostly_own"]["n"] == report["guesses_right"]["n"] == 1
    assert report["personalisation"] == {"shown": 1}
    ease = next(item for item in report["items"] if item["key"] == "ease")
    assert (ease["n"], ease["counts"]["4"], ease["spread"]["median"]) == (1, 1, 4)
    simulated = lab.get(f"/api/lab/studies/{walked.id}/report?who=simulated").json()
    assert (simulated["joined"], simulated["preferences"]) == (1, 1)


def _sessions_of_people():
    from desirepath.store.models import Session

    return select(Session.id).join(Participant).where(~Participant.simulated)


def test_stored_values_read_the_same_in_every_language(lab, walked: Walked):
    page = f"/lab/studies/{walked.id}/people/{walked.finished}"
    for language in ("en", "de"):
        told = lab.get(page, headers={"Accept-Language": language}).text
        assert re.search(r'<code lang="en" translate="no">given=true; ', told)


def test_excluding_needs_a_reason_is_marked_and_can_be_undone(lab, lab_services, walked: Walked):
    here = f"/lab/studies/{walked.id}/people/{walked.half_way}"
    token = csrf(lab)
    assert lab.post(f"{here}/exclude", data={"csrf": token, "reason": "  "}).status_code == 422
    assert lab.post(f"{here}/exclude", data={"csrf": token, "reason": "fire alarm"}).status_code == 303
    page = lab.get(here).text
    assert "fire alarm" in page
    assert "experimenter" in page
    assert lab.get(f"/api/lab/studies/{walked.id}/report").json()["preferences"] == 15
    assert lab.post(f"{here}/include", data={"csrf": token}).status_code == 303
    assert lab.get(f"/api/lab/studies/{walked.id}/report").json()["preferences"] == 22
    with lab_services.database.session() as s:
        kinds = list(s.scalars(select(Event.kind).where(Event.kind.like("participant_%")).order_by(Event.id)))
    assert kinds == ["participant_excluded", "participant_included"]


def test_erasing_asks_for_the_studys_name_and_leaves_only_a_note(lab, lab_services, walked: Walked):
    here = f"/lab/studies/{walked.id}/people/{walked.half_way}"
    token = csrf(lab)
    page = lab.get(here).text
    assert "exports, reports and files that were downloaded" in page
    assert int(re.search(r"destroys (\d+) answers", page)[1]) == int(re.search(r"given=1[^>]*>(\d+)</a>", page)[1])
    lab.post(f"{here}/exclude", data={"csrf": token, "reason": "asked for erasure by telephone"})
    assert lab.post(f"{here}/erase", data={"csrf": token, "typed": "corridor pilot"}).status_code == 422
    assert walked.half_way in lab.get(f"/lab/studies/{walked.id}/people").text
    erased = lab.post(f"{here}/erase", data={"csrf": token, "typed": NAME})
    assert erased.status_code == 303
    note = lab.get(erased.headers["location"]).text
    assert "experimenter" in note
    assert "backups made before" in note
    assert lab.get(here).status_code == 404
    for planted in (b"asked for erasure by telephone", b"froze</b> once"):
        holding = [
            file for file in lab_services.settings.data.rglob("*") if file.is_file() and planted in file.read_bytes()
        ]
        assert not holding


def test_closed_study_turns_new_people_away_until_it_is_opened_again(lab, lab_services, walked: Walked):
    with lab_services.database.session() as s:
        link = f"/join/{s.get_one(Study, walked.id).recruiting_token}"
    token = csrf(lab)
    assert lab.get(link).status_code == 200
    assert lab.post(f"/lab/studies/{walked.id}/state", data={"csrf": token, "state": "closed"}).status_code == 303
    assert lab.get(link).status_code == 403
    assert "This study is closed" in lab.get(f"/lab/studies/{walked.id}/recruit").text
    assert lab.post(f"/lab/studies/{walked.id}/state", data={"csrf": token, "state": "ajar"}).status_code == 422
    lab.post(f"/lab/studies/{walked.id}/state", data={"csrf": token, "state": "open"})
    assert lab.get(link).status_code == 200


def test_export_button_gives_the_whole_data_set_without_links(lab, lab_services, walked: Walked):
    answered = lab.post(f"/lab/studies/{walked.id}/export", data={"csrf": csrf(lab)})
    assert answered.headers["content-type"] == "application/zip"
    packed = zipfile.ZipFile(io.BytesIO(answered.content))
    names = {name.split("/", 1)[1] for name in packed.namelist() if not name.endswith("/")}
    assert {"participants.csv", "responses.csv", "responses.parquet", "events.csv"} <= names
    with lab_services.database.session() as s:
        token = s.get_one(Study, walked.id).recruiting_token
    assert all(token.encode() not in packed.read(name) for name in packed.namelist())


def test_public_address_and_contact_reach_links_and_participants(lab, lab_services, walked: Walked):
    token = csrf(lab)

    def save(address: str, contact: str = "") -> int:
        form = {"csrf": token, "address": address, "help_contact": contact}
        return lab.post("/lab/settings", data=form).status_code

    for wrong in (
        "study.example.org",
        "https://study.example.org/path",
        "javascript:alert(1)",
        "https://a b",
        "http://x:y",
    ):
        assert save(wrong) == 422, wrong
    assert save("https://study.example.org/", "Ada, room 7") == 303
    page = lab.get(f"/lab/studies/{walked.id}/recruit").text
    assert 'value="https://study.example.org/join/' in page
    assert "PROLIFIC_PID={{%PROLIFIC_PID%}}" in page
    with lab_services.database.session() as s:
        link = f"/join/{s.get_one(Study, walked.id).recruiting_token}"
    assert "Ada, room 7" in lab.get(link).text
    assert save("") == 303
    assert "study.example.org/join" not in lab.get(f"/lab/studies/{walked.id}/recruit").text


def test_what_people_wrote_is_shown_as_text(lab, walked: Walked):
    for page in ("problems", f"people/{walked.half_way}"):
        text = lab.get(f"/lab/studies/{walked.id}/{page}").text
        assert "The picture &lt;b&gt;froze&lt;/b&gt; once." in text


def test_unknown_things_are_refused_kindly(lab, walked: Walked):
    for address in ("/lab/studies/nope/now", f"/lab/studies/{walked.id}/people/P999", "/lab/new/0123456789abcdef"):
        refused = lab.get(address)
        assert refused.status_code == 404
        assert 'class="button main" href="/lab/studies"' in refused.text
    assert lab.get("/api/lab/studies/nope/monitor").json()["error"]["code"] == "no_study"


def test_studies_are_listed_with_their_numbers(lab, walked: Walked):
    page = lab.get("/lab/studies").text
    row = page[page.index(NAME) :]
    assert re.findall(r'<a class="number"[^>]*>(\d+)</a>', row)[:3] == ["3", "1", "1"]


def test_a_second_browser_sees_the_same_study(lab_services, walked: Walked):
    with TestClient(create_application(lab_services), follow_redirects=False) as other:
        assert NAME in sign_in(other).get(f"/lab/studies/{walked.id}/data").text


def test_rankings_and_items_asked_in_several_conditions_count_and_lead_to_their_rows(lab, lab_services):
    """The interface study: the same items after every condition, a ranking at the end, repeated queries."""
    text = (
        (PROTOCOLS / "interface_study.yaml")
        .read_text()
        .replace("count: 25, probes: {repeat: 5}", "count: 4, probes: {repeat: 2}")
    )
    text = text.replace("  alpha: 0.05", "  alpha: 0.05\n  min_probes: 2")
    with lab_services.database.transaction() as s:
        study = create_study(s, lab_services.files, freeze_text(text), name="Three views", created_by=None)
    walk_in_process(lab_services.database, lab_services.files, study, 2)
    here = f"/lab/studies/{study.id}"
    report = lab.get(f"/api/lab/studies/{study.id}/report?who=simulated").json()
    ranked = next(item for item in report["items"] if item["mean_ranks"])
    assert ranked["n"] == sum(ranked["counts"].values()) == 2
    assert sum(ranked["mean_ranks"].values()) == pytest.approx(1 + 2 + 3)
    assert report["repeats_agree"]["n"] == 2 * 3 * 2
    page = lab.get(f"{here}/report?who=simulated").text
    assert "First choice:" in page
    numbers = [one for one in LINKED_NUMBER.findall(page) if not one[0].endswith(",kept")]
    assert len(numbers) > 30
    for href, number in numbers:
        assert rows_shown(lab.get(urljoin(f"{here}/report", html.unescape(href))).text) == int(number), (number, href)
    pages_read = lab.get(f"{here}/answers?kind=information").text
    assert rows_shown(pages_read) == 2
    people = lab.get(f"/api/lab/studies/{study.id}/monitor").json()["people"]
    assert {p["answers"] for p in people} == {rows_shown(lab.get(f"{here}/answers?given=1&participant=S001").text)}


def test_pairs_without_difference_are_no_choices_of_the_first_one(lab, lab_services, tmp_path):
    asked = {"count": 8, "probes": {"repeat": 6}}
    block = {"view": "top_down", "answers": {"no_difference": True}, "trials": [{"queries": asked}]}
    frozen = small_protocol(tmp_path, [{"block": block}])
    with lab_services.database.transaction() as s:
        study = create_study(s, lab_services.files, frozen, name="Alike", created_by=None)
    walk_in_process(lab_services.database, lab_services.files, study, 3)
    with lab_services.database.session() as s:
        said = select(Response.value, Trial).join(Trial, Response.trial_id == Trial.id).join(Session)
        rows = [(value, trial) for value, trial in s.execute(said.where(Session.study_id == study.id))]
    chosen = [value for value, trial in rows if trial.role == "regular" and "choice" in value]
    assert 0 < len(chosen) < 24
    choices = {trial.id: value["choice"] for value, trial in rows if "choice" in value}
    twice = [trial for _, trial in rows if trial.role == "repeat" and {trial.id, trial.probe_of} <= choices.keys()]
    assert 0 < len(twice) < 18
    report = lab.get(f"/api/lab/studies/{study.id}/report?who=simulated").json()
    assert (report["preferences"], report["second_chosen"]["n"]) == (24, len(chosen))
    assert report["repeats_agree"]["n"] == len(twice)
    assert report["repeats_agree"]["hits"] == sum(choices[one.id] == choices[one.probe_of] for one in twice)
    here = f"/lab/studies/{study.id}/report?who=simulated"
    links = [one for one in LINKED_NUMBER.findall(lab.get(here).text) if "kind=preference" in one[0]]
    assert len(links) == 5
    for href, number in links:
        assert rows_shown(lab.get(urljoin(here, html.unescape(href))).text) == int(number), href


def test_a_missing_text_is_added_where_it_is_missed_and_refused_edits_stay_in_the_form(lab, lab_services):
    text = QUICK.read_text().replace("texts/instruction.md", "texts/my_instruction.md")
    draft = draft_of(lab, source="paste", yaml=text)
    assert "my_instruction.en.md" in lab.get(draft).text
    token = {"csrf": csrf(lab), "yaml": text.replace("minutes: 15", "minutes: 13")}
    wrong = lab.post(draft, data=token, files=[("texts", ("notes.txt", b"no", "text/plain"))])
    assert wrong.status_code == 422
    assert "minutes: 13" in wrong.text, "what was typed is still there"
    added = [
        ("texts", (f"my_instruction.{one}.md", b"# Mine\n\nWatch closely.", "text/markdown")) for one in ("en", "de")
    ]
    assert lab.post(draft, data=token, files=added).status_code == 303
    page = lab.get(draft).text
    assert "The protocol is valid" in page
    assert "minutes: 13" in page
    for told in ("Counterbalancing", "Analysis plan", "none declared"):
        assert told in page


def test_a_study_begins_with_a_pilot_phase_unless_that_is_unticked(lab, lab_services):
    for pilot in (True, False):
        draft = draft_of(lab, source="shipped:quick_preference_study")
        assert 'name="pilot" value="1" checked' in lab.get(draft).text
        ticked = {"pilot": "1"} if pilot else {}
        opened = lab.post(f"{draft}/open", data={"csrf": csrf(lab), "name": f"Pilot {pilot}", **ticked})
        with lab_services.database.session() as s:
            study = s.scalars(select(Study).where(Study.name == f"Pilot {pilot}")).one()
        assert study.pilot == pilot
        words = "You become a pilot participant" if pilot else "exclude yourself afterwards"
        assert words in lab.get(opened.headers["location"]).text


# ---- people ----


def test_people_are_searched_and_sorted_and_every_flag_is_explained(lab, walked: Walked):
    here = f"/lab/studies/{walked.id}/people"

    def codes(query: str) -> list[str]:
        return re.findall(r'<th scope="row"><a href="[^"]*/people/([^"]+)"', lab.get(f"{here}?{query}").text)

    everyone = {walked.finished, walked.half_way, walked.fresh, walked.bot}
    assert set(codes("")) == everyone
    assert codes(f"q={walked.finished[2:].lower()}") == [walked.finished]
    by_answers = codes("sort=-answers")
    assert (by_answers[0], set(by_answers)) == (walked.finished, everyone)
    assert codes("sort=code") == sorted(everyone)
    assert codes("sort=-code") == sorted(everyone, reverse=True)
    assert set(codes("sort=nonsense")) == everyone
    page = lab.get(f"{here}?sort=-code").text
    assert 'aria-sort="descending"' in page
    assert page.count("<dt>") >= len(monitoring.RULES)
    assert "took less than 0.5 s" in page


def test_a_persons_page_shows_flags_and_no_raw_data(lab, lab_services, walked: Walked):
    with lab_services.database.transaction() as s:
        session = s.scalars(select(Session).join(Participant).where(Participant.code == walked.half_way)).one()
        session.device = {"width": 800, "reasons": ["width", "webgl"], "screen": {"dpi": 96, "touch": False}}
        s.execute(update(Trial).where(Trial.session_id == session.id).values(restarts=2))
    page = html.unescape(lab.get(f"/lab/studies/{walked.id}/people/{walked.half_way}").text)
    assert "interrupted" in page
    assert "width, webgl" in page
    assert "{'" not in page
    assert "['" not in page


def test_answers_are_shown_in_the_words_of_their_questions_and_their_stored_form_is_folded(lab, walked: Walked):
    here = f"/lab/studies/{walked.id}"
    read = {
        "en": ("A few questions about you", "How old are you?", "Woman", "1 of 7", "Stored form"),
        "de": ("Ein paar Fragen zu Ihnen", "Wie alt sind Sie?", "Frau", "1 von 7", "Gespeicherte Form"),
    }
    for language, (title, question, woman, scale, folded) in read.items():
        lab.get(f"/lab/language/{language}?next=/lab/studies")
        for path in (f"{here}/people/{walked.finished}", f"{here}/answers?participant={walked.finished}"):
            page = html.unescape(lab.get(path).text)
            open_text = re.sub(r"<details.*?</details>", "", page, flags=re.S)
            assert f"<dt>{question}</dt><dd>44</dd>" in open_text
            assert f"<dd>{woman}</dd>" in open_text
            assert f"<dd>{scale}</dd>" in open_text
            assert f">{title}</td>" in open_text
            assert not re.search(r"\w=", re.sub(r"<[^>]+>", "", open_text[open_text.index("<tbody") :]))
            assert f"<summary>{folded}</summary><code" in page
        of_item = lab.get(f"{here}/answers?step=demographics&item=gender&participant={walked.finished}").text
        assert f"<td>{woman}</td>" in of_item
        assert f">{title}</th>" in lab.get(f"{here}/now").text


def test_an_answer_is_replayed_as_its_participant_saw_it(lab, lab_services, walked: Walked):
    here = f"/lab/studies/{walked.id}"
    page = lab.get(f"{here}/people/{walked.finished}").text
    links = re.findall(rf'href="({here}/answers/[0-9a-f]+)"', page)
    assert len(links) == 1 + 15 + 6 + 1, "practice, choices, comparisons, the guess about the last of them"
    assert links[0] in lab.get(f"{here}/answers?participant={walked.finished}").text
    shown = lab.get(links[2]).text
    assert f"{walked.finished} chose " in shown
    assert "s · from above" in shown
    assert 'id="trial"' in shown, "the participants' own page"
    data = json.loads(re.search(r'id="page-data">(.*?)</script>', shown, re.S)[1])
    assert data["stage_token"]
    with lab_services.database.session() as s:
        trial = s.get_one(Response, links[2].rpartition("/")[2]).trial_id
        lengths = [load_trajectory(lab_services.files, one).duration_s for one in _sides(s.get_one(Trial, trial))]
    assert data["durations"] == [round(one, 1) for one in lengths]
    with lab_services.database.session() as s:
        read = s.scalars(select(Response.id).where(Response.kind == "information")).first()
    assert lab.get(f"{here}/answers/{read}").status_code == 404
    assert lab.get(f"{here}/answers/{'0' * 32}").status_code == 404


def _sides(trial: Trial) -> tuple[str, str]:
    return trial.trajectory_a, trial.trajectory_b


def test_what_was_rated_after_watching_stands_in_the_report_and_leads_to_its_rows(lab, lab_services, tmp_path):
    scale = {"question": {"en": "How did you like it?"}, "points": 5, "low": {"en": "no"}, "high": {"en": "yes"}}
    asked = {"rating": {"each": ["top_down", "first_person"], "count": 3, "scale": scale}}
    with lab_services.database.transaction() as s:
        study = create_study(s, lab_services.files, small_protocol(tmp_path, [asked]), name="Rated", created_by=None)
    walk_in_process(lab_services.database, lab_services.files, study, 2)
    here = f"/lab/studies/{study.id}"
    report = lab.get(f"/api/lab/studies/{study.id}/report?who=simulated").json()
    found = {one["under"].rpartition(".")[2]: (one["n"], one["people"], one["points"]) for one in report["ratings"]}
    assert found == {"top_down": (6, 2, 5), "first_person": (6, 2, 5)}
    page = lab.get(f"{here}/report?who=simulated").text
    assert "How did you like it?" in page
    links = [one for one in LINKED_NUMBER.findall(page) if "kind=rating" in one[0]]
    assert [number for _, number in links] == ["6", "6"]
    for href, number in links:
        assert rows_shown(lab.get(urljoin(f"{here}/report", html.unescape(href))).text) == int(number), href
