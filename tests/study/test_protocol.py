"""A protocol says what is wrong with it: file, line, field, value, and what would work."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import yaml

from desirepath.analysis.scale_wordings import INSTRUMENTS, SCALES
from desirepath.analysis.scales import frozen_scale
from desirepath.grammar.error_words import example_of, parse
from desirepath.grammar.questionnaires import Questionnaire
from desirepath.grammar.source import Source
from desirepath.installed import PROTOCOLS
from desirepath.store.dataset.descriptions import instruments_asked
from desirepath.study.kind import Page, kind_of, read_step
from desirepath.study.kinds.wait import TrainStage
from desirepath.study.protocol.freezing import (
    ProtocolError,
    find_shipped_protocols,
    freeze,
    freeze_text,
    validate_protocol_file,
)
from desirepath.study.protocol.instruments import file_to_fill_in, list_instruments
from desirepath.study.protocol.outline import describe_stages, estimate_minutes
from desirepath.study.protocol.schema import DeviceGate, Protocol, json_schema
from desirepath.study.protocol.stages import STAGES, StageEntry
from desirepath.study.refusals import Refused
from desirepath.study.session.devices import device_problems, fit_device
from tests.study.small_protocol import BLOCK, protocol_text, write_files

QUICK = PROTOCOLS / "quick_preference_study.yaml"
INFORMATION = {"key": "information", "kind": "information", "stage": "information", "text": "texts/information.md"}


def page_of(frozen, step, language):
    """What the page of a step is given."""
    found = read_step({"key": "page", **step})
    return kind_of(found).payload(found, Page(frozen, language))


def broken(tmp_path: Path, old: str, new: str) -> dict:
    """The first error of the quick study with one text replaced."""
    folder = tmp_path / "protocols"
    shutil.copytree(PROTOCOLS, folder)
    file = folder / QUICK.name
    text = QUICK.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    result = validate_protocol_file(file)
    assert result["valid"] is False
    return result["errors"][0]


def test_a_query_set_made_here_is_named_by_its_id_and_an_unknown_one_is_told_what_there_is():
    made, unknown = "a" * 64, "b" * 64
    here = {made: "60 queries, seed 3 (study_room, 60 queries)"}
    text = QUICK.read_text()
    assert freeze_text(text.replace("study_room/queries_varied_200", made), query_sets=here).protocol.query_set == made
    for name, known in ((unknown, here), (made, None)):
        with pytest.raises(ProtocolError) as refused:
            freeze_text(text.replace("study_room/queries_varied_200", name), query_sets=known)
        (error,) = refused.value.errors
        assert (error["field"], error["value"], error["line"]) == ("query_set", name, line_of("query_set:"))
        assert "shipped are: " in error["message"]
        assert "study_room/queries_500" in error["message"]
        assert ("60 queries, seed 3" in error["message"]) == (known is here)


def line_of(text: str) -> int:
    return next(n for n, line in enumerate(QUICK.read_text().splitlines(), 1) if text in line)


@pytest.mark.parametrize("file", find_shipped_protocols(), ids=lambda file: file.stem)
def test_every_shipped_protocol_is_valid(file: Path):
    assert validate_protocol_file(file) == {"valid": True, "errors": []}


@pytest.mark.parametrize(
    ("old", "new", "line", "field", "value", "says"),
    [
        ("view: top_down", "view: topdown", "view:", "stages[4].block.view", "topdown", "did you mean top_down"),
        ("count: 15", "count: 0", "count: 15", "stages[4].block.trials[1].queries.count", 0, "at least 1"),
        (
            "choose: information",
            "chose: information",
            "choose: information",
            "stages[4].block.trials[1].queries.chose",
            "information",
            "did you mean choose",
        ),
        (
            "query_set: study_room/queries_varied_200",
            'query_set: ""',
            "query_set:",
            "query_set",
            "",
            "must not be empty",
        ),
        (
            "study_room/queries_varied_200",
            "study_room/queries_50",
            "query_set:",
            "query_set",
            "study_room/queries_50",
            "did you mean study_room/queries_500",
        ),
        ("use: demographics", "use: demografics", "use:", "stages[2].questionnaire.use", "demografics", "no file"),
        ("version: 2\n", "version: one\n", "version: 2", "version", "one", "a whole number"),
        ("languages: [en, de]", "languages: [en, de, fr]", "languages:", "languages[2]", "fr", "no title and no text"),
        ("texts/consent.md", "../consent.md", "consent:", "stages[1].consent.text", "../consent.md", "without '..'"),
        ("texts/consent.md", "texts/other.md", "consent:", "stages[1].consent.text", "texts/other.md", "other.de.md"),
        ("scenes: 6", "scenes: many", "comparison:", "stages[6].comparison.scenes", "many", "a whole number"),
        (
            "[base, own]",
            "[own, base]",
            "comparison:",
            "stages[6].comparison.arms",
            None,
            "[base, neutral, population, own, ",
        ),
        (
            "completion_code: random",
            "completion_code: no",
            "completion_code",
            "stages[8].debriefing.completion_code",
            "no",
            "4 to 40 letters",
        ),
        ("languages: [en, de]", "languages: [eng]", "languages:", "languages[0]", "eng", "two lower-case letters"),
        ("scheme: random", "scheme: balanced", "assignment:", "assignment.scheme", "balanced", "one of random, all"),
    ],
)
def test_an_error_names_file_line_field_value_and_what_is_allowed(tmp_path, old, new, line, field, value, says):
    error = broken(tmp_path, old, new)
    assert error["file"] == QUICK.name
    assert error["line"] == line_of(line)
    assert error["field"] == field
    assert error["value"] == value
    assert says in error["message"]


def test_a_missing_key_is_named_where_it_should_stand(tmp_path):
    error = broken(tmp_path, "query_set: study_room/queries_varied_200\n", "")
    assert error["field"] == "query_set"
    assert error["message"].startswith("is needed")


def test_all_errors_are_told_at_once(tmp_path):
    text = QUICK.read_text().replace("view: top_down", "view: below", 1).replace("scenes: 6", "scenes: 99", 1)
    with pytest.raises(ProtocolError) as wrong:
        freeze_text(text)
    assert {error["field"] for error in wrong.value.errors} == {"stages[4].block.view", "stages[6].comparison.scenes"}


@pytest.mark.parametrize(
    ("move", "says"),
    [
        (lambda s: s[:1] + s[2:], "needs a consent stage"),
        (lambda s: [s[0], s[2], s[1], *s[3:]], "before the consent stage"),
        (lambda s: s[:-1], "end with its one debriefing"),
        (lambda s: s[:4] + s[5:], "at least one block"),
        (lambda s: [*s[:5], *s[6:]], "needs a train stage before it"),
        (lambda s: [*s[:2], s[1], *s[2:]], "at most one consent"),
    ],
)
def test_stages_in_an_order_that_makes_no_sense_are_refused(move, says):
    head, _, tail = QUICK.read_text().partition("stages:\n")
    stages: list[str] = []
    for line in tail.splitlines(keepends=True):
        if line.startswith("  - "):
            stages.append(line)
        else:
            stages[-1] += line
    with pytest.raises(ProtocolError, match=says):
        freeze_text(head + "stages:\n" + "".join(move(stages)))


@pytest.mark.parametrize(
    ("stage", "wrong"),
    [
        ({"order": {"view": "top_down", "count": 1}}, "stages[1].order"),
        ({"block": BLOCK["block"] | {"orders": [{"count": 1}]}}, "stages[1].block.orders"),
    ],
)
def test_an_order_needs_a_setup_in_which_a_policy_drives_in_several_ways(tmp_path, stage, wrong):
    write_files(tmp_path)
    freeze_text(protocol_text([stage]), folder=tmp_path)
    with pytest.raises(ProtocolError, match="conditioned policy: ") as refused:
        freeze_text(protocol_text([stage], query_set="home/queries_depth_12"), folder=tmp_path)
    assert [error["field"] for error in refused.value.errors] == [wrong]


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("a: [1, 2\nb: 3", 2, "not valid YAML"),
        ("", 1, "must be a mapping"),
        ("- a", 1, "must be a mapping"),
        ("protocol: x\nversion: 1\nprotocol: y", 3, "given twice"),
    ],
)
def test_a_file_that_is_no_protocol_at_all(text, line, says):
    with pytest.raises(ProtocolError) as wrong:
        freeze_text(text)
    assert [error["line"] for error in wrong.value.errors if says in error["message"]] == [line]


def test_a_file_that_is_not_there_is_told_kindly(tmp_path):
    result = validate_protocol_file(tmp_path / "nothing.yaml")
    assert not result["valid"]
    assert "cannot be read" in result["errors"][0]["message"]


def test_a_questionnaires_error_points_into_the_questionnaires_file(tmp_path):
    folder = tmp_path / "protocols"
    shutil.copytree(PROTOCOLS, folder)
    file = folder / "questionnaires" / "demographics.yaml"  # one's own comes before the shipped instrument
    file.write_text(INSTRUMENTS["demographics"].replace("type: number", "type: numbr"))
    error = validate_protocol_file(folder / QUICK.name)["errors"][0]
    assert error["file"] == "questionnaires/demographics.yaml"
    assert error["field"] == "blocks[0].items[0].type"
    assert "did you mean number" in error["message"]


def test_the_hash_changes_with_any_text(tmp_path):
    folder = tmp_path / "protocols"
    shutil.copytree(PROTOCOLS, folder)
    before = freeze(folder / QUICK.name).hash
    assert before == freeze(QUICK).hash
    text = folder / "texts" / "consent.de.md"
    text.write_text(text.read_text() + "\nNoch ein Satz.\n")
    assert freeze(folder / QUICK.name).hash != before


def test_the_numbers_in_a_text_are_the_protocols():
    """Whoever asks fewer pairs in less time does not promise their participants the old numbers."""
    changed = freeze_text(QUICK.read_text().replace("count: 15", "count: 4").replace("minutes: 15", "minutes: 7"))
    for language, told in (("en", "There are 4 such pairs"), ("de", "Es gibt 4 solche Paare")):
        information = " ".join(page_of(changed, INFORMATION, language)["text"].split())
        assert told in information
        assert "7 Minut" in information or "7 minutes" in information
        assert "{" not in information
    assert "There are 4 such pairs" in describe_stages(changed.data, changed.files)[0].texts[0][1].replace("\n", " ")


def test_a_number_that_nothing_fills_in_is_told_with_what_there_is(tmp_path):
    folder = tmp_path / "protocols"
    shutil.copytree(PROTOCOLS, folder)
    text = folder / "texts" / "information.en.md"
    text.write_text(text.read_text().replace("{minutes}", "{minute}"))
    (error,) = validate_protocol_file(folder / QUICK.name)["errors"]
    assert (error["field"], error["line"]) == ("stages[0].information.text", line_of("texts/information.md"))
    for said in ("information.en.md has {minute}", "{minutes}, {pairs}", "did you mean minutes"):
        assert said in error["message"]


def test_every_stage_is_readable_in_both_languages():
    frozen = freeze(QUICK)
    stages = describe_stages(frozen.data, frozen.files)
    assert [stage.kind for stage in stages] == [entry.kind for entry in frozen.protocol.stages]
    assert len({stage.key for stage in stages}) == len(stages)
    for stage in stages:
        assert stage.kind not in ("information", "consent", "debriefing") or len(stage.texts) == 2
    for language in ("en", "de"):
        consent = page_of(frozen, {"kind": "consent", "stage": "consent", "text": "texts/consent.md"}, language)
        assert len(consent["points"]) == 4
        assert "[ ]" not in consent["text"]
        items = page_of(
            frozen, {"kind": "questionnaire", "stage": "train", "questionnaire": "interface_items"}, language
        )
        assert sum(len(block["items"]) for block in items["blocks"]) == 10  # spec 07: ten items


@pytest.mark.parametrize("file", find_shipped_protocols(), ids=lambda file: file.stem)
def test_the_minutes_told_to_participants_fit_the_protocol(file):
    protocol = freeze(file).protocol
    usual, _ = estimate_minutes(protocol)
    assert abs(usual - protocol.minutes) < max(2.3, 0.1 * protocol.minutes)


def test_schema_and_words_agree():
    keys = {field.alias or name for name, field in StageEntry.model_fields.items()}
    assert {*STAGES, "when"} == keys
    assert "stages" in json_schema()["properties"]


def test_only_true_and_false_are_booleans():
    """YAML 1.1 reads `on:` as True, which would make our own keys unreadable."""
    assert freeze(QUICK).stage(TrainStage).on == "own_answers"


def test_the_published_schema_is_the_schema_and_the_reference_names_every_key():
    docs = PROTOCOLS.parent / "docs"
    told = "run `desirepath studies schema > docs/protocol.schema.json`, and with --questionnaire"
    schemas = json_schema(), json_schema(Questionnaire)
    assert json.loads((docs / "protocol.schema.json").read_text()) == schemas[0], told
    assert json.loads((docs / "questionnaire.schema.json").read_text()) == schemas[1], told
    reference = (docs / "protocol-reference.md").read_text()
    parts = [part for schema in schemas for part in (schema, *schema["$defs"].values())]
    keys = {key for part in parts for key in part.get("properties", {})}
    assert sorted(key for key in keys if not re.search(rf"\b{key}\b", reference)) == []


# ---- questionnaires --------------------------------------------------------------------------------------------------


def asked(tmp_path: Path, **content) -> list[dict]:
    """What is wrong with a protocol whose questionnaire `rating` is this one."""
    write_files(tmp_path)
    content = {"title": {"en": "Rating"}, **content}
    (tmp_path / "questionnaires" / "rating.yaml").write_text(yaml.safe_dump(content, allow_unicode=True))
    (tmp_path / "small.yaml").write_text(protocol_text([{"questionnaire": {"use": "rating"}}, BLOCK]))
    return validate_protocol_file(tmp_path / "small.yaml")["errors"]


def items_of(scale: str, language: str = "en") -> list[dict]:
    """A validated scale's items as somebody would write them out."""
    return [
        {
            "key": item.key,
            "type": "scale",
            "points": SCALES[scale].points,
            "reversed": item.reversed,
            **{field: {language: getattr(item, field)[language]} for field in ("text", "low", "high")},
        }
        for item in SCALES[scale].items
    ]


