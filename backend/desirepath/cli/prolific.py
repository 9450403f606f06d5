"""`desirepath prolific ...`: places, approvals and bonuses at Prolific. Without `--send` nothing leaves the machine."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from desirepath.cli.output import COMMAND_LINE, JsonFlag, in_data_folder, say
from desirepath.cli.study import find_study, open_store
from desirepath.settings import get_settings

if TYPE_CHECKING:
    from desirepath.web.core.prolific import Call

commands = typer.Typer(
    help="A study's places, approvals and bonuses at Prolific; shows what would be sent until you say --send.",
    no_args_is_help=True,
)
StudyId = Annotated[str, typer.Argument(help="Id of the study here.")]
Send = Annotated[bool, typer.Option("--send", help="Send it; default: only show what would be sent.")]
There = Annotated[
    str | None, typer.Option("--there", help="The study's id at Prolific; default as participants brought it along.")
]


@commands.command("list")
@in_data_folder
def list_submissions(study: StudyId, there: There = None, send: Send = False, as_json: JsonFlag = False) -> None:
    """List who came by Prolific, with their states here and, with --send, there."""
    from desirepath.web.core.prolific import Prolific, submissions_call

    people, known = _people(study, there)
    rows = [
        {"participant": one["external_id"], "submission": one["submission"], "here": one["state"]} for one in people
    ]
    if not send:
        _shown([submissions_call(_named(known, study), 1)] if known else [], as_json, {"participants": rows})
        return
    prolific = Prolific(get_settings())
    status = {str(one.get("participant_id")): one.get("status") for one in prolific.submissions(_named(known, study))}
    found = {row["participant"] for row in rows}
    rows = [row | {"there": status.get(row["participant"])} for row in rows]
    rows += [
        {"participant": who, "submission": None, "here": None, "there": of}
        for who, of in status.items()
        if who not in found
    ]
    say({"study": study, "participants": rows}, as_json)


@commands.command()
@in_data_folder
def places(
    study: StudyId,
    number: Annotated[int, typer.Argument(min=1, max=100_000, help="How many people in all.")],
    there: There = None,
    send: Send = False,
    as_json: JsonFlag = False,
) -> None:
    """Take in so many people in all at Prolific, which can only become more."""
    from desirepath.web.core.prolific import Prolific, ProlificError, places_call

    _, known = _people(study, there)
    call = places_call(_named(known, study), number)
    if not send:
        _shown([call], as_json)
        return
    prolific = Prolific(get_settings())
    now = prolific.study(_named(known, study)).get("total_available_places")
    if isinstance(now, int) and number <= now:
        raise ProlificError(f"number = {number}: there are {now} places already, and Prolific takes none back")
    prolific.send(call)
    _record(study, "prolific_places_changed", places=number)
    say({"study": study, "places": number, "before": now}, as_json)


@commands.command()
@in_data_folder
def approve(study: StudyId, there: There = None, send: Send = False, as_json: JsonFlag = False) -> None:
    """Approve the submissions of everybody who completed the study here.

    With --send only of those whom Prolific has waiting for review.
    """
    from desirepath.web.core.prolific import AWAITING, Prolific, approve_calls

    people, known = _people(study, there)
    done = {one["external_id"]: one["submission"] for one in people if one["completed"]}
    if not send:
        without = [who for who, submission in done.items() if not submission]
        calls = approve_calls([submission for submission in done.values() if submission])
        _shown(calls, as_json, {"submission_looked_up_when_sent": without} if without else {})
        return
    prolific = Prolific(get_settings())
    waiting = [
        str(one.get("id"))
        for one in prolific.submissions(_named(known, study))
        if one.get("status") == AWAITING and one.get("participant_id") in done
    ]
    for call in approve_calls(waiting):
        prolific.send(call)
        _record(study, "prolific_approved", submissions=len((call.body or {})["submission_ids"]))
    say({"study": study, "approved": len(waiting), "completed_here": len(done)}, as_json)


@commands.command()
@in_data_folder
def bonus(
    study: StudyId,
    amount: Annotated[str, typer.Option(help="For each, in the study's currency at Prolific, e.g. 1.50.")],
    there: There = None,
    send: Send = False,
    as_json: JsonFlag = False,
) -> None:
    """Set up a bonus for everybody who completed the study here.

    `prolific pay` then pays it.
    """
    from desirepath.web.core.prolific import Prolific, bonus_calls
    from desirepath.web.lab.payments import LARGEST_BONUS, read_amount

    paid = read_amount(amount)
    if paid is None:
        raise ValueError(f"amount = {amount[:20]!r}: must be more than 0 and at most {LARGEST_BONUS}, e.g. 1.50")
    people, known = _people(study, there)
    calls = bonus_calls(_named(known, study), [one["external_id"] for one in people if one["completed"]], paid)
    if not send:
        _shown(calls, as_json)
        return
    prolific = Prolific(get_settings())
    kept = ("id", "amount", "fees", "vat", "total_amount")
    set_up = []
    for call in calls:
        answered = prolific.send(call)
        set_up.append({name: answered.get(name) for name in kept} if isinstance(answered, dict) else {})
        _record(study, "prolific_bonus_set_up", bulk=str(set_up[-1].get("id")), each=paid)
    say({"study": study, "each": paid, "set_up_amounts_in_cents": set_up}, as_json)
    typer.echo(f"Nothing is paid yet: desirepath prolific pay {study} ID --send", err=True)


@commands.command()
@in_data_folder
def pay(
    study: StudyId,
    bulk: Annotated[str, typer.Argument(help="Id that `prolific bonus --send` printed.")],
    send: Send = False,
    again: Annotated[
        bool, typer.Option("--again", help="Although it was sent before: Prolific pays it a second time.")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Pay a bonus that was set up, once.

    What was sent before is not sent again, since Prolific would pay a second time.
    """
    from sqlalchemy import select

    from desirepath.store.models import Audit, Study
    from desirepath.web.core.prolific import Prolific, ProlificError, pay_call

    call = pay_call(bulk)
    if not send:
        _people(study, None)
        _shown([call], as_json)
        return
    prolific = Prolific(get_settings())
    database, _ = open_store()
    with database.transaction() as s:  # written before it is sent: after a failure nobody pays twice by trying again
        find_study(s, study)
        s.execute(select(Study.id).where(Study.id == study).with_for_update())
        sent = select(Audit).where(Audit.study_id == study, Audit.action == "prolific_bonus_paid")
        before = next((one for one in s.scalars(sent) if one.data.get("bulk") == bulk), None)
        if before is not None and not again:
            raise ProlificError(
                f"bulk payment {bulk} was sent before, and Prolific pays once more for every time: look there first; "
                "--again sends it all the same"
            )
        _note(s, study, "prolific_bonus_paid", bulk=bulk)
    prolific.send(call)
    say({"study": study, "paid": bulk}, as_json)


