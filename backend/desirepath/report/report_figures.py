"""A study's findings in pictures like the thesis's figures 7.2 to 7.4, each beside a CSV with exactly what is drawn.

Importing this loads matplotlib, which is slow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from desirepath.analysis.tested import Mean, star_bounds
from desirepath.explain.pictures import Picture, Rows, blank, quiet
from desirepath.explain.scene_plots import DATA, INK, PAPER, SOFT, STYLE
from desirepath.report.analysis_plan import METRICS
from desirepath.report.choice_findings import Pair
from desirepath.report.explanation_figures import explanation_pictures
from desirepath.report.findings import Findings
from desirepath.report.item_tests import ItemResult
from desirepath.report.planned_design import Assumed
from desirepath.report.simulated_power import WANTED, Power

PLACES = ("#2f6a3d", "#a5cba5", "#e9e2d2")  # first, second, third place: the darker, the better


def pictures(found: Findings) -> list[Picture]:
    """All figures of the report that the data allow, in its order."""
    drawn = explanation_pictures(found.explained) if found.explained else []
    if found.items:
        drawn.append(items_picture(found))
    if found.rankings:
        drawn.append(ranking_picture(found))
    if found.between:
        drawn.append(agreement_picture(found))
    if any(any(of.n for of in metrics.values()) for metrics in found.disagreement.values()):
        drawn.append(disagreement_picture(found))
    if found.personalised:
        drawn.append(personalised_picture(found))
    return drawn


def labelled(name: str) -> str:
    """A key in words."""
    return name.replace("_", " ")


def pair_words(pair: Pair, between: str = " – ") -> str:
    """Two conditions in words."""
    return between.join(labelled(name) for name in pair)


def items_picture(found: Findings) -> Picture:
    """Figure 7.2: means and standard errors of every item per condition, brackets over pairs that differ."""
    columns = min(5, len(found.items))
    lines = math.ceil(len(found.items) / columns)
    with mpl.rc_context(STYLE):
        figure, axes = blank(columns, 1.55 * columns + 0.4, 2.1 * lines + 0.5, rows=lines)
        for ax, item in zip(axes, found.items, strict=False):
            _item(ax, item, found)
        for ends in {(one.item.lowest, one.item.points) for one in found.items}:
            alike = [
                ax for ax, one in zip(axes, found.items, strict=False) if (one.item.lowest, one.item.points) == ends
            ]
            _same_heights(alike)
        for ax in axes[len(found.items) :]:
            ax.set_visible(False)
        for ax in axes[::columns]:
            ax.set_ylabel("mean rating")
        handles = {label: handle for ax in axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
        figure.legend(
            handles.values(), handles.keys(), loc="outside lower center", ncols=min(4, len(handles)), frameon=False
        )
    rows: Rows = [
        {
            "item": item.item.key,
            "text": item.item.text,
            "reversed": item.item.reversed,
            "condition": name,
            **_mean_row(mean),
            "test": item.test.test,
            "of": item.test.about,
            "statistic": item.test.statistic,
            "p": item.test.p,
            "p_corrected": item.test.p_corrected,
        }
        for item in found.items
        for name, mean in item.means.items()
    ]
    where = "" if found.plan.pairs == "always" else ", in items where the conditions differ"
    over = "all items" if found.plan.pairs_over == "items" else "an item's pairs"
    marks = ", ".join(f"{'*' * (k + 1)} p ≤ {bound:g}" for k, bound in enumerate(star_bounds(found.plan.alpha)))
    caption = (
        "Mean ratings with standard errors over people. Brackets: conditions that differ, corrected over "
        f"{over}{where}; {marks}."
    )
    return Picture("items", "Questionnaire after each block", caption, figure, rows)


def _item(ax: Axes, item: ItemResult, found: Findings) -> None:
    heights = []
    lowest, top = item.item.lowest, item.item.points
    unit = (top - lowest) / 6  # of a scale from 1 to 7
    for k, (name, mean) in enumerate(item.means.items()):
        ax.bar(k, mean.mean - lowest, bottom=lowest, width=0.7, color=DATA[k % len(DATA)], label=labelled(name))
        ax.errorbar(k, mean.mean, yerr=mean.se, color=INK, linewidth=0.9, capsize=2)
        heights.append(mean.mean + mean.se)
    level = max(top, max(heights) + 0.3 * unit)
    pairs = [] if item.design.factorial else list(combinations(range(len(item.means)), 2))
    for (i, j), test in zip(pairs, item.tests if len(item.means) == 2 else item.pairs, strict=False):
        if test.significant(found.plan.alpha):
            ax.plot([i, i, j, j], [level, level + 0.12 * unit, level + 0.12 * unit, level], color=INK, linewidth=0.7)
            ax.text((i + j) / 2, level + 0.1 * unit, test.stars(found.plan.alpha), ha="center", va="bottom", fontsize=7)
            level += 0.6 * unit
    ax.set(title=labelled(item.item.key), xticks=[], ylim=(lowest, max(top, level) + 0.2 * unit))
    if item.item.type != "score":
        ax.set_yticks(range(round(lowest), top + 1))
    quiet(ax)


def _same_heights(axes: Sequence[Axes]) -> None:
    """One scale for all panels, so that equal bars mean equal numbers."""
    low, high = min(ax.get_ylim()[0] for ax in axes), max(ax.get_ylim()[1] for ax in axes)
    for ax in axes:
        ax.set_ylim(low, high)


def ranking_picture(found: Findings) -> Picture:
    """Figure 7.3: how many people put each condition first, second, third."""
    with mpl.rc_context(STYLE):
        figure, axes = blank(len(found.rankings), 2.4 * len(found.rankings) + 0.4, 2.6)
        for ax, ranking in zip(axes, found.rankings, strict=True):
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
            ax.set_xticks(range(len(shares)), [labelled(name).replace(" ", "\n") for name in ranking.places])
            ax.set(title=labelled(ranking.item.key), ylim=(0, 1))
            ax.yaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
            quiet(ax)
        axes[0].set_ylabel("share of people")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    rows: Rows = [
        {
            "ranking": ranking.item.key,
            "condition": name,
            "place": place + 1,
            "people": count,
            "share": count / ranking.test.n,
        }
        for ranking in found.rankings
        for name, counts in ranking.places.items()
        for place, count in enumerate(counts)
    ]
    caption = "Share of people who put each condition first, second, third; ties were not possible."
    return Picture("rankings", "Ranking of the conditions", caption, figure, rows)


def agreement_picture(found: Findings) -> Picture:
    """Table 7.2 as a figure: agreement between conditions, beside what people agree with themselves."""
    lines: list[tuple[str, str, Mean]] = [("between", pair_words(pair), of.share) for pair, of in found.between.items()]
    for name, of_condition in found.of_condition.items():
        for role, words in (("repeat", "asked again"), ("swap", "asked again, sides exchanged")):
            again = getattr(of_condition, role).share
            if again.n:
                lines.append(("within", f"{labelled(name)}, {words}", again))
    with mpl.rc_context(STYLE):
        figure, axes = blank(1, 5.2, 0.7 + 0.3 * len(lines))
        ax = axes[0]
        for k, (kind, _, mean) in enumerate(lines):
            colour = DATA[0] if kind == "between" else DATA[2]
            ax.errorbar(
                mean.mean, -k, xerr=[[mean.mean - mean.low], [mean.high - mean.mean]], fmt="o", color=colour,
                markersize=4, linewidth=1.2,
            )  # fmt: skip
        ax.axvline(0.5, color=SOFT, linewidth=0.7, linestyle=(0, (1, 2)))
        ax.set_yticks([-k for k in range(len(lines))], [words for _, words, _ in lines])
        lowest = min((mean.low for _, _, mean in lines if not math.isnan(mean.low)), default=1.0)
        ax.set(xlim=(min(0.4, lowest - 0.02), 1.0), xlabel="share of the same answers, mean over people")
        ax.xaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
        quiet(ax)
    rows: Rows = [{"kind": kind, "what": words, **_mean_row(mean)} for kind, words, mean in lines]
    caption = (
        "Share of a person's answers that are the same for the same queries, mean over people with 95 % "
        "intervals (Wilson's, over people). Dotted line: guessing. Agreement between conditions can hardly be higher "
        "than that of people with themselves within one."
    )
    return Picture("agreement", "Agreement between and within conditions", caption, figure, rows)


def disagreement_picture(found: Findings) -> Picture:
    """Figure 7.4: what changes in the preferred trajectory where a choice flips between conditions."""
    metrics = found.plan.metrics
    columns = min(3, len(metrics))
    lines = math.ceil(len(metrics) / columns)
    pairs = list(found.disagreement)
    with mpl.rc_context(STYLE):
        figure, axes = blank(columns, 2.3 * columns + 0.3, 1.9 * lines + 0.5, rows=lines)
        for letter, ax, metric in zip("abcdefghij", axes, metrics, strict=False):
            for k, pair in enumerate(pairs):
                of = found.disagreement[pair][metric]
                ax.bar(k, of.mean, width=0.7, color=DATA[k % len(DATA)], label=pair_words(pair, " → "))
                ax.errorbar(k, of.mean, yerr=of.se, color=INK, linewidth=0.9, capsize=2)
            ax.axhline(0, color=SOFT, linewidth=0.7)
            ax.set(title=f"{letter}  {METRICS[metric][0]}", xticks=[])
            quiet(ax)
        _same_heights(axes[: len(metrics)])
        for ax in axes[len(metrics) :]:
            ax.set_visible(False)
        for ax in axes[::columns]:
            ax.set_ylabel("change (z)")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(3, len(labels)), frameon=False)
    rows: Rows = [
        {"from": pair[0], "to": pair[1], "metric": metric, "unit": "z within person", **_mean_row(of)}
        for pair, metrics_of in found.disagreement.items()
        for metric, of in metrics_of.items()
    ]
    caption = (
        "Where a person chose differently under two conditions: the preferred trajectory under the second minus that "
        "under the first, z-scored over all trajectories shown to that person, averaged within people; mean and "
        "standard error over people. Descriptive, no test: what the two trajectories of a query differ in was made, "
        "not observed."
    )
    return Picture("disagreement", "Change of the preferred trajectory where choices differ", caption, figure, rows)


def personalised_picture(found: Findings) -> Picture:
    """How often the own policy was preferred."""
    words = {"base": "base policy", "neutral": "conditioned policy", "other": "another participant's"}
    with mpl.rc_context(STYLE):
        figure, axes = blank(1, 4.6, 0.7 + 0.35 * len(found.personalised))
        ax = axes[0]
        for k, one in enumerate(found.personalised):
            mean = one.share
            ax.errorbar(
                mean.mean, -k, xerr=[[mean.mean - mean.low], [mean.high - mean.mean]], fmt="o", color=DATA[0],
                markersize=4, linewidth=1.2,
            )  # fmt: skip
        ax.axvline(0.5, color=SOFT, linewidth=0.7, linestyle=(0, (1, 2)))
        ax.set_yticks(
            [-k for k in range(len(found.personalised))], [f"own, not {words[o.against]}" for o in found.personalised]
        )
        ax.set(xlim=(0, 1), ylim=(-len(found.personalised) + 0.5, 0.5), xlabel="share of a person's choices")
        ax.xaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
        quiet(ax)
    rows: Rows = [
        {"own_against": one.against, **_mean_row(one.share), "p": one.test.p, "p_corrected": one.test.p_corrected}
        for one in found.personalised
    ]
    caption = (
        "Blind comparisons: share of a person's choices that went to the own policy, mean and 95 % interval over "
        "people (Wilson's)."
    )
    return Picture("personalised", "The own policy against others", caption, figure, rows)


def power_picture(found: Sequence[Power], assumed: Assumed, *, queried: bool = True) -> Picture:
    """Power against participants, one line per test. queried: whether the design asks preference queries."""
    tests = [rate.test for rate in found[0].rates]
    cohorts = found[0].rates[0].n if tests else 0
    with mpl.rc_context(STYLE):
        figure, axes = blank(1, 5.4, 3.6)
        ax = axes[0]
        for k, test in enumerate(tests):
            rates = [rate for one in found for rate in one.rates if rate.test == test]
            x = [one.participants for one in found]
            colour = DATA[k % len(DATA)]
            ax.plot(x, [rate.rate for rate in rates], color=colour, marker=".", linewidth=1.4, label=test)
            ax.fill_between(
                x, [rate.low for rate in rates], [rate.high for rate in rates], color=colour, alpha=0.13, linewidth=0
            )
        ax.axhline(WANTED, color=SOFT, linewidth=0.7, linestyle=(0, (1, 2)))
        ax.set(xlabel="participants", ylabel="power", ylim=(0, 1.02))
        ax.set_title(f"Simulated: {cohorts} made-up studies of each number", loc="left", fontsize="medium")
        ax.yaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
        quiet(ax)
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    compared = any("own against" in test for test in tests)
    own = f"the own policy is preferred in {100 * assumed.own:.0f} %" if compared else ""
    own += f" by the {100 * assumed.shown:.0f} % who are shown one" if compared and assumed.shown < 1 else ""
    ranked = any(test.startswith("tau, ") for test in tests)
    rated = (
        f"agreement of importance rankings is {assumed.tau:g}, with what is shown {assumed.tau + assumed.tau_gain:g}"
        if ranked
        else ""
    )
    under = f" under {labelled(assumed.condition)}" if assumed.condition else ""
    first = "it" if assumed.item else labelled(assumed.condition)
    said = [  # what the design does not have is named by nothing
        rated,
        f"{labelled(assumed.item)} is rated {assumed.effect:g} standard deviations higher{under}"
        if assumed.item
        else "",
        f"{100 * assumed.first_choice:.0f} % rank {first} first for {labelled(assumed.ranking)}"
        if assumed.ranking and assumed.condition
        else "",
        f"the same query gets the same answer in {100 * assumed.consistency:.0f} %" if queried else "",
        own,
    ]
    caption = (
        f"Simulated: share of {cohorts} made-up studies in which the analysis finds what was assumed, with 95 % Wilson "
        f"intervals. Assumed: {'; '.join(filter(None, said))}. Dotted line: {100 * WANTED:.0f} %."
    )
    return Picture("power", "Power against participants", caption, figure, [row for one in found for row in one.rows()])


def _mean_row(mean: Mean) -> dict[str, object]:
    return {"people": mean.n, "mean": mean.mean, "sd": mean.sd, "se": mean.se, "low": mean.low, "high": mean.high}