def test_a_validated_scale_is_asked_by_its_name_word_by_word_and_kept_in_the_studys_copy(tmp_path):
    assert asked(tmp_path, blocks=[{"scale": "sus"}, {"scale": "raw_tlx"}]) == []
    frozen = freeze(tmp_path / "small.yaml")
    items = frozen.questionnaires["rating"].items
    assert [item.text["en"] for item in items] == [
        item.text["en"] for name in ("sus", "raw_tlx") for item in SCALES[name].items
    ]
    assert [item.reversed for item in items[:4]] == [False, True, False, True]
    assert {"scales/sus.json", "scales/raw_tlx.json"} <= set(frozen.files)
    assert asked(tmp_path, blocks=[{"scale": "sus", "items": items_of("sus")}]) == []


def test_a_scales_name_may_hold_another_ones(tmp_path):
    """The short form of the trust scale is asked; its name has the long one's in it."""
    title = {"en": "Short Trust in Automation Scale (S-TIAS)"}
    assert asked(tmp_path, title=title, blocks=[{"scale": "s_tias"}]) == []
    (error,) = asked(tmp_path, title={"en": "Trust in Automation Scale"}, blocks=[{"scale": "s_tias"}])
    assert "the validated scale TIAS, whose items are not asked here" in error["message"]