def _people(study: str, there: str | None) -> tuple[list[dict[str, Any]], str | None]:
    """Who came by Prolific and is no pilot, and the study's id there, where it is known. Raises LookupError."""
    from sqlalchemy import select

    from desirepath.store.models import Participant, RecruitingId
    from desirepath.web.core.prolific import ProlificError
    from desirepath.web.lab.payments import payees

    database, _ = open_store()
    with database.session() as s:
        find_study(s, study)
        rows = select(Participant.code, RecruitingId.details).join(
            Participant, Participant.id == RecruitingId.participant_id
        )
        details = {row.code: row.details for row in s.execute(rows.where(RecruitingId.study_id == study))}
        people = [
            {
                "external_id": one.external_id,
                "submission": details.get(one.code, {}).get("session"),
                "study": details.get(one.code, {}).get("study"),
                "state": one.state,
                "completed": one.completed and not one.excluded,
            }
            for one in payees(s, study)
            if one.platform == "prolific" and one.is_listed and not one.pilot
        ]
    named = sorted({one["study"] for one in people if one["study"]})
    if there is None and len(named) > 1:
        raise ProlificError(
            f"participants came from {len(named)} studies there: --there names one of {', '.join(named)}"
        )
    chosen = there or (named[0] if named else None)
    return [one for one in people if there is None or one["study"] in (None, there)], chosen


def _named(known: str | None, study: str) -> str:
    from desirepath.web.core.prolific import ProlificError

    if known is None:
        raise ProlificError(f"nobody brought along the id that study {study} has at Prolific: name it by --there")
    return known


def _shown(calls: list[Call], as_json: bool, more: dict[str, Any] | None = None) -> None:
    """What would be sent. The token is in none of it."""
    from desirepath.web.core.prolific import prolific_address

    base = prolific_address(get_settings())
    say({"sent": False, "would_send": [call.as_dict(base) for call in calls], **(more or {})}, as_json)
    typer.echo("Nothing was sent; --send sends it", err=True)


def _record(study: str, action: str, **data: Any) -> None:
    database, _ = open_store()
    with database.transaction() as s:
        _note(s, study, action, **data)


def _note(s: Any, study: str, action: str, **data: Any) -> None:
    from desirepath.store.audit import record

    record(s, action, by=COMMAND_LINE, study_id=study, **data)
