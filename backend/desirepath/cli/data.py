"""`desirepath studies export|import`, `backup` and `restore`."""

from __future__ import annotations

from collections import Counter
from pathlib import PurePosixPath
from typing import Annotated, Any

import typer

from desirepath.cli.output import COMMAND_LINE, JsonFlag, in_data_folder, say, takes_long
from desirepath.cli.study import open_store, say_who_is_left_out
from desirepath.settings import get_settings


def register(app: typer.Typer, studies: typer.Typer) -> None:
    """Add this module's commands to the main one and to `desirepath studies`."""
    studies.command()(export)
    studies.command("import")(import_)
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