def test_a_scale_whose_words_may_not_be_shipped_is_asked_in_the_labs_words_and_kept_in_the_studys_copy(tmp_path):
    name = "godspeed_likeability"
    (error,) = asked(tmp_path, blocks=[{"scale": name}])
    assert "whose words may not be shipped" in error["message"]
    assert "godspeed_likeability_like, godspeed_likeability_friendly" in error["message"]
    words = {"text": {"en": "Your words"}, "low": {"en": "low"}, "high": {"en": "high"}}
    items = [{"key": item.key, "type": "scale", "points": 5, **words} for item in SCALES[name].items]
    title = {"en": "Godspeed III: Likeability"}
    assert asked(tmp_path, title=title, blocks=[{"scale": name, "items": items}]) == []
    frozen = freeze(tmp_path / "small.yaml")
    kept = frozen_scale(frozen.files[f"scales/{name}.json"])
    assert [item.text for item in kept.items] == [{"en": "Your words"}] * 5
    assert kept.score({item.key: 4 for item in kept.items}) == 4.0
    for wrong, said in (
        (items[:4], "has the items godspeed_likeability_like"),
        ([*items[:4], {**items[4], "points": 7}], "5 points, and no 'when'"),
        ([{**items[0], "low": {"de": "nur"}}, *items[1:]], "needs of every item text, low and high in en"),
    ):
        errors = asked(tmp_path, blocks=[{"scale": name, "items": wrong}])
        assert any(said in error["message"] for error in errors), errors


