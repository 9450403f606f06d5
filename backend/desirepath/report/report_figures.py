"""A study's findings in pictures like the thesis's figures 7.2 to 7.4, 8.6 and 8.7, each beside a CSV with exactly what
is drawn.

Importing this loads matplotlib, which is slow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from desirepath.analysis.tested import Mean, star_bounds
from desirepath.explain.pictures import Picture, Rows, blank, quiet
from desirepath.explain.scene_plots import DATA, INK, PAPER, SOFT, STYLE
from desirepath.report.analysis_plan import METRICS
from desirepath.report.explanation_findings import Explained, Outcome
from desirepath.report.findings import Findings
from desirepath.report.item_tests import ItemResult
from desirepath.report.planned_design import Assumed
from desirepath.report.report_cells import name_in_words, pair_words
from desirepath.report.simulated_power import WANTED, Power

DOTTED = (0, (1, 2))
PLACES = ("#2f6a3d", "#a5cba5", "#e9e2d2")  # first, second, third place: the darker, the better


def pictures(findings: Findings) -> list[Picture]:
    """All figures of the report that the data allow, in its order."""
    drawn = explanation_pictures(findings.explained) if findings.explained else []
    if findings.items:
        drawn.append(items_picture(findings))
    if findings.rankings:
        drawn.append(ranking_picture(findings))
    if findings.between:
        drawn.append(agreement_picture(findings))
    if any(any(of.n for of in metrics.values()) for metrics in findings.disagreement.values()):
        drawn.append(disagreement_picture(findings))
    if findings.personalised:
        drawn.append(personalised_picture(findings))
    return drawn


def _bars(ax: Axes, means: Mapping[str, Mean], *, error: str = "se", lowest: float = 0.0, cap: float = 2) -> None:
    """A bar per mean from the scale's lowest, with its error (se, sd)."""
    for k, (name, mean) in enumerate(means.items()):
        ax.bar(k, mean.mean - lowest, bottom=lowest, width=0.7, color=DATA[k % len(DATA)], label=name)
        ax.errorbar(k, mean.mean, yerr=getattr(mean, error), color=INK, linewidth=0.9, capsize=cap)
    quiet(ax)


def _shares(ax: Axes, lines: Sequence[tuple[str, Mean, str]]) -> None:
    """A line per share (words, mean, colour), from above, with its interval; dotted: one half."""
    for k, (_, mean, colour) in enumerate(lines):
        ax.errorbar(
            mean.mean, -k, xerr=[[mean.mean - mean.low], [mean.high - mean.mean]], fmt="o", color=colour,
            markersize=4, linewidth=1.2,
        )  # fmt: skip
    ax.axvline(0.5, color=SOFT, linewidth=0.7, linestyle=DOTTED)
    ax.set_yticks([-k for k in range(len(lines))], [words for words, _, _ in lines])
    ax.xaxis.set_major_formatter(_percent)
    quiet(ax)


def _percent(value: float, _: object) -> str:
    return f"{value:.0%}"


def _legend(figure: Figure, axes: Sequence[Axes], columns: int) -> None:
    """What is drawn in any of the panels, named once below them."""
    handles = {label: handle for ax in axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=min(columns, len(handles)), frameon=False
    )


def _in_words(means: Mapping[str, Mean]) -> dict[str, Mean]:
    return {name_in_words(name): mean for name, mean in means.items()}


def items_picture(findings: Findings) -> Picture:
    """Figure 7.2: means and standard errors of every item per condition, brackets over pairs that differ."""
    columns = min(5, len(findings.items))
    lines = math.ceil(len(findings.items) / columns)
    with mpl.rc_context(STYLE):
        figure, axes = blank(columns, 1.55 * columns + 0.4, 2.1 * lines + 0.5, rows=lines)
        for ax, result in zip(axes, findings.items, strict=False):
            _item(ax, result, findings)
        for ends in {(result.item.lowest, result.item.points) for result in findings.items}:
            alike = [
                ax
                for ax, result in zip(axes, findings.items, strict=False)
                if (result.item.lowest, result.item.points) == ends
            ]
            _same_heights(alike)
        for ax in axes[len(findings.items) :]:
            ax.set_visible(False)
        for ax in axes[::columns]:
            ax.set_ylabel("mean rating")
        _legend(figure, axes, 4)
    rows: Rows = [
        {
            "item": result.item.key,
            "text": result.item.text,
            "reversed": result.item.reversed,
            "condition": name,
            **_mean_row(mean),
            "test": result.test.test,
            "of": result.test.about,
            "statistic": result.test.statistic,
            "p": result.test.p,
            "p_corrected": result.test.p_corrected,
        }
        for result in findings.items
        for name, mean in result.means.items()
    ]
    where = "" if findings.plan.pairs == "always" else ", in items where the conditions differ"
    over = "all items" if findings.plan.pairs_over == "items" else "an item's pairs"
    marks = ", ".join(f"{'*' * (k + 1)} p ≤ {bound:g}" for k, bound in enumerate(star_bounds(findings.plan.alpha)))
    caption = (
        "Mean ratings with standard errors over people. Brackets: conditions that differ, corrected over "
        f"{over}{where}; {marks}."
    )
    return Picture("items", "Questionnaire after each block", caption, figure, rows)


