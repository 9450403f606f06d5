"""What a protocol's keys must be together: the order of stages, counts that fit, references that lead somewhere."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from desirepath.grammar import source as yaml_source
from desirepath.grammar.conditions import Crossed
from desirepath.grammar.error_words import meant
from desirepath.grammar.questionnaires import Questionnaire
from desirepath.grammar.skipping import problems_with
from desirepath.grammar.source import Path, Problem, Source
from desirepath.grammar.when import ItemWhen, When
from desirepath.simulation.setups import setup_folders, setups_with
from desirepath.study.kinds.comparison import ComparisonStage
from desirepath.study.kinds.comprehension import ComprehensionStage
from desirepath.study.kinds.consent import ConsentStage
from desirepath.study.kinds.feedback import Feedback
from desirepath.study.kinds.live import LiveStage, crowd_setups
from desirepath.study.kinds.order import OrderStage
from desirepath.study.kinds.wait import EACH_SCENE, TrainStage
from desirepath.study.plan.asked_queries import Needs
from desirepath.study.plan.counterbalancing import design_of
from desirepath.study.protocol.schema import Protocol
from desirepath.study.protocol.stages import STAGES, stage_keys

NOT_IN_HEADSETS = ("words", "rules")
"""Stages that are seen from inside and answered by what no headset has: a keyboard."""


def problems_across(
    protocol: Protocol, questionnaires: Mapping[str, Questionnaire], source: Source
) -> Iterator[Problem]:
    """Everything that no single key can know. questionnaires: those that could be read."""
    yield from _order(protocol, source)
    for index, entry in enumerate(protocol.stages):
        yield from entry.stage.problems(("stages", index, entry.kind), protocol.all_stages, source)
    yield from _headset(protocol, source)
    yield from _conditions(protocol, source)
    yield from _references(protocol, questionnaires, source)
    yield from _checks(protocol, questionnaires, source)


def order_problems(protocol: Protocol, source: Source) -> Iterator[Problem]:
    """Orders of a shipped query set whose setup has no policy that drives in other ways; of any other set opening a
    study says so."""
    asked_in, driven = (protocol.query_set or "").partition("/")[0], setups_with("conditioned")
    if asked_in in driven or asked_in not in setup_folders():
        return
    for index, entry in enumerate(protocol.stages):
        below = ("orders",) if getattr(entry.stage, "orders", ()) else ()
        if below or isinstance(entry.stage, OrderStage):
            message = f"needs a query set of a setup with a conditioned policy: {', '.join(driven)}"
            yield source.problem(("stages", index, entry.kind, *below), message)


def _headset(protocol: Protocol, source: Source) -> Iterator[Problem]:
    """A headset shows the room from inside; where nobody is shown that, there is nothing to see with it."""
    asked = protocol.asked_of_devices.headset
    for index, entry in enumerate(protocol.stages):
        if isinstance(entry.stage, Crossed) and entry.stage.in_headset and asked != "required":
            message = "has the view headset, which needs device: {headset: required}"
            yield source.problem(("stages", index, entry.kind), message)
    if asked and not any("immersive" in stage.views for stage in protocol.all_stages):
        yield source.problem(("device", "headset"), f"is {asked}, but no stage has the view immersive")
    for index, entry in enumerate(protocol.stages):
        if asked == "required" and "immersive" in entry.stage.views and entry.kind in NOT_IN_HEADSETS:
            told = "cannot be answered in a headset, which the study requires; give it another view"
            yield source.problem(("stages", index, entry.kind), told)


def _order(protocol: Protocol, source: Source) -> Iterator[Problem]:
    """What the order of stages must be, so that nobody is asked before they have consented, or shown nothing."""
    kinds = [entry.kind for entry in protocol.stages]

    def at(index: int, message: str) -> Problem:
        return source.problem(("stages", index, kinds[index]), message)

    def first(kind: str) -> int:
        return kinds.index(kind) if kind in kinds else len(kinds)

    if "consent" not in kinds:
        yield source.problem(("stages",), "needs a consent stage before anything is asked")
    if kinds[-1] != "debriefing" or kinds.count("debriefing") != 1:
        yield source.problem(("stages",), "must end with its one debriefing stage")
    for once in dict.fromkeys(entry.kind for entry in protocol.stages if entry.stage.once):
        if kinds.count(once) > 1:
            again = len(kinds) - 1 - kinds[::-1].index(once)
            yield at(again, f"stands {kinds.count(once)} times; a protocol has at most one {once} stage")
    for index, kind in enumerate(kinds):
        if protocol.stages[index].stage.asks and index < first("consent") < len(kinds):
            yield at(index, "stands before the consent stage; nothing may be asked before it")
        if kind == "appointment" and index < first("consent"):
            yield at(index, "stands before the consent stage; nobody can be asked to come back before they consented")
        if kind == "appointment" and kinds[index + 1 : index + 2] in (["appointment"], ["debriefing"]):
            yield at(index, f"is followed by {kinds[index + 1]}; the next appointment needs something to do")
        elif kind == "appointment" and not _met_by_everybody(protocol, index + 1):
            yield at(index, "is followed by stages with 'when' only; the next appointment needs one for everybody")
    if not any(entry.stage.teaches or entry.stage.measures for entry in protocol.stages):
        asking = " or ".join(kind for kind, stage in STAGES.items() if stage.teaches or stage.measures)
        yield source.problem(("stages",), f"needs at least one {asking} stage; there is nothing to judge or to show")
    if protocol.needs != Needs() and protocol.query_set is None:
        yield source.problem(("query_set",), "is needed: it is what the trajectories that are shown are drawn from")
    if "evaluation" in kinds:
        if first("evaluation") < first("train") or "demonstrations" not in kinds:
            yield at(first("evaluation"), "needs demonstrations and a train stage before it: it shows what was learned")
        if kinds[first("evaluation") - 1] == "appointment":
            yield at(first("evaluation"), "needs a page before it, so that the new appointment begins with words")
    learning = protocol.stage_of(TrainStage)
    if learning is not None:
        taught_by = [kind for kind, stage in STAGES.items() if stage.teaches == learning.job]
        if first("train") < min(map(first, taught_by)):
            message = (
                f"stands before any {' or '.join(taught_by)}; there is nothing to learn from yet for job {learning.job}"
            )
            yield at(first("train"), message)
        if learning.job == "demonstrations":
            for index, entry in enumerate(protocol.stages):
                if getattr(entry.stage, "at_once", False) and entry.stage.teaches == "demonstrations":
                    yield at(index, "paths count at once here, which no controller learns from: train on own_answers")
        at_prior = ("stages", first("train"), "train", "prior")
        if learning.prior == "earlier_participants":
            yield from _earlier(protocol, learning, at_prior, source)
        elif learning.prior == "people_in_general" and learning.job != "align":
            yield source.problem(at_prior, "needs job align: nothing of it is about paths")
        elif learning.prior == "people_in_general" and (protocol.query_set or "").partition("/")[0] in crowd_setups():
            yield source.problem(at_prior, "needs a query set with one person: raters were not asked about crowds")
        own = kinds[: first("train")].count("appointment")
        for index, kind in enumerate(kinds):
            if kind in (*taught_by, "comparison") and kinds[:index].count("appointment") != own:
                yield at(index, "stands in another appointment than train, which learns from and shows its own only")
        compared = protocol.stage_of(ComparisonStage)
        if compared is not None:
            at_comparison = ("stages", first("comparison"), "comparison")
            yield from _arms(compared, learning, at_comparison, source)
            if "population" in compared.arms:
                yield from _earlier(protocol, learning, (*at_comparison, "arms"), source)
    if "comparison" in kinds and first("comparison") < first("train"):
        yield at(first("comparison"), "needs a train stage before it that makes the participant's own policy")
    asked_in, taught = (protocol.query_set or "").partition("/")[0], setups_with("conditioned")
    chooses = learning is not None and learning.recipe == EACH_SCENE
    if chooses and asked_in in taught and asked_in not in setups_with("policy_library"):
        message = f"needs a query set of a setup with a policy library: {', '.join(setups_with('policy_library'))}"
        yield source.problem(("stages", first("train"), "train", "recipe"), message)
    for index, entry in enumerate(protocol.stages):
        live = entry.stage
        learned = isinstance(live, LiveStage) and getattr(live, "start", "learned") == "learned"
        if isinstance(live, LiveStage) and learned and asked_in in taught and live.setup != asked_in:
            here = ("stages", index, entry.kind, "setup")
            yield source.problem(here, f"must be {asked_in}, as the query set's, whose answers it shows")
        shown = getattr(live, "feedback", None)
        if isinstance(shown, Feedback) and asked_in in taught and shown.setup != asked_in:
            here = ("stages", index, entry.kind, "feedback", "setup")
            yield source.problem(here, f"must be {asked_in}, as the query set's, whose answers it shows")
    for index, entry in enumerate(protocol.stages):
        if entry.when is not None and entry.stage.for_everybody:
            yield source.problem(("stages", index, "when"), f"cannot stand beside {entry.kind}, which everybody meets")


def _earlier(protocol: Protocol, learning: TrainStage, here: Path, source: Source) -> Iterator[Problem]:
    """Where nobody who took part before can be learned from."""
    consent = protocol.stage_of(ConsentStage)
    if learning.job != "align":
        yield source.problem(here, "needs job align: nothing is learned from others' paths")
    elif consent is None or "training" not in consent.purposes:
        yield source.problem(
            here, "needs the purpose 'training' in the consent stage: only who agrees to it is learned from"
        )


def _arms(compared: ComparisonStage, learning: TrainStage, here: Path, source: Source) -> Iterator[Problem]:
    """Opponents that there cannot be after that training."""
    if (learning.job == "align") == ("dwa" in compared.arms):
        arms = "own with some of base, neutral, population and other" if learning.job == "align" else "[dwa, own]"
        yield source.problem((*here, "arms"), f"must be {arms} after a train stage with job {learning.job}")
    elif learning.recipe != "instant" and ("neutral" in compared.arms or compared.stand_ins):
        what = "arms" if "neutral" in compared.arms else "stand_ins"
        message = "needs recipe instant: it is the conditioned policy, and the own one would be of another kind"
        yield source.problem((*here, what), message)
    elif "population" in compared.arms and learning.recipe != EACH_SCENE:
        yield source.problem((*here, "arms"), f"population needs recipe {EACH_SCENE}: it is a choice per scene, too")
    elif compared.stand_ins and "other" not in compared.arms:
        yield source.problem((*here, "stand_ins"), "lend policies of others; add other to the arms, or remove it")


def _met_by_everybody(protocol: Protocol, begins: int) -> bool:
    """Whether the appointment whose stages begin there has one without `when`."""
    for entry in protocol.stages[begins:]:
        if entry.kind in ("appointment", "debriefing"):
            return False
        if entry.when is None:
            return True
    return False


def _conditions(protocol: Protocol, source: Source) -> Iterator[Problem]:
    scheme = protocol.assignment.scheme
    try:
        design = design_of(protocol)
    except ValueError as wrong:
        yield source.problem(("assignment", "scheme"), str(wrong))
        return
    if scheme != "random" and not design.blocks:
        yield source.problem(
            ("assignment", "scheme"),
            "needs a block with 'each' or 'one_of', or an evaluation; otherwise there is no order",
        )
    names = [
        {condition.name for group in range(len(block.groups)) for condition in block.conditions(group)}
        for block in design.blocks.values()
    ]
    for n, one in enumerate(names):
        if any(one & other for other in names[:n]):
            index = stage_keys(protocol.stages).index(list(design.blocks)[n])
            message = f"has conditions called as those of another block: {', '.join(sorted(one))}; add a factor"
            yield source.problem(("stages", index, protocol.stages[index].kind), message)


def _references(protocol: Protocol, questionnaires: Mapping[str, Questionnaire], source: Source) -> Iterator[Problem]:
    """`when` and quotas must name an item that was asked, and an answer that it can have."""
    asked: dict[str, int] = {}
    for index, entry in enumerate(protocol.stages):
        if entry.when is not None:
            here: yaml_source.Path = ("stages", index, "when")
            if asked.get(entry.when.questionnaire, index) >= index:
                message = "is not asked before this stage" + meant(entry.when.questionnaire, list(asked))
                yield source.problem((*here, "questionnaire"), message)
            else:
                yield from _answers(entry.when, questionnaires, here, source)
        for name, path in entry.stage.questionnaires():
            used = questionnaires[name].items if name in questionnaires else []
            at = ("stages", index, entry.kind, *path)
            seen: list[ItemWhen] = []  # the items of a screen share its condition
            for one in [one for item in used for one in item.when if one.questionnaire not in (None, name)]:
                if one in seen:
                    continue
                seen.append(one)
                about = When.model_validate(one.model_dump(by_alias=True))
                if asked.get(about.questionnaire, index) >= index:
                    message = (
                        f"has an item with 'when' about {about.questionnaire}, which is not asked before this stage"
                    )
                    yield source.problem(at, message + meant(about.questionnaire, list(asked)))
                else:
                    yield from _answers(about, questionnaires, at, source)
        for name, _ in entry.stage.questionnaires():
            asked.setdefault(name, index)
    for q, quota in enumerate(protocol.quotas):
        if quota.questionnaire not in asked:
            message = f"is not asked in this protocol; asked are {', '.join(asked) or 'none'}"
            yield source.problem(("quotas", q, "questionnaire"), message)
        else:
            wanted = When.model_validate({"questionnaire": quota.questionnaire, "item": quota.item, "is": quota.is_})
            yield from _answers(wanted, questionnaires, ("quotas", q), source)


def _answers(
    when: When, questionnaires: Mapping[str, Questionnaire], here: yaml_source.Path, source: Source
) -> Iterator[Problem]:
    if when.questionnaire in questionnaires:  # one that could not be read is an error of its own
        yield from problems_with(when, when.questionnaire, questionnaires[when.questionnaire].items, here, source)


def _checks(protocol: Protocol, questionnaires: Mapping[str, Questionnaire], source: Source) -> Iterator[Problem]:
    """Comprehension checks have right answers, and nothing else has."""
    for index, entry in enumerate(protocol.stages):
        for name, path in entry.stage.questionnaires():
            if name not in questionnaires:
                continue
            here = ("stages", index, entry.kind, *path)
            right = [item.key for item in questionnaires[name].items if item.correct is not None]
            if isinstance(entry.stage, ComprehensionStage) and not right:
                yield source.problem(here, "has no item with 'correct'; a comprehension check needs right answers")
            elif right and not isinstance(entry.stage, ComprehensionStage):
                message = (
                    f"has right answers ({', '.join(right)}); ask it as a comprehension stage, or remove 'correct'"
                )
                yield source.problem(here, message)
