"""Any answer about trajectories as its participant saw it: the same page, view, level of detail and shape of window,
with the pair, the one that was rated or watched alone, or the drawn path and the rollout of it.

Nothing is stored. The list of answers is `answer_rows.py`'s, the protocol's preview `preview.py`'s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, cast

from fastapi import APIRouter, Depends, Request
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from desirepath.explain.methods import COMMANDS
from desirepath.explain.shown_explanation import ShownExplanation
from desirepath.store.artefacts import ArtefactError, ArtefactStore, load_trajectory
from desirepath.store.models import Artefact, Event, Participant, Session, StrokeRow, Trial
from desirepath.store.models import Response as Answered
from desirepath.store.sides import Side, is_tie
from desirepath.study.drawing import paths, walks
from desirepath.study.kind import Moment, Page, kind_of, read_plan
from desirepath.study.kinds.demonstration import DemonstrationStep
from desirepath.study.kinds.trial import viewing_in
from desirepath.study.session.machine import StepView
from desirepath.study.session.versions import protocol_of
from desirepath.study.steps import Step
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.dependencies import Db, Files, contact, page, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language
from desirepath.web.lab.answer_words import said_of_marks, said_of_several
from desirepath.web.lab.preview import QueryPreview, videos_in
from desirepath.web.lab.replay_reasons import Reasons, policies_for, reasons_of
from desirepath.web.lab.study_tabs import the_study
from desirepath.web.participant.session_view import leads_to, next_kind
from desirepath.web.stage.drawing_sheet import as_drawn
from desirepath.web.stage.replay_stages import Played
from desirepath_stage.paper import Paper

if TYPE_CHECKING:
    from desirepath.simulation.trajectory import Trajectory
    from desirepath_stage.stage import Stage
    from desirepath_stage.views import View

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["experimenter"])


@dataclass(frozen=True)
class SeenQuery(QueryPreview):
    """A pair, or one trajectory alone, on a stage with as much detail as the participant's device was given.

    reasons: of A and B, where somebody asks what a policy would look at; they were not shown to the participant.
    """

    light: bool = False
    reasons: tuple[ShownExplanation, ...] = ()

    def show(self, stage: Stage) -> None:
        stage.detail = "light" if self.light else "full"
        super().show(stage)

    def play(self, stage: Stage, side: Side) -> None:
        of = self.reasons[min("ab".index(side), len(self.reasons) - 1)] if self.reasons else self.explained
        QueryPreview.play(replace(self, explained=of, reasons=()) if self.reasons else self, stage, side)


@dataclass(frozen=True)
class SeenPath:
    """A drawn path on its paper, and its rollout in the scene that was drawn in, watched in `rollout_view`."""

    rollout: Trajectory
    paper: Paper
    view: View
    rollout_view: View
    light: bool

    def show(self, stage: Stage) -> None:
        stage.detail = "light" if self.light else "full"
        stage.draw(self.rollout.scene, self.view, self.paper)

    def play(self, stage: Stage, side: str) -> None:
        stage.play(self.rollout, label="", view=self.rollout_view, playback_id=side, goal=True, paper=self.paper)


@dataclass(frozen=True)
class _Seen:
    """What an answer is about. step: whose page it is shown on; shown: on the stage; durations_s: of what plays there;
    state: of the page where it is not a trial's; view, block: of the trial or drawing; payload: what the page is given
    beside what it is always; reasons, policies: what moved the robots, and by which policies it can be asked."""

    step: Step
    shown: Played
    durations_s: list[float]
    view: str
    block: str | None = None
    state: dict[str, Any] | None = None
    payload: dict[str, Any] = field(default_factory=dict)
    reasons: Reasons | None = None
    policies: list[Artefact] = field(default_factory=list)
    trial: Trial | None = None


@router.get("/lab/studies/{study_id}/answers/{response_id}")
def replay(
    request: Request, study_id: str, response_id: str, database: Db, files: Files, policy: str = "", command: str = ""
) -> Response:
    """The step of an answer with what was seen there, and on request what a policy would look at along the same way.
    404 for answers that are about no trajectory."""
    with database.session() as s:
        study = the_study(s, study_id)
        given = s.get(Answered, response_id)
        session = s.get(Session, given.session_id) if given is not None else None
        if given is None or session is None or session.study_id != study.id:
            raise LabRefusal(404, "no_replay")
        device = _device_at(s, session, given)
        try:
            seen = _seen(s, files, session, given, light=device.get("scene_detail") == "light")
            if seen is not None:
                seen = _with_reasons(request, s, files, seen, policy, command)
        except ArtefactError:
            seen = None
        if seen is None:
            raise LabRefusal(404, "no_replay")
        frozen = protocol_of(s, session)
        plan = read_plan(session.plan)
        code = s.get_one(Participant, session.participant_id).code
    texts = services_of(request).texts.get(lab_language(request))
    videos = videos_in(seen.shown.a, seen.shown.b) if isinstance(seen.shown, QueryPreview) else None
    at = next(i for i, step in enumerate(plan) if step.key == seen.step.key)
    return page(
        request,
        "lab/preview.html",
        language=session.language,
        step=StepView(
            kind=seen.step.kind,
            key=seen.step.key,
            index=at,
            total=len(plan),
            payload=kind_of(seen.step).payload(seen.step, Page(frozen, session.language)) | seen.payload,
        ),
        next_kind=next_kind(plan, at),
        leads_to=leads_to(plan, at),
        bar=_bar(texts, code, given, seen, device),
        stage_name=seen.step.stage,
        number=1,
        steps=[seen.step],
        languages=[session.language],
        study_title=frozen.title(session.language),
        code=code,
        contact=frozen.protocol.contact or contact(request),
        back=f"/lab/studies/{study.id}/people/{code}",
        back_text=texts("lab.replay.back", code=code),
        here="",
        lab=texts,
        stage_token=None if videos else services_of(request).replays.grant(seen.shown),
        videos=videos,
        durations=[round(seconds, 1) for seconds in seen.durations_s],
        shown_state=seen.state,
        shown_window=_window(device),
        reasons=seen.reasons,
        policies=seen.policies,
        commands=COMMANDS,
        csrf=request.state.sign_in.csrf,
    )


def _seen(s: DatabaseSession, files: ArtefactStore, session: Session, given: Answered, *, light: bool) -> _Seen | None:
    """None for an answer about no trajectory. Raises ArtefactError for one whose trajectories are gone."""
    about = given.value.get("about") if given.kind == "guess" else given.step_key
    step = next((planned for planned in read_plan(session.plan) if planned.key == about), None)
    if isinstance(step, DemonstrationStep):
        return _seen_path(s, files, session, step, given, light)
    trial = s.scalars(select(Trial).where(Trial.session_id == session.id, Trial.step_key == about)).first()
    if step is None or trial is None:
        return None
    a, b = load_trajectory(files, trial.trajectory_a), load_trajectory(files, trial.trajectory_b)
    alone = kind_of(step).trajectories == 1
    moment = Moment(s, session, protocol_of(s, session), given.created_at)
    explained = kind_of(step).explains(step, moment)
    view, goal = cast("View", trial.view), viewing_in(step).goal_and_trail
    several = tuple(load_trajectory(files, one) for one in trial.shown) if len(trial.shown) > 2 else ()
    shown = SeenQuery(a, b, view, alone=alone, goal=goal, light=light, explained=explained, several=several)
    durations = [trajectory.duration_s for trajectory in several or ((a,) if alone else (a, b))]
    if several:
        said = {"said": given.value, **kind_of(step).payload_now(step, moment)}
        return _Seen(step, shown, durations, trial.view, trial.block, payload=said, trial=trial)
    if "marks" in given.value:
        return _Seen(step, shown, durations, trial.view, trial.block, payload={"said": given.value}, trial=trial)
    ranked = {"ranked": given.value["ranking"], **kind_of(step).payload_now(step, moment)} if explained else {}
    return _Seen(step, shown, durations, trial.view, trial.block, payload=ranked, trial=trial)


def _with_reasons(
    request: Request, s: DatabaseSession, files: ArtefactStore, seen: _Seen, policy: str, command: str
) -> _Seen:
    """With the charts of what moved the robots, and on the stage what a policy that is asked for would look at."""
    if seen.trial is None or not isinstance(seen.shown, SeenQuery):
        return seen
    if seen.shown.several:
        return seen
    trajectories = (seen.shown.a,) if seen.shown.alone else (seen.shown.a, seen.shown.b)
    stepped = all(one.recorded_steps for one in trajectories)  # else there is nothing that a policy would look at
    policies = policies_for(s, request, seen.trial, seen.shown.a.scene.setup) if stepped else []
    t = services_of(request).texts.get(lab_language(request))
    found = reasons_of(
        files, t, trajectories, policies, asked=policy, command=command, shown=seen.shown.explained
    )  # fmt: skip
    if found is None or found.policy is None:
        return replace(seen, reasons=found, policies=policies)
    return replace(seen, reasons=found, policies=policies, shown=replace(seen.shown, reasons=found.explained))


def _seen_path(
    s: DatabaseSession,
    files: ArtefactStore,
    session: Session,
    step: DemonstrationStep,
    given: Answered,
    light: bool,
) -> _Seen | None:
    stroke = s.get(StrokeRow, given.value.get("stroke") or "")
    if stroke is None or stroke.session_id != session.id or stroke.trajectory is None:
        return None  # a further path was not wanted
    scene = walks.scene_with(paths.scene_of(step), stroke.walk)
    rollout = replace(load_trajectory(files, stroke.trajectory), scene=scene)
    afterwards: View = "top_down" if step.person == "walks" else step.view  # who walked then watches from outside
    shown = SeenPath(rollout, as_drawn(s, session.id, step, stroke), step.view, afterwards, light)
    state = {"phase": "watched", "stroke": stroke.id, "duration_s": rollout.duration_s, "walking": False, "met": False}
    return _Seen(step, shown, [rollout.duration_s], step.view, state=state)


def _device_at(s: DatabaseSession, session: Session, given: Answered) -> dict[str, Any]:
    """The device that was answered on: a session may go on with another one, and the log has the one before."""
    changes = select(Event.at, Event.data).where(Event.session_id == session.id, Event.kind == "device_checked")
    for at, data in s.execute(changes.order_by(Event.at)):
        if at > given.created_at:
            return dict(data.get("before") or {})
    return session.device


def _window(device: dict[str, Any]) -> list[int] | None:
    """Width and height of the participant's window in CSS pixels, where the page reported them."""
    size = [device.get(name) for name in ("width", "height")]
    known = [
        round(pixels)
        for pixels in size
        if isinstance(pixels, int | float) and not isinstance(pixels, bool) and pixels > 0
    ]
    return known if len(known) == len(size) else None


