"""`desirepath studies check|preview|diff|revise|schema|instruments`: protocols, before and while a study runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from desirepath.cli.output import COMMAND_LINE, JsonFlag, in_data_folder, say
from desirepath.cli.study import find_study, frozen_protocol, open_store, query_sets


def register(studies: typer.Typer) -> None:
    """Add this module's commands to `desirepath studies`."""
    for command in (check, preview, diff, revise, instruments):
        studies.command()(command)
    studies.command("schema")(schema_command)
    studies.command("validate", hidden=True)(check)  # as it was called


@in_data_folder
def check(file: Path, as_json: JsonFlag = False) -> None:
    """Check a protocol file; exit code 1 if it is not valid."""
    from desirepath.grammar.source import Problem
    from desirepath.study.protocol.freezing import validate_protocol_file

    result = validate_protocol_file(file, query_sets())
    if as_json or result["valid"]:
        say({key: value for key, value in result.items() if as_json or key != "warnings"}, as_json)
    for found in [] if as_json else [*result["errors"], *result.get("warnings", [])]:
        typer.echo(str(Problem(**found)), err=True)
    if not result["valid"]:
        raise typer.Exit(1)


@in_data_folder
def preview(
    file: Path,
    seed: Annotated[int, typer.Option(help="Of the participant: another one, another order.")] = 0,
    language: Annotated[str | None, typer.Option(help="Of the titles; default the protocol's first.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Show the steps that one participant would meet; pages are previewed in the lab."""
    from desirepath.study.protocol.freezing import freeze
    from desirepath.study.protocol.outline import plan_preview

    shown = plan_preview(freeze(file, query_sets()), seed, language)
    if as_json:
        say(shown, as_json)
        return
    for number, step in enumerate(shown["steps"], 1):
        typer.echo(f"{number:4} {step['kind']:14} {step['key']:36} {step['description']}")
    most = f", up to {shown['minutes_at_most']:g} with further pairs"
    longer = most if shown["minutes_at_most"] > shown["minutes"] else ""
    orders = shown["orders"] or "by lot"
    typer.echo(f"{len(shown['steps'])} steps, about {shown['minutes']:g} minutes{longer}; orders: {orders}")


@in_data_folder
def diff(
    before: Annotated[str, typer.Argument(help="A protocol file, or the id of a study (its newest protocol).")],
    after: Annotated[str, typer.Argument(help="The same.")],
    as_json: JsonFlag = False,
) -> None:
    """Say what differs between two protocols, and what that means for data."""
    from desirepath.study.revising import differences

    changes = differences(frozen_protocol(before), frozen_protocol(after))
    if as_json:
        say({"same": not changes, "changes": [change.as_dict() for change in changes]}, as_json)
        return
    for change in changes:
        typer.echo(f"{change.field}: {_shown(change.before)} -> {_shown(change.after)}")
    for means in dict.fromkeys(change.means for change in changes):
        typer.echo(f"  {means}")
    if not changes:
        typer.echo("no difference")


def _shown(value: object) -> str:
    return "nothing" if value is None else str(value)


@in_data_folder
def revise(
    study: Annotated[str, typer.Argument(help="Id of a running study.")],
    file: Annotated[Path, typer.Argument(help="The edited protocol, with a higher version.")],
    as_json: JsonFlag = False,
) -> None:
    """Give a running study a new version of its protocol, for new participants."""
    from desirepath.store.audit import record
    from desirepath.study.protocol.freezing import freeze
    from desirepath.study.revising import query_sets_for, revise_study, versions_of

    database, files = open_store()
    with database.transaction() as s:
        row = find_study(s, study)
        frozen = freeze(file, query_sets_for(s, row))
        version = revise_study(s, files, row, frozen, by=COMMAND_LINE)
        record(s, "study_revised", by=COMMAND_LINE, study_id=study, number=version.number)
        on = {line.number: line.people + line.simulated for line in versions_of(s, row)}
    result = {"study": study, "number": version.number, "changes": version.changes, "participants_on_version": on}
    if as_json:
        say(result, as_json)
        return
    for means in dict.fromkeys(change["means"] for change in version.changes):
        typer.echo(means)
    typer.echo(f"Who is under way goes on with the protocol they began with; participants by version: {on}")


@in_data_folder
def instruments(
    name: Annotated[str | None, typer.Argument(help="Of one: print its file, to read or to fill in.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """List the instruments that a protocol asks by `use: NAME`; print one's file.

    Where its words may not be shipped, the file is to be filled in and put into `questionnaires/` beside the protocol.
    """
    from desirepath.study.protocol.instruments import file_to_fill_in, list_instruments

    if name is None:
        short = ("name", "known_as", "items", "words", "scores")
        listed = list_instruments()
        say({"instruments": listed if as_json else [{key: of[key] for key in short} for of in listed]}, as_json)
        return
    text = file_to_fill_in(name)
    if as_json:
        say({"name": name, "file": f"questionnaires/{name}.yaml", "text": text}, as_json)
    else:
        typer.echo(text, nl=False)


@in_data_folder
def schema_command(
    questionnaire: Annotated[bool, typer.Option("--questionnaire", help="Of a questionnaire's file instead.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Print the JSON Schema of protocols, for editors that complete and check."""
    import json

    from desirepath.grammar.questionnaires import Questionnaire
    from desirepath.study.protocol.schema import Protocol, json_schema

    schema = json_schema(Questionnaire if questionnaire else Protocol)
    typer.echo(json.dumps(schema, indent=None if as_json else 0, ensure_ascii=False))
