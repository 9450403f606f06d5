"""The analysts' pages that compare policies: many at once; two with numbers and intervals, paired differences,
trajectories side by side.

Measuring is a job's; here its evaluation is shown. The 3D replay goes through `replay_stages.py`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from fastapi import APIRouter, Depends, Request
from markupsafe import Markup
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from desirepath.jobs.kinds import KINDS
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore, lineage
from desirepath.store.database import Database
from desirepath.store.models import Artefact, Job
from desirepath.store.shipped_policies import find_artefact, shipped_name
from desirepath.web.analyst.artefact_pages import is_comparison, without_archived
from desirepath.web.analyst.chosen_policies import query_of
from desirepath.web.analyst.compared_scenes import (
    SIDES,
    bins_of,
    choose_scenes,
    compare_scene,
    pair_rollouts,
    rollouts_in,
)
from desirepath.web.analyst.job_forms import form_fields
from desirepath.web.analyst.many_policies import (
    FIRST_SORT,
    MAIN,
    RATES,
    SameScenes,
    draw_together,
    find_measured_together,
)
from desirepath.web.core import svg_figures
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page, rights_in
from desirepath.web.core.media import answers_with, csv_response, figure_file
from desirepath.web.core.permits import seen_artefacts
from desirepath.web.lab.study_rows import slice_page
from desirepath.web.stage.camera_views import camera_views
from desirepath.web.stage.replay_stages import Replay

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])

MEASURES = {  # name in results -> digits that are shown
    "min_human_distance_m": 2,
    "path_length_m": 2,
    "time_s": 2,
    "mean_speed_m_s": 3,
    "accumulated_angle_rad": 2,
    "path_area_m2": 2,
    "min_obstacle_distance_m": 2,
    "self_intersections": 3,
    "personal_space_violations": 3,
    "personal_space_time_s": 2,
    "min_time_to_collision_s": 2,
    "stalled_time_s": 2,
    "mean_jerk_m_s3": 2,
    "path_irregularity_rad_m": 3,
    "spl": 3,
}


_DIGITS = dict.fromkeys(RATES, 1) | MEASURES


@dataclass(frozen=True)
class Row:
    """One number of the table: both policies with [low, high], the difference and ratio where they are known."""

    name: str
    rate: bool
    digits: int
    a: tuple[float, float, float]
    b: tuple[float, float, float]
    difference: tuple[float, float, float] | None
    ratio: tuple[float, float, float] | None

    @property
    def apart(self) -> bool:
        """Whether the interval of the difference leaves out zero."""
        return self.difference is not None and not self.difference[1] <= 0 <= self.difference[2]


@router.get("/lab/compare")
def compare(
    request: Request,
    database: Db,
    files: Files,
    policy_a: str = "",
    policy_b: str = "",
    weights_a: str = "",
    weights_b: str = "",
    archived: bool = False,
    sort: str = "",
) -> Response:
    """All that were measured in the same scenes; two to compare in new ones, and the comparisons there are."""
    chosen = {"policy_a": policy_a, "policy_b": policy_b, "weights_a": weights_a, "weights_b": weights_b}
    with database.session() as s:
        for name in ("policy_a", "policy_b"):
            called, _, weights = chosen[name].partition("@")
            if (artefact := find_artefact(s, called)) is not None:
                chosen |= {name: artefact.id, f"weights_{name[-1]}": chosen[f"weights_{name[-1]}"] or weights}
        groups, together, sort, measures = _together(request, s, files)
        if together is not None and not policy_a and not policy_b:  # two of them, the product's own first
            ids = sorted((one.policy.id for one in together.ordered(sort)), key=lambda one: shipped_name(one) is None)
            chosen |= dict(zip(("policy_a", "policy_b"), ids, strict=False))
        given = {name: value for name, value in chosen.items() if value}
        rights = rights_in(request)
        evaluated = select(Artefact).where(Artefact.kind == "evaluation", seen_artefacts(rights))
        evaluations = [
            evaluation
            for evaluation in s.scalars(evaluated.order_by(Artefact.created_at.desc()))
            if is_comparison(evaluation)
        ]
        shown, archived_count = without_archived(evaluations, archived)
        drawn = None
        if together is not None:
            here = f"/lab/compare?{_asked_of(request)}&sort="
            drawn = Markup(draw_together(_t(request), together, measures, _DIGITS, sort, here))  # noqa: S704 - escaped
        return lab_page(
            request,
            "analyst/compare_new.html",
            groups=groups,
            together=together,
            drawn=drawn,
            sort=sort,
            query=_asked_of(request, sort=sort),
            every="measures" in request.query_params,
            fields=form_fields(s, KINDS["compare"], given, rights),
            comparisons=shown,
            archived=archived,
            archived_count=archived_count,
        )


@router.get("/lab/compare/policies.svg", response_class=Response, responses=answers_with("svg"))
def together_svg(request: Request, database: Db, files: Files) -> Response:
    with database.session() as s:
        together, sort, measures = _drawn_together(request, s, files)
        drawn = draw_together(_t(request), together, measures, _DIGITS, sort, None)
    return figure_file(request, "policies.svg", drawn.encode(), shown=("svg",))


@router.get("/lab/compare/policies.csv", response_class=Response, responses=answers_with("csv"))
def together_csv(request: Request, database: Db, files: Files) -> Response:
    """Every measure of every policy, with the bounds of its interval."""
    with database.session() as s:
        together, sort, _ = _drawn_together(request, s, files)
        header = ["policy", "id", "simulated", "setup", "scenes", "seed"]
        header += [f"{measure}{end}" for measure in together.measures for end in ("", "_low", "_high")]
        about = (together.setup, together.scenes, together.seed)
        rows = [
            [one.name, one.policy.id, int(one.policy.simulated), *about]
            + [value for measure in together.measures for value in one.values[measure]]
            for one in together.ordered(sort)
        ]
    return csv_response(header, rows, "policies.csv")


def _together(
    request: Request, s: DatabaseSession, files: ArtefactStore
) -> tuple[list[SameScenes], SameScenes | None, str, list[str]]:
    """All groups, the one that the address asks for or the largest, by what it is sorted, what is drawn of it. Raises
    LabRefusal for what there is not."""
    given = request.query_params
    groups = find_measured_together(s, files, rights_in(request), [*RATES, *MEASURES])
    together = next((one for one in groups if one.key == given.get("of")), None)
    if together is None and given.get("of"):
        raise LabRefusal(404, "no_figure")
    together = together or next(iter(groups), None)
    if together is None:
        return [], None, "", []
    known = together.measures
    sort = given.get("sort") or (FIRST_SORT if FIRST_SORT.lstrip("-") in known else f"-{known[0]}")
    if sort.removeprefix("-") not in known:
        raise LabRefusal(404, "no_figure")
    main = [measure for measure in MAIN if measure in known]
    return groups, together, sort, known if "measures" in given or not main else main


def _drawn_together(request: Request, s: DatabaseSession, files: ArtefactStore) -> tuple[SameScenes, str, list[str]]:
    """The same for a file of the figure. Raises LabRefusal where there is none."""
    _, together, sort, measures = _together(request, s, files)
    if together is None:
        raise LabRefusal(404, "no_figure")
    return together, sort, measures


def _asked_of(request: Request, **more: str) -> str:
    """What of the address says which policies and measures are drawn."""
    given = request.query_params
    kept = {"of": given.get("of"), "measures": "all" if "measures" in given else None, **more}
    return query_of(**kept)


@router.get("/lab/compare/{artefact_id}")
def comparison(
    request: Request,
    artefact_id: str,
    database: Db,
    files: Files,
    measure: str = "min_human_distance_m",
    only: str = "",
    page: int = 1,
    scene: int | None = None,
    stage: bool = False,
) -> Response:
    """The table, the histogram of one measure, the scenes behind a number or a bar, and both trajectories in one.

    only: which scenes (`compared_scenes.py`); scene: the number of the one that is shown, default the first of them.
    """
    t = _t(request)
    with database.session() as s:
        artefact, content = _comparison(s, files, artefact_id)
        measure = _measure(content, measure)
        numbers = choose_scenes(content, only, measure)
        if numbers is None:
            raise LabRefusal(404, "no_figure")
        listed = slice_page(numbers.tolist(), page)
        seeds = content["scenes"]["scene_seed"]
        number = scene if scene is not None else next(iter(listed.rows), 0)
        number = min(max(0, number), len(seeds) - 1)
        pair = rollouts_in(s, files, content, number)
        job = s.get(Job, artefact.job_id) if artefact.job_id else None
        sides = [s.get(Artefact, policy["id"]) for policy in content["policies"]]
        tree = lineage(s, artefact.id)
    plan = replay = None
    if pair is not None:
        names = _names(content)
        title = t("analyst.compare.plan", scene=str(seeds[number]))
        plan = Markup(svg_figures.rollouts(pair[0].scene, pair, names=names, title=title))  # noqa: S704
        if stage:
            replay = services_of(request).replays.grant(
                Replay(pair, tuple(names), pictures=camera_views(t, pair, names))
            )
    return lab_page(
        request,
        "analyst/comparison.html",
        artefact=artefact,
        content=content,
        job=job,
        sides=sides,
        rows=_rows(content),
        measure=measure,
        measures=_measures_of(content),
        histogram=Markup(_histogram(request, content, measure, artefact.id)),  # noqa: S704 - made by us, texts escaped
        only=only,
        filter_words=_filter_words(t, content, only, measure, len(numbers)),
        filters=_filters(content),
        listed=listed,
        scenes=[compare_scene(content, row, measure) for row in listed.rows],
        shown=compare_scene(content, number, measure),
        kept=len(content["replays"]),
        pair=pair,
        plan=plan,
        replay=replay,
        answers=len(tree.all_answers()),
    )


def _names(content: dict[str, Any]) -> list[str]:
    return [f"{letter}: {one['name']}" for letter, one in zip("AB", content["policies"], strict=True)]


def _filters(content: dict[str, Any]) -> dict[str, int]:
    """Which scenes can be asked for beside the bars -> how many there are; only those that there are."""
    names = ["", "apart", *(f"{side}-{outcome}" for side in SIDES for outcome in ("collision", "timeout"))]
    found = {name: choose_scenes(content, name, "") for name in names}
    return {name: len(numbers) for name, numbers in found.items() if numbers is not None and (len(numbers) or not name)}


def _filter_words(t: Catalogue, content: dict[str, Any], only: str, measure: str, count: int) -> str:
    """Which scenes are listed, in words."""
    if not only.startswith("bar-"):
        return t(f"analyst.compare.only.{only or 'all'}", count=count)
    low, high = _between(t, content, measure, int(only.removeprefix("bar-")))
    return t("analyst.compare.only.bar", count=count, measure=t(f"analyst.metrics.{measure}"), low=low, high=high)


def _between(t: Catalogue, content: dict[str, Any], measure: str, bar: int) -> tuple[str, str]:
    """Where a bar begins and ends; one digit more than the measure has."""
    edges = bins_of(content, measure)[0].edges
    low, high = (t.number(float(edges[min(k, len(edges) - 1)]), MEASURES[measure] + 1) for k in (bar, bar + 1))
    return low, high


@router.get("/lab/compare/{artefact_id}/table.csv")
def table_csv(artefact_id: str, database: Db, files: Files) -> Response:
    with database.session() as s:
        _, content = _comparison(s, files, artefact_id)
    header = ["number"] + [
        f"{what}{end}" for what in ("a", "b", "difference", "ratio") for end in ("", "_low", "_high")
    ]
    nothing = ("", "", "")
    rows = [[r.name, *r.a, *r.b, *(r.difference or nothing), *(r.ratio or nothing)] for r in _rows(content)]
    return csv_response(header, rows, "comparison.csv")


@router.get("/lab/compare/{artefact_id}/scenes.csv")
def scenes_csv(artefact_id: str, database: Db, files: Files) -> Response:
    """Every scene with what both policies did in it: what all numbers and figures of the comparison are made from."""
    with database.session() as s:
        _, content = _comparison(s, files, artefact_id)
    columns: dict[str, list[Any]] = {"scene_seed": content["scenes"]["scene_seed"]}
    for letter, per_policy in zip("ab", content["scenes"]["policies"], strict=True):
        columns |= {f"{name}_{letter}": values for name, values in per_policy.items()}
    return csv_response(list(columns), zip(*columns.values(), strict=True), "scenes.csv")


@router.get("/lab/compare/{artefact_id}/difference-{measure}.svg")
def difference_svg(request: Request, artefact_id: str, measure: str, database: Db, files: Files) -> Response:
    with database.session() as s:
        _, content = _comparison(s, files, artefact_id)
    return Response(_histogram(request, content, _measure(content, measure)), media_type="image/svg+xml")


@router.get("/lab/compare/{artefact_id}/difference-{measure}.csv")
def difference_csv(artefact_id: str, measure: str, database: Db, files: Files) -> Response:
    with database.session() as s:
        _, content = _comparison(s, files, artefact_id)
    _, seeds, a, b = pair_rollouts(content, _measure(content, measure))
    rows = zip(seeds.tolist(), a.tolist(), b.tolist(), (b - a).tolist(), strict=True)
    return csv_response(["scene_seed", "a", "b", "difference"], rows, f"difference_{measure}.csv")


@router.get("/lab/compare/{artefact_id}/scene-{scene}.svg")
def scene_svg(request: Request, artefact_id: str, scene: int, database: Db, files: Files) -> Response:
    pair, names, seed = _pair(artefact_id, scene, database, files)
    title = _t(request)("analyst.compare.plan", scene=str(seed))
    return Response(svg_figures.rollouts(pair[0].scene, pair, names=names, title=title), media_type="image/svg+xml")


@router.get("/lab/compare/{artefact_id}/scene-{scene}.csv")
def scene_csv(artefact_id: str, scene: int, database: Db, files: Files) -> Response:
    """Both trajectories' poses: time (s), x, y (m), heading (rad)."""
    pair, _, _ = _pair(artefact_id, scene, database, files)
    rows = [
        [letter, f"{time:.1f}", *(f"{value:.4f}" for value in pose)]
        for letter, one in zip("AB", pair, strict=True)
        for time, pose in zip(one.times, one.poses, strict=True)
    ]
    return csv_response(["policy", "time_s", "x_m", "y_m", "yaw_rad"], rows, f"scene_{scene}.csv")


