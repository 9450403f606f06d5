"""Policies that were measured in the same scenes, many at once: what the page of comparisons opens with.

Numbers are those of evaluations, of comparisons and of cards; they stand together only where setup, number and seed of
the scenes are the same. Measuring is a job's; the figure is drawn by `svg_figures.py`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.artefact_upkeep import is_offered
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.models import Artefact
from desirepath.store.shipped_policies import find_artefact
from desirepath.web.analyst.artefact_pages import artefact_href, is_comparison
from desirepath.web.analyst.policy_rows import find_measured
from desirepath.web.core import svg_figures
from desirepath.web.core.artefact_names import artefact_name
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.permits import seen_artefacts
from desirepath.web.core.roles import Rights

RATES = ("success_rate", "collision_rate", "timeout_rate")
MAIN = ("success_rate", "min_human_distance_m", "path_length_m", "time_s", "mean_speed_m_s", "min_obstacle_distance_m")
"""Measures that are drawn at first, ours: what people ask of a robot beside them."""
FIRST_SETUP, FIRST_SORT = "study_room", "-min_human_distance_m"
MOST_COMPARISONS = 100  # newest ones, whose files are read

Value = tuple[float, float, float]


@dataclass(frozen=True)
class Measured:
    """One policy. name: with its weights; values: (value, low, high) by measure."""

    policy: Artefact
    name: str
    values: Mapping[str, Value]


@dataclass(frozen=True)
class SameScenes:
    """Policies that were measured in the same scenes of a setup."""

    setup: str
    scenes: int
    seed: int
    policies: tuple[Measured, ...]

    @property
    def key(self) -> str:
        """How an address names it."""
        return f"{self.setup}/{self.scenes}/{self.seed}"

    @property
    def measures(self) -> list[str]:
        """Those that all have."""
        first, *others = self.policies
        return [name for name in first.values if all(name in one.values for one in others)]

    def ordered(self, by: str) -> list[Measured]:
        """by: a measure, with `-` before it the most first. Raises KeyError for one that not all have."""
        return sorted(self.policies, key=lambda one: one.values[by.lstrip("-")][0], reverse=by.startswith("-"))


def find_measured_together(
    s: DatabaseSession, files: ArtefactStore, rights: Rights, known: Sequence[str]
) -> list[SameScenes]:
    """The most policies first. known: names of measures that can be shown."""
    groups: dict[tuple[str, int, int], dict[tuple[str, str], Measured]] = {}
    for policy, name, numbers, seed in _measurements(s, files, rights):
        found = {
            measure: (float(numbers[measure]), *(float(bound) for bound in numbers["intervals"][measure]))
            for measure in known
            if measure in numbers and measure in numbers.get("intervals", {})
        }
        if found and policy.setup and "n" in numbers:
            rows = groups.setdefault((policy.setup, int(numbers["n"]), seed), {})
            rows.setdefault((policy.id, name), Measured(policy, name, found))  # type: ignore[arg-type]  # three each
    together = [SameScenes(*key, tuple(rows.values())) for key, rows in groups.items()]
    return sorted(together, key=lambda one: (-len(one.policies), one.setup != FIRST_SETUP))


def _measurements(
    s: DatabaseSession, files: ArtefactStore, rights: Rights
) -> Iterator[tuple[Artefact, str, dict[str, Any], int]]:
    """(policy, name, numbers, seed of the scenes) of every measurement that there is, the newest first."""

    def seen(kind: Any) -> list[Artefact]:
        rows = select(Artefact).where(kind, is_offered(), seen_artefacts(rights))
        return list(s.scalars(rows.order_by(Artefact.created_at.desc())))

    policies = {one.id: one for one in seen(Artefact.kind.like("%policy"))}
    read = 0
    for made in seen(Artefact.kind == "evaluation"):
        config = made.card.get("config", {})
        if is_comparison(made):
            read += 1
            for one in _compared(files, made.id) if read <= MOST_COMPARISONS else ():
                if one["id"] in policies:
                    yield policies[one["id"]], one["name"], one["measured"], int(config.get("seed", 0))
        elif (numbers := find_measured(made)) is not None:
            policy = find_artefact(s, str(config.get("policy", "")))
            if policy is not None and policy.id in policies:
                yield policy, policy.name, numbers, int(config.get("seed", 0))
    for policy in policies.values():
        if (numbers := find_measured(policy)) is not None and "seed" in numbers:
            yield policy, policy.name, numbers, int(numbers["seed"])


@lru_cache(maxsize=MOST_COMPARISONS)
def _compared(files: ArtefactStore, comparison: str) -> list[dict[str, Any]]:
    return [
        {name: policy[name] for name in ("id", "name", "measured")}
        for policy in json.loads(files.get(comparison))["policies"]
    ]


def distinct_names(names: Sequence[str]) -> list[str]:
    """The names without those parts, between commas and colons, that another one has, too."""
    parts = [[part for first in name.split(", ") for part in first.split(": ")] for name in names]
    alone = [[part for part in own if sum(part in other for other in parts) == 1] for own in parts]
    return [", ".join(kept) or name for kept, name in zip(alone, names, strict=True)]


def draw_together(
    t: Catalogue, together: SameScenes, measures: Sequence[str], digits: Mapping[str, int], sort: str, here: str | None
) -> str:
    """The figure. here: the page's address up to the value of `sort`, where names lead on; None: they do not."""
    ordered = together.ordered(sort)
    names = [artefact_name(one.name, t) for one in ordered]

    def write(measure: str) -> svg_figures.Number:
        if measure not in RATES:
            return svg_figures.exact(t.number)
        return lambda share: t.percent(share, 0 if abs(share * 100 - round(share * 100)) < 1e-6 else 1)

    def tell(measure: str, values: Value) -> str:
        value, low, high = (t.percent(one, 1) if measure in RATES else t.number(one, digits[measure]) for one in values)
        return f"{t(f'analyst.metrics.{measure}')}: {value} {t.interval(low, high)}"

    def panel(measure: str) -> svg_figures.Panel:
        name = t(f"analyst.metrics.{measure}")
        link = (
            (f"{here}{'' if sort == f'-{measure}' else '-'}{measure}", t("analyst.many.sort", measure=name))
            if here
            else None
        )
        return svg_figures.Panel(name, write(measure), link, sorted=sort.lstrip("-") == measure)

    rows = [
        svg_figures.PanelRow(
            short,
            "\n".join([name, *(tell(measure, one.values[measure]) for measure in measures)]),
            [one.values[measure] for measure in measures],
            artefact_href(one.policy) if here else None,
            hollow=one.policy.simulated,
        )
        for one, name, short in zip(ordered, names, distinct_names(names), strict=True)
    ]
    title = t("analyst.many.title", count=len(rows), setup=together.setup)
    return svg_figures.small_multiples(rows, [panel(measure) for measure in measures], title=title)
