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
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


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
    serve.register(app)
    data.register(app)
    drive.register(app)
    science.register(app)
    recordings.register(science.queries)
    plots.register(app)
    report.register(app)
    study_protocols.register()
    app.add_typer(study.commands, name="study")
    app.add_typer(jobs.commands, name="jobs")
    app.add_typer(words.commands, name="words")
    app.add_typer(policies.commands, name="policies")
    app.add_typer(places.robots, name="robot")
    app.add_typer(places.setups, name="setup")
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
