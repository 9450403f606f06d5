"""Kind of step `demonstration`: a path is drawn on the floor, rolled out at once, and kept or drawn again.

What becomes of strokes and of walks beside them is `drawing/`'s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, GetJsonSchemaHandler, TypeAdapter, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.grammar.parts import an_example
from desirepath.grammar.words import PersonMode, View
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import setups_with
from desirepath.store.models import Session
from desirepath.study.drawing import paths, strokes, walks
from desirepath.study.kind import Acting, Kind, Moment, Page, Simulated
from desirepath.study.refusals import Refused
from desirepath.study.steps import Pace, Planning, Stage, Step
from desirepath.study.wire import Answer, BadValue, Besides, Flag, Progress

SECONDS_PER_PATH = 50  # drawn in about 10 s and driven at 0.2 m/s over 6 m, ours; redrawing included


class DemonstrationsStage(Stage):
    """Paths are drawn in `pairs` situations of an environment (ch. 2; `home`: ch. 3, whose controllers go by a depth
    camera), `per_pair` in each and up to `up_to`.

    Situations come in an order drawn by lot, the first `pairs` of the environment's four. at_once: each path counts in
    the posterior of the session, as a choice among what the conditioned policy does there at other weights: queries
    that are chosen after it follow it. That is in the study room, whose conditioned policy that is, and no controller
    is trained of paths there.
    """

    model_config = an_example({"environment": "corridor", "pairs": 2, "per_pair": 2})

    asks = True
    teaches = "demonstrations"
    sets_view = True
    draws = True

    environment: Literal["corridor", "room", "home", "study_room"]
    pairs: int = Field(4, ge=1, le=4)
    per_pair: int = Field(3, ge=1, le=10)  # ch. 2: three to five
    up_to: int | None = Field(None, ge=1, le=10, description="default: per_pair, so that nothing is left open")
    at_once: bool = False
    view: View = "top_down"
    person: PersonMode = Field(
        "still",
        description="still: stands; walks: the participant walks in first person while the robot drives the path; "
        "recorded: the participant first chooses one of three walks that were planned by a program",
    )

    @model_validator(mode="after")
    def _counts_fit(self) -> DemonstrationsStage:
        if self.up_to is not None and self.up_to < self.per_pair:
            raise ValueError(f"up_to = {self.up_to} must be at least per_pair = {self.per_pair}")
        if self.person == "recorded" and self.view != "top_down":
            raise ValueError(
                f"view = {self.view!r} must be top_down with person: recorded: the walk is shown on the floor"
            )
        counted = setups_with("path_weights")
        if self.at_once != (self.environment in counted):
            where = " or ".join(counted)
            raise ValueError(f"at_once = {self.at_once} in {self.environment}: paths count at once in {where} alone")
        if self.at_once and self.person != "still":
            raise ValueError(f"person = {self.person!r} must be still where paths count at once")
        return self

    @property
    def most_per_pair(self) -> int:
        return self.up_to or self.per_pair

    def plan(self, at: Planning) -> list[Step]:
        """One step per path that is drawn, situation by situation; those beyond `per_pair` can be left out."""
        return [
            DemonstrationStep.model_validate(
                {
                    "key": f"{at.key}.{pair + 1}.{number}",
                    "kind": "demonstration",
                    "stage": at.key,
                    "environment": self.environment,
                    "pair": pair,
                    "view": self.view,
                    **({"person": self.person} if self.person != "still" else {}),
                    **({"at_once": True} if self.at_once else {}),
                    "place": place,
                    "places": self.pairs,
                    "number": number,
                    "of": self.per_pair if number <= self.per_pair else self.most_per_pair,
                    "optional": number > self.per_pair,
                }
            )
            for place, pair in enumerate((int(i) for i in at.random.permutation(self.pairs)), 1)
            for number in range(1, self.most_per_pair + 1)
        ]

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return self.pairs * self.per_pair * SECONDS_PER_PATH

    def numbers(self) -> dict[str, int]:
        return {"places": self.pairs, "paths": self.pairs * self.per_pair}


class DemonstrationStep(walks.PathStep):
    """place: which of this participant's situations; number, of: its paths; at_once: as of the stage."""

    kind: Literal["demonstration"]
    place: int
    places: int
    number: int
    of: int
    at_once: bool = False


