"""A simulated study's whole report, word by word: whatever changes in it is seen, and looked at, before it is accepted.

The numbers themselves are tested against other programs elsewhere. After a change that is wanted:
`python -m tests.report.test_known_report` writes the expected report anew.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from desirepath.analysis.scale_wordings import SCALES
from desirepath.explain.printed import Section
from desirepath.report.analysis_plan import AnalysisPlan, Equivalence
from desirepath.report.findings import Findings, analyse
from desirepath.report.planned_design import Assumed, PlannedDesign
from desirepath.report.report_text import brief, every_test, facts, sections
from desirepath.report.simulated_cohorts import Cohort, simulate_data
from desirepath.report.simulated_power import enough, power
from desirepath.report.study_data import Choice, Guess, ItemText, Rating, StudyData
from desirepath.report.study_report import answer_rows, findings_dict, scale_rows

EXPECTED = Path(__file__).with_name("known_report.txt")
PEOPLE = 14
VIEWS = ("first_person", "immersive", "top_down")


def nothing(trajectory: str) -> None:
    raise LookupError(trajectory)


def three_views() -> StudyData:
    """The interface study with a scale, probes of every kind, comparisons, a guess; some did not finish."""
    cohort = Cohort(
        ratings={"fun": {"immersive": 1.5}, "sus": {"immersive": 0.8}},
        first_choice={"usefulness": {"immersive": 0.8}},
        own=0.8,
        seed=4,
    )
    items = ("ease", "fun")
    data = simulate_data(
        cohort,
        PEOPLE,
        items=items,
        rankings=("usefulness",),
        queries=6,
        repeats=5,
        comparisons=3,
        scales=[SCALES["sus"]],
    )
    orders = [VIEWS, VIEWS[1:] + VIEWS[:1], VIEWS[2:] + VIEWS[:2]]
    people = [replace(one, simulated=k == 0, order=orders[k % 3]) for k, one in enumerate(data.people)]
    people[1] = replace(people[1], excluded="looked away")
    people[2] = replace(people[2], state="paused")
    people[3] = replace(people[3], withdrawn=True)
    choices = [
        replace(one, decision_s=1.0 + (k % 7) / 2, device=MOUSE if k % 3 else {}) for k, one in enumerate(data.choices)
    ]
    for k, one in enumerate(people):
        choices += [
            _triad(one.code, k, pair) for pair in (("x", "y"), ("y", "z"), ("z", "x") if k % 4 == 0 else ("x", "z"))
        ]
        choices += [_swapped(one.code, n, steady=(k + n) % 3 > 0) for n in range(5)]
        choices.append(Choice(one.code, "top_down", "top_down", "p", "practice", "a", "b", "b", 9.0))
    ratings = [
        *data.ratings,
        *(Rating(one.code, None, "about", "age", 20 + 3 * k) for k, one in enumerate(people)),
        *(Rating(one.code, None, "about", "plays", ("yes", "no")[k % 2]) for k, one in enumerate(people)),
        *(Rating(one.code, None, "about", "remarks", "none") for one in people),
    ]
    texts = [
        ItemText("about", "age", "number", "How old are you?", 7, {}),
        ItemText("about", "plays", "choice", "Do you play?", 7, {"yes": "Yes", "no": "No"}),
        ItemText("about", "remarks", "text", "Anything else?", 7, {}),
        ItemText("interface_items", "ease", "scale", "How easy was it?", 7, {}, reversed=True),
    ]
    compared = [
        replace(
            one,
            opponent=f"policy-{int(one.person[1:]) % 5}" if "other" in (one.chosen, one.rejected) else "base",
            look_alike=k % 9 == 0,
        )
        for k, one in enumerate(data.comparisons)
    ]
    guesses = [Guess(one.code, k % 3 > 0) for k, one in enumerate(people)]
    return replace(
        data, people=people, choices=choices, ratings=ratings, items=texts, comparisons=compared, guesses=guesses
    )


MOUSE = {"pointer": "fine"}


def _triad(person: str, k: int, pair: tuple[str, str]) -> Choice:
    return Choice(
        person,
        "top_down",
        "top_down",
        f"t{pair}",
        "transitivity",
        f"{k}{pair[0]}",
        f"{k}{pair[1]}",
        f"{k}{pair[0]}",
        1.0,
    )


def _swapped(person: str, n: int, *, steady: bool) -> Choice:
    query = f"{person}-{n}"
    return Choice(
        person, "immersive", "immersive", query, "swap", f"{query}-b", f"{query}-a", f"{query}-{'ab'[steady]}", 1.0
    )


def two_by_two() -> StudyData:
    cohort = Cohort(ratings={"fun": {"immersive": 1.5}}, seed=2)
    return simulate_data(
        cohort,
        12,
        items=("fun",),
        rankings=(),
        queries=2,
        within={"view": ("immersive", "top_down")},
        between={"robot": ("small", "large")},
    )


def shown(parts: list[Section]) -> Iterator[str]:
    for part in parts:
        yield f"## {part.title}"
        yield from part.sentences
        for table in part.tables:
            yield f"[{table.caption}]"
            yield from (" | ".join(row) for row in (table.heads, *table.rows))
        yield from (f"- {point}" for point in part.points)


def numbers(value: object) -> object:
    """As the findings' file has it, to four digits; what models fit is told in words above."""
    if isinstance(value, dict):
        return {name: numbers(inner) for name, inner in value.items() if name not in ("models", "metrics")}
    if isinstance(value, list):
        return [numbers(one) for one in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def report(data: StudyData, found: Findings) -> Iterator[str]:
    yield from brief(found)
    yield from shown([*sections(found, [], Path()), *every_test(found)])
    told = facts(found, study="known", protocol="made up, version 1", protocol_hash="", command="none")
    yield from (f"{name}: {value}" for name, value in told)
    yield from found.deviations
    yield from (str(row) for row in answer_rows(data, found)[:40:3])
    yield from (str(row) for row in scale_rows(found)[:6])
    for name, value in findings_dict(found).items():
        yield f"{name}: {json.dumps(numbers(value), ensure_ascii=False)}"


def whole() -> str:
    every = AnalysisPlan(
        metrics=(), bayes_factors=True, models=True, equivalence=Equivalence(rating=1.0, share=0.2), own="signed_ranks"
    )
    first, second = three_views(), two_by_two()
    lines = ["# Three views", *report(first, analyse(first, nothing, "all", every))]
    plain = AnalysisPlan(metrics=(), pairs="always", pairs_over="item", alpha=0.01, correction="bonferroni")
    lines += [
        "# The same, another plan",
        *brief(found := analyse(first, nothing, "simulated", plain)),
        *shown(sections(found, [], Path())),
    ]
    lines += ["# Two by two", *report(second, analyse(second, nothing, "all", AnalysisPlan(metrics=())))]
    lines += ["# Power", *_planned()]
    return "\n".join(lines) + "\n"


def _planned() -> Iterator[str]:
    """Small power analyses with what is assumed where nothing is said, with every digit of Wilson's intervals: sums,
    products and square roots are the same on every processor. (When two formulas of his became one, the last digit of 0
    and 3 of 6 changed.)"""
    views = {"view": VIEWS}
    for planned, assumed in (
        (
            PlannedDesign(VIEWS, ("ease", "fun"), ("usefulness",), 4, 2, within=views),
            Assumed("immersive", "fun", "usefulness"),
        ),
        (
            PlannedDesign(VIEWS, ("fun",), (), 1, 0, between=views),
            Assumed("top_down", "fun", "", effect=1.5, drop_out=0.2),
        ),
    ):
        yield str(assumed)
        found = power(planned, assumed, (9, 18), cohorts=6)
        for one in found:
            for row in one.rows():
                yield str({**row, "agreement_half_width": numbers(row["agreement_half_width"])})
        yield str(enough(found))


def test_the_report_of_a_known_study_is_as_it_was_read() -> None:
    assert whole().splitlines() == EXPECTED.read_text(encoding="utf-8").splitlines()


if __name__ == "__main__":
    EXPECTED.write_text(whole(), encoding="utf-8")
