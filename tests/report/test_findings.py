"""The report's numbers from studies small enough to work out by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
import yaml

from desirepath.analysis.metrics import measure
from desirepath.analysis.scale_wordings import SCALES
from desirepath.analysis.triads import is_circular
from desirepath.learning.policies.shipped import load_queries
from desirepath.report.analysis_plan import AnalysisPlan, deviations, find_declared_plan, read_plan
from desirepath.report.choice_text import disagreement_section
from desirepath.report.findings import NothingToReport, analyse
from desirepath.report.report_text import sections
from desirepath.report.study_data import Choice, Comparison, ItemText, ParticipantRow, Rating, StudyData
from desirepath.report.study_report import answer_rows, scale_rows

HERE, THERE = "first_person", "top_down"
MOUSE = {"pointer": "fine"}
PERSON = ParticipantRow("P-1", False, None, False, "completed", (HERE, THERE))


def nothing(trajectory: str) -> None:
    raise LookupError(trajectory)


def choice(person: str, condition: str, query: int, chosen: str, role: str = "regular") -> Choice:
    shown = {"a": f"{query}-a", "b": f"{query}-b"}
    return Choice(person, condition, condition, str(query), role, shown["a"], shown["b"], shown[chosen], 2.0, MOUSE)


def study(choices: list[Choice], people: list[ParticipantRow] | None = None, **more: object) -> StudyData:
    data = StudyData("By hand", "1", {}, "", [], people or [PERSON], choices, [], [])
    return replace(data, **more)


PLAN = AnalysisPlan(metrics=())


def test_a_known_agreement_table() -> None:
    """P-1 answers 3 of 4 alike, P-2 1 of 4: mean 50 %, SD sqrt(0.125). P-1's kappa: (0.75 - 0.5) / 0.5; P-2 always
    chose the second under one condition and never under the other but once, so chance alone gives 0.25."""
    two = [PERSON, replace(PERSON, code="P-2")]
    answers = [choice("P-1", HERE, k, side) for k, side in enumerate("aabb")]
    answers += [choice("P-1", THERE, k, side) for k, side in enumerate("abbb")]
    answers += [choice("P-2", HERE, k, side) for k, side in enumerate("aaaa")]
    answers += [choice("P-2", THERE, k, side) for k, side in enumerate("abbb")]
    found = analyse(study(answers, two), nothing, plan=PLAN)
    of = found.between[HERE, THERE]
    assert (of.share.n, of.share.mean, of.share.sd) == pytest.approx((2, 0.5, math.sqrt(0.125)))
    assert of.kappa.mean == pytest.approx((0.5 + 0.0) / 2)
    assert found.of_condition[THERE].second_shown.mean == pytest.approx(0.75)
    assert found.of_condition[HERE].second_shown.mean == pytest.approx(0.25)


def test_learning_trials_and_probes_are_no_regular_answers() -> None:
    answers = [choice("P-1", HERE, k, "a") for k in range(6)]
    answers += [choice("P-1", HERE, 9, "b", "learning")]
    answers += [choice("P-1", HERE, k, "ab"[k < 2], "repeat") for k in range(5)]
    found = analyse(study(answers), nothing, plan=PLAN)
    assert found.of_condition[HERE].answers == 6
    assert found.of_condition[HERE].repeat.share.mean == pytest.approx(3 / 5)
    fewer = analyse(study(answers), nothing, plan=AnalysisPlan(metrics=(), min_probes=6))
    assert fewer.of_condition[HERE].repeat.share.n == 0


def test_the_flow_adds_up_and_only_those_who_count_are_analysed() -> None:
    people = [
        PERSON,
        replace(PERSON, code="P-2", excluded="looked away"),
        replace(PERSON, code="P-3", withdrawn=True, state="none"),
        replace(PERSON, code="P-4", state="active"),
        replace(PERSON, code="S001", simulated=True),
    ]
    answers = [choice(one.code, HERE, 0, "a") for one in people if not one.withdrawn]
    found = analyse(study(answers, people), nothing, plan=PLAN)
    flow = found.flow
    assert (flow.joined, flow.withdrawn, flow.excluded) == (4, 1, {"looked away": 1})
    assert (flow.unfinished, flow.analysed) == ({"active": 1}, 1)
    assert found.of_condition[HERE].answers == 1
    assert found.simulated == 0
    everybody = analyse(study(answers, people), nothing, "all", AnalysisPlan(metrics=(), sessions="all"))
    assert (everybody.flow.analysed, everybody.simulated) == (3, 1)
    with pytest.raises(NothingToReport, match="joined: 1 people"):
        analyse(study([], [replace(PERSON, state="active")]), nothing, plan=PLAN)


def test_what_changes_where_a_choice_flips() -> None:
    """One person, one query: there minus here of the two trajectories, over the standard deviation of both."""
    query = load_queries("study_room/queries_500").queries[3]
    trajectories = {"0-a": query.trajectory_a, "0-b": query.trajectory_b}
    people = [PERSON, replace(PERSON, code="P-2")]
    flips = [choice("P-1", HERE, 0, "a"), choice("P-1", THERE, 0, "b")]
    stays = [choice("P-2", HERE, 0, "a"), choice("P-2", THERE, 0, "a")]
    found = analyse(study(flips + stays, people), trajectories.__getitem__)
    lengths = measure([query.trajectory_a, query.trajectory_b]).path_length
    changed = found.disagreement[HERE, THERE]["path_length"]
    assert changed.n == 1  # P-2 never disagreed
    assert changed.mean == pytest.approx((lengths[1] - lengths[0]) / np.std(lengths, ddof=1))
    assert set(found.disagreement[HERE, THERE]) == set(AnalysisPlan().metrics)


def test_ratings_need_everybody_under_every_condition() -> None:
    """Three of four people rated all three conditions; who left one out does not count. Attention checks never do."""
    conditions = ("first_person", "immersive", "top_down")
    people = [replace(PERSON, code=f"P-{k}") for k in range(4)]
    ratings = [Rating(one.code, c, "q", "fun", 1 + k) for one in people for k, c in enumerate(conditions)]
    ratings.pop()
    ratings += [Rating(one.code, None, "about", "age", 30 + k) for k, one in enumerate(people)]
    answers = [choice(one.code, c, 0, "a") for one in people for c in conditions]
    items = [ItemText("about", "age", "number", "How old are you?", 7, {})]
    found = analyse(study(answers, people, ratings=ratings, items=items), nothing, plan=PLAN)
    (fun,) = found.items
    assert fun.test.n == 3
    assert fun.test.statistic == pytest.approx(6.0)  # three people in full agreement: n (k - 1)
    assert fun.test.effect == pytest.approx(1.0)
    assert [(one.item.key, one.n, one.numbers.mean) for one in found.demographics if one.numbers] == [("age", 4, 31.5)]


def test_an_evaluation_without_queries_is_tested_over_the_controllers() -> None:
    """The declared plan of the demonstration study on made-up ratings of 12 people in two environments: the own
    controller is 2 better than the others. A person counts once, with the mean of both environments."""
    text = (Path(__file__).resolve().parents[2] / "study_protocols" / "demonstration_study.yaml").read_text()
    six = list(permutations(("dwa", "own", "social_cost")))
    people = [replace(PERSON, code=f"P-{k}", order=six[k % 6]) for k in range(12)]
    ratings = [
        Rating(one.code, name, "drawing_rating", item, 2 + 2 * (name == "own") + (k + later) % 2)
        for k, one in enumerate(people)
        for later in (0, 1)
        for name in one.order
        for item in ("comfort", "too_close", "preference")
    ]
    found = analyse(study([], people, ratings=ratings, protocol=yaml.safe_load(text)), nothing)
    assert found.deviations == []
    assert found.conditions == ("dwa", "own", "social_cost")
    assert found.orders == {", ".join(order): 2 for order in six}
    assert [one.item.key for one in found.items] == ["comfort", "too_close", "preference"]
    for one in found.items:
        assert (one.test.n, one.means["own"].mean, one.means["dwa"].mean) == (12, 4.5, 2.5)
        assert (one.test.test, one.test.correction, one.test.df) == ("Friedman", "Bonferroni", 2)
        assert [pair.test for pair in one.pairs] == ["Wilcoxon signed-rank"] * 3
        assert [pair.correction for pair in one.pairs] == ["Bonferroni"] * 3
        assert [pair.significant() for pair in one.pairs] == [True, False, True]
        assert [pair.z < -2.9 for pair in one.pairs] == [True, False, True]
    parts = sections(found, [], Path())
    (orders,) = (table for part in parts for table in part.tables if table.caption.startswith("Orders"))
    assert len(orders.rows) == 6
    told = " ".join(point for part in parts for point in part.points)
    assert "higher for own than for social cost" in told
    assert any("in the reverse order" in sentence for part in parts for sentence in part.sentences)
    # Nothing differs any more: chapter 2's plan tests the pairs all the same.
    alike = [replace(one, value=3) for one in ratings]
    for name, pairs in {"always": 3, "where_significant": 0}.items():
        plan = found.plan.model_copy(update={"pairs": name})
        same = analyse(study([], people, ratings=alike), nothing, plan=plan)
        assert [len(one.pairs) for one in same.items] == [pairs] * 3
    assert "Agreement" not in [part.title for part in parts]


def test_circular_triads_are_counted_beside_chance() -> None:
    """P-1's first triad goes round, the second has an order, of the third one pair's time was over."""

    def probe(k: int, first: str, second: str) -> Choice:
        shown = f"{k}-{first}", f"{k}-{second}"
        return Choice("P-1", HERE, HERE, f"{k}{first}{second}", "transitivity", *shown, chosen=shown[0], decision_s=1)

    answers = [choice("P-1", HERE, 99, "a")]
    answers += [probe(1, *pair) for pair in ("xy", "yz", "zx")]
    answers += [probe(2, *pair) for pair in ("xy", "yz", "xz")]
    answers += [probe(3, *pair) for pair in ("xy", "yz")]
    found = analyse(study(answers), nothing, plan=PLAN)
    triads = found.triads[HERE]
    assert (triads.triads, triads.circular, triads.share.mean) == (2, 1, 0.5)
    assert found.of_condition[HERE].answers == 1
    (table,) = (t for part in sections(found, [], Path()) for t in part.tables if t.caption.startswith("Circular"))
    assert "coin makes 25%" in table.caption
    with pytest.raises(ValueError, match="three pairs of three"):
        is_circular([("x", "y"), ("y", "z"), ("u", "v")])


def test_a_validated_scale_is_scored_per_participant_by_its_own_scoring() -> None:
    """SUS: agreeing with everything is 50, with the praise only 100; an unfinished page has no score."""
    sus, people = SCALES["sus"], [replace(PERSON, code=code) for code in ("P-1", "P-2", "P-3")]
    given = [Rating("P-1", None, "usability", item.key, 5) for item in sus.items]
    given += [Rating("P-2", None, "usability", item.key, 1 if item.reversed else 5) for item in sus.items]
    given += [Rating("P-3", None, "usability", item.key, 3) for item in sus.items[1:]]
    answers = [choice(one.code, HERE, 0, "a") for one in people]
    found = analyse(study(answers, people, ratings=given, scales=[("usability", sus)]), nothing, plan=PLAN)
    (score,) = found.scales
    assert {(one.person, one.score) for one in score.scores} == {("P-1", 50.0), ("P-2", 100.0)}
    assert not found.demographics
    assert (score.means[""].mean, score.means[""].n, score.incomplete) == (75.0, 2, 1)
    assert score.means[""].sd == pytest.approx(math.sqrt(2 * 25**2))
    assert [row["score"] for row in scale_rows(found)] == [50.0, 100.0]
    (part,) = (part for part in sections(found, [], Path()) if part.title == "Validated scales")
    assert part.tables[0].rows[0][:4] == ["SUS", "asked once", "75.0", "35.4"]
    assert "Brooke" in part.sentences[0]


def test_what_is_asked_before_and_after_is_a_row_each_of_so_many_people() -> None:
    """An item, a validated scale and a ranking, asked by two stages of four people: nothing is pooled."""
    sus, people = SCALES["sus"], [replace(PERSON, code=f"P-{k}") for k in range(4)]
    given = []
    for k, one in enumerate(people):
        for stage, more in (("mood", 0), ("mood_2", 1)):
            given += [Rating(one.code, None, "mood", "mood", 2 + k + more, stage)]
            order = [HERE, THERE] if more else [THERE, HERE]
            given += [Rating(one.code, None, "best", "best", order, f"best_{more}")]
            given += [Rating(one.code, None, "usability", item.key, 3 + more, f"sus_{more}") for item in sus.items]
    answers = [choice(one.code, HERE, 0, "a") for one in people]
    found = analyse(study(answers, people, ratings=given, scales=[("usability", sus)]), nothing, plan=PLAN)
    assert [(one.asking, one.n, one.numbers.mean) for one in found.demographics] == [
        ("mood", 4, 3.5),
        ("mood_2", 4, 4.5),
    ]
    (scale,) = found.scales
    assert {name: mean.n for name, mean in scale.means.items()} == {"sus_0": 4, "sus_1": 4}
    assert [row["asking"] for row in scale_rows(found)] == ["sus_0", "sus_1"] * 4
    assert [(one.about, one.test.n, one.places[HERE]) for one in found.rankings] == [
        ("best_0", 4, [0, 4]), ("best_1", 4, [4, 0]),
    ]  # fmt: skip
    assert [(one.condition, one.of.n) for one in found.further.reliabilities] == [("sus_0", 4), ("sus_1", 4)]
    (who,) = (part for part in sections(found, [], Path()) if part.title == "Who took part")
    assert [row[:2] for row in who.tables[-1].rows] == [["mood (mood)", "4"], ["mood (mood 2)", "4"]]


def test_view_and_device_stand_beside_every_answer() -> None:
    data = study([choice("P-1", HERE, 0, "a"), choice("P-1", HERE, 1, "b", "learning")])
    rows = answer_rows(data, analyse(data, nothing, plan=PLAN))
    assert [(row["view"], row["device"], row["role"], row["second_chosen"]) for row in rows] == [
        (HERE, "mouse or touchpad", "regular", False),
        (HERE, "mouse or touchpad", "learning", True),
    ]


def test_look_alike_comparisons_are_counted_and_said() -> None:
    compared = [Comparison("P-1", "own", "base", False), Comparison("P-1", "base", "own", True)]
    found = analyse(study([choice("P-1", HERE, 0, "a")], comparisons=compared), nothing, plan=PLAN)
    (own,) = found.personalised
    assert (own.answers, own.look_alike, own.share.mean, own.test.used) == (2, 1, 0.5, 0)


def test_a_plan_that_came_with_a_later_version_is_used_and_told() -> None:
    answers = [choice("P-1", HERE, k, "a") for k in range(2)]
    begun = {"analysis": {"metrics": []}}
    found = analyse(study(answers, protocol=begun, newest={"analysis": {"metrics": [], "alpha": 0.01}}), nothing)
    assert (found.plan.alpha, found.deviations) == (0.01, ["alpha: declared 0.05, used 0.01."])
    assert analyse(study(answers, protocol=begun), nothing).deviations == []


def test_the_declared_plan_counts_and_deviations_are_said(tmp_path: Path) -> None:
    declared = find_declared_plan({"analysis": {"correction": "bonferroni"}})
    assert declared == AnalysisPlan(correction="bonferroni")
    assert declared.digest() != AnalysisPlan().digest()
    file = tmp_path / "plan.yaml"
    file.write_text("alpha: 0.01\ncorrection: bonferroni\n")
    used = read_plan(file)
    assert deviations(declared, used) == ["alpha: declared 0.05, used 0.01."]
    assert deviations(declared, declared) == []
    assert "No analysis plan was declared" in deviations(None, used)[0]
    file.write_text("alfa: 0.01\n")
    with pytest.raises(ValueError, match=r"alfa.*allowed: alpha, .*did you mean alpha"):
        read_plan(file)


@pytest.mark.parametrize("state", ["paused", "active", "expired", "screened_out", "none"])
def test_only_who_completed_is_analysed(state: str) -> None:
    """Whatever else a session is, unless the plan takes all."""
    two = [PERSON, replace(PERSON, code="P-2", state=state)]
    answers = [choice(one.code, HERE, 0, "a") for one in two]
    found = analyse(study(answers, two), nothing, plan=PLAN)
    assert (found.analysed, found.flow.unfinished) == (("P-1",), {state: 1})
    assert analyse(study(answers, two), nothing, plan=AnalysisPlan(metrics=(), sessions="all")).flow.analysed == 2


def test_flips_are_averaged_within_people_before_over_them() -> None:
    """P-1 flips three queries, P-2 one: each counts once. Pooled, P-1 would count three times."""
    queries = load_queries("study_room/queries_500").queries[:4]
    trajectories = {
        f"{k}-{side}": t for k, q in enumerate(queries) for side, t in (("a", q.trajectory_a), ("b", q.trajectory_b))
    }
    two = [PERSON, replace(PERSON, code="P-2")]
    answers = [choice(code, HERE, k, "a") for code in ("P-1", "P-2") for k in range(4)]
    answers += [choice("P-1", THERE, k, "b" if k < 3 else "a") for k in range(4)]
    answers += [choice("P-2", THERE, k, "b" if k == 3 else "a") for k in range(4)]
    found = analyse(study(answers, two), trajectories.__getitem__)
    lengths = {name: float(measure([t]).path_length[0]) for name, t in trajectories.items()}
    deviation = np.std(list(lengths.values()), ddof=1)
    flips = [(lengths[f"{k}-b"] - lengths[f"{k}-a"]) / deviation for k in range(4)]
    changed = found.disagreement[HERE, THERE]["path_length"]
    assert changed.n == 2
    assert changed.mean == pytest.approx((np.mean(flips[:3]) + flips[3]) / 2)
    assert changed.sd == pytest.approx(np.std([np.mean(flips[:3]), flips[3]], ddof=1))


def test_what_was_not_chosen_was_rejected() -> None:
    first, second = choice("P-1", HERE, 0, "a"), choice("P-1", HERE, 0, "b")
    assert (first.chosen, first.rejected, first.second_chosen) == ("0-a", "0-b", False)
    assert (second.chosen, second.rejected, second.second_chosen) == ("0-b", "0-a", True)


def test_position_and_time_are_of_regular_answers_alone() -> None:
    """Two people; probes and practice, all second, all slow, count nowhere. Times: the mean of people's medians."""
    two = [PERSON, replace(PERSON, code="P-2")]
    answers = [
        replace(choice("P-1", HERE, k, side), decision_s=s)
        for k, (side, s) in enumerate(zip("aab", (1.0, 3.0, 8.0), strict=True))
    ]
    answers += [replace(choice("P-2", HERE, k, "a"), decision_s=s) for k, s in enumerate((5.0, 7.0))]
    answers += [
        replace(choice(one.code, HERE, k, "b", role), decision_s=99.0)
        for one in two
        for k in range(5)
        for role in ("practice", "repeat", "swap", "transitivity")
    ]
    of = analyse(study(answers, two), nothing, plan=PLAN).of_condition[HERE]
    assert of.answers == 5
    assert (of.second_shown.n, of.second_shown.mean) == (2, pytest.approx(1 / 6))
    assert (of.decision_s.n, of.decision_s.mean) == (2, 4.5)
    timeless = [replace(one, decision_s=None) for one in answers]
    assert math.isnan(analyse(study(timeless, two), nothing, plan=PLAN).of_condition[HERE].decision_s.mean)


