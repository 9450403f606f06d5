"""The analysts' pages about what exists: snapshots with their answers, policies and other artefacts with their cards,
lineage and downloads. Making them is a job's work.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Annotated, Any, get_args

from fastapi import APIRouter, Depends, Request
from markupsafe import Markup
from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.datastructures import FormData
from starlette.responses import RedirectResponse, Response

from desirepath.deploy.manifest import BundleError
from desirepath.explain.sketches import SKETCHED, Scheme
from desirepath.jobs.kinds import ANY_POLICY
from desirepath.learning.cards import SOCIAL
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.policy import StoredPolicy
from desirepath.simulation.setups import SetupError, setup_folders
from desirepath.store.artefacts import Lineage, lineage, load_trajectory
from desirepath.store.events import log_event
from desirepath.store.models import Artefact, ArtefactParent, Job, Participant, Study
from desirepath.store.models import Response as Answered
from desirepath.store.models import Session as SessionRow
from desirepath.store.shipped_policies import find_artefact
from desirepath.store.snapshots import Snapshot, SnapshotError, TooFewAnswers, check_whose, take_snapshot
from desirepath.store.who_counts import Whose
from desirepath.web.analyst.job_pages import read_form, studies_to_keep_in
from desirepath.web.analyst.policy_rows import GROUPINGS, SORTS, find_measured, policy_groups
from desirepath.web.core import svg_figures
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.contract import form_of
from desirepath.web.core.dependencies import Db, Files, TheServices, services_of
from desirepath.web.core.figure_process import FigureError
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page, rights_in
from desirepath.web.core.media import answers_with, csv_response, figure_file, media_of
from desirepath.web.core.permits import in_studies, may_with, seen_artefacts
from desirepath.web.core.roles import Right

DRIVING = ANY_POLICY.split("|")
MODELS = ("reward_model", "query_set", "ranking_set")
router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])
LINK_S = 300  # ours: how long a signed link to the store of files is good for


@router.get("/lab/snapshots")
def snapshots(request: Request, database: Db, archived: bool = False) -> Response:
    with database.session() as s:
        return _snapshots_page(request, s, archived=archived)


@router.post("/lab/snapshots", openapi_extra=form_of(("study", "participant", "answers")))
def take(
    request: Request, database: Db, files: Files, user: CheckedCsrf, form: Annotated[FormData, Depends(read_form)]
) -> Response:
    """Freeze the answers of a study's people, of simulated participants or of one of them; 422 if there are too few."""
    study_id, code = str(form.get("study") or ""), str(form.get("participant") or "").strip()
    whose = str(form.get("answers") or "people")
    try:
        with database.transaction() as s:
            if not rights_in(request).may(Right.ANALYSE, study_id):
                raise LabRefusal(403, "role", role=user.role)
            if s.get(Study, study_id) is None:
                raise LabRefusal(404, "no_study")
            chosen = None
            if code:
                wanted = select(Participant.id).where(Participant.study_id == study_id, Participant.code == code)
                chosen = list(s.scalars(wanted))
                if not chosen:
                    raise LabRefusal(422, "no_participant", code=code)
            taken = take_snapshot(s, files, study_id=study_id, participant_ids=chosen, whose=check_whose(whose))
            log_event(s, "snapshot_taken", study_id=study_id, snapshot=taken.id, whose=whose, by=user.name)
    except SnapshotError as problem:
        with database.session() as s:
            return _snapshots_page(
                request, s, problem=problem, study=study_id, participant=code, whose=whose, status=422
            )
    audit_details(request, study_id=study_id, snapshot=taken.id)
    return RedirectResponse(f"/lab/snapshots/{taken.id}", status_code=303)


