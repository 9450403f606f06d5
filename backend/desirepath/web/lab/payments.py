"""Who has to be paid: the platform's ids with participant, state, completion code and time, and the files that the
platform reads. The only page on which a person's id of elsewhere stands beside a code of ours.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from decimal import Decimal, InvalidOperation
from typing import Literal

from fastapi import APIRouter, Depends, Request
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from desirepath.store.models import Participant, RecruitingId, Session
from desirepath.store.who_counts import FINISHED
from desirepath.study.session.platforms import TITLES, is_id
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.dependencies import Db
from desirepath.web.core.lab_frame import LabRefusal
from desirepath.web.core.media import csv_response
from desirepath.web.lab.study_tabs import study_tab, the_study

LARGEST_BONUS = Decimal(1000)  # of one person (ours), against a slip of the decimal point
ENDED = ("withdrawn", "screened_out", "expired")  # nothing more will come of these

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["experimenter"])


@dataclass(frozen=True)
class Payee:
    """Somebody whom a platform sent. `state`: of the newest session; `minutes`: from the first start to the end."""

    platform: str
    external_id: str
    code: str
    pilot: bool
    excluded: bool
    state: str
    completion_code: str | None
    joined_at: datetime
    finished_at: datetime | None
    minutes: float | None

    @property
    def completed(self) -> bool:
        return self.state == FINISHED

    @property
    def is_listed(self) -> bool:
        """Whether platforms are told: of an id that is none, nothing is written into a file for them."""
        return is_id(self.external_id)


def payees(s: DatabaseSession, study_id: str) -> list[Payee]:
    """Everybody with a platform's id, in the order in which they joined."""
    newest: dict[str, Payee] = {}
    begun: dict[str, datetime] = {}
    rows = (
        select(RecruitingId, Participant, Session)
        .join(Participant, Participant.id == RecruitingId.participant_id)
        .join(Session, Session.participant_id == Participant.id)
        .where(RecruitingId.study_id == study_id)
        .order_by(Participant.created_at, Participant.code, Session.appointment)
    )
    for known, person, session in s.execute(rows):
        start = begun.setdefault(person.id, session.started_at or session.created_at)
        ended = session.finished_at
        newest[person.id] = Payee(
            platform=known.platform,
            external_id=known.external_id,
            code=person.code,
            pilot=person.pilot,
            excluded=person.excluded_at is not None,
            state="withdrawn" if person.withdrawn_at else session.state,
            completion_code=session.completion_code,
            joined_at=person.created_at,
            finished_at=ended,
            minutes=(ended - start).total_seconds() / 60 if ended else None,
        )
    return list(newest.values())


@router.get("/lab/studies/{study_id}/payments")
def payments(request: Request, study_id: str, database: Db) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        found = payees(s, study.id)
        return study_tab(
            request,
            study,
            "recruit",
            "lab/payments.html",
            payees=found,
            titles=TITLES,
            platforms=list(dict.fromkeys(payee.platform for payee in found)),
            approved=[payee for payee in found if payee.completed and payee.is_listed],
            rejected=[payee for payee in found if payee.state in ENDED and payee.is_listed],
            unlisted=[payee for payee in found if not payee.is_listed],
        )


@router.get("/lab/studies/{study_id}/payments.csv")
def payments_csv(
    study_id: str,
    database: Db,
    which: Literal["all", "approve", "reject", "bonus"] = "all",
    bonus: str = "",
    platform: str = "",
) -> Response:
    """`all` with every column; `approve` and `reject`: the platform's ids alone, one a line, of completed and of ended
    sessions; `bonus`: id and amount of all that completed. platform: of that one alone."""
    with database.session() as s:
        study = the_study(s, study_id)
        found = [payee for payee in payees(s, study.id) if platform in ("", payee.platform)]
    name = f"{study.protocol_name}-{study.id[:8]}-{which}.csv"
    if which == "all":
        columns = ["platform_id", "participant", "state", "completion_code", "joined_at", "finished_at", "minutes"]
        return csv_response([*columns, "platform"], [_row(payee) for payee in found], name)
    amount = [_amount(bonus)] if which == "bonus" else []
    wanted = [
        payee for payee in found if (payee.state in ENDED if which == "reject" else payee.completed) and payee.is_listed
    ]
    return _lines(([payee.external_id, *amount] for payee in wanted), name)


def _row(one: Payee) -> list[object]:
    minutes = "" if one.minutes is None else f"{one.minutes:.1f}"
    finished = one.finished_at.isoformat() if one.finished_at else ""
    code, joined = one.completion_code or "", one.joined_at.isoformat()
    return [one.external_id, one.code, one.state, code, joined, finished, minutes, one.platform]


def _lines(rows: Iterable[Sequence[str]], name: str) -> Response:
    """Rows without a head, ids as they are, as platforms want them pasted or uploaded."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(out.getvalue(), media_type="text/csv", headers=headers)


def _amount(given: str) -> str:
    """Raises LabRefusal for what is no amount of money."""
    amount = read_amount(given)
    if amount is None:
        raise LabRefusal(422, "bad_bonus", value=given[:20], largest=str(LARGEST_BONUS))
    return amount


def read_amount(given: str) -> str | None:
    """An amount of money with two digits after the point; None for what is none, or more than one person gets."""
    try:
        amount = round(Decimal(given.strip().replace(",", ".")), 2)
    except InvalidOperation:
        return None
    return f"{amount:.2f}" if amount.is_finite() and 0 < amount <= LARGEST_BONUS else None
