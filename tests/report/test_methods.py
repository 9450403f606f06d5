"""Ways of telling a robot how to drive in the report: whose robots win, and what each way taught."""

from __future__ import annotations

from itertools import combinations
from types import SimpleNamespace

import pytest

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.method_findings import analyse_methods
from desirepath.report.method_text import methods_section
from desirepath.report.study_data import MethodChoice, Taught

METHODS = ("choices", "drawing", "sliders", "words")


def cohort(people: int, better) -> tuple[list[MethodChoice], list[Taught]]:
    """Each of them compares every two robots twice; better: of two methods, the one whose robot they choose."""
    choices, taught = [], []
    for k in range(people):
        for pair in [*combinations(METHODS, 2)] * 2:
            chosen = better(k, pair)
            choices.append(MethodChoice(f"P{k}", chosen, pair[1 - pair.index(chosen)], look_alike=False))
        taught += [
            Taught(f"P{k}", name, {"farther": 1.0} if name != "drawing" else {}, 60.0 * (n + 1))
            for n, name in enumerate(METHODS)
        ]
    return choices, taught


def test_a_way_whose_robot_always_wins_is_found():
    choices, taught = cohort(8, lambda k, pair: "words" if "words" in pair else pair[k % 2])
    found = analyse_methods(choices, taught, AnalysisPlan())
    assert found.won["words"].mean == 1
    assert found.pairs["choices", "words"].mean == 0
    assert found.test.test == "Friedman"
    assert found.test.significant()
    assert any("words" in one.about and one.significant() for one in found.between)
    assert max(found.worths, key=lambda one: one.log_worth).name == "words"


def test_where_every_robot_is_as_good_nothing_is_found():
    choices, taught = cohort(8, lambda k, pair: pair[k % 2])
    found = analyse_methods(choices, taught, AnalysisPlan())
    assert not found.test.significant()
    assert found.between == []


def test_weights_their_distance_and_the_time_of_each_way_stand_beside():
    choices, taught = cohort(3, lambda k, pair: pair[0])
    found = analyse_methods(choices, taught, AnalysisPlan())
    assert found.apart["choices", "drawing"].mean == pytest.approx(1.0)
    assert found.apart["choices", "words"].mean == 0
    assert found.nothing == {"choices": 0, "drawing": 3, "sliders": 0, "words": 0}
    assert found.minutes["sliders"][1] == pytest.approx(3.0)
    assert found.weights["drawing"] == {}


def test_one_person_is_described_and_not_tested():
    found = analyse_methods(*cohort(1, lambda k, pair: pair[0]), AnalysisPlan())
    assert (found.test, found.between, found.comparisons) == (None, [], 12)


def test_who_broke_off_counts_with_what_they_answered_and_the_report_says_so():
    choices, taught = cohort(3, lambda k, pair: pair[0])
    found = analyse_methods(choices[:-5], taught, AnalysisPlan())
    assert (found.comparisons, found.unfinished) == (31, 1)
    said = " ".join(methods_section(SimpleNamespace(ways=found, plan=AnalysisPlan())).sentences)
    assert "1 of the people answered fewer comparisons than the others" in said
    assert analyse_methods(choices, taught, AnalysisPlan()).unfinished == 0


def test_other_studies_have_no_such_part():
    assert analyse_methods([], [], AnalysisPlan()) is None


def test_the_report_says_that_scenes_were_chosen_in_which_the_robots_differ():
    ways = analyse_methods(*cohort(2, lambda k, pair: pair[0]), AnalysisPlan())
    said = methods_section(SimpleNamespace(ways=ways, plan=AnalysisPlan())).sentences[0]
    assert "24 comparisons" in said
    assert "differ more there than in scenes as they come" in said
