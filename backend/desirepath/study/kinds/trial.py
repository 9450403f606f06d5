"""Kind of step `trial`: two trajectories of one query, one after the other, then which of them one would rather have.

Trials stand in blocks (`protocol/block.py`); here are their queries and probes and how trajectories may be watched.
Which query a chosen one asks is `personalising/next_query.py`'s.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from pydantic import Field
from sqlalchemy import select

from desirepath.grammar.parts import Part
from desirepath.learning.preferences.evidence.graded_pair import Degree, Possible
from desirepath.learning.queries.choosing import STRATEGIES, StoppingRule
from desirepath.store.events import log_event
from desirepath.store.models import Trial as Row
from desirepath.store.sides import Side
from desirepath.study.kind import Acting, Kind, Moment, Page, Simulated, make_trial
from desirepath.study.personalising import next_query
from desirepath.study.plan.asked_queries import Pair
from desirepath.study.steps import Step
from desirepath.study.wire import AboutQuery, Answer, BadValue, Flag

# ---- in the protocol -------------------------------------------------------------------------------------------------


class Stopping(Part):
    """End the queries early once little is left to learn: when the best next answer promised less than `below_bits` of
    information for `in_a_row` queries, and at least `at_least` were answered.
    """

    below_bits: float = Field(0.1, gt=0, le=1)  # as in backend/desirepath/learning/queries/choosing.py
    in_a_row: int = Field(3, ge=1, le=20)
    at_least: int = Field(8, ge=2, le=200)


class Probes(Part):
    """Asked to measure consistency (ch. 7), beside the regular queries: `repeat` queries again as they were, `swap`
    with the sides changed. `transitivity`: so many scenes of which three trajectories are compared in all three pairs;
    the query set needs scenes with three trajectories or more.
    """

    repeat: int = Field(0, ge=0, le=50)
    swap: int = Field(0, ge=0, le=50)
    transitivity: int = Field(0, ge=0, le=20)

    @property
    def trials(self) -> int:
        """How many trials they are."""
        return self.repeat + self.swap + 3 * self.transitivity


if TYPE_CHECKING:
    ChooseBy = str
else:
    ChooseBy = STRATEGIES.literal


class Queries(Part):
    """`count` queries of the query set. `practice` ones are marked and never analysed (ch. 7).

    choose: `random` draws them before the session; `disagreement` and `information` choose each next one by the
    participant's own answers so far, as weights of the nine objectives explain them; `information_beyond` the one that
    tells most of whatever else they may be about, too (ours). Further ones come with `desirepath.query_strategies`.
    """

    count: int = Field(ge=1, le=200)
    role: Literal["practice", "regular"] = "regular"
    choose: ChooseBy = "random"
    stop: Stopping | None = Field(None, description="default: all queries are asked")
    probes: Probes = Probes()


class Trials(Part):
    """One entry of a block's `trials`."""

    queries: Queries


class Viewing(Part):
    """How a pair may be watched. By default as in ch. 7: each trajectory once, to its end, before the choice.

    replays: how often both may be watched again before choosing. early_choice: the choice is possible once B has begun.
    choice_limit_s: time for the choice; after it the trial counts as not answered. goal_and_trail: the robot's goal and
    its trail are shown; ours, so that the eye has a hold: ch. 7 showed neither start nor goal.
    """

    replays: int = Field(0, ge=0, le=5)
    early_choice: bool = False
    choice_limit_s: int | None = Field(None, ge=3, le=600)
    goal_and_trail: bool = True


DEGREE_S = 3.0  # ours: to say how clearly, after the choice


class PairAnswers(Part):
    """What may be answered to a pair besides A or B: that there is no difference, and how much better the chosen one is
    (`strength`: a little or clearly) or how sure one is (`confidence`: not quite or quite). All of it counts in the
    posterior of the session and in what recipe `instant` learns; other recipes learn from the choices among it.
    """

    no_difference: bool = False
    degree: Literal["strength", "confidence"] | None = Field(None, description="default: nothing more is asked")

    @property
    def possible(self) -> Possible:
        """How many different answers there are."""
        return cast("Possible", (4 if self.degree else 2) + self.no_difference)


# ---- in the plan -----------------------------------------------------------------------------------------------------

Role = Literal["practice", "regular", "repeat", "swap", "transitivity", "further"]


