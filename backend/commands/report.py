"""`desirepath report`: a study's report, from this installation or from an exported data set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from backend.commands.output import JsonFlag, plain_errors, say


def register(app: typer.Typer) -> None:
    """Add the command to `desirepath`."""
    app.command()(report)


@plain_errors
def report(
    study: Annotated[str, typer.Argument(help="Id of the study, or the folder of an exported data set.")],
    out: Annotated[Path, typer.Option(help="Folder for report.html, tests.csv and figures.")] = Path("report"),
    who: Annotated[str, typer.Option(help="Whose answers: people, simulated or all.")] = "people",
    plan: Annotated[
        Path | None, typer.Option(help="Another analysis plan (YAML) than the protocol's; told as deviations.")
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """The study's report: tests, agreement, figures; HTML that prints, PNG, SVG and CSV."""
    from backend.report.plan import read_plan
    from backend.report.reading import read_folder, read_study
    from backend.report.run import write_study_report
    from backend.store.models import Study
    from backend.store.snapshots import checked_whose

    chosen, used = checked_whose(who), read_plan(plan) if plan is not None else None
    command = f"desirepath report STUDY --who {who}{' --plan FILE' if plan is not None else ''}"
    if Path(study).is_dir():
        data, load = read_folder(Path(study))
    else:
        from backend.commands.study import open_store

        database, files = open_store()
        with database.session() as s:
            row = s.get(Study, study)
            if row is None:
                raise LookupError(
                    f"no study with id {study!r} and no such folder; `desirepath study list` shows studies"
                )
            data, load = read_study(s, files, row)
    say(write_study_report(data, load, out, who=chosen, plan=used, command=command), as_json)