_WHICH = "must be the id of the stroke that is kept"


def _id(given: object) -> object:
    if given is not None and not isinstance(given, str):
        raise ValueError(_WHICH)
    return given


class DemonstrationAnswer(Answer):
    """Which stroke is kept, or that a further path is not wanted."""

    stroke: Annotated[str | None, BeforeValidator(_id)] = None
    skipped: Flag = False


class DrawingState(Progress):
    """How far a drawn path is."""

    phase: Literal["drawing", "ready", "driving", "watched"]
    walking: bool = Field(description="whether the participant walks beside the rollout")
    met: bool = Field(description="whether the robot met the participant on the last walk")
    stroke: str | None = Field(description="the drawn path that can be kept")
    duration_s: float | None = Field(description="of the rollout of the drawn path")
    playback_id: str | None = Field(description="what is playing now")
    may_skip: bool
    attempts: int


class _AsScene:
    """Published as the scene that it is; built and measured where it is stored, so not checked again on its way out."""

    @classmethod
    def __get_pydantic_json_schema__(cls, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(TypeAdapter(Scene).core_schema)


class AboutDemonstration(Besides):
    """scenes: one per walk that is offered, or the one."""

    scenes: list[Annotated[dict[str, Any], _AsScene]] | None = None


def drawing_of(session: Session) -> DemonstrationStep:
    """The step that the session stands at, which must be one at which a path is drawn. Raises Refused."""
    stored = session.plan[session.position]
    if stored["kind"] == Demonstration.name:
        return DemonstrationStep.model_validate(stored)
    raise Refused(409, "not_current_step", "The session is at another step.", session_id=session.id)


class Demonstration(Kind[DemonstrationStep, DemonstrationAnswer]):
    name = "demonstration"
    step = DemonstrationStep
    answers = DemonstrationAnswer
    progress = DrawingState
    besides = AboutDemonstration
    stored = {"stroke": "id of the stroke that is kept", "skipped": "true where a further path was not wanted"}
    stages = {"demonstrations": DemonstrationsStage}
    shows = "paper"

    def payload(self, step: DemonstrationStep, page: Page) -> dict[str, Any]:
        shown = {name: getattr(step, name) for name in ("view", "place", "places", "number", "of", "optional")}
        offered = len(walks.PLANNED) if step.person == "recorded" else 0
        return shown | {"person": step.person, "walks": offered}

    def interrupt(self, step: DemonstrationStep, s: DatabaseSession, session: Session, reason: str) -> bool | None:
        return strokes.interrupt(s, session, step, reason=reason)

    def state(self, step: DemonstrationStep, moment: Moment) -> dict[str, Any]:
        return paths.state_of(moment.s, moment.session, step)

    def is_asked(self, step: DemonstrationStep, moment: Moment) -> bool:
        """Further paths of a situation only until one of them was skipped."""
        return not step.optional or step.number - 1 <= paths.count_kept(moment.s, moment.session.id, step)

    def may_come(self, step: DemonstrationStep, moment: Moment) -> bool:
        return not step.optional

    def check(self, step: DemonstrationStep, answer: DemonstrationAnswer, page: Page) -> dict[str, Any]:
        if answer.skipped and step.optional:
            return {"skipped": True}
        if answer.stroke is None:
            raise BadValue("value.stroke", None, _WHICH)
        return {"stroke": answer.stroke[:32]}

    def keep(self, step: DemonstrationStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        strokes.keep(acting.s, acting.session, step, stored)
        return {}

    def tell_simulated(self, step: DemonstrationStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        scene = paths.scene_of(step)
        offered: list[Scene] = [walks.scene_with(scene, walk) for walk in walks.offer_walks(step)]
        return {"scenes": [walked.as_dict() for walked in offered or [scene]]}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        return participant.draw(step)


KIND = Demonstration()
