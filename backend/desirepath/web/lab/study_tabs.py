"""What every page of one study needs: the study, one of its participants, the frame with tabs. No route lives here."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Any, cast

from fastapi import Request
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from sqlalchemy.orm import object_session
from starlette.responses import Response

from desirepath.store.example_study import example_id
from desirepath.store.models import Participant, ProtocolVersion, Study
from desirepath.study.protocol.freezing import FrozenProtocol, ProtocolError, thaw
from desirepath.web.core.dependencies import services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page
from desirepath.web.lab.answer_words import AnswerWords

OPEN = re.compile(r"""\btype:\s*["']?text\b""")  # an open question, in a questionnaire's YAML
TABS = ("now", "people", "protocol", "recruit", "data", "report", "team")


def the_study(s: DatabaseSession, study_id: str) -> Study:
    """The study with this id. Raises LabRefusal 404."""
    study = s.get(Study, study_id)
    if study is None:
        raise LabRefusal(404, "no_study")
    return study


def the_participant(s: DatabaseSession, study: Study, code: str) -> Participant:
    """The participant with this code. Raises LabRefusal 404."""
    found = s.scalars(select(Participant).where(Participant.study_id == study.id, Participant.code == code)).first()
    if found is None:
        raise LabRefusal(404, "no_participant", code=code)
    return found


def answer_words(request: Request, s: DatabaseSession, study: Study) -> AnswerWords:
    """The study's answers in the reader's words, by all versions of its protocol that can be read: one with a kind of
    step that was taken away must not keep anybody from the study's pages."""
    later = select(ProtocolVersion).where(ProtocolVersion.study_id == study.id).order_by(ProtocolVersion.number.desc())
    t = services_of(request).texts.get(lab_language(request))
    versions: list[FrozenProtocol] = []
    for one in (*s.scalars(later), study):
        with suppress(ProtocolError):
            versions.append(thaw(one))
    return AnswerWords(t, versions)


def study_tab(
    request: Request, study: Study, tab: str, template: str | None = None, *, status: int = 200, **context: Any
) -> Response:
    """A page of a study, whose session is open; without a template, the tab's own."""
    drawn = any(
        entry.get("demonstrations") or "drawing" in (entry.get("methods") or {}).get("methods", ())
        for entry in study.protocol.get("stages", [])
    )
    written = any(name.startswith("questionnaires/") and OPEN.search(text) for name, text in study.files.items())
    driven = tab == "robots" or any(entry.get("robot_drive") for entry in study.protocol.get("stages", []))
    beside = [name for name, there in (("robots", driven), ("paths", drawn), ("coding", written)) if there]
    tabs = (*TABS[:2], *beside, *TABS[2:])
    shown = template or f"lab/study_{tab}.html"
    s = cast(DatabaseSession, object_session(study))
    context |= {"example": example_id(s) == study.id, "words": answer_words(request, s, study)}
    return lab_page(request, shown, status=status, study=study, tab=tab, tabs=tabs, **context)
