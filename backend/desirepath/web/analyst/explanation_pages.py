"""The workspace's explanation: what moved the robot of one policy in a scene, or of two side by side, thing by thing.

On the stage the first one's reasons while it moves; below it figures, drawn by `figure_process.py`, which the page
fetches. Which policies and which scene an address asks for is `chosen_policies.py`'s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from fastapi import APIRouter, Depends, Request
from starlette.responses import Response

from desirepath.explain.flow_words import ExplanationWords
from desirepath.explain.methods import COMMANDS, METHODS, AttributionError, Command, Method, check_method
from desirepath.store.artefacts import ArtefactStore
from desirepath.web.analyst.chosen_policies import NOT_DRAWN, SIDES, Side, no_file, query_of
from desirepath.web.analyst.flow_pages import SHOWN
from desirepath.web.analyst.workspace import (
    EXPLAIN,
    Asked,
    Made,
    check_weights,
    find_asked,
    find_drawn,
    moved_on,
    part,
    roll_out_sides,
    words_of,
    workspace_page,
)
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.figure_process import ExplanationOrder
from desirepath.web.core.lab_frame import LabRefusal, lab_language
from desirepath.web.core.media import FIGURE_ENDINGS, answers_with, figure_file
from desirepath.web.core.moment_charts import (
    MomentChart,
    ScoresOverTime,
    compare_charts,
    lanes_of,
    moment_chart,
    scores_in,
)
from desirepath.web.stage.replay_stages import Replay

if TYPE_CHECKING:  # the simulator comes with it; a server that starts need not wait for it
    from desirepath.explain.flow_files import FigureFiles

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])

LONGEST_S = 1000.0  # no trajectory is longer; a later moment is a mistyped one


@dataclass(frozen=True)
class Explained:
    """One side's figure. mark: changes with its content."""

    side: Side
    letter: str
    mark: str
    figure: FigureFiles

    @property
    def over_time(self) -> ScoresOverTime:
        return scores_in(self.figure.files["explanation.csv"])

    def chart(self, t: Catalogue, thing: Callable[[str], str]) -> MomentChart:
        """Its scores over time, with the cursor at the moment of the figure."""
        found = self.over_time
        lanes = lanes_of(found.things, found.scores, {name: thing(name) for name in found.things})
        return moment_chart(
            lanes,
            found.dt,
            title=t("explanation.over_time_of", name=self.side.name),
            time_label=t("explanation.words.time"),
            at_s=float(self.figure.numbers["at_s"]),
        )


@dataclass(frozen=True)
class Options:
    """How is explained, as the address says. at_s: None: where the robot slowed down or turned most."""

    method: Method
    command: Command
    at_s: float | None

    @property
    def query(self) -> str:
        at = None if self.at_s is None else f"{self.at_s:g}"
        return query_of(method=self.method, command=self.command, at=at)


@router.get("/lab/explain")
def explanation(request: Request, database: Db, files: Files) -> Response:
    """The stage on which the first policy moves with its reasons; the figures are fetched."""
    t = services_of(request).texts.get(lab_language(request))
    asked = shown = problem = None
    options = Options(METHODS[0], COMMANDS[0], None)
    try:
        with database.session() as s:
            asked = find_asked(request, s, EXPLAIN)
        options = _options(request.query_params)
        if asked is not None:
            if (onward := moved_on(request, asked, EXPLAIN)) is not None:
                return onward
            drawn, how = asked, options
            check_weights(files, asked)
            shown = Made(lambda: _replays(files, drawn, how))
    except AttributionError as wrong:
        problem = t("explanation.problem", message=str(wrong))
    except NOT_DRAWN as wrong:
        problem = words_of(request, wrong)
    return workspace_page(
        request,
        database,
        EXPLAIN,
        asked,
        problem=problem,
        shown=shown,
        methods=METHODS,
        commands=COMMANDS,
        options=options,
    )


@router.get("/lab/explain/figures")
def explanation_figures(request: Request, database: Db, files: Files) -> Response:
    """A figure and the most important things for each policy."""
    t = services_of(request).texts.get(lab_language(request))
    asked = options = problem = None
    figures: list[Explained] = []
    try:
        with database.session() as s:
            asked = find_drawn(request, s, EXPLAIN)
        options = _options(request.query_params)
        figures = [_drawn(request, t, files, asked, options, side) for side in asked.sides]
    except AttributionError as wrong:
        problem = t("explanation.problem", message=str(wrong))
    except NOT_DRAWN as wrong:
        problem = words_of(request, wrong)
    thing = ExplanationWords(things=t.table("explanation.things")).thing
    return part(
        request,
        "analyst/explanation_figures.html",
        problem=problem,
        asked=asked,
        options=options,
        shown=figures,
        thing=thing,
        charts=[side.chart(t, thing) for side in figures],
        looked_at=compare_charts(*(side.over_time for side in figures)) if len(figures) == len(SIDES) else [],
        command_line=command_line,
    )