def test_a_study_that_was_frozen_with_a_scales_words_keeps_them(tmp_path):
    """Before, Godspeed was shipped: such a study's copy has its words, and is read as it was."""
    name = "godspeed_likeability"
    words = [replace(item, text={"en": "As then"}, low={"en": "l"}, high={"en": "h"}) for item in SCALES[name].items]
    old = SCALES[name].with_words(words)
    write_files(tmp_path)
    (tmp_path / "scales").mkdir()
    (tmp_path / "scales" / f"{name}.json").write_text(json.dumps(asdict(old)), encoding="utf-8")
    assert asked(tmp_path, blocks=[{"scale": name}]) == []
    frozen = freeze(tmp_path / "small.yaml")
    assert [item.text["en"] for item in frozen.questionnaires["rating"].items] == ["As then"] * 5


def test_a_reworded_item_cannot_carry_a_scales_name(tmp_path):
    reworded = items_of("sus")
    reworded[4]["text"]["en"] = "I found the various functions were well integrated."
    (error,) = asked(tmp_path, blocks=[{"scale": "sus", "items": reworded}])
    assert (error["field"], error["value"]) == ("blocks[0].scale", "sus")
    assert "not those of SUS word by word; leave 'items' out" in error["message"]
    (error,) = asked(tmp_path, title={"en": "The System Usability Scale"}, blocks=[{"items": reworded}])
    assert error["field"] == "title"
    assert "carries the name of the validated scale SUS, whose items are not asked here" in error["message"]
    (error,) = asked(tmp_path, blocks=[{"scale": "suss"}])
    assert "did you mean sus" in error["message"]