def _item(ax: Axes, result: ItemResult, findings: Findings) -> None:
    lowest, top = result.item.lowest, result.item.points
    unit = (top - lowest) / 6  # of a scale from 1 to 7
    _bars(ax, _in_words(result.means), lowest=lowest)
    level = max(top, max(mean.mean + mean.se for mean in result.means.values()) + 0.3 * unit)
    pairs = [] if result.design.factorial else list(combinations(range(len(result.means)), 2))
    for (i, j), test in zip(pairs, result.tests if len(result.means) == 2 else result.pairs, strict=False):
        if test.significant(findings.plan.alpha):
            ax.plot([i, i, j, j], [level, level + 0.12 * unit, level + 0.12 * unit, level], color=INK, linewidth=0.7)
            ax.text(
                (i + j) / 2, level + 0.1 * unit, test.stars(findings.plan.alpha), ha="center", va="bottom", fontsize=7
            )
            level += 0.6 * unit
    ax.set(title=name_in_words(result.item.key), xticks=[], ylim=(lowest, max(top, level) + 0.2 * unit))
    if result.item.type != "score":
        ax.set_yticks(range(round(lowest), top + 1))


def _same_heights(axes: Sequence[Axes]) -> None:
    """One scale for all panels, so that equal bars mean equal numbers."""
    low, high = min(ax.get_ylim()[0] for ax in axes), max(ax.get_ylim()[1] for ax in axes)
    for ax in axes:
        ax.set_ylim(low, high)


def ranking_picture(findings: Findings) -> Picture:
    """Figure 7.3: how many people put each condition first, second, third."""
    with mpl.rc_context(STYLE):
        figure, axes = blank(len(findings.rankings), 2.4 * len(findings.rankings) + 0.4, 2.6)
        for ax, ranking in zip(axes, findings.rankings, strict=True):
            bottom = np.zeros(len(ranking.places))
            shares = np.array(list(ranking.places.values()), dtype=float)
            shares /= shares.sum(axis=1, keepdims=True)
            for place in range(shares.shape[1]):
                colour = PLACES[min(place, len(PLACES) - 1)]
                ax.bar(
                    range(len(shares)), shares[:, place], bottom=bottom, width=0.7, color=colour, edgecolor=PAPER,
                    label=f"place {place + 1}",
                )  # fmt: skip
                bottom += shares[:, place]
            ax.set_xticks(range(len(shares)), [name_in_words(name).replace(" ", "\n") for name in ranking.places])
            ax.set(title=name_in_words(ranking.item.key), ylim=(0, 1))
            ax.yaxis.set_major_formatter(_percent)
            quiet(ax)
        axes[0].set_ylabel("share of people")
        _legend(figure, axes[:1], len(findings.rankings[0].places))
    rows: Rows = [
        {
            "ranking": ranking.item.key,
            "condition": name,
            "place": place + 1,
            "people": count,
            "share": count / ranking.test.n,
        }
        for ranking in findings.rankings
        for name, counts in ranking.places.items()
        for place, count in enumerate(counts)
    ]
    caption = "Share of people who put each condition first, second, third; ties were not possible."
    return Picture("rankings", "Ranking of the conditions", caption, figure, rows)


