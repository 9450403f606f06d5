"""What became of the rules that people told, in numbers and words: understood as meant, obeyed, changed. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from desirepath.analysis.intervals import end_at_scale
from desirepath.analysis.tested import Mean, mean_of
from desirepath.explain.printed import Section
from desirepath.learning.rules.rule import Rule, acted_on
from desirepath.report.report_cells import means_section
from desirepath.report.study_data import ToldRules


@dataclass(frozen=True)
class OfRules:
    """Over people. told: rules of a person; as_read: share that stand as their sentence was read; as_meant: of the
    rules that were shown obeyed and broken, the share whose obeyed picture was picked; obeyed: share of the steps in
    which a rule holds, arrived: share of the drives that reach their goal (rolled out in the step's homes: who stands
    still or collides obeys a zone, too); edits: changes after telling."""

    people: int
    told: Mean
    as_read: Mean
    as_meant: Mean
    obeyed: Mean
    arrived: Mean
    edits: Mean


def summarise_rules(told: Sequence[ToldRules]) -> OfRules | None:
    """None where nobody told any."""
    some = [one for one in told if one.rules]
    if not some:
        return None
    picked = [[shown == "obeyed" for shown in one.picked] for one in some if one.picked]
    driven = [_obeyed(acted_on(one.rules), one.places) for one in some]
    return OfRules(
        people=len(some),
        told=mean_of([len(one.rules) for one in some]),
        as_read=end_at_scale(mean_of([sum(one.read) / len(one.read) for one in some]), 0.0, 1.0),
        as_meant=end_at_scale(mean_of([sum(of) / len(of) for of in picked]), 0.0, 1.0),
        obeyed=end_at_scale(mean_of([share for share, _ in driven if share is not None]), 0.0, 1.0),
        arrived=end_at_scale(mean_of([share for _, share in driven]), 0.0, 1.0),
        edits=mean_of([one.edits for one in some]),
    )


@lru_cache(maxsize=1024)
def _obeyed(rules: tuple[Rule, ...], places: int) -> tuple[float | None, float]:
    """(mean over the rules that held there at some time, None where none did; share of the drives that arrived)."""
    from desirepath.learning.rules.homes import rule_places  # numba comes with it
    from desirepath.learning.rules.obedience import drive_by, obeyed_steps
    from desirepath.simulation.trajectory import arrived

    shares, drives = [], []
    for place, scene in enumerate(rule_places()[:places]):
        trajectory = drive_by(rules, [scene], [place])[0]
        drives.append(trajectory)
        counted = [obeyed_steps(rule, trajectory, place) for rule in rules]
        shares += [obeyed / held for held, obeyed in counted if held]
    return sum(shares) / len(shares) if shares else None, float(arrived(drives).mean())


def rules_section(of: OfRules | None) -> Section:
    """Empty where nobody told rules."""
    title = "Rules that were told"
    if of is None:
        return Section(title)
    means = {
        "rules told": (of.told, "{:.1f}"),
        "share that stand as their sentence was read": (of.as_read, "{:.2f}"),
        "understood as meant: share whose obeyed picture was picked": (of.as_meant, "{:.2f}"),
        "obeyed: share of the steps in which a rule holds": (of.obeyed, "{:.2f}"),
        "arrived: share of the homes in which their robot reaches its goal": (of.arrived, "{:.2f}"),
        "changes after telling": (of.edits, "{:.1f}"),
    }
    return means_section(
        title,
        "Means over people with 95 % intervals.",
        means,
        f"{of.people} people told rules. Whether a rule is obeyed is found by rolling their robot out in the homes "
        "that they saw; what counts as obeyed is declared in learning/rules/obedience.py.",
    )
