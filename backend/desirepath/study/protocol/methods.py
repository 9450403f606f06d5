"""The stage `methods`: several ways to say how the robot should drive, one after the other, each with pages around it.

Every method is a condition in the order of the assignment, and its steps are of kinds that there are: trials, drawn
paths, a sentence, sliders. What robot each results in is `personalising/method_robots.py`'s; the blind comparison of
them is the stage `method_comparison`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar

from pydantic import Field, field_validator

from desirepath.grammar.conditions import Condition
from desirepath.grammar.parts import Part, an_example
from desirepath.grammar.source import Path, Problem, Source
from desirepath.grammar.words import View
from desirepath.simulation.setup_parts import PLACES
from desirepath.simulation.setups import setups_with
from desirepath.study.kinds.demonstration import SECONDS_PER_PATH, DemonstrationStep
from desirepath.study.kinds.live import TAKES_S, PersonSetup
from desirepath.study.kinds.method_comparison import TaughtByMethods
from desirepath.study.kinds.trial import PairAnswers, Queries, Trials, Viewing, plan_trials
from desirepath.study.kinds.tuning import TuningStep
from desirepath.study.kinds.wait import TrainStage
from desirepath.study.kinds.words import WordsStep
from desirepath.study.personalising.method_robots import METHODS, Method
from desirepath.study.plan.asked_queries import Needs
from desirepath.study.protocol.pages_around import BlockEntry, PagesAround
from desirepath.study.steps import Pace, Planning, Stage, Step

MOST_PATHS = 4  # of the setup's scenes


class Drawing(Part):
    """One path in each of `paths` scenes."""

    paths: int = Field(MOST_PATHS, ge=1, le=MOST_PATHS)


class MethodsStage(TaughtByMethods, PagesAround):
    """Ways to say how the robot should drive, each resulting in a robot of the participant's own.

    methods: which, in the order of the assignment. `choices` are queries of the query set; `drawing` a path in each of
    some scenes; `words` a sentence, corrected by sliders only if `correct_words`; `sliders` the weights by hand, from
    neutral, in `scenes` scenes. before, after: pages of every method, whose texts may have `{method}` in their names;
    between: pages between two.
    """

    model_config = an_example({"methods": ["words", "sliders"]})

    asks: ClassVar[bool] = True
    measures: ClassVar[bool] = True
    sets_view: ClassVar[bool] = True
    once: ClassVar[bool] = True
    for_everybody: ClassVar[bool] = True

    methods: list[Method] = Field(list(METHODS), min_length=2, max_length=len(METHODS))
    setup: PersonSetup = "study_room"
    view: View = "top_down"
    choices: list[Trials] = Field([Trials(queries=Queries(count=15))], min_length=1, max_length=10)
    drawing: Drawing = Drawing()
    correct_words: bool = False
    scenes: int = Field(3, ge=1, le=PLACES)
    before: list[BlockEntry] = []
    after: list[BlockEntry] = []
    between: list[BlockEntry] = []

    @field_validator("methods")
    @classmethod
    def _are_different(cls, methods: list[Method]) -> list[Method]:
        if len(set(methods)) < len(methods):
            raise ValueError(f"has a method twice: {', '.join(methods)}")
        return methods

    # ---- its conditions, as a block's

    @property
    def each(self) -> dict[str, list[str]]:
        """What is ordered, as a block's `each`."""
        return {"method": list(self.methods)}

    @property
    def one_of(self) -> None:
        """Everybody meets all of them."""

    @property
    def groups(self) -> list[dict[str, str]]:
        """One, as of a block without `one_of`."""
        return [{}]

    def conditions(self, _group: int) -> list[Condition]:
        """The methods as a block's conditions."""
        return [Condition(name=name, view=self.view, levels={"method": name}) for name in self.methods]

    # ---- what it needs and takes

    @property
    def draws(self) -> bool:  # type: ignore[override]  # a method may be left out
        """Whether drawing is one of the methods."""
        return "drawing" in self.methods

    def needs(self) -> Needs:
        return Needs(own=sum(choice.queries.count for choice in self.choices)) if "choices" in self.methods else Needs()

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        trials = sum(choice.queries.count + choice.queries.probes.trials for choice in self.choices)
        of_method = {
            "choices": trials * pace.trial_s,
            "drawing": self.drawing.paths * SECONDS_PER_PATH,
            "words": TAKES_S,
            "sliders": TAKES_S,
        }
        return sum(of_method[name] for name in self.methods) + self.pages() * pace.page_s

    def numbers(self) -> dict[str, int]:
        regular = sum(choice.queries.count for choice in self.choices if choice.queries.role == "regular")
        return {"pairs": regular, "paths": self.drawing.paths, "methods": len(self.methods)}

    # ---- its steps

    def plan_condition(
        self, prefix: str, condition: Condition, where: Mapping[str, Any], at: Planning
    ) -> Sequence[Step]:
        method = condition.name
        if method == "choices":
            pairs = at.drawn.pairs(sum(choice.queries.count for choice in self.choices), shared=False)
            return [
                *plan_trials(prefix, where, self.choices, Viewing(), PairAnswers(), iter(pairs), iter(()), at.random)
            ]
        if method == "drawing":
            return [
                DemonstrationStep.model_validate(
                    {
                        "key": f"{prefix}.{pair + 1}",
                        "kind": "demonstration",
                        **where,
                        "environment": self.setup,
                        "pair": pair,
                        "place": place,
                        "places": self.drawing.paths,
                        "number": 1,
                        "of": 1,
                    }
                )
                for place, pair in enumerate((int(k) for k in at.random.permutation(self.drawing.paths)), 1)
            ]
        fields = {**where, "key": f"{prefix}.weights", "setup": self.setup, "scenes": self.scenes}
        if method == "words":
            return [WordsStep.model_validate({"kind": "words", **fields, "correct": self.correct_words})]
        return [TuningStep.model_validate({"kind": "tuning", **fields, "start": "neutral"})]

    # ---- what cannot be

    def problems(self, here: Path, stages: Sequence[Stage], source: Source) -> Iterator[Problem]:
        for stage in stages:
            if stage is not self and (stage.teaches or isinstance(stage, TrainStage)):
                yield source.problem(
                    here, "cannot stand beside blocks, ratings, demonstrations or train: its robots are its own"
                )
                break
        drawn_in = setups_with("path_weights")
        if "drawing" in self.methods and self.setup not in drawn_in:
            known = " or ".join(drawn_in)
            yield source.problem((*here, "setup"), f"must be {known}, where paths can be drawn, or leave drawing out")
        if not any(choice.queries.role == "regular" for choice in self.choices):
            yield source.problem((*here, "choices"), "has practice trials only; add queries of role regular")
        for n, one in enumerate(self.choices):
            if one.queries.probes.transitivity:
                where = (*here, "choices", n, "queries", "probes", "transitivity")
                yield source.problem(where, "is for blocks; ask repeats here")