def agreement_picture(findings: Findings) -> Picture:
    """Table 7.2 as a figure: agreement between conditions, beside what people agree with themselves."""
    lines: list[tuple[str, str, Mean]] = [
        ("between", pair_words(pair), of.share) for pair, of in findings.between.items()
    ]
    for name, of_condition in findings.of_condition.items():
        for role, words in (("repeat", "asked again"), ("swap", "asked again, sides exchanged")):
            again = getattr(of_condition, role).share
            if again.n:
                lines.append(("within", f"{name_in_words(name)}, {words}", again))
    with mpl.rc_context(STYLE):
        figure, (ax,) = blank(1, 5.2, 0.7 + 0.3 * len(lines))
        _shares(ax, [(words, mean, DATA[0 if kind == "between" else 2]) for kind, words, mean in lines])
        lowest = min((mean.low for _, _, mean in lines if not math.isnan(mean.low)), default=1.0)
        ax.set(xlim=(min(0.4, lowest - 0.02), 1.0), xlabel="share of the same answers, mean over people")
    rows: Rows = [{"kind": kind, "what": words, **_mean_row(mean)} for kind, words, mean in lines]
    caption = (
        "Share of a person's answers that are the same for the same queries, mean over people with 95 % "
        "intervals (Wilson's, over people). Dotted line: guessing. Agreement between conditions can hardly be higher "
        "than that of people with themselves within one."
    )
    return Picture("agreement", "Agreement between and within conditions", caption, figure, rows)


def disagreement_picture(findings: Findings) -> Picture:
    """Figure 7.4: what changes in the preferred trajectory where a choice flips between conditions."""
    metrics = findings.plan.metrics
    columns = min(3, len(metrics))
    lines = math.ceil(len(metrics) / columns)
    with mpl.rc_context(STYLE):
        figure, axes = blank(columns, 2.3 * columns + 0.3, 1.9 * lines + 0.5, rows=lines)
        for letter, ax, metric in zip("abcdefghij", axes, metrics, strict=False):
            _bars(ax, {pair_words(pair, " → "): of[metric] for pair, of in findings.disagreement.items()})
            ax.axhline(0, color=SOFT, linewidth=0.7)
            ax.set(title=f"{letter}  {METRICS[metric][0]}", xticks=[])
        _same_heights(axes[: len(metrics)])
        for ax in axes[len(metrics) :]:
            ax.set_visible(False)
        for ax in axes[::columns]:
            ax.set_ylabel("change (z)")
        _legend(figure, axes[:1], 3)
    rows: Rows = [
        {"from": pair[0], "to": pair[1], "metric": metric, "unit": "z within person", **_mean_row(of)}
        for pair, metrics_of in findings.disagreement.items()
        for metric, of in metrics_of.items()
    ]
    caption = (
        "Where a person chose differently under two conditions: the preferred trajectory under the second minus that "
        "under the first, z-scored over all trajectories shown to that person, averaged within people; mean and "
        "standard error over people. Descriptive, no test: what the two trajectories of a query differ in was made, "
        "not observed."
    )
    return Picture("disagreement", "Change of the preferred trajectory where choices differ", caption, figure, rows)


def personalised_picture(findings: Findings) -> Picture:
    """How often the own policy was preferred."""
    words = {
        "base": "base policy",
        "neutral": "conditioned policy",
        "population": "earlier participants'",
        "other": "another participant's",
    }
    with mpl.rc_context(STYLE):
        figure, (ax,) = blank(1, 4.6, 0.7 + 0.35 * len(findings.personalised))
        _shares(ax, [(f"own, not {words[of.against]}", of.share, DATA[0]) for of in findings.personalised])
        ax.set(xlim=(0, 1), ylim=(-len(findings.personalised) + 0.5, 0.5), xlabel="share of a person's choices")
    rows: Rows = [
        {
            "own_against": comparison.against,
            **_mean_row(comparison.share),
            "p": comparison.test.p,
            "p_corrected": comparison.test.p_corrected,
        }
        for comparison in findings.personalised
    ]
    caption = (
        "Blind comparisons: share of a person's choices that went to the own policy, mean and 95 % interval over "
        "people (Wilson's)."
    )
    return Picture("personalised", "The own policy against others", caption, figure, rows)


def explanation_pictures(of: Explained) -> list[Picture]:
    """Agreement per condition, and what was rated, where anything was."""
    return [tau_picture(of.agreement), *([explanation_ratings_picture(of)] if of.rated else [])]


def tau_picture(of: Outcome) -> Picture:
    """Figure 8.6: tau-b per condition, means and standard deviations over people."""
    with mpl.rc_context(STYLE):
        figure, (ax,) = blank(1, 0.9 * len(of.means) + 1.2, 2.8)
        _bars(ax, of.means, error="sd", cap=3)
        ax.axhline(0, color=INK, linewidth=0.6)
        ax.set_xticks(range(len(of.means)), [name.replace(" and ", " and\n") for name in of.means])
        ax.set(ylabel="Kendall's tau-b", xlabel="shown")
    caption = (
        "Agreement of people's rankings with the objects' scores: Kendall's tau-b, means over people, bars one "
        "standard deviation. 0: no agreement; 1: the same order."
    )
    title = "Agreement of rankings with scores"
    return Picture("ranking_agreement", title, caption, figure, _outcome_rows(of))