@router.get("/lab/snapshots/{artefact_id}")
def snapshot(request: Request, artefact_id: str, database: Db, files: Files) -> Response:
    with database.session() as s:
        artefact = _artefact(s, artefact_id, "snapshot")
        content = None if artefact.quarantined_at else Snapshot.from_bytes(files.get(artefact.id))
        per_participant = Counter(answer.participant for answer in content.answers) if content else Counter[str]()
        return lab_page(
            request,
            "analyst/snapshot.html",
            artefact=artefact,
            may=_may(request, s, artefact),
            study=s.get(Study, artefact.study_id) if artefact.study_id else None,
            content=content,
            per_participant=sorted(per_participant.items()),
            children=_children(request, s, artefact.id),
        )


@router.get("/lab/snapshots/{artefact_id}/answers/{response_id}")
def answer(request: Request, artefact_id: str, response_id: str, database: Db, files: Files) -> Response:
    """One answer of a snapshot: the two trajectories and which was chosen."""
    with database.session() as s:
        artefact = _artefact(s, artefact_id, "snapshot")
        if artefact.quarantined_at:
            raise LabRefusal(410, "quarantined")
        content = Snapshot.from_bytes(files.get(artefact.id))
        found = next((answer for answer in content.answers if answer.response == response_id), None)
        if found is None:
            raise LabRefusal(404, "no_answer")
        t = services_of(request).texts.get(lab_language(request))
        pair = [load_trajectory(files, trajectory) for trajectory in (found.trajectory_a, found.trajectory_b)]
        names = [
            t("analyst.answer.trajectory_chosen" if found.choice == x.lower() else "analyst.answer.trajectory", name=x)
            for x in "AB"
        ]
        known = all(one.recorded is None or "poses" in one.recorded.has for one in pair)
        title = t("analyst.answer.figure")
        drawn = svg_figures.rollouts(pair[0].scene, pair, names=names, title=title) if known else ""
        return lab_page(
            request,
            "analyst/answer.html",
            artefact=artefact,
            study=s.get(Study, content.study),
            answer=found,
            given=s.get(Answered, response_id),
            pair=pair,
            figure=Markup(drawn),  # noqa: S704 - made by us, texts escaped
            names=names,
        )


@router.get("/lab/policies")
def policies(
    request: Request, database: Db, archived: bool = False, group: str = GROUPINGS[0], sort: str = ""
) -> Response:
    with database.session() as s:
        kinds = (*DRIVING, *MODELS)
        seen = seen_artefacts(rights_in(request))
        chosen = select(Artefact).where(Artefact.kind.in_(kinds), seen).order_by(Artefact.created_at.desc())
        listed, archived_count = without_archived(s.scalars(chosen), archived)
        driving = [one for one in listed if one.kind in DRIVING]
        models: dict[str, list[Artefact]] = {kind: [one for one in listed if one.kind == kind] for kind in MODELS}
        for found in models.values():  # one's own first, newest first; then what came with the product, by name
            found.sort(key=lambda one: "" if one.job_id or one.card.get("imported") else one.name)
        group = group if group in GROUPINGS else GROUPINGS[0]
        return lab_page(
            request,
            "analyst/policies.html",
            groups=policy_groups(s, driving, group, sort),
            groupings=GROUPINGS,
            group=group,
            sort=sort if sort.removeprefix("-") in SORTS else "",
            models=models,
            archived=archived,
            archived_count=archived_count,
            setups=list(setup_folders()),
            keep_in=studies_to_keep_in(s, rights_in(request)),
        )


@router.get("/lab/policies/{artefact_id}/sketch.svg", response_class=Response, responses=answers_with("svg"))
def sketch(request: Request, artefact_id: str, database: Db, files: Files, scheme: str = "light") -> Response:
    """Five rollouts of a policy from above, in the colours of a scheme. 503: others are being drawn; ask again."""
    with database.session() as s:
        found = _usable(s, artefact_id)
    if found.kind not in DRIVING:
        raise LabRefusal(404, "no_figure")
    try:
        drawn = services_of(request).figures.sketch(found.id, lambda: files.get(found.id))
    except FigureError as problem:
        if problem.busy:
            return Response(status_code=503, headers={"Retry-After": "2"})
        raise LabRefusal(404, "no_figure") from None
    chosen: Scheme = "dark" if scheme == "dark" else "light"
    mark = f"{found.id[:16]}-{chosen}-{SKETCHED}"
    return figure_file(request, "sketch.svg", drawn.svg(chosen).encode(), shown=("svg",), mark=mark)


