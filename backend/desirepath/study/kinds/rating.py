"""Kind of step `rating`: watch one trajectory, rate it on the protocol's own scale (evaluative feedback)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

from pydantic import Field

from desirepath.grammar.conditions import Crossed
from desirepath.grammar.parts import Localized, Part, an_example
from desirepath.grammar.source import Path
from desirepath.grammar.texts import local
from desirepath.study.kind import Acting, Kind, Moment, Page, Simulated, make_trial
from desirepath.study.kinds.questionnaire import within
from desirepath.study.plan.asked_queries import Needs
from desirepath.study.steps import Pace, Planning, Stage, Step
from desirepath.study.wire import Answer, Besides, WholeNumber

RATING = "rating"


class RatingScale(Part):
    """What one trajectory is rated on: `points` with labelled ends, as buttons or, with many, as a slider."""

    question: Localized
    points: int = Field(7, ge=2, le=101)
    low: Localized
    high: Localized


class RatingStage(Crossed, Stage):
    """`count` trajectories, each watched once and rated; once per condition, where there are several.

    They are the first trajectories of queries that nothing else in the protocol shows, the same under every condition,
    in an order of each one's own. Trainings learn from the choices that ratings imply. at_once: each counts in the
    posterior of the session as well, by a likelihood of its own: queries that are chosen after it follow it, too.
    """

    model_config = an_example(
        {
            "view": "top_down",
            "count": 10,
            "scale": {
                "question": {"en": "How close was it?", "de": "Wie nah war es?"},
                "low": {"en": "far", "de": "fern"},
                "high": {"en": "close", "de": "nah"},
            },
        }
    )

    asks = True
    teaches = "align"
    sets_view = True

    count: int = Field(ge=1, le=100)
    scale: RatingScale
    at_once: bool = False

    def needs(self) -> Needs:
        return Needs(own=self.count)

    def trials_asked(self) -> int:
        return self.count

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return self.count * len(self.conditions(0)) * (pace.trial_s / 2)

    def local_texts(self) -> Iterator[tuple[dict[str, str], Path]]:
        for name in ("question", "low", "high"):
            yield getattr(self.scale, name), ("scale", name)

    def plan(self, at: Planning) -> list[Step]:
        pairs = at.drawn.pairs(self.count, shared=False)
        steps: list[Step] = []
        for condition in at.conditions:
            prefix = f"{at.key}.{condition.name}" if condition.name else at.key
            where = {"stage": at.key, "block": condition.name or at.key, **condition.shown}
            for number, i in enumerate(at.random.permutation(self.count), 1):
                shown = {"query": pairs[i].query, "trajectory": pairs[i].trajectory_a, "rates": RATING}
                fields = {"number": number, "of": self.count, "points": self.scale.points}
                fields |= {"at_once": True} if self.at_once else {}
                key = f"{prefix}.{number:02d}"
                steps.append(RatingStep.model_validate({"kind": "rating", "key": key, **where, **shown, **fields}))
        return steps


class RatingStep(Step):
    """One trajectory. query: that it is of; number, of: among its like; at_once: as of the stage."""

    kind: Literal["rating"]
    query: str
    trajectory: str
    number: int
    of: int
    points: int
    at_once: bool = False


class RatingAnswer(Answer):
    rating: WholeNumber = Field(description="1 to the scale's points")


class AboutRating(Besides):
    query: str | None = None
    points: int | None = None


class Rating(Kind[RatingStep, RatingAnswer]):
    name = "rating"
    step = RatingStep
    answers = RatingAnswer
    besides = AboutRating
    stages = {"rating": RatingStage}
    stored = {RATING: "1 to the scale's points, more is more of what `high` says"}
    shows = "trajectories"
    trajectories = 1
    previewed = True

    def payload(self, step: RatingStep, page: Page) -> dict[str, Any]:
        stage = page.stage_of(step, RatingStage)
        assert stage is not None  # noqa: S101  that is what planned it
        words = {name: local(getattr(stage.scale, name), page.language) for name in ("question", "low", "high")}
        return {"view": step.view, "number": step.number, "of": step.of, "points": step.points, **words}

    def arrive(self, step: RatingStep, acting: Acting) -> None:
        """Both trajectories of the trial are the one that is shown."""
        shown = {"trajectory_a": step.trajectory, "trajectory_b": step.trajectory}
        make_trial(acting, step, kind="rating", block=step.block, role="regular", query_id=step.query, **shown)

    def check(self, step: RatingStep, answer: RatingAnswer, page: Page) -> dict[str, Any]:
        return {RATING: within(f"value.{RATING}", answer.rating, 1, step.points)}

    def tell_simulated(self, step: RatingStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        return {"query": step.query, "points": step.points}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        liked = participant.opinion(step, participant.watch(step, "a")[0])
        return {RATING: 1 + min(int(liked * step["points"]), step["points"] - 1)}


KIND = Rating()
