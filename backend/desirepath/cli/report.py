"""`desirepath studies report`: a study's report, from this installation or from an exported data set."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from desirepath.cli.output import JsonFlag, in_data_folder, say, takes_long

if TYPE_CHECKING:
    from desirepath.jobs.params import Params
    from desirepath.report.policy_table import PolicyRow
    from desirepath.store.artefacts import ArtefactStore
    from desirepath.store.database import Database
    from desirepath.store.models import Job
    from desirepath.store.who_counts import Whose


FOLDS = 3  # of scenes whose answers are held out, to tell which reward model predicts better


def register(studies: typer.Typer) -> None:
    """Add the command to `desirepath studies`."""
    studies.command()(report)


@in_data_folder
@takes_long("writing the report of {study} to {out}")
def report(
    study: Annotated[str, typer.Argument(help="Id of the study, or the folder or zip of an exported data set.")],
    out: Annotated[Path, typer.Option(help="Folder for report.html, tests.csv and figures.")] = Path("report"),
    who: Annotated[str, typer.Option(help="Whose answers: people, simulated or all.")] = "people",
    plan: Annotated[
        Path | None, typer.Option(help="Another analysis plan (YAML) than the protocol's; reported as deviations.")
    ] = None,
    policies: Annotated[
        bool,
        typer.Option("--policies", help="Also align a policy with each view's answers, as jobs, and evaluate it."),
    ] = False,
    model: Annotated[
        str, typer.Option(help="Reward models of the policies, with commas: interface, linear, weights, mlp.")
    ] = "interface,weights",
    recipe: Annotated[
        str, typer.Option(help="Algorithm of the policies: fine_tuning, instant, conditioning_search, thesis, ...")
    ] = "fine_tuning",
    scenes: Annotated[int, typer.Option(min=20, help="Fresh scenes that every policy rolls out in.")] = 1_000,
    as_json: JsonFlag = False,
) -> None:
    """Write a study's report: tests, agreement, figures; HTML, PNG, SVG and CSV."""
    from desirepath.cli.study import open_store, say_who_is_left_out
    from desirepath.report.analysis_plan import read_plan
    from desirepath.report.study_report import write_study_report
    from desirepath.report.tidy_tables import read_folder, read_study
    from desirepath.store.dataset.unpacking import unpack
    from desirepath.store.models import Study
    from desirepath.store.snapshots import check_whose

    chosen, used = check_whose(who), read_plan(plan) if plan is not None else None
    command = f"desirepath studies report STUDY --who {who}{' --plan FILE' if plan is not None else ''}"
    learned: list[PolicyRow] = []
    with unpack(Path(study)) as folder:
        if folder.is_dir():
            if policies:
                raise ValueError("--policies: learns from a study of this installation; import the data set first")
            data, load = read_folder(folder)
        else:
            database, files = open_store()
            with database.session() as s:
                row = s.get(Study, study)
                if row is None:
                    raise LookupError(
                        f"no study with id {study!r} and no such folder; `desirepath studies list` shows all"
                    )
                data, load = read_study(s, files, row)
                say_who_is_left_out(s, study)
            if policies:
                views = sorted({choice.view for choice in data.choices})
                learned = _learned(database, files, study, views, chosen, model.split(","), recipe, scenes)
                command += f" --policies --model {model} --recipe {recipe} --scenes {scenes}"
        say(write_study_report(data, load, out, who=chosen, plan=used, command=command, policies=learned), as_json)


def _learned(
    database: Database,
    files: ArtefactStore,
    study: str,
    views: Sequence[str],
    whose: Whose,
    models: Sequence[str],
    recipe: str,
    scenes: int,
) -> list[PolicyRow]:
    """A policy per view and reward model, and the base policy, each rolled out in the same scenes; what is there
    already is used."""
    from desirepath.cli.science import check_params, jobs_at_hand
    from desirepath.report.policy_table import BASE, PolicyRow
    from desirepath.store.snapshots import take_snapshot

    rows = []
    setup = ""
    aligning = {"comparisons": 0, "recipe": recipe, "hold_out": FOLDS}
    for model in models:  # what cannot be asked is refused before any answers are frozen
        check_params("align", aligning | {"model": model}, takes=True)
    with jobs_at_hand() as finish_job:

        def done(kind: str, params: dict[str, Any]) -> dict[str, Any]:
            return known_job(database, kind, params) or finish_job(kind, params)[1]

        for view in views:
            with database.transaction() as s:
                snapshot = take_snapshot(s, files, study_id=study, whose=whose, view=view)
                identity, setup = snapshot.id, snapshot.setup
                answers = snapshot.card["answers"] - snapshot.card["probes"]
            for model in models:
                aligned = done("align", aligning | {"snapshot": identity, "model": model})
                rows.append(
                    PolicyRow(
                        name=view,
                        policy=aligned["policy"],
                        measured=done("evaluate", {"policy": aligned["policy"], "scenes": scenes})["measured"],
                        model=model,
                        answers=answers,
                        accuracy=aligned["training_accuracy"],
                        held_out=aligned["held_out"],
                        passed=aligned["passed"],
                    )
                )
        base = f"{setup}/base"
        measured = done("evaluate", {"policy": base, "scenes": scenes})["measured"]
    return [*rows, PolicyRow(BASE, base, measured)]


def known_job(database: Database, kind: str, params: dict[str, Any]) -> dict[str, Any] | None:
    """The result of a job that succeeded with these very parameters, None where there was none."""
    from sqlalchemy import select

    from desirepath.jobs.kinds import get_kind
    from desirepath.store.models import Job

    wanted = get_kind(kind).parse(params)
    with database.session() as s:
        done = s.scalars(select(Job).where(Job.kind == kind, Job.state == "succeeded").order_by(Job.created_at.desc()))
        return next((job.result for job in done if job.result and _asks(job, wanted)), None)


def _asks(job: Job, wanted: Params) -> bool:
    """Whether a stored job was asked just that."""
    from desirepath.jobs.kinds import JobParamsError, get_kind

    try:
        return get_kind(job.kind).parse(job.params) == wanted
    except JobParamsError:
        return False