@router.get("/lab/policies/{artefact_id}")
def policy(request: Request, artefact_id: str, database: Db) -> Response:
    with database.session() as s:
        return _card(request, s, _artefact(s, artefact_id, "policy"))


@router.get("/lab/artefacts/{artefact_id}")
def artefact(request: Request, artefact_id: str, database: Db) -> Response:
    """The page of any artefact: snapshots, policies and comparisons have their own."""
    with database.session() as s:
        found = _artefact(s, artefact_id)
        if found.kind in ("policy", "snapshot") or is_comparison(found):
            return RedirectResponse(artefact_href(found), status_code=303)
        return _card(request, s, found)


@router.get("/lab/artefacts/{artefact_id}/card.json")
def card(artefact_id: str, database: Db) -> Response:
    with database.session() as s:
        found = _artefact(s, artefact_id)
        described = {
            "id": found.id,
            "kind": found.kind,
            "name": found.name,
            "setup": found.setup,
            "simulated": found.simulated,
            "created_at": found.created_at.isoformat(),
            "card": found.card,
            "answers": list(lineage(s, found.id).all_answers()),
        }
    return _download(json.dumps(described, indent=2, sort_keys=True).encode(), f"{found.id[:12]}.card.json")


@router.get("/lab/artefacts/{artefact_id}/content", response_class=Response, responses=answers_with("json", "npz"))
def content(artefact_id: str, database: Db, files: Files, services: TheServices) -> Response:
    """The artefact's own file, as its id says; where browsers reach the artefact store, it comes from there."""
    with database.session() as s:
        found = _usable(s, artefact_id)
    name = f"{found.kind}-{found.id[:12]}.{'json' if found.kind in ('snapshot', 'evaluation') else 'npz'}"
    link = files.link_to(found.id, name, seconds=LINK_S) if services.settings.links_to_store else None
    if link is not None:
        return RedirectResponse(link, status_code=307, headers={"Cache-Control": "no-store"})
    return _download(files.get(found.id), name)


@router.get("/lab/policies/{artefact_id}/policy.zip")
def policy_sb3(artefact_id: str, database: Db, files: Files) -> Response:
    """The policy as a Stable-Baselines3 TD3 zip."""
    from desirepath.learning.policies.export import (
        policy_to_sb3_zip,  # torch takes seconds to import; the server does without
    )

    return _exported(artefact_id, database, files, lambda stored: policy_to_sb3_zip(stored.driving()), "zip")


@router.get("/lab/policies/{artefact_id}/policy.onnx")
def policy_onnx(artefact_id: str, database: Db, files: Files) -> Response:
    from desirepath.learning.policies.export import policy_to_onnx

    return _exported(artefact_id, database, files, lambda stored: policy_to_onnx(stored.driving()), "onnx")


@router.get("/lab/policies/{artefact_id}/bundle.zip")
def bundle(artefact_id: str, database: Db, files: Files) -> Response:
    """All that drives a robot by it, as `desirepath policies export` writes it; a conditioned one takes its weights
    while it drives."""
    from desirepath.learning.policies.bundles import bundle_files, zipped

    return _exported(artefact_id, database, files, lambda stored: zipped(bundle_files(stored)), "bundle.zip")


@router.get("/lab/policies/{artefact_id}/manifest.json")
def manifest(artefact_id: str, database: Db, files: Files) -> Response:
    """Observation layout, units and action scaling: what a robot needs to run the exported policy."""

    def write(stored: StoredPolicy) -> bytes:
        return json.dumps(stored.driving().manifest(), indent=2, sort_keys=True).encode()

    return _exported(artefact_id, database, files, write, "manifest.json")


@router.get("/lab/artefacts/{artefact_id}/held-out.svg")
def held_out_svg(request: Request, artefact_id: str, database: Db) -> Response:
    with database.session() as s:
        drawn = _held_out_figure(request, _artefact(s, artefact_id, "reward_model"))
    if drawn is None:
        raise LabRefusal(404, "no_figure")
    return Response(str(drawn), media_type="image/svg+xml")


