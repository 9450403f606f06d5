"""Kind of step `importance_ranking` (ch. 8): the robot drives, halts, and objects are ranked by how much they mattered.

What is ranked comes from a ranking set, computed when that was made (`explain/ranking_sets.py`); here are the stage
with its conditions, the trial and its answer. How rankings are compared with scores is the report's.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from desirepath.explain.shown_explanation import ShownExplanation, is_of_people, simulate_ranking
from desirepath.grammar.conditions import Condition, Crossed
from desirepath.grammar.parts import FileName, Slug, an_example
from desirepath.grammar.source import Path
from desirepath.store.ranking_sets import StoredScores, scores_of
from desirepath.study.kind import Acting, Kind, Moment, Page, Simulated, make_trial
from desirepath.study.kinds.break_ import BreakStep
from desirepath.study.kinds.instruction import InstructionStep
from desirepath.study.kinds.questionnaire import QuestionnaireStep
from desirepath.study.plan.asked_queries import Needs, Pair
from desirepath.study.protocol_rows import row_of
from desirepath.study.steps import Pace, Planning, Stage, Step
from desirepath.study.wire import STORED_IN_ROOM, BadValue, Besides, InRoomAnswer, WholeNumber

RANKING_S = 15.0  # ours: until five objects are ranked
HOLD_S = 1.0  # ch. 8: what is shown stays so long after the halt
SHOWN = {"outline": ("outline", "plain"), "lidar": ("lidar", "bare"), "attention": ("attention", "hidden")}
"""Factor -> its levels, shown first. Things have outlines, a policy's attention is given to people."""

# ---- in the protocol -------------------------------------------------------------------------------------------------


