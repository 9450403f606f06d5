"""What the page of all policies lists: a row per policy with its measured numbers, in groups that fold.

Numbers are those of its newest evaluation, else of its own card. Reads only; the route lives in `artefact_pages.py`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import Artefact, ArtefactParent, Study

GROUPINGS = ("setup", "kind", "study")
SORTS = ("name", "success", "distance", "time", "created")
PERSONAL = "personal"


@dataclass(frozen=True)
class PolicyRow:
    """success in [0, 1]; distance: to the person at the nearest (m); time: to the goal (s). of: what success was
    counted in, a key below `analyst.policies.of`."""

    artefact: Artefact
    success: float | None
    distance: float | None
    time: float | None
    of: str

    def key(self, sort: str) -> Any:
        """What a column is sorted by; None comes last."""
        artefact = self.artefact
        found = {
            "name": artefact.name.casefold(),
            "success": self.success,
            "distance": self.distance,
            "time": self.time,
            "created": artefact.created_at,
        }
        return found[sort]


@dataclass(frozen=True)
class PolicyGroup:
    """kind: what `name` is: a setup, a kind of policy, a study's id, or the policies made from answers (`PERSONAL`)."""

    kind: str
    name: str
    title: str
    folded: bool
    rows: list[PolicyRow]


def policy_groups(s: DatabaseSession, found: Iterable[Artefact], grouping: str, sort: str) -> list[PolicyGroup]:
    """Groups by what is asked, those of which there is most first, studies' policies last and folded; within each
    sorted, by `-KEY` downwards."""
    artefacts = list(found)
    evaluated = newest_evaluations(s, [one.id for one in artefacts])
    studies = {one: s.get(Study, one) for one in {one.study_id for one in artefacts if one.study_id}}
    groups: dict[tuple[bool, str, str], list[PolicyRow]] = {}
    for artefact in artefacts:
        personal = artefact.study_id is not None
        kind = PERSONAL if personal and grouping == "kind" else "study" if personal else grouping
        name = {"setup": artefact.setup, "kind": artefact.kind, "study": artefact.study_id, PERSONAL: PERSONAL}[kind]
        row = measured_row(artefact, evaluated.get(artefact.id))
        groups.setdefault((personal, kind, name or ""), []).append(row)
    made = []
    most = Counter(one.kind if grouping == "kind" else one.setup for one in artefacts)
    ordered = sorted(groups.items(), key=lambda one: (one[0][0], -most[one[0][2]], one[0][2]))
    for (personal, kind, name), rows in ordered:
        study = studies.get(name) if kind == "study" else None
        made.append(PolicyGroup(kind, name, study.name if study else name, personal, sorted_rows(rows, sort)))
    return made


def sorted_rows(rows: Iterable[PolicyRow], sort: str) -> list[PolicyRow]:
    """By the name where nothing, or nothing known, is asked."""
    column = sort.removeprefix("-")
    if column not in SORTS:
        column, sort = "name", "name"
    keyed = [(row.key(column), row) for row in rows]
    there = sorted((one for one in keyed if one[0] is not None), key=lambda one: one[0], reverse=sort.startswith("-"))
    return [row for _, row in there] + [row for key, row in keyed if key is None]


def newest_evaluations(s: DatabaseSession, ids: list[str]) -> dict[str, Artefact]:
    """Of each policy that was measured by itself."""
    made = (
        select(ArtefactParent.parent_id, Artefact)
        .join(Artefact, Artefact.id == ArtefactParent.artefact_id)
        .where(ArtefactParent.parent_id.in_(ids), Artefact.kind == "evaluation", Artefact.quarantined_at.is_(None))
        .order_by(Artefact.created_at)
    )
    return {parent: one for parent, one in s.execute(made) if "success_rate" in one.card.get("results", {})}


def find_measured(artefact: Artefact) -> dict[str, Any] | None:
    """The numbers on an artefact's card that an evaluation measured: its own results, or on shipped cards the first."""
    results: dict[str, Any] = artefact.card.get("results", {})
    for numbers in (results, results.get("first", {})):
        if "success_rate" in numbers:
            return numbers
    return None


def measured_row(artefact: Artefact, evaluation: Artefact | None) -> PolicyRow:
    """Its numbers, from whichever card has them."""
    numbers = evaluation.card["results"] if evaluation else find_measured(artefact)
    if numbers:
        n = "evaluation" if evaluation else "card"
        return PolicyRow(artefact, numbers["success_rate"], _nearest(numbers), numbers.get("time_s"), n)
    results: Mapping[str, Any] = artefact.card.get("results", {})
    neutral = (results.get("told") or {}).get("neutral") if isinstance(results.get("told"), Mapping) else None
    if neutral:  # conditioned, told nothing
        where = neutral.get("measures_where_successful", {})
        return PolicyRow(artefact, neutral["success_rate"]["value"], _nearest(where), where.get("time_s"), "neutral")
    if results.get("gate"):
        return PolicyRow(artefact, results["gate"]["success_rate"], None, None, "gate")
    shares = results.get("policy") if isinstance(results.get("policy"), Mapping) else results
    if shares and "success" in shares:  # in per cent: chapters 4 and 5
        nearest = shares.get("human_m") or _nearest(shares)
        return PolicyRow(artefact, shares["success"] / 100, nearest, shares.get("time_s"), "card")
    return PolicyRow(artefact, results.get("selection_success"), None, None, "selection")


def _nearest(numbers: Mapping[str, Any]) -> float | None:
    return numbers.get("min_human_distance_m")