def test_an_instrument_is_asked_in_one_line_in_its_own_words_where_there_is_no_translation(tmp_path):
    write_files(tmp_path)
    for name in ("consent.de.md", "consent.en.md", "debriefing.de.md", "debriefing.en.md"):
        (tmp_path / name).write_text("# Words\nwords")
    stages = [{"questionnaire": {"use": name}} for name in ("s_tias", "ueq_s", "colour_vision", "demographics")]
    keys = {"languages": ["en", "de"], "title": {"en": "S", "de": "K"}}
    frozen = freeze_text(protocol_text([*stages, BLOCK], **keys), folder=tmp_path)
    step = {"kind": "questionnaire", "stage": "q"}
    trust = page_of(frozen, {**step, "questionnaire": "s_tias"}, "de")
    assert trust["title"] == "Was halten Sie von dem Roboter?"
    assert [item["lang"] for block in trust["blocks"] for item in block["items"]] == ["en"] * 3
    (pairs,) = page_of(frozen, {**step, "questionnaire": "ueq_s"}, "de")["blocks"]
    assert pairs["items"][0].items() >= {"text": "behindernd – unterstützend", "low": "behindernd", "points": 7}.items()
    assert not any("lang" in item for item in pairs["items"])
    plates = page_of(frozen, {**step, "questionnaire": "colour_vision"}, "de")["blocks"][1:]
    assert all(len(block["items"][0]["plate"]) > 250 for block in plates)
    assert frozen_scale(frozen.files["scales/ueq_s.json"]) == SCALES["ueq_s"]
    described = instruments_asked(frozen.files)
    assert "UEQ-S: hedonic quality, -3 to 3: `ueq_s_5`, `ueq_s_6`" in described
    assert "Terms of its words: CC BY 4.0, as all articles of Frontiers" in described
    with pytest.raises(ProtocolError, match=r"no instrument of that name.*did you mean s_tias"):
        freeze_text(protocol_text([{"questionnaire": {"use": "s_tia"}}, BLOCK]), folder=tmp_path)


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_every_instrument_is_asked_at_once_or_prints_a_file_to_fill_in(tmp_path, name):
    write_files(tmp_path)
    text = protocol_text([{"questionnaire": {"use": name}}, BLOCK])
    (listed,) = (of for of in list_instruments() if of["name"] == name)
    if listed["words"] != "not shipped":
        assert len(freeze_text(text, folder=tmp_path).questionnaires[name].items) == listed["items"]
        return
    with pytest.raises(ProtocolError, match="may not be shipped"):
        freeze_text(text, folder=tmp_path)
    blank, file = file_to_fill_in(name), tmp_path / "questionnaires" / f"{name}.yaml"
    file.write_text(blank)
    with pytest.raises(ProtocolError, match="has no text for en"):
        freeze_text(text, folder=tmp_path)
    file.write_text(re.sub(r"^ +de: .*\n", "", re.sub("en: ''", "en: word", blank), flags=re.MULTILINE))
    assert len(freeze_text(text, folder=tmp_path).questionnaires[name].items) == listed["items"]


