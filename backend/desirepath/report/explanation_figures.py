"""Figures 8.6 and 8.7 of a study's importance rankings, each beside a CSV with exactly what is drawn.

Importing this loads matplotlib, which is slow.
"""

from __future__ import annotations

import matplotlib as mpl

from desirepath.explain.pictures import Picture, Rows, blank, quiet
from desirepath.explain.scene_plots import DATA, INK, STYLE
from desirepath.report.explanation_findings import Explained, Outcome

AGREEMENT, RATED = "ranking_agreement", "explanation_ratings"


def explanation_pictures(of: Explained) -> list[Picture]:
    """Agreement per condition, and what was rated, where anything was."""
    drawn = [agreement_picture(of.agreement)]
    return [*drawn, rated_picture(of)] if of.rated else drawn


def agreement_picture(of: Outcome) -> Picture:
    """Figure 8.6: tau-b per condition, means and standard deviations over people."""
    with mpl.rc_context(STYLE):
        figure, (ax,) = blank(1, 0.9 * len(of.means) + 1.2, 2.8)
        for k, mean in enumerate(of.means.values()):
            ax.bar(k, mean.mean, width=0.7, color=DATA[k % len(DATA)])
            ax.errorbar(k, mean.mean, yerr=mean.sd, color=INK, linewidth=0.9, capsize=3)
        ax.axhline(0, color=INK, linewidth=0.6)
        ax.set_xticks(range(len(of.means)), [name.replace(" and ", " and\n") for name in of.means])
        ax.set(ylabel="Kendall's tau-b", xlabel="shown")
        quiet(ax)
    caption = (
        "Agreement of people's rankings with the objects' scores: Kendall's tau-b, means over people, bars one "
        "standard deviation. 0: no agreement; 1: the same order."
    )
    return Picture(AGREEMENT, "Agreement of rankings with scores", caption, figure, _rows(of))


def rated_picture(of: Explained) -> Picture:
    """Figure 8.7: awareness, trust, plausibility per condition, means and standard errors over people."""
    with mpl.rc_context(STYLE):
        figure, axes = blank(len(of.rated), 1.75 * len(of.rated) + 0.4, 2.9)
        for ax, one in zip(axes, of.rated, strict=True):
            for k, (name, mean) in enumerate(one.means.items()):
                height = mean.mean - one.lowest
                ax.bar(k, height, bottom=one.lowest, width=0.7, color=DATA[k % len(DATA)], label=name)
                ax.errorbar(k, mean.mean, yerr=mean.se, color=INK, linewidth=0.9, capsize=2)
            ax.set(title=one.key.replace("_", " "), xticks=[], ylim=(one.lowest, one.highest))
            quiet(ax)
        axes[0].set_ylabel("mean rating")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    caption = (
        "What was said after each block: means and standard errors over people, by what was shown; reversed items are "
        "inverted."
    )
    return Picture(
        RATED, "Ratings of the explanations", caption, figure, [row for one in of.rated for row in _rows(one)]
    )


def _rows(of: Outcome) -> Rows:
    return [
        {"outcome": of.key, "shown": name, "mean": mean.mean, "sd": mean.sd, "se": mean.se, "low": mean.low,
         "high": mean.high, "n": mean.n}
        for name, mean in of.means.items()
    ]  # fmt: skip
