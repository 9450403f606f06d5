"""A declared analysis that cannot be done is an error that says what would work; studies of before still open."""

from __future__ import annotations

from pathlib import Path

import pytest

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import analyse
from desirepath.report.study_data import ItemText, ParticipantRow, Rating, StudyData
from desirepath.study.protocol.freezing import find_shipped_protocols, freeze_text, thaw, validate_protocol_file
from tests.study.small_protocol import BLOCK, CROSSED, RATING, VIEWS, protocol_text, write_files

RATED = {"block": {**CROSSED["block"], "after": [{"questionnaire": {"use": "rating"}}]}}
RANKED = {"questionnaire": {"use": "order"}}
GROUPS = {"block": {"one_of": {"view": VIEWS}, "trials": [{"queries": {"count": 3}}]}}


def probed(repeat: int) -> dict:
    queries = {"count": 6, "probes": {"repeat": repeat}}
    return {"block": {"each": VIEWS, "trials": [{"queries": queries}]}}


def errors(folder: Path, stages: list[dict], **analysis: object) -> list[tuple[str, str]]:
    folder.mkdir(exist_ok=True)
    write_files(folder)
    (folder / "small.yaml").write_text(protocol_text(stages, analysis=analysis))
    return [(one["field"], one["message"]) for one in validate_protocol_file(folder / "small.yaml")["errors"]]


@pytest.mark.parametrize(
    ("stages", "analysis", "field", "says"),
    [
        ([RATED, RANKED], {"ranking": "ordre"}, "analysis.ranking", "rankings are order; did you mean order?"),
        ([RATED, RANKED], {"ranking": "rating"}, "analysis.ranking", "no item of type ranking; rankings are order"),
        ([RATED], {"items": "nonsense"}, "analysis.items", "not asked in this protocol; asked are rating"),
        ([CROSSED, RATING], {"items": "rating"}, "analysis.items", "about one condition only"),
        ([RATED, RANKED], {"items": "order"}, "analysis.items", "about one condition only"),
        (
            [{"block": {**BLOCK["block"], "after": RATED["block"]["after"]}}],
            {"items": "rating"},
            "analysis.items",
            "one",
        ),
        ([probed(3)], {}, "probes.repeat", "is 3, fewer than analysis.min_probes = 5"),
        ([probed(5)], {"min_probes": 6}, "probes.repeat", "declare a smaller min_probes"),
        ([BLOCK], {}, "analysis", "compares nothing"),
        ([CROSSED], {"equivalence": {"share": 0.1}}, "equivalence.share", "add a comparison stage"),
        (
            [CROSSED],
            {"equivalence": {"rating": 0.5}},
            "equivalence.rating",
            "nothing is rated or answered about several",
        ),
    ],
)
def test_an_analysis_that_cannot_be_done_is_refused(
    tmp_path: Path, stages: list, analysis: dict, field: str, says: str
) -> None:
    found = errors(tmp_path, stages, **analysis)
    assert any(name.endswith(field) and says in message for name, message in found), found


def test_a_view_that_was_dropped_cannot_be_ranked(tmp_path: Path) -> None:
    two = {"block": {**CROSSED["block"], "each": ["top_down", "first_person"]}}
    ((_, message),) = errors(tmp_path, [two, RANKED], ranking="order")
    assert "ranks immersive, which nobody is shown; shown are first_person, top_down" in message
    ((_, message),) = errors(tmp_path, [two, RANKED])  # found by itself, it would be tested as well
    assert "ranks immersive" in message
    ((_, message),) = errors(tmp_path, [GROUPS, RANKED])
    assert "of which everybody is shown one only" in message


@pytest.mark.parametrize(
    ("stages", "analysis"),
    [
        ([RATED, RANKED], {"items": "rating", "ranking": "order", "equivalence": {"rating": 0.5}}),
        ([probed(3)], {"min_probes": 3}),
        ([probed(5)], {}),
        ([{"block": {**GROUPS["block"], "after": RATED["block"]["after"]}}], {"items": "rating"}),
    ],
)
def test_an_analysis_that_can_be_done_is_valid(tmp_path: Path, stages: list, analysis: dict) -> None:
    assert errors(tmp_path, stages, **analysis) == []


def test_shipped_protocols_declare_what_can_be_done() -> None:
    files = find_shipped_protocols()
    assert [validate_protocol_file(file)["errors"] for file in files] == [[]] * len(files)


def test_a_study_of_before_opens_with_a_plan_that_would_be_refused_now(tmp_path: Path) -> None:
    write_files(tmp_path)
    fine = freeze_text(protocol_text([RATED], analysis={"items": "rating"}), folder=tmp_path)

    class Stored:
        protocol_yaml = fine.yaml.replace("items: rating", "items: nonsense")
        files = fine.files

    assert thaw(Stored()).protocol.analysis.items == "nonsense"


SCALE = {"question": {"en": "How was it?"}, "points": 5, "low": {"en": "bad"}, "high": {"en": "good"}}


def test_a_stage_of_ratings_can_be_named_as_the_items(tmp_path: Path) -> None:
    """By the key that its answers carry; where it has one condition nothing is compared."""
    rated = {"rating": {"each": VIEWS, "count": 2, "scale": SCALE}}
    assert errors(tmp_path / "both", [rated], items="rating", equivalence={"rating": 0.5}) == []
    alone = {"rating": {"view": "top_down", "count": 2, "scale": SCALE}}
    ((field, told),) = errors(tmp_path / "alone", [CROSSED, alone], items="rating")
    assert field == "analysis.items"
    assert "about one condition only" in told
    ((field, told),) = errors(tmp_path / "unknown", [rated], items="ratings")
    assert "asked are rating; did you mean rating?" in told


def test_the_report_tests_what_the_named_stage_rated(tmp_path: Path) -> None:
    ratings = [
        Rating(f"P{n}", view, stage, "rating", n % 3 + (stage == "rating_2" and view == "immersive") + 1)
        for n in range(12)
        for view in ("top_down", "immersive")
        for stage in ("rating", "rating_2")
    ]
    people = [ParticipantRow(f"P{n}", False, None, False, "completed", ("top_down", "immersive")) for n in range(12)]
    items = [ItemText(stage, "rating", "scale", stage, 5, {}) for stage in ("rating", "rating_2")]
    data = StudyData("By hand", "1", {}, "", items, people, [], ratings, [])
    for stage, differs in (("rating", False), ("rating_2", True)):
        (one,) = analyse(data, lambda _: None, plan=AnalysisPlan(items=stage, metrics=())).items
        assert (one.item.questionnaire, one.significant(0.05)) == (stage, differs)
