"""The `desirepath` command: assembles the groups beside it. Imports stay lazy so that `--help` is quick."""

from __future__ import annotations

import os
import sys

from desirepath.collecting import ended_by_interrupt, without_collecting

with ended_by_interrupt(), without_collecting():
    from importlib.metadata import entry_points
    from importlib.metadata import version as version_of
    from typing import Annotated

    import typer

    from desirepath.cli import (
        data,
        drive,
        jobs,
        places,
        plots,
        policies,
        prolific,
        recordings,
        report,
        science,
        serve,
        study,
        study_protocols,
        words,
    )
    from desirepath.cli.output import INTERRUPTED

app = typer.Typer(
    name="desirepath",
    help="Human-in-the-loop platform for personalised robot navigation.",
    epilog="Exporting and measuring: studies export, policies evaluate. Ends with 0 done; 1 refused or failed, with "
    "the reason on stderr; 2 wrongly asked; 130 ended by Ctrl-C.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

GROUPS = {
    "studies": study.commands,
    "queries": science.queries,
    "policies": policies.commands,
    "setups": places.setups,
    "robots": places.robots,
    "jobs": jobs.commands,
    "words": words.commands,
    "prolific": prolific.commands,
}
ONCE_GROUPS = {"study": study.commands, "setup": places.setups, "robot": places.robots}
ONCE_COMMANDS = {"export": data.export, "evaluate": science.evaluate, "report": report.report}
"""What they were called when others began to call them: both still answer, and are not listed."""


def _say_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"desirepath {version_of('desirepath')}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", help="Say which version this is.", callback=_say_version, is_eager=True)
    ] = False,
) -> None:
    """Human-in-the-loop platform for personalised robot navigation."""


with ended_by_interrupt():
    study_protocols.register(study.commands)
    report.register(study.commands)
    data.register(app, study.commands)
    science.register(policies.commands)
    plots.register(policies.commands)
    recordings.register(science.queries)
    serve.register(app)
    drive.register(app)
    app.add_typer(science.train, name="train")
    for name, group in GROUPS.items():
        app.add_typer(group, name=name, rich_help_panel="Things, each with verbs")
    for name, group in ONCE_GROUPS.items():
        app.add_typer(group, name=name, hidden=True)
    for name, command in ONCE_COMMANDS.items():
        app.command(name, hidden=True)(command)
    for further in entry_points(group="desirepath.commands"):
        command = further.load()
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=further.name)
        else:
            app.command(further.name)(command)


def main() -> None:
    """Entry point of the console script. Whatever a command writes is its user's alone: most of it is about people."""
    os.umask(0o077)
    try:
        with ended_by_interrupt():  # until a command begins: `cli/output.py`
            app()
    except SystemExit as end:
        if end.code == INTERRUPTED:  # compiled code that another thread is in may not survive the interpreter's end
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(INTERRUPTED)
        raise


if __name__ == "__main__":
    main()