@router.get("/lab/artefacts/{artefact_id}/held-out.csv")
def held_out_csv(artefact_id: str, database: Db) -> Response:
    with database.session() as s:
        rows = _held_out(_artefact(s, artefact_id, "reward_model"))
    columns = ["participant", "n", "method", "accuracy", "low", "high", "reason"]
    return csv_response(columns, [[row.get(name, "") for name in columns] for row in rows], "held_out_accuracy.csv")


@router.get("/lab/policies/{setup}/{name:path}")
def policy_by_name(request: Request, setup: str, name: str, database: Db) -> Response:
    """A policy that was shipped, by its name: `/lab/policies/study_room/base`."""
    with database.session() as s:
        found = find_artefact(s, f"{setup}/{name}")
        if found is None or not may_with(s, rights_in(request), Right.LOOK, found):
            raise LabRefusal(404, "no_artefact")
        return RedirectResponse(artefact_href(found), status_code=303)


def artefact_href(artefact: Artefact) -> str:
    """Where an artefact's page is."""
    if artefact.kind == "policy":
        return f"/lab/policies/{artefact.id}"
    if artefact.kind == "snapshot":
        return f"/lab/snapshots/{artefact.id}"
    return f"/lab/compare/{artefact.id}" if is_comparison(artefact) else f"/lab/artefacts/{artefact.id}"


def without_archived(found: Iterable[Artefact], wanted: bool) -> tuple[list[Artefact], int]:
    """Of a list what is shown, and how many archived ones there are; wanted: whether these are shown, too."""
    everything = list(found)
    archived = sum(artefact.archived_at is not None for artefact in everything)
    return [artefact for artefact in everything if wanted or artefact.archived_at is None], archived


def is_comparison(artefact: Artefact) -> bool:
    """Whether an evaluation is one of two policies."""
    return artefact.kind == "evaluation" and "paired" in artefact.card.get("results", {})


def _card(request: Request, s: DatabaseSession, artefact: Artefact) -> Response:
    tree = lineage(s, artefact.id)
    job = s.get(Job, artefact.job_id) if artefact.job_id else None
    children = _children(request, s, artefact.id)
    measured = [
        child
        for child in children
        if child.kind == "evaluation" and not is_comparison(child) and child.quarantined_at is None
    ]
    return lab_page(
        request,
        "analyst/artefact.html",
        artefact=artefact,
        may=_may(request, s, artefact),
        tree=tree,
        answers=_answers(s, tree),
        job=job,
        measured=measured,
        children=children,
        on_card=find_measured(artefact),
        driving=DRIVING,
        social_measures=SOCIAL,
        held_out=_held_out(artefact),
        held_out_figure=_held_out_figure(request, artefact),
    )


def _answers(s: DatabaseSession, tree: Lineage) -> list[tuple[str, int]]:
    """The participants behind an artefact with the number of their answers; only of answers that still exist."""
    counted: Counter[str] = Counter()
    ids = tree.all_answers()
    if ids:
        rows = (
            select(Participant.code, func.count())
            .join(SessionRow, SessionRow.participant_id == Participant.id)
            .join(Answered, Answered.session_id == SessionRow.id)
            .where(Answered.id.in_(ids))
            .group_by(Participant.code)
        )
        counted.update({code: count for code, count in s.execute(rows)})  # noqa: C416 - rows are no pairs to mypy
    return sorted(counted.items())


def _held_out(artefact: Artefact) -> list[dict[str, Any]]:
    """One row per participant; an alignment's card holds one for all of them."""
    rows: list[dict[str, Any]] | dict[str, Any] = artefact.card.get("results", {}).get("held_out") or []
    if isinstance(rows, dict):  # a `rewards.held_out.Predicted`
        return [{"participant": "–", "n": rows["answers"], "method": f"{rows['folds']}_folds", **rows}]
    return rows