class TrialStep(Step):
    """Of a query that is known before the session: `query` and its trajectories as A and B; `sides_swapped`: its second
    one is shown as A. Of one that is chosen by the answers so far: `choose`, by what. `again`: the step that a probe
    repeats. answers: what may be said of it. number, of: this trial among its like. round: of `asking_on.py`, from 1.
    """

    kind: Literal["trial"]
    role: Role
    number: int
    of: int
    sides_swapped: bool
    viewing: Viewing = Viewing()
    answers: PairAnswers = PairAnswers()
    query: str | None = None
    trajectory_a: str | None = None
    trajectory_b: str | None = None
    duration_a_s: float | None = None
    duration_b_s: float | None = None
    choose: ChooseBy | None = None
    stop: Stopping | None = None
    again: str | None = None
    round: int | None = None

    @property
    def further(self) -> bool:
        return self.round is not None

    @property
    def sort(self) -> tuple[str, ...]:
        return (*super().sort, self.role)


def viewing_in(step: Step) -> Viewing:
    """The view rules of a step; the defaults where its kind has none of its own."""
    return getattr(step, "viewing", Viewing())


def plan_trials(
    prefix: str,
    where: Mapping[str, Any],
    entries: Sequence[Trials],
    viewing: Viewing,
    answers: PairAnswers,
    pairs: Iterator[Pair],
    triads: Iterator[tuple[Pair, Pair, Pair]],
    random: np.random.Generator,
) -> list[TrialStep]:
    """The trials of one condition of a block, in the order in which they are shown: practice, regular, probes.

    prefix: of their keys; where: stage, block and view.
    """
    asked: dict[str, list[dict[str, Any]]] = {"practice": [], "regular": [], "probe": []}
    for entry in entries:
        wanted = entry.queries
        mine = [next(pairs) for _ in range(wanted.count)]
        if wanted.role == "practice":
            asked["practice"] += [_fixed("practice", pair) for pair in mine]
            continue
        place = len(asked["regular"])
        asked["regular"] += _regular(wanted, mine, random)
        asked["probe"] += _repeats(wanted, asked["regular"], place, random)
        for three in (next(triads) for _ in range(wanted.probes.transitivity)):
            asked["probe"] += [_fixed("transitivity", pair) for pair in three]
    asked["probe"] = [asked["probe"][i] for i in random.permutation(len(asked["probe"]))]
    counted = len(asked["regular"]) + len(asked["probe"])
    practice = len(asked["practice"])
    rules = {"viewing": viewing, "answers": answers}
    watched = {name: said for name, of in rules.items() if (said := of.model_dump(exclude_defaults=True))}
    steps = []
    for number, step in enumerate(asked["practice"] + asked["regular"] + asked["probe"], 1):
        practising = step["role"] == "practice"
        if "again" in step:
            step["again"] = f"{prefix}.{practice + step['again'] + 1:02d}"
        shown = {"number": number if practising else number - practice, "of": practice if practising else counted}
        key = f"{prefix}.{number:02d}"
        steps.append(TrialStep.model_validate({**where, "key": key, "kind": "trial", **shown, **watched, **step}))
    return steps


def _regular(wanted: Queries, mine: list[Pair], random: np.random.Generator) -> list[dict[str, Any]]:
    if wanted.choose == "random":
        return [_fixed("regular", mine[i]) for i in random.permutation(len(mine))]
    rule = {"choose": wanted.choose} | ({"stop": wanted.stop.model_dump()} if wanted.stop else {})
    return [{"role": "regular", "sides_swapped": bool(random.integers(2)), **rule} for _ in mine]


def _repeats(
    wanted: Queries, regular: list[dict[str, Any]], place: int, random: np.random.Generator
) -> list[dict[str, Any]]:
    """Probes of the regular steps from `place` on; `again` is the index of the step that they repeat."""
    probes = []
    for n, i in enumerate(random.choice(wanted.count, wanted.probes.repeat + wanted.probes.swap, False)):
        step = regular[place + int(i)]
        role = "repeat" if n < wanted.probes.repeat else "swap"
        probe = {**step, "role": role, "again": place + int(i)}
        if role == "swap":
            probe["sides_swapped"] = not step["sides_swapped"]
            if "query" in step:
                for name in ("trajectory_{}", "duration_{}_s"):
                    probe[name.format("a")], probe[name.format("b")] = step[name.format("b")], step[name.format("a")]
        probe.pop("stop", None)
        probes.append(probe)
    return probes


def _fixed(role: str, pair: Pair) -> dict[str, Any]:
    """A query that is known before the session."""
    return {
        "role": role,
        "query": pair.query,
        "sides_swapped": pair.sides_swapped,
        "trajectory_a": pair.trajectory_a,
        "trajectory_b": pair.trajectory_b,
        "duration_a_s": pair.duration_a_s,
        "duration_b_s": pair.duration_b_s,
    }


# ---- in a session ----------------------------------------------------------------------------------------------------


class TrialAnswer(Answer):
    """The trajectory that one would rather have and, where that is asked, how clearly; that there is no difference, by
    `degree` alone; or that the time for the choice was over. hmd: of an early choice, whether B is being watched with a
    headset."""

    choice: Side | None = None
    degree: Degree | None = None
    timed_out: Flag = False
    hmd: Flag = False


