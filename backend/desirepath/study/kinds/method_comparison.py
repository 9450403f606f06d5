"""Kind of step `method_comparison`: the robots of two methods in the same scene, blind.

Methods are ways to say how the robot should drive (`protocol/methods.py`); what robot each resulted in is
`personalising/method_robots.py`'s. The last page of such a study asks about the methods; this one never names one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any, Literal

from pydantic import Field

from desirepath.grammar.parts import an_example
from desirepath.grammar.source import Path, Problem, Source
from desirepath.grammar.words import View
from desirepath.store.artefacts import save_trajectories
from desirepath.store.models import Participant
from desirepath.store.who_counts import lets_us_learn
from desirepath.study.kind import Acting, Moment, make_trial
from desirepath.study.kinds.comparison import BlindPair, PairStep
from desirepath.study.personalising.method_robots import Method, find_robots, hard_to_tell, make_robots, rollouts_in
from desirepath.study.steps import Pace, Planning, Stage, Step


class TaughtByMethods(Stage):
    """Base of the stage that has the methods; it needs a block's pages, so it stands with the protocol."""

    methods: list[Method]
    setup: str


class MethodComparisonStage(Stage):
    """After `methods`: every two of the resulting robots in `scenes` fresh scenes, the same for all pairs, blind, in an
    order and with sides drawn by lot.
    """

    model_config = an_example({"scenes": 2})

    once = True
    for_everybody = True

    scenes: int = Field(2, ge=1, le=6)
    view: View | None = Field(None, description="default: the view of the methods")

    def plan(self, at: Planning) -> list[Step]:
        (taught,) = at.of(TaughtByMethods)
        pairs = [
            (first, second, place) for place in range(self.scenes) for first, second in combinations(taught.methods, 2)
        ]
        asked = [pairs[int(k)] for k in at.random.permutation(len(pairs))]
        shown = {"stage": at.key, "view": self.view or at.view, "of": len(asked), "scenes": self.scenes}
        about = {"setup": taught.setup, "methods": taught.methods}
        return [
            MethodComparisonStep.model_validate(
                {
                    "kind": "method_comparison",
                    "key": f"{at.key}.{number:02d}",
                    **shown,
                    **about,
                    "number": number,
                    "first": first,
                    "second": second,
                    "place": place,
                    "sides_swapped": bool(at.random.integers(2)),
                }
            )
            for number, (first, second, place) in enumerate(asked, 1)
        ]

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return self._pairs(stages) * pace.trial_s

    def _pairs(self, stages: Sequence[Stage]) -> int:
        taught = next((stage for stage in stages if isinstance(stage, TaughtByMethods)), None)
        return self.scenes * len(list(combinations(taught.methods, 2))) if taught else 0

    def problems(self, here: Path, stages: Sequence[Stage], source: Source) -> Iterator[Problem]:
        before = stages[: [stage is self for stage in stages].index(True)]
        if not any(isinstance(stage, TaughtByMethods) for stage in before):
            yield source.problem(here, "needs a methods stage before it: it compares the robots that these result in")


class MethodComparisonStep(PairStep):
    """first, second: methods; sides_swapped: the second one's robot is shown as A. place: which of the `scenes`.
    methods: all that are compared, as their robots drive in the same scenes.
    """

    kind: Literal["method_comparison"]
    first: Method
    second: Method
    place: int
    scenes: int
    setup: str
    methods: list[Method]
    sides_swapped: bool

    @property
    def sides(self) -> tuple[Method, Method]:
        """The methods whose robots are A and B."""
        return (self.second, self.first) if self.sides_swapped else (self.first, self.second)


class MethodComparison(BlindPair[MethodComparisonStep]):
    name = "method_comparison"
    step = MethodComparisonStep
    stages = {"method_comparison": MethodComparisonStage}
    stored = {
        "choice": "a or b",
        "methods": "a, b: by which method each robot was taught (choices, drawing, words, sliders)",
        "weights": "a, b: objective -> weight that each robot was conditioned on; {}: its method taught nothing",
        "place": "which of the scenes, from 0; all robots drive in the same ones",
    }

    def is_asked(self, step: MethodComparisonStep, moment: Moment) -> bool:
        """Not who does not want programs to learn from their answers."""
        return lets_us_learn(moment.s.get_one(Participant, moment.session.participant_id))

    def may_come(self, step: MethodComparisonStep, moment: Moment) -> bool:
        return self.is_asked(step, moment)

    def arrive(self, step: MethodComparisonStep, acting: Acting) -> None:
        """Two rollouts, some milliseconds; with the first comparison what each method taught, and the scenes."""
        made = make_robots(acting, step.stage, step.setup, step.methods, step.scenes)
        a, b = rollouts_in(made, step.place, step.sides)
        rows = save_trajectories(acting.s, acting.files, [a, b])
        arms = {"a": step.sides[0], "b": step.sides[1], "look_alike": hard_to_tell(a, b)}
        shown = {"trajectory_a": rows[0].id, "trajectory_b": rows[1].id}
        make_trial(acting, step, kind="method_comparison", block=step.stage, arms=arms, **shown)

    def keep(self, step: MethodComparisonStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        weights = find_robots(acting, step.stage)["weights"]
        sides = dict(zip("ab", step.sides, strict=True))
        taught = {side: weights[method] for side, method in sides.items()}
        return {"methods": sides, "weights": taught, "place": step.place}


KIND = MethodComparison()