class ImportanceRankingStage(Crossed, Stage):
    """`trials` rollouts per condition, each ranked once; the query set must be a ranking set.

    each, one_of: the factors `outline` (levels outline, plain) of things, `attention` (levels attention, hidden) given
    to people, and `lidar` (levels lidar, bare) say what is shown of the robot's reasons; a factor that is left out is
    shown. practice: so many before the first condition, with
    everything shown, never analysed. No rollout is shown twice. before: a text before each condition, which may hold
    the factors in braces; questionnaire: after each; between: a text for a rest between two of at least
    `between_at_least_s`. hold_s: how long what is shown stays after the halt.
    """

    model_config = an_example({"view": "top_down", "each": {"lidar": ["lidar", "bare"]}, "trials": 6})

    asks = True
    measures = True
    sets_view = True

    trials: int = Field(12, ge=1, le=100)
    practice: int = Field(2, ge=0, le=20)
    before: FileName | None = None
    questionnaire: Slug | None = None
    between: FileName | None = None
    between_at_least_s: int = Field(0, ge=0, le=1800)
    hold_s: float = Field(HOLD_S, ge=0, le=30)

    @model_validator(mode="after")
    def _factors_say_what_is_shown(self) -> Self:
        for factor, levels in [*(self.each or {}).items(), *(self.one_of or {}).items()]:
            known = SHOWN.get(factor)
            if known is not None and set(levels) != set(known):
                raise ValueError(f"the factor {factor} has the levels {', '.join(levels)}; must be {', '.join(known)}")
        return self

    def needs(self) -> Needs:
        return Needs(ranked=self.trials * len(self.conditions(0)), practised=self.practice)

    def trials_asked(self) -> int:
        return self.trials

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        conditions = len(self.conditions(0))
        pages = conditions * sum(page is not None for page in (self.before, self.questionnaire))
        rests = (conditions - 1) * (pace.page_s + self.between_at_least_s) if self.between else 0.0
        return (self.trials * conditions + self.practice) * (pace.single_s + RANKING_S) + pages * pace.page_s + rests

    def numbers(self) -> dict[str, int]:
        conditions = len(self.conditions(0))
        return {"blocks": conditions, "rankings": self.trials * conditions, "practice_rankings": self.practice}

    def texts(self) -> Iterator[tuple[str, Path]]:
        met = list(chain.from_iterable(self.conditions(group) for group in range(len(self.groups))))
        for field in ("before", "between"):
            text = getattr(self, field)
            for name in sorted({condition.filled(text) for condition in met}) if text else ():
                yield name, (field,)

    def questionnaires(self) -> Iterator[tuple[str, Path]]:
        if self.questionnaire is not None:
            yield self.questionnaire, ("questionnaire",)

    def plan(self, at: Planning) -> list[Step]:
        """Practice, then condition by condition: its text, its rollouts, its questions, and a rest before the next."""
        practice = at.drawn.rankings(self.practice, practice=True)
        where: dict[str, Any] = {"stage": at.key, "view": at.conditions[0].view}
        steps: list[Step] = [
            self._step(f"{at.key}.practice", where, pair, number, self.practice, "practice", {})
            for number, pair in enumerate(practice, 1)
        ]
        for turn, condition in enumerate(at.conditions):
            name = condition.name
            prefix = f"{at.key}.{name}" if name else at.key
            where = {"stage": at.key, "block": name or at.key, "view": condition.view}
            if turn and self.between:
                steps.append(self._rest(prefix, condition, where))
            if self.before:
                fields = {"kind": "instruction", "key": f"{prefix}.before", "text": condition.filled(self.before)}
                steps.append(InstructionStep.model_validate({**where, **fields}))
            steps += [
                self._step(prefix, where, pair, number, self.trials, "regular", condition.levels)
                for number, pair in enumerate(at.drawn.rankings(self.trials, practice=False), 1)
            ]
            if self.questionnaire:
                steps.append(QuestionnaireStep.of(f"{prefix}.{self.questionnaire}", self.questionnaire, **where))
        return steps

    def _rest(self, prefix: str, condition: Condition, where: Mapping[str, Any]) -> Step:
        fields = {"text": condition.filled(self.between or ""), "at_least_s": self.between_at_least_s}
        return BreakStep.model_validate({"kind": "break", "key": f"{prefix}.between", **where, **fields})

    def _step(
        self,
        prefix: str,
        where: Mapping[str, Any],
        pair: Pair,
        number: int,
        of: int,
        role: str,
        levels: Mapping[str, str],
    ) -> Step:
        shown = {factor: levels.get(factor, on) == on for factor, (on, _) in SHOWN.items()}
        fields = {"role": role, "number": number, "of": of, "hold_s": self.hold_s, **shown}
        asked = {"query": pair.query, "trajectory": pair.trajectory_a}
        return ImportanceRankingStep.model_validate(
            {"kind": "importance_ranking", "key": f"{prefix}.{number:02d}", **where, **asked, **fields}
        )


# ---- in the plan -----------------------------------------------------------------------------------------------------


class ImportanceRankingStep(Step):
    """One rollout. query: of the ranking set; outline, lidar, attention: what of the reasons is shown, where the set
    has it; number, of: its place."""

    kind: Literal["importance_ranking"]
    role: Literal["practice", "regular"]
    query: str
    trajectory: str
    outline: bool
    lidar: bool
    attention: bool = True
    number: int
    of: int
    hold_s: float = HOLD_S

    @property
    def sort(self) -> tuple[str, ...]:
        return (*super().sort, self.role)


# ---- in a session ----------------------------------------------------------------------------------------------------


class ImportanceRankingAnswer(InRoomAnswer):
    """All objects, the most important first. placed_s: when each got its place, seconds since ranking was possible."""

    ranking: Annotated[list[str], Field(max_length=40)]
    undone: WholeNumber = 0
    placed_s: Annotated[list[float], Field(max_length=40)] = []


class AboutRanking(Besides):
    """scores: at the halt; only where outlines or attention told them."""

    role: str | None = None
    query: str | None = None
    things: list[str] | None = None
    scores: dict[str, float] | None = None


