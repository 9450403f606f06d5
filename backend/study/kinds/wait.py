"""Kind of step `wait`: something is being learned from the answers; then the session goes on. The stage is `train`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from backend.store.events import log_event
from backend.study.grammar.parts import Part, Slug
from backend.study.grammar.source import Path
from backend.study.kinds.base import Acting, Kind, Moment, Page, Planning, Stage, Step
from backend.study.kinds.comparison import ComparisonStage, ComparisonStep
from backend.study.kinds.guess import GuessStep
from backend.study.kinds.questionnaire import QuestionnaireStep
from backend.study.kinds.wire import Confirmed
from backend.study.personalising import alignment_jobs


class Meanwhile(Part):
    """What the participant does while the job runs."""

    questionnaire: Slug


def _recipe_in_new_words(given: object) -> object:
    """Protocols of before call fine-tuning `refine`."""
    return "fine_tuning" if given == "refine" else given


class TrainStage(Stage):
    """Starts when the answer before it is stored; the participant waits at most `give_up_after_s` after `while`.

    job: `align` learns from choices between trajectories, `demonstrations` from drawn paths, one controller per
    environment. recipe (of `align`): `instant` is there at once (a conditioning search runs behind it and takes its
    place where it is better), `fine_tuning` trains on the learned reward, `thesis` as in thesis 6.4. prior (of
    `align`): by the light of what own answers are read before a policy is called surely better for this person; `none`
    of others', `earlier_participants` of those of the study, the same version and group who consented to training.
    """

    once = True
    for_everybody = True
    begins = "train"

    job: Literal["align", "demonstrations"] = "align"
    on: Literal["own_answers"] = "own_answers"
    recipe: Annotated[Literal["instant", "fine_tuning", "thesis"], BeforeValidator(_recipe_in_new_words)] = "instant"
    prior: Literal["none", "earlier_participants"] = "none"
    meanwhile: Meanwhile | None = Field(None, alias="while")
    give_up_after_s: int = Field(120, ge=1, le=1800)  # ours

    def plan(self, at: Planning) -> list[Step]:
        steps: list[Step] = []
        if self.meanwhile:
            used = self.meanwhile.questionnaire
            steps.append(QuestionnaireStep.of(f"{at.key}.{used}", used, stage=at.key))
        if at.of(ComparisonStage):  # otherwise there is nothing to wait for
            steps.append(WaitStep(kind="wait", key=f"{at.key}.wait", stage=at.key))
        return steps

    def questionnaires(self) -> Iterator[tuple[str, Path]]:
        if self.meanwhile:
            yield self.meanwhile.questionnaire, ("while", "questionnaire")


class WaitStep(Step):
    """Planned by the stages `train` and `evaluation`."""

    kind: Literal["wait"]


class Wait(Kind[WaitStep, Confirmed]):
    name = "wait"
    step = WaitStep
    stages = {"train": TrainStage}
    goes_on = True
    begun = {"train": alignment_jobs.start_training}

    def payload(self, step: WaitStep, page: Page) -> dict[str, Any]:
        return {"learns_from": page.frozen.learns_from}

    def may_come(self, step: WaitStep, moment: Moment) -> bool:
        return False

    def check_time(self, step: WaitStep, moment: Moment, value: Mapping[str, Any]) -> None:
        raise moment.refused("still_waiting", "This step goes on by itself.")

    def waits(self, step: WaitStep, moment: Moment) -> bool:
        return alignment_jobs.outcome_of(moment) is None

    def settle(self, step: WaitStep, acting: Acting) -> int | None:
        """Once the job has ended or is late: to the first comparison or rollout to be rated, past all that needs a
        trial and the guess if there is none."""
        outcome = alignment_jobs.outcome_of(acting)
        if outcome is None:
            return None
        planned = [(i, step) for i, step in enumerate(acting.plan) if isinstance(step, ComparisonStep)]
        shown = alignment_jobs.make_comparisons(acting, planned) if outcome == "shown" else 0
        acting.session.personalisation = outcome
        acting.session.predictive_check = alignment_jobs.check_of(acting.s, acting.session)
        log_event(acting.s, "personalisation", session_id=acting.session.id, outcome=outcome, comparisons=shown)
        past = () if shown else (ComparisonStep, GuessStep)
        after = range(acting.session.position + 1, len(acting.plan))
        return next(i for i in after if not isinstance(acting.plan[i], past))


KIND = Wait()
