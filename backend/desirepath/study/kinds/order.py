"""Kind of step `order`: several trajectories of one scene, watched one after the other, then all put in order, the best
one picked, or sorted into piles (comparative feedback).

They are a query's two and others of the same scene: of the query set where it has more there, else of the setup's
conditioned policy at different preference weights (`personalising/several_drives.py`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

from pydantic import Field

from desirepath.grammar.conditions import Crossed
from desirepath.grammar.parts import Localized, Part, an_example
from desirepath.grammar.source import Path
from desirepath.grammar.texts import local
from desirepath.grammar.words import TOLERANCE_S
from desirepath.store.sides import is_answer_to_several
from desirepath.study.kind import Acting, Kind, Moment, Page, Simulated, make_trial
from desirepath.study.personalising.several_drives import choose_drives, durations_s
from desirepath.study.plan.asked_queries import DrawnQueries, Needs
from desirepath.study.steps import Pace, Planning, Stage, Step
from desirepath.study.wire import BadValue, Besides, InRoomAnswer, WholeNumber

FEWEST, MOST = 3, 6
PILES = 4
PLACE_S = 3.0  # ours: for each place after the first, or pile
COLOURS = ((196, 84, 10), (30, 104, 176), (136, 60, 150), (14, 122, 104), (176, 40, 72), (120, 98, 12))
"""Of the ways on the floor and their numbers, white upon them readable."""

Ask = Literal["order", "best", "groups"]


class Orders(Part):
    """`count` scenes with `of` trajectories each, all watched, then asked for: the whole order, the best one alone, or
    `piles` piles from least to most liked. By Plackett and Luce's model, piles as ratings, they count in the posterior
    of the session; trainings learn from the choices that they imply.
    """

    count: int = Field(ge=1, le=50)
    of: int = Field(4, ge=FEWEST, le=MOST)
    ask: Ask = "order"
    piles: int = Field(3, ge=2, le=PILES)
    question: Localized | None = Field(None, description="default: which one they like best")

    def seconds_each(self, pace: Pace) -> float:
        """How long one takes."""
        return self.of * pace.trial_s / 2 + PLACE_S * (1 if self.ask == "best" else self.of - 1)

    def plan_steps(self, prefix: str, where: Mapping[str, Any], drawn: DrawnQueries) -> list[OrderStep]:
        """Its steps under one condition."""
        fields = {"kind": "order", **where, **self.model_dump(include={"of", "ask"})}
        fields |= {"piles": self.piles} if self.ask == "groups" else {}
        fields |= {"question": self.question} if self.question else {}
        return [
            OrderStep.model_validate(
                {
                    **fields,
                    "key": f"{prefix}.order_{number:02d}",
                    "number": number,
                    "count": self.count,
                    "query": pair.query,
                    "trajectories": [pair.trajectory_a, pair.trajectory_b],
                }
            )
            for number, pair in enumerate(drawn.pairs(self.count, shared=False), 1)
        ]


class OrderStage(Crossed, Orders, Stage):
    """Orders on their own; among the pairs of a block they are its `orders`."""

    model_config = an_example({"view": "top_down", "count": 4, "of": 4})

    asks = True
    teaches = "align"
    sets_view = True

    def needs(self) -> Needs:
        return Needs(own=self.count * len(self.conditions(0)))

    def trials_asked(self) -> int:
        return self.count

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return self.count * len(self.conditions(0)) * self.seconds_each(pace)

    def local_texts(self) -> Iterator[tuple[dict[str, str], Path]]:
        if self.question is not None:
            yield self.question, ("question",)

    def plan(self, at: Planning) -> list[Step]:
        steps: list[Step] = []
        for condition in at.conditions:
            prefix = f"{at.key}.{condition.name}" if condition.name else at.key
            where = {"stage": at.key, "block": condition.name or at.key, **condition.shown}
            steps += self.plan_steps(prefix, where, at.drawn)
        return steps


class OrderStep(Step):
    """query, trajectories: that are shown in any case; of: how many with others of the same scene. number, count: among
    its like. piles: of `groups` alone."""

    kind: Literal["order"]
    query: str
    trajectories: list[str]
    of: int
    ask: Ask
    number: int
    count: int
    piles: int | None = None
    question: dict[str, str] | None = None
    role: Literal["regular"] = "regular"


class OrderAnswer(InRoomAnswer):
    """Trajectories by their numbers as shown, from 1."""

    order: list[WholeNumber] | None = Field(None, max_length=MOST, description="the best first; of `best` that one")
    groups: list[list[WholeNumber]] | None = Field(
        None, max_length=PILES, description="piles of numbers, the least liked first"
    )


class AboutOrder(Besides):
    query: str | None = None
    ask: Ask | None = None
    piles: int | None = None


class Order(Kind[OrderStep, OrderAnswer]):
    name = "order"
    step = OrderStep
    answers = OrderAnswer
    besides = AboutOrder
    stages = {"order": OrderStage}
    stored = {
        "order": "numbers of the trajectories as shown (of the trial's arms.shown), the best first; of `best` one",
        "groups": "instead: piles of numbers, the least liked first; a pile may be empty",
        "ask": "order, best or groups",
    }
    shows = "trajectories"
    trajectories = MOST
    previewed = True

    def payload(self, step: OrderStep, page: Page) -> dict[str, Any]:
        shown = {name: getattr(step, name) for name in ("view", "number", "count", "of", "ask", "piles")}
        return shown | {"question": local(step.question, page.language) if step.question else None, "colours": COLOURS}

    def payload_now(self, step: OrderStep, moment: Moment) -> dict[str, Any]:
        shown = moment.trial(step.key).shown
        return {"of": len(shown), "durations_s": durations_s(moment.s, shown)}

    def arrive(self, step: OrderStep, acting: Acting) -> None:
        """All can be watched at once, as the page does: whether they were is checked with the answer."""
        shown = choose_drives(acting, step.query, step.trajectories, step.of)
        make_trial(
            acting,
            step,
            kind="order",
            trajectory_a=shown[0],
            trajectory_b=shown[1],
            block=step.block or step.stage,
            query_id=step.query,
            phase="choosing",
            arms={"shown": shown},
        )

    def check(self, step: OrderStep, answer: OrderAnswer, page: Page) -> dict[str, Any]:
        if step.ask == "groups":
            if answer.groups is None or len(answer.groups) != step.piles:
                raise BadValue("value.groups", answer.groups, f"must be {step.piles} piles, the least liked first")
            return {"groups": answer.groups, "ask": step.ask}
        if answer.order is None:
            raise BadValue("value.order", None, "must be numbers of trajectories, the best first")
        return {"order": answer.order, "ask": step.ask}

    def keep(self, step: OrderStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        """Nothing more; refuses what cannot be of these trajectories, or comes before they can have been watched."""
        shown = acting.trial(step.key).shown
        if not is_answer_to_several(stored, len(shown)):
            field = "groups" if step.ask == "groups" else "order"
            what = "one" if step.ask == "best" else "each once"
            raise BadValue(f"value.{field}", stored[field], f"must be numbers from 1 to {len(shown)}, {what}")
        takes_s, stood_s = sum(durations_s(acting.s, shown)), acting.stood_s
        if not acting.session.simulated and stood_s is not None and stood_s < takes_s - TOLERANCE_S:
            message = f"Watching all takes {takes_s:.0f} s and began {stood_s:.0f} s ago."
            raise acting.refusal("too_early", message, step=step.key, needed_s=round(takes_s, 1))
        return {}

    def tell_simulated(self, step: OrderStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        return {"query": step.query, "ask": step.ask, "piles": step.piles}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        worth = participant.judge_several(step)
        best_first = sorted(range(1, len(worth) + 1), key=lambda number: -worth[number - 1])
        if step["ask"] != "groups":
            return {"order": best_first[: 1 if step["ask"] == "best" else None]}
        piles: list[list[int]] = [[] for _ in range(step["piles"])]
        for place, number in enumerate(reversed(best_first)):
            piles[place * len(piles) // len(best_first)].append(number)
        return {"groups": piles}


KIND = Order()
