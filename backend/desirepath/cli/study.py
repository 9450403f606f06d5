"""`desirepath studies ...`: protocols and studies from the command line."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click
import typer

from desirepath.cli.loopback import loopback_server
from desirepath.cli.options import RESPONSE_MODEL, Configured, OptionsOf, configured
from desirepath.cli.output import (
    COMMAND_LINE,
    JsonFlag,
    in_data_folder,
    say,
    takes_long,
)
from desirepath.registries import find_offer
from desirepath.settings import get_settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.web.replicas.only_server import running_server

if TYPE_CHECKING:
    from sqlalchemy.orm import Session

    from desirepath.learning.preferences.oracles import ResponseModel
    from desirepath.report.planned_design import Assumed
    from desirepath.store.models import Study
    from desirepath.study.protocol.freezing import FrozenProtocol

NOT_REACHED = "Not reached: backups made before, and exports and reports already downloaded; delete or replace those."

commands = typer.Typer(help="Studies and their protocols.", no_args_is_help=True)


def open_store(*, makes: bool = False) -> tuple[Database, ArtefactStore]:
    """The installation's database (migrated) and artefact store. Raises LookupError where there is none, unless the
    command makes one."""
    from desirepath.store.database import check_writable

    settings = get_settings()
    if not makes and not is_installed():
        raise LookupError(
            f"no installation in {settings.data.resolve()}: `desirepath serve` or `desirepath studies create` begin "
            "one; --data or DESIREPATH_DATA name another folder"
        )
    check_writable(settings.data)
    database = Database(settings.database)
    if (command := click.get_current_context(silent=True)) is not None:
        command.call_on_close(database.close)
    database.migrate()
    return database, ArtefactStore(settings.artefacts)


def is_installed() -> bool:
    """Whether there is a database; on a server there is taken to be."""
    file = Database(get_settings().database).file
    return file is None or file.is_file()


def say_who_is_left_out(s: Session, study: str, more: str = "") -> None:
    """Told on stderr where pilot participants are not among what is told: else a piloted study looks empty."""
    from sqlalchemy import func, select

    from desirepath.store.models import Participant

    pilots = s.scalar(select(func.count()).where(Participant.study_id == study, Participant.pilot))
    if pilots:
        typer.echo(f"{pilots} of the pilot left out: who joins in a pilot counts in no number{more}", err=True)


def query_sets() -> dict[str, str]:
    """The query sets of this installation, none where there is no installation yet; nothing is made or migrated."""
    from desirepath.store.query_sets import query_sets_here

    if not is_installed():
        return {}
    with contextlib.closing(Database(get_settings().database)) as database, database.session() as s:
        return query_sets_here(s)


@commands.command()
@in_data_folder
def create(
    file: Path,
    name: Annotated[str | None, typer.Option(help="Name of the study; default the protocol's title.")] = None,
    live: Annotated[
        bool,
        typer.Option("--live", help="Without a pilot: whoever joins counts. Default: pilots, until `studies live`."),
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Open a study from a protocol, as a pilot first; print its id and recruiting link."""
    from desirepath.store.shipped_policies import register_shipped
    from desirepath.study.protocol.freezing import freeze
    from desirepath.study.studies import create_study

    if is_installed():
        open_store()  # an older one is migrated before its query sets are read
    frozen = freeze(file, query_sets())  # what is wrong with it is said before anything is made
    database, files = open_store(makes=True)
    with database.transaction() as s:
        register_shipped(s, files)
        study = create_study(s, files, frozen, name=name or frozen.title("en"), created_by=None)
        study.pilot = not live
        result = {"study": study.id, "link": _link(study), "pilot": study.pilot}
    say(result, as_json)
    if not live:
        typer.echo(
            f"New participants are pilot participants, whom reports leave out; `desirepath studies live {study.id}`",
            err=True,
        )


@commands.command("live")
@in_data_folder
def go_live(study: Annotated[str, typer.Argument(help="Id of the study.")], as_json: JsonFlag = False) -> None:
    """End a study's pilot: participants who join after this are in the main study.

    Pilot participants stay pilots.
    """
    from desirepath.store.audit import record
    from desirepath.store.events import log_event
    from desirepath.store.models import Study

    database, _ = open_store()
    with database.transaction() as s:
        row = s.get(Study, study, with_for_update=True)
        if row is None:
            raise ValueError(f"no study with id {study!r}; `desirepath studies list` names them")
        if row.pilot:
            row.pilot = False
            log_event(s, "pilot_ended", study_id=row.id, by=COMMAND_LINE)
            record(s, "study_pilot_changed", by=COMMAND_LINE, study_id=row.id, pilot=False)
    say({"study": study, "pilot": False}, as_json)