class AboutPair(AboutQuery):
    """What may be answered besides A or B."""

    no_difference: bool = False
    degrees: bool = False


class Trial(Kind[TrialStep, TrialAnswer]):
    name = "trial"
    step = TrialStep
    answers = TrialAnswer
    besides = AboutPair
    stored = {
        "choice": "a or b; none where there is no difference, or the time was over",
        "degree": "where that was asked: slight or clear, or no_difference",
        "degree_of": "of what that is: strength (a little, clearly) or confidence (not quite sure, sure)",
        "possible": "how many different answers there were, where more than A and B: 3 with no difference, 4 with "
        "degrees, 5 with both",
        "timed_out": "true where the time for the choice was over",
    }
    shows = "trajectories"
    previewed = True
    answer = "preference"

    def payload(self, step: TrialStep, page: Page) -> dict[str, Any]:
        shown = {"role": step.role, "view": step.view, "number": step.number, "of": step.of}
        asked = {"answers": step.answers.model_dump()}
        return shown | asked | step.viewing.model_dump() | ({"may_end": True} if step.stop is not None else {})

    def pass_over(self, step: TrialStep, index: int, acting: Acting) -> int:
        """Past the queries that are chosen, once the stopping rule ends them."""
        if step.choose is None or step.stop is None:
            return index
        if not next_query.little_left(acting, step.choose, StoppingRule(**step.stop.model_dump())):
            return index
        log_event(acting.s, "queries_ended", session_id=acting.session.id, step=step.key)
        while isinstance(one := acting.plan[index], TrialStep) and one.choose and one.again is None:
            index += 1
        return index

    def is_asked(self, step: TrialStep, moment: Moment) -> bool:
        if step.round is not None and moment.session.personalisation is not None:
            return False  # it is known what becomes of the training: nothing more is asked for it
        return step.again is None or moment.has_trial(step.again)

    def may_come(self, step: TrialStep, moment: Moment) -> bool:
        return step.round is None or step.round == getattr(moment.step, "round", None)

    def arrive(self, step: TrialStep, acting: Acting) -> None:
        asked = _asked(step, acting)
        trial = make_trial(
            acting,
            step,
            kind="query",
            trajectory_a=asked.trajectory_a,
            trajectory_b=asked.trajectory_b,
            block=step.block,
            role=step.role,
            query_id=asked.query,
            probe_of=asked.probe_of,
            sides_swapped=asked.sides_swapped,
        )
        if asked.why is not None:
            log_event(
                acting.s,
                "query_chosen",
                session_id=acting.session.id,
                trial_id=trial.id,
                query=asked.query,
                **asked.why,
            )

    def check(self, step: TrialStep, answer: TrialAnswer, page: Page) -> dict[str, Any]:
        if answer.timed_out and step.viewing.choice_limit_s is not None:
            return {"timed_out": True}
        asked = step.answers
        if asked.no_difference and answer.degree == "no_difference":
            return {"degree": "no_difference", "possible": asked.possible}
        if answer.choice is None:
            raise BadValue("value.choice", None, "must be 'a' or 'b'")
        if asked.degree is None:
            return {"choice": answer.choice} | ({"possible": asked.possible} if asked.no_difference else {})
        if answer.degree not in ("slight", "clear"):
            raise BadValue("value.degree", answer.degree, "must be 'slight' or 'clear'")
        graded = {"degree": answer.degree, "degree_of": asked.degree, "possible": asked.possible}
        return {"choice": answer.choice, **graded}

    def tell_simulated(self, step: TrialStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        asked = {"no_difference": step.answers.no_difference, "degrees": step.answers.degree is not None}
        return {"role": step.role, "query": moment.query_shown(step.key), **asked}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        a, b = participant.watch(step, "ab")
        ties, degrees = bool(step.get("no_difference")), bool(step.get("degrees"))
        return participant.grade(step, a, b, no_difference=ties, degrees=degrees)


def _asked(step: TrialStep, acting: Acting) -> next_query.Asked:
    """What the step's trial shows: again what another one did, what the plan says, or what is chosen now."""
    if step.again is not None:
        again = select(Row).where(Row.session_id == acting.session.id, Row.step_key == step.again)
        before = acting.s.scalars(again).one()
        sides = (before.trajectory_a, before.trajectory_b)
        a, b = sides[::-1] if step.role == "swap" else sides
        return next_query.Asked(str(before.query_id), a, b, step.sides_swapped, probe_of=before.id)
    if step.query is not None:
        return next_query.Asked(step.query, str(step.trajectory_a), str(step.trajectory_b), step.sides_swapped)
    return next_query.choose_query(acting, step.choose or "random", sides_swapped=step.sides_swapped)


KIND = Trial()
