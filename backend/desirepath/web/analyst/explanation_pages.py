"""The analysts' page of what moved the robot: one policy in a scene, or two side by side, thing by thing.

Which policies and which scene an address asks for is `chosen_policies.py`'s; `figure_process.py` draws the figures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Request
from starlette.responses import Response

from desirepath.explain.flow_words import ExplanationWords
from desirepath.explain.methods import COMMANDS, METHODS, AttributionError, Command, Method, check_method
from desirepath.store.artefacts import ArtefactStore
from desirepath.web.analyst.chosen_policies import (
    NOT_DRAWN,
    SIDES,
    Asked,
    Side,
    find_asked,
    form_of,
    no_file,
    problem_of,
)
from desirepath.web.analyst.flow_pages import SHOWN
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.figure_process import ExplanationOrder
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page
from desirepath.web.core.media import FIGURE_ENDINGS, answers_with, figure_file
from desirepath.web.core.moment_charts import (
    MomentChart,
    ScoresOverTime,
    compare_charts,
    lanes_of,
    moment_chart,
    scores_in,
)

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
        at = {} if self.at_s is None else {"at": f"{self.at_s:g}"}
        return urlencode({"method": self.method, "command": self.command, **at})


@router.get("/lab/explain")
def explanation(request: Request, database: Db, files: Files) -> Response:
    """The form, and below it a figure and the most important things for each policy."""
    t = services_of(request).texts.get(lab_language(request))
    asked = options = problem = None
    shown: list[Explained] = []
    try:
        with database.session() as s:
            asked = find_asked(request, s)
        options = _options(request.query_params)
        if asked is not None:
            shown = [_drawn(request, t, files, asked, options, side) for side in asked.sides]
    except AttributionError as wrong:
        problem = t("explanation.problem", message=str(wrong))
    except NOT_DRAWN as wrong:
        problem = problem_of(t, wrong)
    thing = ExplanationWords(things=t.table("explanation.things")).thing
    return lab_page(
        request,
        "analyst/explanation.html",
        status=422 if problem else 200,
        **form_of(request, database),
        methods=METHODS,
        commands=COMMANDS,
        problem=problem,
        asked=asked,
        options=options,
        shown=shown,
        thing=thing,
        charts=[side.chart(t, thing) for side in shown],
        looked_at=compare_charts(*(side.over_time for side in shown)) if len(shown) == len(SIDES) else [],
        command_line=command_line,
    )


@router.get("/lab/explain/{letter}/{name}", response_class=Response, responses=answers_with(*FIGURE_ENDINGS))
def explanation_file(request: Request, letter: str, name: str, database: Db, files: Files) -> Response:
    """One file of one side's figure that the rest of the address asks for."""
    t = services_of(request).texts.get(lab_language(request))
    try:
        with database.session() as s:
            asked = find_asked(request, s)
        if asked is None or letter not in SIDES[: len(asked.sides)]:
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