@commands.command("list")
@in_data_folder
def list_studies(as_json: JsonFlag = False) -> None:
    """List the studies of this installation."""
    from sqlalchemy import select

    from desirepath.store.models import Study

    database, _ = open_store()
    with database.session() as s:
        studies = _rows(s, s.scalars(select(Study).order_by(Study.created_at)))
    say({"studies": studies}, as_json)


@commands.command()
@in_data_folder
def show(study: Annotated[str, typer.Argument(help="Id of the study.")], as_json: JsonFlag = False) -> None:
    """Show one study: its protocol, its recruiting link, who took part."""
    database, _ = open_store()
    with database.session() as s:
        row = find_study(s, study)
        more = {"created_at": row.created_at.isoformat(), "protocol_hash": row.protocol_hash, "link": _link(row)}
        say(_rows(s, [row])[0] | more, as_json)


def find_study(s: Session, study: str) -> Study:
    """The study of that id. Raises LookupError, which says where ids are listed."""
    from desirepath.store.models import Study

    row = s.get(Study, study)
    if row is None:
        raise LookupError(f"no study with id {study!r}; `desirepath studies list` shows them")
    return row


def _rows(s: Session, studies: Iterable[Study]) -> list[dict[str, Any]]:
    """What is told of each study; who took part is counted once for all of them."""
    from sqlalchemy import func, select

    from desirepath.store.models import Participant
    from desirepath.store.who_counts import GROUPS, in_group

    per_study = select(Participant.study_id, func.count()).group_by(Participant.study_id)
    groups = {name: s.execute(per_study.where(in_group(name))).all() for name in GROUPS}
    counts = {(study, name): count for name, rows in groups.items() for study, count in rows}
    return [
        {
            "study": study.id,
            "name": study.name,
            "protocol": f"{study.protocol_name} v{study.protocol_version}",
            "state": study.state,
            "pilot": study.pilot,
            "people": counts.get((study.id, "people"), 0),
            "pilot_participants": counts.get((study.id, "pilot"), 0),
            "simulated": counts.get((study.id, "simulated"), 0),
        }
        for study in studies
    ]


def _link(study: Study) -> str:
    """Where people join: on the server that runs on this folder, or on the one that would."""
    settings = get_settings()
    served = None if settings.public_url else running_server(settings)
    return f"{served or settings.own_url}/join/{study.recruiting_token}"