def test_a_head_of_ones_own_says_where_words_are_from_and_brings_no_scale(tmp_path):
    head = {"names": ["Mine"], "measures": {"en": "ease"}, "source": "own", "licence": "own"}
    item = {"key": "a", "type": "text", "text": {"en": "A"}}
    assert asked(tmp_path, instrument=head, blocks=[{"items": [item]}]) == []
    (error,) = asked(tmp_path, instrument=head | {"scales": {"mine": {}}}, blocks=[{"items": [item]}])
    assert (error["field"], "no scale of a shipped instrument" in error["message"]) == ("instrument.scales.mine", True)


@pytest.mark.parametrize(
    ("item", "says"),
    [
        ({"type": "ranking", "options": []}, "at least two 'options'"),
        ({"type": "choice", "options": [{"value": 1, "label": {"en": "a"}}] * 2}, "has a value twice"),
        ({"type": "number", "reversed": True}, "'reversed' is for scales"),
        ({"type": "number", "correct": 3}, "'correct' needs a choice or a scale"),
        ({"type": "scale", "low": {"en": "a"}, "high": {"en": "b"}, "instructed": 9}, "none of the answers: 1, 2, 3"),
        ({"type": "number", "plate": {"shows": "6", "of": "protan"}}, "one of the 'options' of a choice"),
    ],
)
def test_an_item_that_cannot_be_answered_as_it_says_is_told(tmp_path, item, says):
    errors = asked(tmp_path, blocks=[{"items": [{"key": "one", "text": {"en": "?"}, **item}]}])
    assert says in errors[0]["message"]


@pytest.mark.parametrize(
    ("when", "says"),
    [
        ({"item": "later", "is": "1"}, "does not stand before this in the questionnaire; before it: first"),
        ({"item": "first", "is": "9"}, "can never be answered to first"),
        ({"item": "first"}, "needs one of is, is_not"),
        ({"questionnaire": "rating", "item": "first", "is": "1"}, "is this questionnaire itself"),
        ({"questionnaire": "about", "item": "age", "at_least": 18}, "about about, which is not asked before"),
    ],
)
def test_a_condition_that_can_never_be_met_is_told(tmp_path, when, says):
    scale = {"type": "scale", "text": {"en": "?"}, "low": {"en": "a"}, "high": {"en": "b"}}
    items = [{"key": "first", **scale}, {"key": "second", **scale, "when": when}, {"key": "later", **scale}]
    errors = asked(tmp_path, blocks=[{"items": items}])
    assert says in errors[0]["message"]
    on_screen = asked(tmp_path, blocks=[{"items": items[:1]}, {"when": when, "items": [items[2]]}])
    assert says in on_screen[0]["message"]


# ---- devices ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("device", "problems"),
    [
        ({"webgl": True, "width": 1200, "height": 700, "pointer": "fine", "frame_rate": 40}, []),
        ({"webgl": True}, []),  # what a browser does not tell stands against nobody
        ({"webgl": False, "width": 1200}, ["webgl"]),
        ({"webgl": True, "width": 400, "height": 300, "pointer": "coarse"}, ["width", "height", "pointer"]),
        ({"webgl": True, "frame_rate": 4.5}, ["frame_rate"]),
    ],
)
def test_a_device_is_measured_against_the_gate(device, problems):
    gate = DeviceGate(min_width=1000, min_height=600, pointers=["fine"], min_frame_rate=10, light_below=20)
    assert device_problems(gate, device) == problems
    assert device_problems(None, device) == []
    if problems:
        with pytest.raises(Refused) as no:
            fit_device(gate, device, study_id="s")
        assert (no.value.code, no.value.details["reasons"]) == ("device", problems)
    assert fit_device(gate, device, study_id="s", simulated=True)["scene_detail"] in ("full", "light")


def test_a_slow_device_gets_a_lighter_scene_before_it_is_refused():
    gate = DeviceGate(min_frame_rate=10, light_below=20)
    rates = {25: "full", 15: "light"}
    for rate, detail in rates.items():
        assert fit_device(gate, {"webgl": True, "frame_rate": rate}, study_id="s")["scene_detail"] == detail


# ---- numbers, texts and files as they are written --------------------------------------------------------------------


def quick(tmp_path: Path, old: str, new: str) -> dict:
    """What is said about the quick study with one text replaced."""
    folder = tmp_path / "protocols"
    if not folder.exists():
        shutil.copytree(PROTOCOLS, folder)
    text = QUICK.read_text()
    assert old in text
    (folder / QUICK.name).write_text(text.replace(old, new))
    return validate_protocol_file(folder / QUICK.name)