def _pair(
    artefact_id: str, number: int, database: Database, files: ArtefactStore
) -> tuple[tuple[Trajectory, Trajectory], list[str], int]:
    with database.session() as s:
        _, content = _comparison(s, files, artefact_id)
        seeds = content["scenes"]["scene_seed"]
        pair = rollouts_in(s, files, content, number) if 0 <= number < len(seeds) else None
    if pair is None:
        raise LabRefusal(404, "no_figure")
    return pair, _names(content), seeds[number]


def _comparison(s: DatabaseSession, files: ArtefactStore, artefact_id: str) -> tuple[Artefact, dict[str, Any]]:
    artefact = s.get(Artefact, artefact_id)
    if artefact is None or not is_comparison(artefact):
        raise LabRefusal(404, "no_artefact")
    if artefact.quarantined_at is not None:
        raise LabRefusal(410, "quarantined")
    content: dict[str, Any] = json.loads(files.get(artefact.id))
    return artefact, content


def _measure(content: dict[str, Any], name: str) -> str:
    if name not in _measures_of(content):
        raise LabRefusal(404, "no_figure")
    return name


def _measures_of(content: dict[str, Any]) -> dict[str, int]:
    """Those that this comparison has: ones made before the social metrics lack them."""
    return {name: digits for name, digits in MEASURES.items() if name in content["policies"][0]["measured"]}


