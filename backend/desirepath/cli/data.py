"""`desirepath studies export|import|deposit|preregistration`, `backup` and `restore`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import typer

from desirepath.cli.output import COMMAND_LINE, JsonFlag, in_data_folder, say, takes_long
from desirepath.cli.study import frozen_protocol, open_store, say_who_is_left_out
from desirepath.settings import get_settings


def register(app: typer.Typer, studies: typer.Typer) -> None:
    """Add this module's commands to the main one and to `desirepath studies`."""
    studies.command()(export)
    studies.command("import")(import_)
    studies.command()(deposit)
    studies.command("preregistration")(preregistration_command)
    app.command()(backup)
    app.command()(restore)


@in_data_folder
@takes_long("writing the data set of study {study} to {out}")
def export(
    study: Annotated[str, typer.Argument(help="Id of the study.")],
    out: Annotated[str, typer.Option(help="Folder to write; made if missing, must be empty. Or s3://BUCKET/FOLDER.")],
    pilots: Annotated[bool, typer.Option("--pilots", help="With the pilot participants, marked.")] = False,
    open_data: Annotated[
        bool, typer.Option("--open-data", help="For publication: nothing of who did not agree to that.")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Write a study's data set: CSV, Parquet, trajectories, dictionary, checksums."""
    from desirepath.store.audit import record
    from desirepath.store.dataset.writing import export_study
    from desirepath.store.places import write_to

    database, files = open_store()
    with write_to(out) as folder:
        written = export_study(database, files, study, folder, pilots=pilots, open_data=open_data)
    with database.transaction() as s:
        record(s, "study_exported", by=COMMAND_LINE, study_id=study, pilots=pilots, open_data=open_data)
        if not pilots:
            say_who_is_left_out(s, study, "; --pilots exports them, marked")
    say(dict(written) if as_json else _summary(written["study"], written["files"], out), as_json)


def _summary(study: str, files: list[dict[str, Any]], out: str) -> dict[str, Any]:
    """What a person wants to know of an export; every file with its hash is in `--json` and in the folder. Tables are
    the files beside the dictionary; what lies in folders is counted by folder."""
    paths = [PurePosixPath(file["path"]) for file in files]
    tables = [
        {"table": path.stem, "rows": one["rows"]}
        for path, one in zip(paths, files, strict=True)
        if path.suffix == ".parquet" and len(path.parts) == 1
    ]
    parts = Counter(path.parts[0] for path in paths if len(path.parts) > 1)
    return {"study": study, "folder": out, "files": len(files), **parts, "tables": tables}


@in_data_folder
@takes_long("reading the data set {folder} and checking it")
def import_(
    folder: Annotated[
        str, typer.Argument(help="A folder that `desirepath studies export` wrote, or its zip, here or on S3.")
    ],
    as_json: JsonFlag = False,
) -> None:
    """Load an exported data set into this installation, to the same answers."""
    from desirepath.store.dataset.importing import import_dataset
    from desirepath.store.dataset.unpacking import unpack
    from desirepath.store.places import read_from

    database, files = open_store(makes=True)
    with read_from(folder) as fetched, unpack(fetched) as data_set:
        say(dict(import_dataset(database, files, data_set)), as_json)


@in_data_folder
@takes_long("writing the deposit of study {study} to {to}")
def deposit(
    study: Annotated[str, typer.Argument(help="Id of the study.")],
    to: Annotated[Path, typer.Option(help="Folder to write; made if missing, must be empty.")],
    author: Annotated[
        list[str] | None,
        typer.Option(help="'Family, Given; affiliation; ORCID', once for each; the last two if you like."),
    ] = None,
    who: Annotated[
        str | None, typer.Option(help="Whom the report is about: people, simulated or all; default people, if any.")
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Write a study as a folder to publish: data, report, preregistration, metadata, checksums.

    With metadata for Zenodo and DataCite; without who did not agree to publication, and without voices. Nothing is sent
    anywhere.
    """
    from desirepath.store.audit import record
    from desirepath.store.snapshots import check_whose
    from desirepath.study.deposit import Author, write_deposit

    authors = [Author.read(written) for written in author or []]
    database, files = open_store()
    written = write_deposit(database, files, study, to, authors=authors, who=check_whose(who) if who else None)
    with database.transaction() as s:
        record(s, "study_exported", by=COMMAND_LINE, study_id=study, pilots=False, open_data=True)
    say(written, as_json)
    for what in written["to_fill_in"]:
        typer.echo(f"{what} not given: fill in .zenodo.json and datacite.json before you publish", err=True)


@in_data_folder
def preregistration_command(
    study: Annotated[str, typer.Argument(help="Id of a study, or a protocol file.")],
    out: Annotated[Path | None, typer.Option(help="File to write; default the terminal.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Write a preregistration from the protocol: hypotheses, design, sample, measures, analysis.

    What only you can say is marked TO FILL IN. Nothing is sent anywhere.
    """
    from sqlalchemy import func, select

    from desirepath.store.models import Response, Session, utc_now
    from desirepath.study.preregistration import preregistration

    frozen, answers = frozen_protocol(study), None
    if not Path(study).is_file():
        database, _ = open_store()
        with database.session() as s:
            counted = select(func.count(Response.id)).join(Session).where(Session.study_id == study)
            answers = s.scalar(counted) or 0
    text = preregistration(frozen, now=utc_now().date().isoformat(), answers=answers)
    if out is not None:
        out.write_text(text, encoding="utf-8")
    if as_json:
        say({"study": study, "answers": answers, "text": text} | ({"file": str(out)} if out else {}), as_json)
    elif out is None:
        typer.echo(text, nl=False)
    if answers:
        typer.echo(f"{answers} answers are there already: a preregistration is written before the first", err=True)


@in_data_folder
@takes_long("copying database and artefacts to {out}")
def backup(
    out: Annotated[str, typer.Option(help="File to write, or s3://BUCKET/FILE.")], as_json: JsonFlag = False
) -> None:
    """Copy the database and all artefacts into one file; the server may keep running."""
    from desirepath.store.audit import record
    from desirepath.store.backup import backup as write_backup
    from desirepath.store.places import write_to

    database, files = open_store()
    with write_to(out) as file:
        written = write_backup(database, files, file) | {"file": out}
    with database.transaction() as s:
        record(s, "backup_made", by=COMMAND_LINE)
    say(dict(written), as_json)


@in_data_folder
@takes_long("bringing {file} back")
def restore(
    file: Annotated[str, typer.Argument(help="A file that `desirepath backup` wrote, here or on S3.")],
    as_json: JsonFlag = False,
) -> None:
    """Bring a backup back into an empty data folder, or into an empty PostgreSQL database."""
    from desirepath.store.backup import restore as read_backup
    from desirepath.store.places import read_from

    settings = get_settings()
    with read_from(file) as fetched:
        back = read_backup(fetched, settings.data, database_url=settings.database, artefacts_url=settings.artefacts)
    say(dict(back), as_json)