def _bar(t: Catalogue, code: str, given: Answered, seen: _Seen, device: dict[str, Any]) -> str:
    """What was answered, when and on what device, in one line."""
    value = given.value
    choice = str(value.get("choice") or "").upper()
    if given.kind == "guess":
        right = t("lab.replay.right" if value.get("right") else "lab.replay.wrong")
        sentence = t("lab.replay.guessed", code=code, choice=choice, right=right)
    elif choice:
        sentence = t("lab.replay.chose", code=code, choice=choice)
    elif is_tie(value):
        sentence = t("lab.replay.saw_no_difference", code=code)
    elif given.kind == "importance_ranking":
        sentence = t("lab.replay.ranked", code=code, tau=_agreement(t, value))
    elif value.get("ask"):
        sentence = t("lab.replay.ordered", code=code, said=said_of_several(t, value))
    elif "marks" in value:
        sentence = t("lab.replay.marked", code=code, said=said_of_marks(t, value))
    elif "stroke" in value:
        sentence = t("lab.replay.drew", code=code)
    elif seen.step.rates and seen.step.rates in value:
        sentence = t("lab.replay.rated", code=code, rating=str(value[seen.step.rates]))
    elif len(seen.durations_s) == 1:
        sentence = t("lab.replay.watched", code=code, block=seen.block or "–")
    else:
        sentence = t("lab.replay.no_choice", code=code)
    parts = [sentence]
    if given.decision_s is not None:
        parts.append(t("lab.replay.decision", seconds=t.number(given.decision_s, 1)))
    in_words = f"live.lab.views.{seen.view}"
    parts.append(t(in_words) if t.knows(in_words) else seen.view)
    window = _window(device)
    if window is not None:
        parts.append(t("lab.replay.window", width=str(window[0]), height=str(window[1])))
    if device.get("scene_detail") == "light":
        parts.append(t("lab.replay.light"))
    return " · ".join(parts)


def _agreement(t: Catalogue, value: dict[str, Any]) -> str:
    """Kendall's tau-b between the ranking and the scores; none where every object scored the same."""
    from scipy.stats import kendalltau  # slow to import

    places = {thing: place for place, thing in enumerate(value["ranking"])}
    things = list(value["scores"])
    tau = float(kendalltau([-places[thing] for thing in things], [value["scores"][thing] for thing in things])[0])
    return "–" if math.isnan(tau) else t.number(tau, 2)