def _rows(content: dict[str, Any]) -> list[Row]:
    measured = [policy["measured"] for policy in content["policies"]]
    compared = content["compared"]

    def of(side: dict[str, Any], name: str) -> tuple[float, float, float]:
        low, high = side["intervals"][name]
        return side[name], low, high

    def bounds(estimate: dict[str, float] | None) -> tuple[float, float, float] | None:
        return (estimate["value"], estimate["low"], estimate["high"]) if estimate else None

    rows = [
        Row(
            name,
            True,
            1,
            of(measured[0], name),
            of(measured[1], name),
            bounds(compared["success_difference"]) if name == "success_rate" else None,
            None,
        )
        for name in RATES
    ]
    for name, digits in _measures_of(content).items():
        paired = compared["paired"][name] if compared["both_succeed"] else {}
        rows.append(
            Row(
                name,
                False,
                digits,
                of(measured[0], name),
                of(measured[1], name),
                bounds(paired.get("difference")),
                bounds(paired.get("ratio")),
            )
        )
    return rows


def _histogram(request: Request, content: dict[str, Any], measure: str, linked: str | None = None) -> str:
    """linked: the comparison's id, where its bars lead to their scenes."""
    t = _t(request)
    bars, mean = bins_of(content, measure)
    counts = bars.counts
    name = t(f"analyst.metrics.{measure}")

    def link(bar: int) -> tuple[str, str]:
        low, high = _between(t, content, measure, bar)
        words = t("analyst.compare.bar", count=int(counts[bar]), low=low, high=high)
        return f"/lab/compare/{linked}?measure={measure}&only=bar-{bar}#scenes", words

    return svg_figures.differences(
        bars,
        mean=mean,
        title=t("analyst.compare.histogram", measure=name),
        x_label=t("analyst.compare.histogram_x", measure=name),
        y_label=t("analyst.compare.histogram_y"),
        number=svg_figures.exact(t.number),
        link=link if linked else None,
    )


def _t(request: Request) -> Catalogue:
    return services_of(request).texts.get(lab_language(request))
