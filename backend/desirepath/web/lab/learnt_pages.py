"""The experimenters' page that follows what the robot learns from one participant, answer by answer."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Depends, Request
from markupsafe import Markup
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from desirepath.learning.preferences.predictive_power import CONVINCING
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.models import Artefact, Participant, Session
from desirepath.study.personalising.learnt import Learnt, find_learnt, takes_long
from desirepath.study.protocol_rows import row_of
from desirepath.web.core import svg_figures
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language
from desirepath.web.core.media import csv_response
from desirepath.web.lab.study_tabs import study_tab, the_participant, the_study

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["experimenter"])


@router.get("/lab/studies/{study_id}/people/{code}/learnt")
def learnt(request: Request, study_id: str, code: str, database: Db, files: Files, wait: bool = False) -> Response:
    """The page; with the header `X-Fragment`, only the part that changes. What takes long to compute comes as that part
    only, which the page asks for at once, or where somebody waits for it."""
    t = services_of(request).texts.get(lab_language(request))
    with database.session() as s:
        study = the_study(s, study_id)
        participant = the_participant(s, study, code)
        fragment = request.headers.get("X-Fragment")
        session = _session(s, participant)
        now = None if not (fragment or wait) and takes_long(s, files, session) else find_learnt(s, files, session)
        return study_tab(
            request,
            study,
            "people",
            "lab/learnt_part.html" if fragment else "lab/learnt.html",
            participant=participant,
            learnt=now,
            convincing=CONVINCING,
            strip=_strip(t, code, now) if now and now.shares else None,
            plans=[_plan(t, now, k) for k in range(len(now.pairs))] if now else [],
        )


@router.get("/lab/studies/{study_id}/people/{code}/learnt.csv")
def learnt_csv(study_id: str, code: str, database: Db, files: Files) -> Response:
    """Expected share of each objective after each answer."""
    with database.session() as s:
        now = _learnt(s, files, the_participant(s, the_study(s, study_id), code))
    names = list(now.shares[0]) if now.shares else []
    rows = ([k, *(f"{shares[name]:.4f}" for name in names)] for k, shares in enumerate(now.shares, 1))
    return csv_response(["answer", *names], rows, f"learnt_{code}.csv")


@router.get("/lab/studies/{study_id}/people/{code}/learnt.svg")
def learnt_svg(request: Request, study_id: str, code: str, database: Db, files: Files) -> Response:
    t = services_of(request).texts.get(lab_language(request))
    with database.session() as s:
        now = _learnt(s, files, the_participant(s, the_study(s, study_id), code))
    if not now.shares:
        raise LabRefusal(404, "nothing_learnt")
    return Response(_strip(t, code, now), media_type="image/svg+xml")


def answers_teach(s: DatabaseSession, session: Session) -> bool:
    """Whether the session's protocol asks queries: else (paths, rankings) nothing is learned answer by answer."""
    queries = row_of(s, session).protocol.get("materials", {}).get("query_set")
    found = s.get(Artefact, queries) if queries is not None else None
    return found is not None and found.kind == "query_set"


def _learnt(s: DatabaseSession, files: ArtefactStore, participant: Participant) -> Learnt:
    return find_learnt(s, files, _session(s, participant))


def _session(s: DatabaseSession, participant: Participant) -> Session:
    """The participant's newest session. Raises LabRefusal if nothing can be learned in it."""
    newest = select(Session).where(Session.participant_id == participant.id).order_by(Session.created_at.desc())
    session = s.scalars(newest.limit(1)).first()
    if session is None:
        raise LabRefusal(404, "nothing_learnt")
    if not answers_teach(s, session):
        raise LabRefusal(404, "no_queries")
    return session


def _strip(t: Any, code: str, now: Learnt) -> Markup:
    return Markup(  # noqa: S704  drawn by us, texts escaped there
        svg_figures.shares_by_answer(
            now.shares,
            names={name: t(f"shared.objectives.{name}") for name in now.shares[0]},
            title=t("lab.learnt.title", code=code),
            x_label=t("lab.learnt.answers"),
            percent=t.percent,
        )
    )


def _plan(t: Any, now: Learnt, k: int) -> Markup:
    base, own = now.pairs[k]
    names = (t("lab.learnt.base"), t("lab.learnt.own", count=len(now.shares)))
    title = t("lab.learnt.trajectories", scene=str(base.scene.seed))
    return Markup(svg_figures.rollouts(base.scene, (base, own), names=names, title=title))  # noqa: S704
