"""Whether the declared analysis can be done: what it names is asked, about what is compared, often enough.

Checked when a protocol is written, not when a study of before is opened again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from desirepath.grammar.conditions import Ordered
from desirepath.grammar.error_words import meant
from desirepath.grammar.questionnaires import Questionnaire
from desirepath.grammar.source import Problem, Source
from desirepath.grammar.words import IN_HEADSET, VIEWS
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.study.kinds.comparison import ComparisonStage
from desirepath.study.kinds.rating import RatingStage
from desirepath.study.protocol.block import BlockStage
from desirepath.study.protocol.schema import Protocol

RATED = ("scale", "number")


def analysis_problems(
    protocol: Protocol, questionnaires: Mapping[str, Questionnaire], source: Source
) -> Iterator[Problem]:
    """What of the declared analysis cannot be done. questionnaires: those that could be read. Nothing without one."""
    plan = protocol.analysis
    if plan is None:
        return
    compared, asked = _compared(protocol), _asked(protocol)
    rated = _rated(protocol)
    several = [*compared, *(name for name, count in rated.items() if count > 1)]
    yield from _items(plan, several, [*asked, *rated], questionnaires, source)
    yield from _ranking(protocol, plan, asked, questionnaires, source)
    yield from _probes(protocol, plan, source)
    comparison = protocol.stage_of(ComparisonStage)
    margins = plan.equivalence
    if comparison is None and margins is not None and margins.share is not None:
        message = "is about choices for the own policy; add a comparison stage, or remove it"
        yield source.problem(("analysis", "equivalence", "share"), message)
    rankings = [name for name in asked if _has(questionnaires.get(name), ("ranking",))]
    if not several and not rankings and comparison is None and not _conditions(protocol):
        message = (
            "declares an analysis of a protocol that compares nothing: no two conditions, no ranking, no comparison of "
            "policies; add one of these, or remove 'analysis' (answers are described all the same)"
        )
        yield source.problem(("analysis",), message)


def _conditions(protocol: Protocol) -> set[str]:
    """Everything that trials or evaluations are compared by: names of conditions, where there are several."""
    names: set[str] = set()
    for entry in protocol.stages:
        stage = entry.stage
        if isinstance(stage, Ordered):
            alone = entry.kind if isinstance(stage, BlockStage) else ""  # ratings alone are compared with nothing
            names |= {
                condition.name or alone for group in range(len(stage.groups)) for condition in stage.conditions(group)
            }
    names.discard("")
    blocks = len(protocol.stages_of(BlockStage))
    return names if len(names) > 1 or blocks > 1 else set()


def _compared(protocol: Protocol) -> list[str]:
    """Questionnaires that are answered about several conditions, by everybody or by groups."""
    times: dict[str, int] = {}
    for entry in protocol.stages:
        stage = entry.stage
        if isinstance(stage, Ordered):
            count = sum(len(stage.conditions(group)) for group in range(len(stage.groups)))
            for name, _ in entry.stage.questionnaires():
                times[name] = times.get(name, 0) + count
    return [name for name, count in times.items() if count > 1]


def _rated(protocol: Protocol) -> dict[str, int]:
    """Stages in which trajectories are rated, by the key that answers carry, with their number of conditions."""
    return {
        key: sum(len(stage.conditions(group)) for group in range(len(stage.groups)))
        for key, stage in protocol.keyed_stages
        if isinstance(stage, RatingStage)
    }


def _asked(protocol: Protocol) -> list[str]:
    return list(dict.fromkeys(name for entry in protocol.stages for name, _ in entry.stage.questionnaires()))


def _has(questionnaire: Questionnaire | None, types: tuple[str, ...]) -> bool:
    return questionnaire is not None and any(item.type in types for item in questionnaire.items)


def _items(
    plan: AnalysisPlan,
    compared: list[str],
    asked: list[str],
    questionnaires: Mapping[str, Questionnaire],
    source: Source,
) -> Iterator[Problem]:
    name, here = plan.items, ("analysis", "items")
    if name is None:
        if plan.equivalence is not None and plan.equivalence.rating is not None and not compared:
            message = "is about ratings of several conditions, and nothing is rated or answered about several"
            yield source.problem(("analysis", "equivalence", "rating"), message)
        return
    if name not in asked:
        message = f"is not asked in this protocol; asked are {', '.join(asked) or 'none'}{meant(name, asked)}"
        yield source.problem(here, message)
    elif name not in compared:
        message = (
            "is answered about one condition only, so nothing is compared; ask it in a stage with several conditions"
        )
        yield source.problem(here, message + (f", or name one of {', '.join(compared)}" if compared else ""))
    elif name in questionnaires and not _has(questionnaires[name], RATED):
        yield source.problem(here, "has no item on a scale and no number, so it has no ratings to test")


def _ranking(
    protocol: Protocol,
    plan: AnalysisPlan,
    asked: list[str],
    questionnaires: Mapping[str, Questionnaire],
    source: Source,
) -> Iterator[Problem]:
    name, here = plan.ranking, ("analysis", "ranking")
    rankings = [name for name in asked if _has(questionnaires.get(name), ("ranking",))]
    if name is not None and name not in asked:
        message = f"is not asked in this protocol; rankings are {', '.join(rankings) or 'none'}{meant(name, asked)}"
        yield source.problem(here, message)
        return
    if name is not None and name in questionnaires and name not in rankings:
        yield source.problem(here, f"has no item of type ranking; rankings are {', '.join(rankings) or 'none'}")
        return
    blocks = protocol.stages_of(BlockStage)
    conditions = [condition for of in blocks for group in range(len(of.groups)) for condition in of.conditions(group)]
    shown = {condition.levels.get("view", condition.view) for condition in conditions}
    views = {*VIEWS, IN_HEADSET}
    between = {view for of in blocks for view in (of.one_of or {}).get("view", ())}
    for index, entry in enumerate(protocol.stages):
        for one, path in entry.stage.questionnaires():
            if one not in rankings or name not in (None, one):
                continue
            options = {o.value for item in questionnaires[one].items if item.type == "ranking" for o in item.options}
            at = ("stages", index, entry.kind, *path)
            if options and options <= views and (missing := sorted(options - shown)):
                message = f"ranks {', '.join(missing)}, which nobody is shown; shown are {', '.join(sorted(shown))}"
                yield source.problem(at, f"{message}; show it, or take it out of the ranking")
            elif options and options <= views and len(options & between) > 1:
                message = f"ranks {', '.join(sorted(options & between))}, of which everybody is shown one only (one_of)"
                yield source.problem(at, f"{message}; use 'each', or remove the ranking")


def _probes(protocol: Protocol, plan: AnalysisPlan, source: Source) -> Iterator[Problem]:
    """Fewer probes of a kind than count would be asked in vain."""
    for index, entry in enumerate(protocol.stages):
        for n, one in enumerate(entry.stage.trials if isinstance(entry.stage, BlockStage) else ()):
            for kind in ("repeat", "swap"):
                asked = getattr(one.queries.probes, kind)
                if 0 < asked < plan.min_probes:
                    at = ("stages", index, "block", "trials", n, "queries", "probes", kind)
                    message = (
                        f"is {asked}, fewer than analysis.min_probes = {plan.min_probes}, so that nobody's would count"
                    )
                    yield source.problem(at, f"{message}; ask more, or declare a smaller min_probes")