@pytest.mark.parametrize("code", ["01234567", "0xC0FFEE", "2026-11-25", "1000", "true", "'0777'"])
def test_a_completion_code_stays_as_it_was_written(code):
    """01234567 was read as octal and shown as 342391."""
    text = protocol_text([BLOCK]).replace("completion_code: random", f"completion_code: {code}")
    debriefing = parse(Source("protocol.yaml", text), Protocol).stages[-1].stage
    assert debriefing.completion_code == code.strip("'")


@pytest.mark.parametrize(
    "value", ["010", "1:30", "1_000", "0x1F", "yes", "no", "1.10", "2026-02-31", "True", "+5", "1e3"]
)
def test_what_is_stored_of_a_choice_is_what_was_written(value):
    text = QUESTIONNAIRE.replace("VALUE", value)
    item = parse(Source("q.yaml", text), Questionnaire).items[0]
    assert [option.value for option in item.options] == [value, "other"]
    assert item.when[0].is_ == value
    assert item.text == {"no": value}


QUESTIONNAIRE = """
title: {no: T}
blocks:
- items:
  - key: a
    type: choice
    text: {no: VALUE}
    options: [{value: VALUE, label: {no: N}}, {value: other, label: {no: O}}]
    when: {questionnaire: b, item: c, is: VALUE}
"""


@pytest.mark.parametrize(
    ("written", "found"),
    [("012", 12), ("0o14", 12), ("0x0C", 12), ("12", 12), ("1:30", None), ("1_2", None), ("'12'", None)],
)
def test_numbers_are_those_of_yaml_1_2(tmp_path, written, found):
    """1:30 was 90 minutes, 012 was 10, and nobody said so."""
    result = quick(tmp_path, "minutes: 15", f"minutes: {written}")
    if found is not None:
        assert freeze(tmp_path / "protocols" / QUICK.name).protocol.minutes == found
        return
    (error,) = result["errors"]
    assert (error["field"], error["line"]) == ("minutes", QUICK.read_text().split("minutes: 15")[0].count("\n") + 1)
    assert error["message"] == "must be a whole number" + ", without quotes" * (written == "'12'")


@pytest.mark.parametrize(
    ("field", "written", "says"),
    [
        ("points", '"5"', "must be a whole number, without quotes"),
        ("points", "5.0", "must be a whole number"),
        ("reversed", '"false"', "must be true or false, without quotes"),
        ("reversed", "no", "must be true or false, without quotes"),
        ("text", "~", "must be a mapping of keys to values, such as text: {en: '...'}"),
        ("low", "{en: }", "must be text, is empty; if the word is meant, write it in quotes: en: 'null'"),
        ("low", "{en: [a]}", "must be text, such as en: '...'"),
        ("when", "[5]", "must be a mapping of keys to values, such as when: [{is: 'yes', item: pets}]"),
        ("options", "{a: b}", "must be a list, such as options: [{value: '...', label: {en: '...'}}]"),
    ],
)
def test_what_is_not_of_its_type_is_refused_with_the_form_that_works(tmp_path, field, written, says):
    """`points: "5"` was valid and ended the report; `reversed: "false"` reversed."""
    item = {"key": "a", "type": "scale", "text": {"en": "A"}, "low": {"en": "l"}, "high": {"en": "h"}, field: "HERE"}
    asked(tmp_path, blocks=[{"items": [item]}])
    file = tmp_path / "questionnaires" / "rating.yaml"
    file.write_text(file.read_text().replace("HERE", written))
    found = validate_protocol_file(tmp_path / "small.yaml")["errors"]
    assert [error["message"] for error in found] == [says]
    assert found[0]["field"].startswith(f"blocks[0].items[0].{field}")


def test_every_example_of_an_error_works():
    """Of all that a protocol and a questionnaire may be made of."""
    from desirepath.grammar.parts import Part

    def below(model: type) -> Iterator[type[Part]]:
        for one in model.__subclasses__():
            yield one
            yield from below(one)

    named = {*json_schema()["$defs"], *json_schema(Questionnaire)["$defs"]}
    models = {one.__name__: one for one in below(Part) if one.__name__ in named}
    assert {"BlockStage", "StageEntry", "Item", "Quota", "Viewing"} <= set(models)
    for model in models.values():
        model.model_validate(example_of(model))


