"""Power before recruiting: bots walk a planned study through the real state machine, and simulated cohorts tell how
often the real analysis finds what was assumed.

The bots show that the study runs and that its tables hold what they answered; then only the answers matter, which the
cohorts of `report/simulated_power.py` give alike, and hundreds of cohorts cost no walk.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings, analyse
from desirepath.report.planned_design import Assumed, PlannedDesign, RankedDesign, plan_factors
from desirepath.report.simulated_cohorts import Cohort
from desirepath.report.simulated_power import Power, enough, power
from desirepath.report.study_data import StudyData
from desirepath.report.tidy_tables import read_study
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.study.kinds.comparison import ComparisonStage
from desirepath.study.protocol.freezing import FrozenProtocol
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study


class PowerError(ValueError):
    """Something a power analysis of this study cannot be asked; names the field and what would work."""


@dataclass(frozen=True)
class PlannedPower:
    """What was found. walked: bots in the real state machine, and what they left."""

    design: PlannedDesign
    assumed: Assumed
    plan: AnalysisPlan
    walked: dict[str, Any]
    power: Sequence[Power]

    def as_dict(self) -> dict[str, Any]:
        return {
            "simulated": True,
            "assumed": asdict(self.assumed),
            "design": asdict(self.design),
            "plan": self.plan.model_dump(mode="json"),
            "walked": self.walked,
            "enough_for_80_percent": enough(self.power),
            "rows": [row for power in self.power for row in power.rows()],
        }


def plan_power(
    frozen: FrozenProtocol,
    participants: Sequence[int],
    assumed: Assumed,
    *,
    walk: int = 6,
    cohorts: int = 500,
    tell: Callable[[str], None] = lambda words: None,
) -> PlannedPower:
    """Power of the protocol's declared analysis for each number of participants.

    walk: bots that go through the state machine. Raises PowerError, CohortError, and SimulationError if one cannot
    finish.
    """
    if not participants or min(participants) < 3:
        raise PowerError(f"participants = {list(participants)}: at least one number, each at least 3")
    if walk < 3:
        raise PowerError(f"walk = {walk}: at least 3 bots, so that their answers can be tested")
    plan = frozen.protocol.analysis or AnalysisPlan()
    # what conditions, items and rankings there are, only a session tells
    base = Cohort(steady=assumed.consistency, seed=assumed.seed)
    tell(f"{walk} bots walk through the study")
    data, findings, walked = _walk(frozen, base, walk)
    design = measure_design(data, findings, frozen)
    _check_same(design, base, data)
    assumed = replace(
        assumed,
        condition=_require_known("condition", assumed.condition, design.places, len(design.conditions) - 1),
        item=_require_known("item", assumed.item, design.items, 0),
        ranking=_require_known("ranking", assumed.ranking, design.rankings, 0),
        seed=assumed.seed + 1,
    )
    results = power(design, assumed, participants, cohorts=cohorts, plan=plan, tell=tell)
    return PlannedPower(design, assumed, plan, walked, results)


def _walk(frozen: FrozenProtocol, cohort: Cohort, walk: int) -> tuple[StudyData, Findings, dict[str, Any]]:
    """Bots through the machine in an installation that is gone afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        database = Database(f"sqlite:///{Path(folder) / 'power.sqlite'}")
        try:
            database.migrate()
            files = ArtefactStore((Path(folder) / "artefacts").as_uri())
            with database.transaction() as s:
                study = create_study(s, files, frozen, name="Power", created_by=None)
            outcome = walk_in_process(database, files, study, walk, Character(cohort=cohort), without_jobs=True)
            with database.session() as s:
                data, load = read_study(s, files, study)
            findings = analyse(data, load, "simulated", AnalysisPlan(sessions="all"), intervals=False)
        finally:
            database.close()
    return data, findings, {name: outcome[name] for name in ("participants", "completed", "responses")}


def measure_design(data: StudyData, findings: Findings, frozen: FrozenProtocol) -> PlannedDesign:
    """What a walked study asked: its factors, items and scales rated under each condition, rankings, queries,
    comparisons. Of several comparisons the first that something is rated in."""
    comparison = frozen.protocol.stage_of(ComparisonStage)
    design = next(
        (design_found for design_found in findings.designs if any(of.design is design_found for of in findings.items)),
        None,
    )
    items = [item.item.key for item in findings.items if item.design is design]
    return PlannedDesign(
        **(plan_factors(design) if design else {}),
        conditions=tuple(sorted(design.cells if design else findings.conditions)),
        items=tuple(items),
        scales=tuple(scale for _, scale in data.scales if scale.name in items),
        rankings=tuple(ranking.item.key for ranking in findings.rankings),
        queries=round(
            sum(choice.role == "regular" for choice in data.choices)
            / max(1, len({(choice.person, choice.condition) for choice in data.choices}))
        ),
        comparisons=comparison.scenes if comparison is not None else 0,
        opponents=comparison.opponents if comparison is not None else (),
        ranked=_ranked_design(findings),
    )


def _ranked_design(findings: Findings) -> RankedDesign:
    """What was ranked by importance, if anything, as everybody met it."""
    if findings.explained is None or not findings.explained.factors:
        return RankedDesign()
    each = {(trial.of.person, trial.of.condition) for trial in findings.explained.trials}
    return RankedDesign(tuple(findings.explained.factors), round(len(findings.explained.trials) / len(each)))


def _check_same(design: PlannedDesign, cohort: Cohort, data: StudyData) -> None:
    """The state machine must have stored what the cohorts assume it does."""
    simulated = design.study(cohort, len(data.people), 0)
    scored = {item.key for scale in design.scales for item in scale.items}
    simulated_items = {(rating.item, rating.condition) for rating in simulated.ratings if rating.item not in scored}
    if design.between:
        return  # who is in which group the cohorts decide for themselves

    def answers_of(of: StudyData) -> dict[tuple[str, str | None, str], Any]:
        return {
            (r.person, r.condition, r.item): r.value for r in of.ratings if (r.item, r.condition) in simulated_items
        }

    stored, expected = answers_of(data), answers_of(simulated)
    if stored != expected:
        raise PowerError("the state machine stored other ratings than the bots gave; this is a bug, please report it")


def _require_known(name: str, wanted: str, known: Sequence[str], default: int) -> str:
    if wanted and wanted not in known:
        raise PowerError(f"{name} = {wanted!r}: this study has {', '.join(known) or 'none'}")
    return wanted or (known[default] if known else "")
