"""`desirepath jobs ...`: background work: started, looked at, stopped."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from sqlalchemy import select

from desirepath.cli.output import COMMAND_LINE, JsonFlag, in_data_folder, say
from desirepath.cli.science import parse_settings, run_job
from desirepath.cli.study import open_store
from desirepath.store.models import Job

JOB_KINDS = (  # as backend/desirepath/jobs/kinds.py has them; not imported, so that --help is quick
    *("align", "reward_model", "compare", "evaluate", "train_base", "ensemble", "queries", "train_demonstrations"),
    *("ask_person", "train_setup"),
)
commands = typer.Typer(help="Background jobs.", no_args_is_help=True)


def _row(job: Job) -> dict[str, Any]:
    return {
        "job": job.id,
        "kind": job.kind,
        "state": job.state,
        "progress": round(job.progress, 3),
        "message": job.message,
        "created_at": job.created_at.isoformat(),
    }


@commands.command()
@in_data_folder
def start(
    kind: Annotated[str, typer.Argument(help=f"One of {', '.join(JOB_KINDS)}.")],
    settings: Annotated[list[str] | None, typer.Option("--set", help="A parameter of the job, as name=value.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Start a job and wait for its result; `train` and `queries generate` have its options."""
    run_job(kind, parse_settings(settings), None, as_json)


@commands.command("list")
@in_data_folder
def list_jobs(
    state: Annotated[str | None, typer.Option(help="Only jobs in this state.")] = None, as_json: JsonFlag = False
) -> None:
    """List jobs, newest first."""
    database, _ = open_store()
    with database.session() as s:
        query = select(Job).order_by(Job.created_at.desc())
        say({"jobs": [_row(job) for job in s.scalars(query.where(Job.state == state) if state else query)]}, as_json)


@commands.command()
@in_data_folder
def show(job: str, as_json: JsonFlag = False) -> None:
    """Show one job with its parameters, result and error."""
    database, _ = open_store()
    with database.session() as s:
        row = s.get(Job, job)
        if row is None:
            raise LookupError(f"no job with id {job!r}; `desirepath jobs list` shows them")
        say({**_row(row), "params": row.params, "result": row.result, "error": row.error}, as_json)


@commands.command()
@in_data_folder
def export(
    job: str,
    out: Annotated[Path, typer.Option(help="The log folder; made if missing.")],
    as_json: JsonFlag = False,
) -> None:
    """Write a job's learning curves as TensorBoard files, for `tensorboard --logdir OUT`."""
    from desirepath.jobs.curves import curves_of
    from desirepath.jobs.tensorboard import event_files

    database, _ = open_store()
    with database.session() as s:
        row = s.get(Job, job)
        if row is None:
            raise LookupError(f"no job with id {job!r}; `desirepath jobs list` shows them")
        curves = curves_of(s, job)
    files = event_files(curves, job=job[:8], at=(row.started_at or row.created_at).timestamp())
    if not files:
        raise LookupError(f"job {job} has no curves: only jobs that train or search have them")
    for path, content in files.items():
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        (out / path).write_bytes(content)
    say({"job": job, "folder": str(out), "files": list(files), "curves": list(curves)}, as_json)


@commands.command()
@in_data_folder
def cancel(job: str, as_json: JsonFlag = False) -> None:
    """Ask a job to stop; a worker ends it within seconds."""
    from desirepath.store.outbox import cancel_job

    database, _ = open_store()
    with database.transaction() as s:
        row = cancel_job(s, job, by=COMMAND_LINE)
        say({"job": row.id, "state": row.state}, as_json)
