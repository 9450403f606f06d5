"""Any answer about trajectories as its participant saw it: the same page, view, level of detail, both trajectories.

Nothing is stored. The list of answers is `answer_rows.py`'s, the protocol's preview `preview.py`'s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fastapi import APIRouter, Depends, Request
from starlette.responses import Response

from backend.api.core.auth import checked_csrf
from backend.api.core.catalogues import Catalogue
from backend.api.core.dependencies import Db, Files, contact, page, services_of
from backend.api.core.lab_frame import LabRefusal, lab_language
from backend.api.lab.preview import QueryPreview
from backend.api.lab.study_tabs import the_study
from backend.api.participant.session_view import leads_to, next_kind
from backend.store.artefacts import ArtefactError, load_trajectory
from backend.store.models import Participant, Session, Trial
from backend.store.models import Response as Answered
from backend.study.kinds import kind_of, read_plan
from backend.study.kinds.base import Page
from backend.study.session.machine import StepView
from backend.study.session.versions import protocol_of

if TYPE_CHECKING:
    from app.stage import Stage

router = APIRouter(dependencies=[Depends(checked_csrf)], tags=["experimenter"])


@dataclass(frozen=True)
class SeenQuery(QueryPreview):
    """A pair on a stage with as much detail as the participant's device was given."""

    light: bool = False

    def show(self, stage: Stage) -> None:
        stage.detail = "light" if self.light else "full"
        super().show(stage)


@router.get("/lab/studies/{study_id}/answers/{response_id}")
def replay(request: Request, study_id: str, response_id: str, database: Db, files: Files) -> Response:
    """The step of an answer with its two trajectories. 404 for answers that are about none."""
    with database.session() as s:
        study = the_study(s, study_id)
        given = s.get(Answered, response_id)
        trial = s.get(Trial, given.trial_id) if given is not None and given.trial_id else None
        session = s.get(Session, given.session_id) if given is not None else None
        if given is None or trial is None or session is None or session.study_id != study.id:
            raise LabRefusal(404, "no_replay")
        plan = read_plan(session.plan)
        step = next((one for one in plan if one.key == given.step_key), None)
        if step is None or not kind_of(step).previewed:
            raise LabRefusal(404, "no_replay")
        frozen = protocol_of(s, session)
        code = s.get_one(Participant, session.participant_id).code
    try:
        a, b = load_trajectory(files, trial.trajectory_a), load_trajectory(files, trial.trajectory_b)
    except ArtefactError:
        raise LabRefusal(404, "no_replay") from None
    texts = services_of(request).texts.get(lab_language(request))
    shown = SeenQuery(a, b, view=trial.view, light=session.device.get("scene_detail") == "light")  # type: ignore[arg-type]
    at = plan.index(step)
    return page(
        request,
        "lab/preview.html",
        language=session.language,
        step=StepView(
            kind=step.kind,
            key=step.key,
            index=at,
            total=len(plan),
            payload=kind_of(step).payload(step, Page(frozen, session.language)),
        ),
        next_kind=next_kind(plan, at),
        leads_to=leads_to(plan, at),
        bar=_told(texts, code, given, trial, session),
        stage_name=step.stage,
        number=1,
        steps=[step],
        languages=[session.language],
        study_title=frozen.title(session.language),
        code=code,
        contact=frozen.protocol.contact or contact(request),
        back=f"/lab/studies/{study.id}/people/{code}",
        back_text=texts("lab.replay.back", code=code),
        here="",
        lab=texts,
        stage_token=services_of(request).replays.grant(shown),
        drives=[round(one.duration_s, 1) for one in (a, b)],
        csrf=request.state.sign_in.csrf,
    )


def _told(t: Catalogue, code: str, given: Answered, trial: Trial, session: Session) -> str:
    """What was answered, when and on what device, in one line."""
    choice = given.value.get("choice")
    said = (
        t("lab.replay.chose", code=code, choice=str(choice).upper()) if choice else t("lab.replay.no_choice", code=code)
    )
    told = [said]
    if given.decision_s is not None:
        told.append(t("lab.replay.decision", seconds=t.number(given.decision_s, 1)))
    told.append(trial.view)
    device: dict[str, Any] = session.device
    if device.get("width") and device.get("height"):
        told.append(t("lab.replay.window", width=str(device["width"]), height=str(device["height"])))
    if device.get("scene_detail") == "light":
        told.append(t("lab.replay.light"))
    return " · ".join(told)