def test_changes_are_told_under_their_metrics_names_for_who_ever_chose_differently() -> None:
    query = load_queries("study_room/queries_500").queries[3]
    trajectories = {"0-a": query.trajectory_a, "0-b": query.trajectory_b}
    people = [PERSON, replace(PERSON, code="P-2")]
    flips = [choice(who, view, 0, side) for who in ("P-1", "P-2") for view, side in ((HERE, "a"), (THERE, "b"))]
    plan = AnalysisPlan(metrics=("path_length", "mean_speed"))
    found = analyse(study(flips, people), trajectories.__getitem__, plan=plan)
    section = disagreement_section(found)
    (table,) = section.tables
    assert list(table.heads) == ["from → to", "length", "mean speed"]
    (row,) = table.rows
    assert row[0] == f"{HERE} → {THERE}".replace("_", " ")
    assert all(cell.endswith("(n = 2)") for cell in row[1:])
    alone = analyse(study(flips[:2], people[:1]), trajectories.__getitem__, plan=plan)
    assert disagreement_section(alone).tables[0].rows[0][1:] == ["–", "–"]


def test_only_the_ranking_that_the_plan_names_is_tested() -> None:
    people = [replace(PERSON, code=f"P-{k}") for k in range(6)]
    ratings = [
        Rating(one.code, None, of, "best", [THERE, HERE] if of == "asked_first" else [HERE, THERE])
        for one in people
        for of in ("asked_first", "asked_last")
    ]
    data = study([choice(one.code, HERE, 0, "a") for one in people], people, ratings=ratings)
    both = analyse(data, nothing, plan=PLAN).rankings
    assert [one.item.questionnaire for one in both] == ["asked_first", "asked_last"]
    assert [one.places[HERE] for one in both] == [[0, 6], [6, 0]]
    (named,) = analyse(data, nothing, plan=AnalysisPlan(metrics=(), ranking="asked_last")).rankings
    assert (named.item.questionnaire, named.places[HERE], named.test.n) == ("asked_last", [6, 0], 6)
    assert named.test.p == pytest.approx(2 / 2**6)