def _replays(files: ArtefactStore, asked: Asked, options: Options) -> Iterator[Replay]:
    """Both move, at once; then with the reasons of the first one, as soon as they are known."""
    from desirepath.learning.policies.foreign import ForeignPolicy
    from desirepath.learning.policies.policy import Policy

    rollouts, names = roll_out_sides(files, asked)
    first = asked.sides[0].policy(files)
    if isinstance(first, Policy | ForeignPolicy):
        plain = Replay(rollouts, names, view=asked.view)
        yield plain
        from desirepath.web.core.explained_policy import explain_along

        _, _, explained = explain_along(first, rollouts[0], method=options.method, command=options.command)
        yield replace(plain, explained=explained)
        return
    from desirepath.explain.shown_explanation import ShownExplanation, people_of

    trajectory, looked = first.attended(rollouts[0].scene)
    scores = tuple(tuple(float(score) for score in row) for row in (*looked, looked[-1]))
    explained = ShownExplanation(people_of(trajectory.scene), scores, outlines=True, lidar=False)
    yield Replay((trajectory, *rollouts[1:]), names, explained=explained, view=asked.view)


@router.get("/lab/explain/{letter}/{name}", response_class=Response, responses=answers_with(*FIGURE_ENDINGS))
def explanation_file(request: Request, letter: str, name: str, database: Db, files: Files) -> Response:
    """One file of one side's figure that the rest of the address asks for."""
    t = services_of(request).texts.get(lab_language(request))
    try:
        with database.session() as s:
            asked = find_drawn(request, s, EXPLAIN)
        if letter not in SIDES[: len(asked.sides)]:
            raise LabRefusal(404, "no_figure")
        side = asked.sides[SIDES.index(letter)]
        made = _drawn(request, t, files, asked, _options(request.query_params), side)
    except AttributionError:
        raise LabRefusal(404, "no_figure") from None
    except NOT_DRAWN as wrong:
        return no_file(wrong)
    if name not in made.figure.files:
        raise LabRefusal(404, "no_figure")
    return figure_file(request, name, made.figure.files[name], shown=SHOWN, mark=made.mark)


def _options(given: Mapping[str, str]) -> Options:
    """Raises AttributionError for an unknown method or command, or a moment that is no number of seconds."""
    method, command = check_method(given.get("method") or METHODS[0], given.get("command") or COMMANDS[0])
    text = given.get("at", "").strip().replace(",", ".")
    if not text:
        return Options(method, command, None)
    try:
        at_s = float(text)
    except ValueError:
        at_s = math.nan
    if not 0 <= at_s <= LONGEST_S:
        raise AttributionError(f"at = {text[:20]!r}: must be seconds since the start, such as 1.4")
    return Options(method, command, at_s)


def _drawn(
    request: Request, t: Catalogue, files: ArtefactStore, asked: Asked, options: Options, side: Side
) -> Explained:
    method = "attention" if side.artefact.kind == "attention_policy" else options.method
    words: dict[str, Any] = {
        **{name: t(f"explanation.words.{name}") for name in ("x", "y", "time", "score", "speed", "turning")},
        "title": t(f"explanation.titles.{options.command}", method=t(f"explanation.methods.{method}")),
        "things": t.table("explanation.things"),
    }
    order = ExplanationOrder(
        side.name,
        side.policy(files).without_critic().to_bytes(),
        asked.scene_seed,
        options.method,
        options.command,
        options.at_s,
        words,
    )
    mark, figure = services_of(request).figures.draw(order)
    return Explained(side, SIDES[asked.sides.index(side)], mark, figure)


def command_line(asked: Asked, options: Options, side: Side) -> str:
    """What draws the same from the command line."""
    at = "" if options.at_s is None else f" --at {options.at_s:g}"
    return (
        f"desirepath policies explain {side.reference} --scene {asked.scene_seed} --method {options.method} "
        f"--command {options.command}{at} --out explanation"
    )
