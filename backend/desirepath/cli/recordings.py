"""`desirepath queries inspect|import|export`: recordings of others as a query set, trajectories as others read them."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from desirepath.cli.output import COMMAND_LINE, JsonFlag, in_data_folder, say, takes_long
from desirepath.cli.study import open_store

if TYPE_CHECKING:
    from desirepath.simulation.trajectory import Trajectory


def register(queries: typer.Typer) -> None:
    """Add this module's commands to `desirepath queries`."""
    queries.command()(inspect)
    queries.command("import")(import_)
    queries.command("export")(export)


@in_data_folder
@takes_long("looking into {path}")
def inspect(
    path: Annotated[Path, typer.Argument(help="A recording, or a folder of them.")],
    as_json: JsonFlag = False,
) -> None:
    """Say what is in a recording, and which mapping its names suggest."""
    from desirepath.recordings.looking import look, suggest

    found = look(path)
    plain = {name: value for name, value in found.as_dict().items() if value or name == "pairs"}
    say({**plain, "mapping": suggest(found).model_dump(exclude_defaults=True, mode="json")}, as_json)


@in_data_folder
@takes_long("reading recordings in {path}")
def import_(
    path: Annotated[
        Path, typer.Argument(help="A recording, or a folder of them: CSV, SocNav3, MCAP, rosbag2, Minari, LeRobot.")
    ],
    setup: Annotated[str, typer.Option(help="Name of the setup whose robot it is shown as, such as study_room.")],
    mapping: Annotated[
        Path | None, typer.Option(help="YAML: columns, units, topics, runs, goal, pairs; for other than usual names.")
    ] = None,
    pairs: Annotated[
        Literal["given", "proposed"] | None,
        typer.Option(help="Those in pairs.csv or the mapping, or the most different; default given, where any are."),
    ] = None,
    count: Annotated[int, typer.Option(min=1, max=2_000, help="So many pairs are proposed at most.")] = 200,
    name: Annotated[str | None, typer.Option(help="What the query set is called; default the path's name.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write the query set to this file (.npz) instead of into the installation.")
    ] = None,
    answers: Annotated[
        Path | None,
        typer.Option(
            help="CSV of answers to pairs (a, b, choice, person): becomes a snapshot; with --out they are printed."
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Make a query set of recordings: trajectories as recorded, pairs given or proposed."""
    from desirepath.recordings.importing import import_recordings
    from desirepath.recordings.mapping import read_mapping

    if out is not None and out.suffix != ".npz":
        raise ValueError(f"--out {out}: must end with .npz")
    mapped, mapped_sha = read_mapping(mapping) if mapping is not None else (None, "")
    found = import_recordings(
        path,
        setup,
        mapped,
        (mapping.name, mapped_sha) if mapping is not None else None,
        pairs=pairs,
        most=count,
        answers=answers,
    )
    result = {
        "scenes": found.scenes,
        "trajectories": found.trajectories,
        "queries": len(found.query_set),
        "warnings": list(found.warnings),
    }
    if out is not None:
        found.query_set.save(out)
        result |= {"file": str(out), "imported": found.recorded_card()}
        if found.answers:
            result["answers"] = [asdict(one) | {"query": query} for query, one in found.answers]
    else:
        from desirepath.store.audit import record
        from desirepath.store.imported_answers import ImportedAnswer, save_imported_answers
        from desirepath.store.query_sets import save_query_set

        database, files = open_store(makes=True)
        with database.transaction() as s:
            card = found.recorded_card()
            stored = save_query_set(
                s, files, found.query_set, name=name or path.stem, card={"imported": card}, videos=found.videos
            )
            record(s, "recordings_imported", by=COMMAND_LINE, name=stored.name, files=len(card["files"]))
            result["query_set"] = stored.id
            if found.answers:
                given = [ImportedAnswer(one.line, query, one.choice, one.person) for query, one in found.answers]
                source = card["files"][-1]
                snapshot = save_imported_answers(s, files, stored, given, name=stored.name, source=source)
                result |= {"answers": len(given), "snapshot": snapshot.id}
    say(result, as_json)


@in_data_folder
@takes_long("writing trajectories of {name}")
def export(
    name: Annotated[
        str, typer.Argument(help="A shipped query set, a file, an id of this installation, or an exported data set.")
    ],
    form: Annotated[Literal["socnav3", "mcap", "lerobot"], typer.Option("--format", help="As what.")],
    out: Annotated[Path, typer.Option(help="New or empty folder.")],
    as_json: JsonFlag = False,
) -> None:
    """Write every trajectory of a query set or data set for the tools of others."""
    from desirepath.recordings.exporting import export_trajectories, unlike

    found = unlike(_trajectories(name))
    say({"trajectories": len(found), "folder": str(out), "files": export_trajectories(found, form, out)}, as_json)


def _trajectories(name: str) -> list[Trajectory]:
    from desirepath.learning.policies.shipped import load_queries
    from desirepath.learning.queries.queries import QuerySet
    from desirepath.simulation.trajectory import Trajectory as Stored
    from desirepath.store.artefacts import SHA256, load_artefact

    if SHA256.fullmatch(name):
        database, files = open_store()
        with database.session() as s:
            queries = QuerySet.from_bytes(load_artefact(s, files, name, kind="query_set")[1]).queries
    elif Path(name).is_dir():
        folder = Path(name) / "trajectories"
        return [Stored.load(one) for one in sorted((folder if folder.is_dir() else Path(name)).glob("*.npz"))]
    else:
        queries = load_queries(name).queries
    return [one for query in queries for one in (query.trajectory_a, query.trajectory_b)]
