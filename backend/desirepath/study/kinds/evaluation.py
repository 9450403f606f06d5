"""Kind of step `evaluation`: one rollout of one controller, in a situation that was drawn in (ch. 2), alone.

The rollouts were made by the training's job; which one is whose stands in the trial's block and arms, never on a page.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

from desirepath.grammar.conditions import Condition
from desirepath.grammar.parts import Slug, an_example
from desirepath.grammar.source import Path
from desirepath.grammar.words import View
from desirepath.study.kind import Acting, Kind, Moment, Page, Simulated, make_trial
from desirepath.study.kinds.demonstration import DemonstrationsStage
from desirepath.study.kinds.questionnaire import QuestionnaireStep
from desirepath.study.kinds.wait import WaitStep
from desirepath.study.personalising.controller_rollouts import rollouts_for
from desirepath.study.steps import Pace, Planning, Stage, Step
from desirepath.study.wire import AboutQuery, Confirmed

CONTROLLERS = ("social_cost", "dwa", "own")  # ch. 2


class EvaluationStage(Stage):
    """The social-cost planner, the dynamic window approach and the own controller, blind, one after the other, in the
    order of the assignment, and in the reverse order in the second environment, so that a participant meets each as
    late as the others on average: each drives in every situation that was drawn in, then `questionnaire` asks about it.
    """

    model_config = an_example({"questionnaire": "drawing_rating"})

    once = True

    questionnaire: Slug
    view: View = "top_down"

    @property
    def each(self) -> dict[str, list[str]]:
        """What is ordered, as a block's `each`."""
        return {"controller": list(CONTROLLERS)}

    @property
    def one_of(self) -> None:
        """Everybody meets all three."""

    @property
    def groups(self) -> list[dict[str, str]]:
        """One, as of a block without `one_of`."""
        return [{}]

    def conditions(self, _group: int) -> list[Condition]:
        """The controllers as a block's conditions."""
        return [Condition(name=name, view=self.view, levels={"controller": name}) for name in CONTROLLERS]

    def plan(self, at: Planning) -> list[Step]:
        """A wait for what is still being learned; then environment by environment, controller by controller: its
        rollouts, and the questions. Keys tell no controller.
        """
        drawn = {stage.environment: stage for stage in at.of(DemonstrationsStage)}
        steps: list[Step] = [WaitStep(kind="wait", key=f"{at.key}.wait", stage=at.key)]
        for turn, environment in enumerate(at.random.permutation(sorted(drawn)).tolist()):
            pairs = drawn[environment].pairs
            for place, controller in enumerate(at.conditions[::-1] if turn % 2 else at.conditions, 1):
                where: dict[str, Any] = {
                    "stage": at.key,
                    "block": controller.name,
                    "view": self.view,
                    "environment": environment,
                }
                prefix = f"{at.key}.{environment}.{place}"
                shown = {"robot": place, "of": pairs, "role": "regular"}
                steps += [
                    EvaluationStep.model_validate(
                        {
                            "key": f"{prefix}.{pair + 1}",
                            "kind": "evaluation",
                            **where,
                            "pair": pair,
                            "number": pair + 1,
                            **shown,
                        }
                    )
                    for pair in range(pairs)
                ]
                steps.append(QuestionnaireStep.of(f"{prefix}.{self.questionnaire}", self.questionnaire, **where))
        return steps

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        drawn = [stage for stage in stages if isinstance(stage, DemonstrationsStage)]
        rollouts = sum(stage.pairs for stage in drawn) * len(CONTROLLERS)
        return rollouts * pace.single_s + len(drawn) * len(CONTROLLERS) * pace.page_s

    def questionnaires(self) -> Iterator[tuple[str, Path]]:
        yield self.questionnaire, ("questionnaire",)


class EvaluationStep(Step):
    """One rollout. block: the controller; robot: its place, as participants are told it."""

    kind: Literal["evaluation"]
    environment: str
    pair: int
    number: int
    of: int
    robot: int
    role: Literal["regular"] = "regular"


class Evaluation(Kind[EvaluationStep, Confirmed]):
    name = "evaluation"
    step = EvaluationStep
    besides = AboutQuery
    stages = {"evaluation": EvaluationStage}
    shows = "trajectories"
    trajectories = 1

    def payload(self, step: EvaluationStep, page: Page) -> dict[str, Any]:
        """The robot's place, not its name."""
        return {name: getattr(step, name) for name in ("role", "view", "robot", "number", "of")}

    def is_asked(self, step: EvaluationStep, moment: Moment) -> bool:
        return bool(rollouts_for(moment.s, moment.session, step.environment, str(step.block), step.pair))

    def arrive(self, step: EvaluationStep, acting: Acting) -> None:
        """Both trajectories of the trial are the one that is shown."""
        (found,) = rollouts_for(acting.s, acting.session, step.environment, str(step.block), step.pair)
        arms = {"a": found.made_by, "b": found.made_by, "own": "a" if step.block == "own" else None}
        shown = {"trajectory_a": found.trajectory, "trajectory_b": found.trajectory}
        make_trial(acting, step, kind="evaluation", block=step.block, arms=arms, **shown)

    def tell_simulated(self, step: EvaluationStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        return {"role": step.role, "query": None}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        participant.watch(step, "a")
        return {}


KIND = Evaluation()