def explanation_ratings_picture(of: Explained) -> Picture:
    """Figure 8.7: awareness, trust, plausibility per condition, means and standard errors over people."""
    with mpl.rc_context(STYLE):
        figure, axes = blank(len(of.rated), 1.75 * len(of.rated) + 0.4, 2.9)
        for ax, outcome in zip(axes, of.rated, strict=True):
            _bars(ax, outcome.means, lowest=outcome.lowest)
            ax.set(title=name_in_words(outcome.key), xticks=[], ylim=(outcome.lowest, outcome.highest))
        axes[0].set_ylabel("mean rating")
        _legend(figure, axes[:1], 4)
    caption = (
        "What was said after each block: means and standard errors over people, by what was shown; reversed items are "
        "inverted."
    )
    rows = [row for outcome in of.rated for row in _outcome_rows(outcome)]
    return Picture("explanation_ratings", "Ratings of the explanations", caption, figure, rows)


def _outcome_rows(of: Outcome) -> Rows:
    return [
        {"outcome": of.key, "shown": name, "mean": mean.mean, "sd": mean.sd, "se": mean.se, "low": mean.low,
         "high": mean.high, "n": mean.n}
        for name, mean in of.means.items()
    ]  # fmt: skip


def power_picture(powers: Sequence[Power], assumed: Assumed, *, queried: bool = True) -> Picture:
    """Power against participants, one line per test. queried: whether the design asks preference queries."""
    tests = [rate.test for rate in powers[0].rates]
    cohorts = powers[0].rates[0].n if tests else 0
    with mpl.rc_context(STYLE):
        figure, (ax,) = blank(1, 5.4, 3.6)
        for k, test in enumerate(tests):
            rates = [rate for of in powers for rate in of.rates if rate.test == test]
            x = [of.participants for of in powers]
            colour = DATA[k % len(DATA)]
            ax.plot(x, [rate.rate for rate in rates], color=colour, marker=".", linewidth=1.4, label=test)
            ax.fill_between(
                x, [rate.low for rate in rates], [rate.high for rate in rates], color=colour, alpha=0.13, linewidth=0
            )
        ax.axhline(WANTED, color=SOFT, linewidth=0.7, linestyle=DOTTED)
        ax.set(xlabel="participants", ylabel="power", ylim=(0, 1.02))
        ax.set_title(f"Simulated: {cohorts} made-up studies of each number", loc="left", fontsize="medium")
        ax.yaxis.set_major_formatter(_percent)
        quiet(ax)
        _legend(figure, [ax], 2)
    compared = any("own against" in test for test in tests)
    own = f"the own policy is preferred in {100 * assumed.own:.0f} %" if compared else ""
    own += f" by the {100 * assumed.shown:.0f} % who are shown one" if compared and assumed.shown < 1 else ""
    ranked = any(test.startswith("tau, ") for test in tests)
    rated = (
        f"agreement of importance rankings is {assumed.tau:g}, with what is shown {assumed.tau + assumed.tau_gain:g}"
        if ranked
        else ""
    )
    under = f" under {name_in_words(assumed.condition)}" if assumed.condition else ""
    first = "it" if assumed.item else name_in_words(assumed.condition)
    assumptions = [  # what the design does not have is named by nothing
        rated,
        f"{name_in_words(assumed.item)} is rated {assumed.effect:g} standard deviations higher{under}"
        if assumed.item
        else "",
        f"{100 * assumed.first_choice:.0f} % rank {first} first for {name_in_words(assumed.ranking)}"
        if assumed.ranking and assumed.condition
        else "",
        f"the same query gets the same answer in {100 * assumed.consistency:.0f} %" if queried else "",
        own,
    ]
    caption = (
        f"Simulated: share of {cohorts} made-up studies in which the analysis finds what was assumed, with 95 % Wilson "
        f"intervals. Assumed: {'; '.join(filter(None, assumptions))}. Dotted line: {100 * WANTED:.0f} %."
    )
    return Picture("power", "Power against participants", caption, figure, [row for of in powers for row in of.rows()])


def _mean_row(mean: Mean) -> dict[str, object]:
    return {"people": mean.n, "mean": mean.mean, "sd": mean.sd, "se": mean.se, "low": mean.low, "high": mean.high}