def _held_out_figure(request: Request, artefact: Artefact) -> Markup | None:
    measured = [row for row in _held_out(artefact) if "accuracy" in row]
    if not measured:
        return None
    t = services_of(request).texts.get(lab_language(request))
    rows = [
        svg_figures.Interval(
            row["participant"],
            row["accuracy"],
            row["low"],
            row["high"],
            t("analyst.held_out.share", share=t.percent(row["accuracy"]), n=row["n"]),
        )
        for row in measured
    ]
    title, x_label = t("analyst.held_out.figure"), t("analyst.held_out.axis")
    return Markup(svg_figures.intervals(rows, title=title, x_label=x_label, chance=0.5))  # noqa: S704


def _snapshots_page(
    request: Request,
    s: DatabaseSession,
    *,
    problem: SnapshotError | None = None,
    study: str = "",
    participant: str = "",
    whose: str = "people",
    archived: bool = False,
    status: int = 200,
) -> Response:
    rights = rights_in(request)
    taken = select(Artefact).where(Artefact.kind == "snapshot", seen_artefacts(rights))
    found, archived_count = without_archived(s.scalars(taken.order_by(Artefact.created_at.desc())), archived)
    studies = list(s.scalars(select(Study).where(in_studies(rights, Study.id)).order_by(Study.created_at.desc())))
    return lab_page(
        request,
        "analyst/snapshots.html",
        status=status,
        snapshots=found,
        archived=archived,
        archived_count=archived_count,
        studies=studies,
        analysed=[study for study in studies if rights.may(Right.ANALYSE, study.id)],
        names={study.id: study.name for study in studies},
        problem=problem,
        too_few=isinstance(problem, TooFewAnswers),
        chosen_study=study or request.query_params.get("study", ""),
        chosen_participant=participant or request.query_params.get("participant", ""),
        chosen_whose=whose,
        all_whose=get_args(Whose),
    )


def _artefact(s: DatabaseSession, artefact_id: str, kind: str | None = None) -> Artefact:
    found = s.get(Artefact, artefact_id)
    if found is None or (kind is not None and found.kind != kind):
        raise LabRefusal(404, "no_artefact")
    return found


def _usable(s: DatabaseSession, artefact_id: str, kind: str | None = None) -> Artefact:
    found = _artefact(s, artefact_id, kind)
    if found.quarantined_at is not None:
        raise LabRefusal(410, "quarantined")
    return found


def _children(request: Request, s: DatabaseSession, artefact_id: str) -> list[Artefact]:
    """What was made from it directly, of what may be seen."""
    made = select(Artefact).join(ArtefactParent, ArtefactParent.artefact_id == Artefact.id)
    made = made.where(ArtefactParent.parent_id == artefact_id, seen_artefacts(rights_in(request)))
    return list(s.scalars(made.order_by(Artefact.created_at.desc())).unique())


def _exported(
    artefact_id: str, database: Db, files: Files, write: Callable[[StoredPolicy], bytes], ending: str
) -> Response:
    """A policy in another format, a conditioned one without preferences. Refused where the format cannot have it."""
    from desirepath.learning.policies.policy import read_policy

    with database.session() as s:
        found = _usable(s, artefact_id)
    if found.kind not in DRIVING:
        raise LabRefusal(404, "no_artefact")
    try:
        written = write(read_policy(files.get(found.id)))
    except (LearningError, SetupError, BundleError):
        raise LabRefusal(404, "no_artefact") from None
    return _download(written, f"policy-{found.id[:12]}.{ending}")


def _download(data: bytes, filename: str) -> Response:
    return Response(
        data,
        media_type=media_of(filename),
        headers={"Content-Disposition": f'attachment; filename="{filename}"'},
    )


def _may(request: Request, s: DatabaseSession, artefact: Artefact) -> dict[str, bool]:
    """Which buttons of an artefact's page are for who looks: what it was made from counts, not its study alone."""
    rights = rights_in(request)
    return {right.value: may_with(s, rights, right, artefact) for right in (Right.ANALYSE, Right.TAKE, Right.TIDY)}