def test_a_text_where_a_mapping_belongs_is_shown_in_its_place(tmp_path):
    error = quick(tmp_path, "information: {text: texts/information.md}", "information: texts/information.md")["errors"][
        0
    ]
    wanted = "must be a mapping of keys to values, such as information: {text: texts/information.md}"
    assert error["message"] == wanted


def test_everything_that_can_be_known_is_said_at_once(tmp_path):
    """An unknown key, a file that is not there, a translation that is missing and a query set that is none."""
    write_files(tmp_path)
    (tmp_path / "consent.en.md").write_text("# Consent")
    (tmp_path / "consent.de.md").write_bytes("# Einverständnis".encode("latin-1"))
    (tmp_path / "questionnaires" / "rating.yaml").write_text(
        "title: {en: R}\nblocks:\n- items:\n  - {key: a, type: number, text: {en: A, de: B}, max: '3'}\n"
    )
    stages = [{"questionnaire": {"use": "rating", "time": 3}}, BLOCK, {"information": 5}]
    text = protocol_text(stages, languages=["en", "de"], title={"en": "T"}, minutes="soon", query_set="none/here")
    (tmp_path / "small.yaml").write_text(text)
    found = validate_protocol_file(tmp_path / "small.yaml")["errors"]
    assert [(one["file"], one["field"]) for one in found] == [
        ("consent.de.md", "(file)"),
        ("questionnaires/rating.yaml", "title"),
        ("questionnaires/rating.yaml", "blocks[0].items[0].max"),
        ("small.yaml", "title"),
        ("small.yaml", "query_set"),
        ("small.yaml", "minutes"),
        ("small.yaml", "stages[1].questionnaire.time"),
        ("small.yaml", "stages[3].information"),
        ("small.yaml", "stages[4].debriefing.text"),
    ]
    assert found == sorted(found, key=lambda one: (one["file"], one["line"]))
    assert found[0]["message"] == "is not UTF-8 text (looks like Latin-1): save it as UTF-8"


# ---- files ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["quick_preference_study.yaml", "texts/information.en.md", "questionnaires/usability.yaml"]
)
def test_a_mark_before_the_text_changes_nothing(tmp_path, name):
    """Notepad's "UTF-8 with BOM" made the heading part of the text."""
    folder = tmp_path / "protocols"
    shutil.copytree(PROTOCOLS, folder)
    (folder / name).write_bytes(b"\xef\xbb\xbf" + (PROTOCOLS / name).read_bytes().replace(b"\n", b"\r\n"))
    assert freeze(folder / QUICK.name).hash == freeze(QUICK).hash


@pytest.mark.parametrize(("encoding", "looks"), [("latin-1", "Latin-1"), ("utf-16", "UTF-16"), ("utf-16-le", "UTF-16")])
@pytest.mark.parametrize("name", ["quick_preference_study.yaml", "texts/debriefing.en.md"])
def test_a_text_in_another_encoding_is_called_so_and_not_missing(tmp_path, name, encoding, looks):
    folder = tmp_path / "protocols"
    shutil.copytree(PROTOCOLS, folder)
    (folder / name).write_bytes(("# one\n# zwei für alle\n").encode(encoding))
    (error,) = validate_protocol_file(folder / QUICK.name)["errors"]
    assert error["message"] == f"is not UTF-8 text (looks like {looks}): save it as UTF-8"
    assert error["file"].endswith(name)
    assert error["line"] == (1 if encoding == "utf-16" else 2)


def test_a_query_set_s_file_lies_beside_the_protocol_and_is_opened(tmp_path, monkeypatch):
    """Any `.npz` was valid, and it was looked for where the command ran."""
    folder = tmp_path / "protocols"
    sets = PROTOCOLS.parent / "datasets"
    named = quick(tmp_path, "query_set: study_room/queries_varied_200", "query_set: own.npz")
    assert "is no query set" in named["errors"][0]["message"]
    monkeypatch.chdir(tmp_path)
    shutil.copy(sets / "study_room" / "queries_triples_50.npz", tmp_path / "own.npz")
    assert validate_protocol_file(folder / QUICK.name)["valid"] is False
    shutil.move(tmp_path / "own.npz", folder / "own.npz")
    assert freeze(folder / QUICK.name).query_set == str(folder / "own.npz")
    for content in (b"PK", (sets / "study_room" / "base.npz").read_bytes()):
        (folder / "own.npz").write_bytes(content)
        (error,) = validate_protocol_file(folder / QUICK.name)["errors"]
        assert error["field"] == "query_set"
        assert "the file is no query set" in error["message"]