@commands.command(cls=Configured)
@in_data_folder
@takes_long("walking {participants} simulated participants through study {study}")
@configured(response_model=RESPONSE_MODEL)
def simulate(
    study: Annotated[str, typer.Argument(help="Id of the study.")],
    response_model: ResponseModel,
    participants: Annotated[int, typer.Option(min=1)] = 1,
    oracle: Annotated[
        str,
        typer.Option(
            help="Whose preference: min-human-distance, shortest, random, ..., somebody outside the list as network:3, "
            "or a whole family as network; with commas each has the next."
        ),
    ] = "min-human-distance",
    seed: Annotated[int, typer.Option(help="Seed of the oracle's wrong answers.")] = 0,
    cohort: Annotated[
        Path | None, typer.Option(help="YAML: what they rate and rank, and how conditions change their answers.")
    ] = None,
    browser: Annotated[
        int, typer.Option(min=0, help="So many of them in a real Chromium, which plays every trajectory to its end.")
    ] = 0,
    language: Annotated[str, typer.Option(help="In which those in a browser read the pages.")] = "en",
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for a picture of every kind of page, from the first in a browser.")
    ] = None,
    url: Annotated[str | None, typer.Option(help="A running server; default one of the command's own.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Walk simulated participants through whole sessions; their data are marked as simulated."""
    from desirepath.report.simulated_cohorts import read_cohort
    from desirepath.study.simulated.http import simulate_study
    from desirepath.study.simulated.participant import Character

    if browser > participants:
        raise ValueError(f"--browser {browser}: there are only {participants} participants")
    character = Character(
        oracle,
        response_model,
        seed,
        read_cohort(cohort) if cohort is not None else None,
    )
    if browser:
        lacking = "--browser needs desirepath-experiments: pip install ./experiments (in a checkout)"
        in_browser: Callable[..., dict[str, Any]] = find_offer("desirepath.walkers", lacking)
    database, _ = open_store()
    with database.session() as s:
        token = find_study(s, study).recruiting_token

    def walk(base_url: str) -> None:
        if not browser:
            say(simulate_study(base_url, token, participants, character), as_json)
            return
        aside = partial(typer.echo, err=True)
        say(in_browser(base_url, token, participants, browser, character, language, pictures, aside), as_json)

    if url:
        walk(url.rstrip("/"))
    else:
        running = running_server(get_settings())
        with contextlib.nullcontext((running, None)) if running else loopback_server(get_settings()) as (own, _):
            walk(own)


@commands.command("power", cls=Configured)
@in_data_folder
@configured(assumed=OptionsOf("desirepath.report.planned_design:Assumed"))
def power_command(
    study: Annotated[str, typer.Argument(help="Id of a study, or a protocol file.")],
    assumed: Assumed,
    participants: Annotated[str, typer.Option(help="Numbers of participants to try.")] = "10,20,30,40",
    walk: Annotated[int, typer.Option(min=3, help="Bots that go through the real state machine first.")] = 6,
    cohorts: Annotated[int, typer.Option(min=1, help="Simulated studies per number of participants.")] = 500,
    out: Annotated[Path | None, typer.Option(help="Folder for power.png, power.svg and power.csv.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Say how many people a study needs, by simulated ones and its own analysis."""
    from desirepath.study.planned_power import plan_power

    sizes = [int(number) if number.strip().isdecimal() else 0 for number in participants.split(",")]
    planned = plan_power(
        frozen_protocol(study),
        sizes,
        assumed,
        walk=walk,
        cohorts=cohorts,
        tell=lambda words: typer.echo(words, err=True),
    )
    result = planned.as_dict()
    if out is not None:
        from desirepath.report.report_figures import power_picture

        picture = power_picture(planned.power, planned.assumed, queried=planned.design.queries > 0)
        result["files"] = [str(path) for path in picture.save(out)]
        result["caption"] = picture.caption
    say(result, as_json)


def frozen_protocol(study: str) -> FrozenProtocol:
    """Of a file, or of a study of this installation (the protocol that whoever joins now gets)."""
    from desirepath.store.models import Study
    from desirepath.study.protocol.freezing import freeze
    from desirepath.study.session.versions import newest_protocol

    if Path(study).is_file():
        return freeze(Path(study), query_sets())
    database, _ = open_store()
    with database.session() as s:
        row = s.get(Study, study)
        if row is None:
            raise LookupError(
                f"{study!r} is neither a file nor the id of a study; `desirepath studies list` shows those"
            )
        return newest_protocol(s, row)[1]


@commands.command()
@in_data_folder
def erase(
    study: Annotated[str, typer.Argument(help="Id of the study.")],
    participant: Annotated[str, typer.Argument(help="The participant's code.")],
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Erase a participant, which cannot be undone.

    Answers, trajectories made for them, models made from them alone.
    """
    from sqlalchemy import select

    from desirepath.store.audit import record
    from desirepath.store.erasure import erase_participant
    from desirepath.store.models import Participant

    database, files = open_store()
    with database.session() as s:
        coded = s.scalars(select(Participant.id).where(Participant.study_id == study, Participant.code == participant))
        identity = coded.first()
    if identity is None:
        raise LookupError(f"no participant {participant!r} in study {study!r}")
    if not yes:
        typer.confirm(f"Erase everything of participant {participant}? This cannot be undone.", abort=True, err=True)
    erased = erase_participant(database, files, identity, by=COMMAND_LINE, data=get_settings().data)
    with database.transaction() as s:
        record(s, "participant_erased", by=COMMAND_LINE, study_id=study)
    say(erased, as_json)
    typer.echo(NOT_REACHED, err=True)


@commands.command("erase-overdue")
@in_data_folder
def erase_overdue(
    study: Annotated[str, typer.Argument(help="Id of the study.")],
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Erase every participant whose date of keeping is over, which cannot be undone.

    The date is set on the study's Data tab.
    """
    from desirepath.store.models import utc_now
    from desirepath.store.retention import erase_overdue as erase_all

    database, files = open_store()
    if not yes:
        typer.confirm(f"Erase every participant of study {study}? This cannot be undone.", abort=True, err=True)
    data = get_settings().data
    say(erase_all(database, files, study, by=COMMAND_LINE, now=utc_now(), data=data), as_json)
    typer.echo(NOT_REACHED, err=True)
