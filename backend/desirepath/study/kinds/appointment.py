"""Kind of step `appointment`: one appointment ends here, and says when and how to come back."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import timedelta
from typing import Any, Literal

from pydantic import Field, model_validator
from sqlalchemy import select

from desirepath.grammar.parts import FileName, an_example
from desirepath.store.events import log_event
from desirepath.store.models import Session
from desirepath.study.kind import Acting, Ending, Moment
from desirepath.study.kinds.text_page import TextPage, TextStep
from desirepath.study.links import next_token, token_hash, window_of
from desirepath.study.steps import Planning, Stage, Step
from desirepath.study.wire import Confirmed


class AppointmentStage(Stage):
    """Here one appointment ends. The next begins at the earliest `after_days` later and at the latest `within_days`,
    with a link or code that is shown, on any device.
    """

    model_config = an_example({"text": "texts/drawing_appointment.md", "after_days": 1, "within_days": 14})

    for_everybody = True

    text: FileName
    after_days: float = Field(1.0, ge=0, le=365)
    within_days: float = Field(14.0, gt=0, le=730)

    @model_validator(mode="after")
    def _has_a_window(self) -> AppointmentStage:
        if self.within_days <= self.after_days:
            raise ValueError(f"within_days = {self.within_days:g} must be more than after_days = {self.after_days:g}")
        return self

    def plan(self, at: Planning) -> list[Step]:
        days = {"after_days": self.after_days, "within_days": self.within_days}
        fields = {"kind": "appointment", "key": at.key, "stage": at.key, "text": self.text, **days}
        return [AppointmentStep.model_validate(fields)]


class AppointmentStep(TextStep):
    kind: Literal["appointment"]
    after_days: float
    within_days: float


class Appointment(TextPage[AppointmentStep, Confirmed]):
    name = "appointment"
    step = AppointmentStep
    ends_appointment = True
    stages = {"appointment": AppointmentStage}

    def payload_now(self, step: AppointmentStep, moment: Moment) -> dict[str, Any]:
        """The next one's window, code and way. The code needs the session's own link, by which it was found
        (`finding.find_session`).
        """
        session = moment.session
        following = moment.s.scalars(
            select(Session).where(
                Session.participant_id == session.participant_id, Session.appointment == session.appointment + 1
            )
        ).first()
        token = moment.s.info.get("token")
        if following is None or token is None:
            return {}
        code = next_token(token)
        return {**window_of(following), "return_code": code, "return_path": f"/p/{code}"}

    def check_time(self, step: AppointmentStep, moment: Moment, value: Mapping[str, Any]) -> None:
        raise moment.refusal("finished", "This session is finished.")

    def arrive(self, step: AppointmentStep, acting: Acting) -> Ending:
        """End this appointment and make the next one, in the same transaction."""
        session, now = acting.session, acting.now
        following = Session(
            participant_id=session.participant_id,
            study_id=session.study_id,
            token_hash=token_hash(next_token(acting.s.info["token"])),
            language=session.language,
            simulated=session.simulated,
            seed=session.seed,
            plan=session.plan,
            position=acting.first_asked(session.position + 1),
            assignment=session.assignment,
            appointment=session.appointment + 1,
            personalisation=session.personalisation,  # why nothing is learned, where that is known already
            protocol_number=session.protocol_number,
            opens_at=now + timedelta(days=step.after_days),
            created_at=now,
            expires_at=now + timedelta(days=step.within_days),
        )
        acting.s.add(following)
        acting.s.flush()
        begun = Acting(acting.s, following, acting.frozen, now, acting.files)
        log_event(acting.s, "step_entered", session_id=following.id, step=begun.step.key)
        begun.arrive()
        return Ending("end_appointment", logged={"appointment": session.appointment})


KIND = Appointment()
