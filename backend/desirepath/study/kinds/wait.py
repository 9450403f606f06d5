"""Kind of step `wait`: something is being learned from the answers; then the session goes on. The stage is `train`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

from pydantic import Field

from desirepath.grammar.parts import Part, Slug, an_example
from desirepath.grammar.source import Path, Problem, Source
from desirepath.grammar.words import View
from desirepath.store.events import log_event
from desirepath.study.frozen import Prior
from desirepath.study.kind import Acting, Kind, Moment, Page
from desirepath.study.kinds.asking_on import AskingOnStep, AskOn
from desirepath.study.kinds.comparison import ComparisonStage, ComparisonStep, make_comparisons
from desirepath.study.kinds.guess import GuessStep
from desirepath.study.kinds.questionnaire import QuestionnaireStep
from desirepath.study.personalising import alignment_jobs
from desirepath.study.plan.asked_queries import Needs
from desirepath.study.steps import Pace, Planning, Stage, Step
from desirepath.study.wire import Confirmed

EACH_SCENE = "each_scene"


class Meanwhile(Part):
    """What the participant does while the job runs."""

    questionnaire: Slug


class TrainStage(Stage):
    """Starts when the answer before it is stored; the participant waits at most `give_up_after_s` after `while`.

    job: `align` learns from choices between trajectories, `demonstrations` from drawn paths, one controller per
    environment. recipe (of `align`): `instant` is there at once (a conditioning search runs behind it and takes its
    place where it is better), `fine_tuning` trains on the learned reward, `thesis` as in thesis 6.4; `each_scene`
    chooses, in each scene, among many policies (one that is trained on the answers behind it is among them as soon as
    it is there): what the answers let expect decides nothing, the comparison does (`meet_your_robot` with
    `preferred`). prior (of `align`): by the light of what own answers are read before a policy
    is called surely better for this person, or chosen per scene; `none` of others', `earlier_participants` of those of
    the study, the same version and group who consented to training, `people_in_general` of what raters of still moments
    found comfortable (distance, from which side, things); what own answers do not bear out counts less with each of
    them. ask_on (of `align`): further pairs where what was
    learned is not surely better for this very person.
    """

    model_config = an_example({"job": "align", "recipe": "instant", "while": {"questionnaire": "usability"}})

    once = True
    for_everybody = True
    begins = "train"

    job: Literal["align", "demonstrations"] = "align"
    on: Literal["own_answers"] = "own_answers"
    recipe: Literal["instant", "each_scene", "fine_tuning", "thesis"] = "instant"
    prior: Prior = "none"
    meanwhile: Meanwhile | None = Field(None, alias="while")
    give_up_after_s: int = Field(120, ge=1, le=1800)  # ours
    ask_on: AskOn | None = Field(None, description="default: nothing more is asked, and nothing compared")

    def plan(self, at: Planning) -> list[Step]:
        steps: list[Step] = []
        if self.meanwhile:
            used = self.meanwhile.questionnaire
            steps.append(QuestionnaireStep.of(f"{at.key}.{used}", used, stage=at.key))
        if at.of(ComparisonStage):  # otherwise there is nothing to wait for
            steps.append(WaitStep(kind="wait", key=f"{at.key}.wait", stage=at.key))
            steps += self._further(self.ask_on, at) if self.ask_on else ()
        return steps

    def _further(self, ask_on: AskOn, at: Planning) -> Iterator[Step]:
        for place in range(1, len(ask_on.rounds) + 1):
            yield from ask_on.round_steps(at.key, place, at.view, at.random)
            yield WaitStep(kind="wait", key=f"{at.key}.wait_{place + 1}", stage=at.key, again=True)

    @property
    def views(self) -> set[View]:
        return {self.ask_on.view} if self.ask_on and self.ask_on.view else set()

    def needs(self) -> Needs:
        return Needs(own=self.ask_on.at_most) if self.ask_on else Needs()

    def further_seconds(self, pace: Pace) -> float:
        return self.ask_on.seconds(pace) if self.ask_on else 0.0

    def numbers(self) -> dict[str, int]:
        return {"further_pairs": self.ask_on.at_most} if self.ask_on else {}

    def problems(self, here: Path, stages: Sequence[Stage], source: Source) -> Iterator[Problem]:
        if self.recipe == EACH_SCENE:
            yield from self._each_scene_problems(here, stages, source)
        if self.ask_on is None:
            return
        if self.job != "align":
            yield source.problem((*here, "ask_on"), "needs job align: it asks further pairs, and paths have none")
        elif not any(isinstance(stage, ComparisonStage) for stage in stages):
            yield source.problem((*here, "ask_on"), "needs a comparison stage: without one nobody is shown anything")

    def _each_scene_problems(self, here: Path, stages: Sequence[Stage], source: Source) -> Iterator[Problem]:
        if self.job != "align":
            yield source.problem((*here, "recipe"), "needs job align: it learns from choices")
        if self.ask_on is not None:
            yield source.problem(
                (*here, "ask_on"), "cannot stand beside recipe each_scene, whose comparison decides; ask more before it"
            )
        compared = next((stage for stage in stages if isinstance(stage, ComparisonStage)), None)
        if compared is not None and "base" not in compared.arms:
            yield source.problem(
                (*here, "recipe"), "each_scene needs a comparison with base: it decides who is shown it"
            )

    def questionnaires(self) -> Iterator[tuple[str, Path]]:
        if self.meanwhile:
            yield self.meanwhile.questionnaire, ("while", "questionnaire")


class WaitStep(Step):
    """Planned by the stages `train` and `evaluation`. again: after further pairs."""

    kind: Literal["wait"]
    again: bool = False

    @property
    def further(self) -> bool:
        return self.again


class Wait(Kind[WaitStep, Confirmed]):
    name = "wait"
    step = WaitStep
    stages = {"train": TrainStage}
    goes_on = True
    begun = {"train": alignment_jobs.start_training}

    def payload(self, step: WaitStep, page: Page) -> dict[str, Any]:
        return {"learns_from": page.frozen.learns_from}

    def payload_now(self, step: WaitStep, moment: Moment) -> dict[str, Any]:
        return {"may_ask_on": True} if self._round_after(moment) else {}

    def is_asked(self, step: WaitStep, moment: Moment) -> bool:
        return not step.again or moment.session.personalisation is None

    def may_come(self, step: WaitStep, moment: Moment) -> bool:
        return False

    def check_time(self, step: WaitStep, moment: Moment, value: Mapping[str, Any]) -> None:
        raise moment.refusal("still_waiting", "This step goes on by itself.")

    def waits(self, step: WaitStep, moment: Moment) -> bool:
        return alignment_jobs.outcome_of(moment) is None

    def settle(self, step: WaitStep, acting: Acting) -> int | None:
        """Once the job has ended or is late: to the first comparison or rollout to be rated, past all that needs a
        trial and the guess if there is none. To further pairs where they may change the outcome."""
        outcome = alignment_jobs.outcome_of(acting)
        if outcome is None:
            return None
        more = self._round_after(acting)
        if more is not None and outcome == "not_surely_better":
            log_event(acting.s, "asked_on", session_id=acting.session.id, round=more.round, pairs=more.pairs)
            return acting.session.position + 1
        shown = make_comparisons(acting) if outcome == "shown" else 0
        acting.session.personalisation = outcome
        acting.session.predictive_check = alignment_jobs.check_of(acting.s, acting.session)
        log_event(acting.s, "personalisation", session_id=acting.session.id, outcome=outcome, comparisons=shown)
        alignment_jobs.end_what_nobody_waits_for(acting.s, acting.session, outcome)
        past = () if shown else (ComparisonStep, GuessStep)
        after = range(acting.session.position + 1, len(acting.plan))
        return next(i for i in after if not isinstance(acting.plan[i], past))

    def _round_after(self, moment: Moment) -> AskingOnStep | None:
        """The further pairs that may follow this wait."""
        after = moment.session.position + 1
        step = moment.plan[after] if after < len(moment.plan) else None
        return step if isinstance(step, AskingOnStep) else None


KIND = Wait()