class ImportanceRanking(Kind[ImportanceRankingStep, ImportanceRankingAnswer]):
    name = "importance_ranking"
    step = ImportanceRankingStep
    answers = ImportanceRankingAnswer
    besides = AboutRanking
    stages = {"importance_ranking": ImportanceRankingStage}
    stored = {
        "ranking": "all objects of the scene, the most important first",
        "scores": "each object's score at the halt, 0 to 1: what the ranking is compared with",
        "placed_s": "seconds until each was put on its place, as `ranking`; empty: not reported",
        "undone": "how often a place was taken back",
        "outline": "whether outlines showed the scores",
        "lidar": "whether the lidar's rays were shown",
        "attention": "whether what the policy attends to was shown; only where people are ranked",
        **STORED_IN_ROOM,
    }
    shows = "trajectories"
    trajectories = 1
    previewed = True

    def payload(self, step: ImportanceRankingStep, page: Page) -> dict[str, Any]:
        shown = {
            name: getattr(step, name) for name in ("role", "view", "number", "of", "outline", "lidar", "attention")
        }
        return shown | {"things": []}

    def payload_now(self, step: ImportanceRankingStep, moment: Moment) -> dict[str, Any]:
        """The objects, in an order that says nothing, another one in every trial."""
        things = _scores(step, moment).things
        return {"things": sorted(things, key=lambda thing: hashlib.sha256(f"{step.key}{thing}".encode()).digest())}

    def explains(self, step: ImportanceRankingStep, moment: Moment) -> ShownExplanation:
        found = _scores(step, moment)
        outlines, attention = _shows(step, found)
        return ShownExplanation(
            found.things, found.scores, outlines, step.lidar, step.hold_s, found.attention if attention else None
        )

    def arrive(self, step: ImportanceRankingStep, acting: Acting) -> None:
        """Both trajectories of the trial are the one that is shown."""
        shown = {"trajectory_a": step.trajectory, "trajectory_b": step.trajectory}
        make_trial(acting, step, kind=self.name, block=step.block, role=step.role, query_id=step.query, **shown)

    def check(self, step: ImportanceRankingStep, answer: ImportanceRankingAnswer, page: Page) -> dict[str, Any]:
        if not 0 <= answer.undone <= 10_000:
            raise BadValue("value.undone", answer.undone, "must be a whole number from 0 to 10000")
        if any(not 0 <= seconds <= 86_400 for seconds in answer.placed_s):
            raise BadValue("value.placed_s", answer.placed_s, "must be seconds from 0 to 86400")
        if answer.placed_s and len(answer.placed_s) != len(answer.ranking):
            raise BadValue("value.placed_s", answer.placed_s, "must have one number per ranked object, or none")
        placed = [round(seconds, 3) for seconds in answer.placed_s]
        return {"ranking": answer.ranking, "undone": answer.undone, "placed_s": placed}

    def keep(self, step: ImportanceRankingStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        """The scores that were explained, so that the row tells the whole trial. Raises Refused for other objects."""
        found = _scores(step, acting)
        if sorted(stored["ranking"]) != sorted(found.things):
            message = f"must have each of {', '.join(found.things)} once"
            raise acting.refusal("bad_value", message, status=422, field="value.ranking", value=stored["ranking"])
        outlines, attention = _shows(step, found)
        of_people = {"attention": attention} if found.attention is not None else {}
        return {"scores": found.at_halt, "outline": outlines, "lidar": step.lidar, **of_people}

    def tell_simulated(self, step: ImportanceRankingStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        found = _scores(step, moment)
        about = {"role": step.role, "query": step.query, "things": list(found.things)}
        return about | ({"scores": found.at_halt} if any(_shows(step, found)) else {})

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        trajectory = participant.watch(step, "a")[0]
        return {"ranking": simulate_ranking(trajectory, step["things"], step.get("scores"), participant.random)}


def _scores(step: ImportanceRankingStep, moment: Moment) -> StoredScores:
    ranking_set: str = row_of(moment.s, moment.session).protocol["materials"]["query_set"]
    return scores_of(moment.s, ranking_set, step.query)


def _shows(step: ImportanceRankingStep, found: StoredScores) -> tuple[bool, bool]:
    """Whether outlines tell the scores, and whether attention does: as the step says, where the set has them."""
    return step.outline and not is_of_people(found.things), step.attention and found.attention is not None


KIND = ImportanceRanking()
