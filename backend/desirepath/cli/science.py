"""`desirepath train ...`, `queries list|show|generate` and `policies evaluate`: the science from the command line.

Training runs as a job like any other, so that its artefact has a card, a lineage and a place in the analysts' pages.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

from desirepath.cli.options import Configured, OptionsOf, configured
from desirepath.cli.output import COMMAND_LINE, INTERRUPTED, JsonFlag, in_data_folder, say, takes_long, working
from desirepath.cli.study import open_store, query_sets
from desirepath.settings import get_settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database

if TYPE_CHECKING:
    from sqlalchemy.orm import Session

    from desirepath.jobs.kinds import TrainDemonstrationsParams
    from desirepath.jobs.params import Params
    from desirepath.learning.policies.policy import DrivingPolicy

train = typer.Typer(help="Train reward models and policies.", no_args_is_help=True)
queries = typer.Typer(help="Queries: a scene and two trajectories each.", no_args_is_help=True)

SetFlag = Annotated[list[str] | None, typer.Option("--set", help="Any other parameter of the job, as name=value.")]
OutFlag = Annotated[Path | None, typer.Option(help="Also write the result to this file.")]
SeedFlag = Annotated[int, typer.Option(help="Seed of everything random.")]
StudyFlag = Annotated[str | None, typer.Option(help="Id of a study: a snapshot of its answers is taken.")]
SnapshotFlag = Annotated[str | None, typer.Option(help="Id of a snapshot.")]
AnswersFlag = Annotated[
    str | None, typer.Option(help="With --study, whose answers: people (default), simulated or all.")
]
WORKER_PATIENCE_S = 3.0
NOT_TAKEN = "0" * 64  # stands for a snapshot while everything else is checked
Taking = Callable[["Session", ArtefactStore], str]
"""Takes a snapshot (or names one); its id."""


def register(policies: typer.Typer) -> None:
    """Add this module's command to `desirepath policies`."""
    policies.command()(evaluate)


def _params(of: str, kind: str, without: tuple[str, ...] = (), **given: str) -> OptionsOf:
    """Parameters of a kind of job as options. of: their class; their words are those of the analysts' form."""

    def help_of(name: str) -> str:
        from desirepath.installed import FRONTEND
        from desirepath.web.core.catalogues import DEFAULT_LANGUAGE, read_catalogue

        entry = read_catalogue(FRONTEND / "locales" / DEFAULT_LANGUAGE / "analyst.yaml")["kinds"][kind]["fields"][name]
        return ". ".join(entry[part] for part in ("label", "hint") if part in entry)

    return OptionsOf(f"desirepath.jobs.kinds:{of}", without=without, given=given, help_of=help_of)


@train.command(cls=Configured)
@in_data_folder
@configured(params=_params("TrainBaseParams", "train_base"))
def base(params: Params, out: OutFlag = None, more: SetFlag = None, as_json: JsonFlag = False) -> None:
    """Train a base policy from scratch."""
    run_job("train_base", params.asked() | parse_settings(more), out, as_json)


@train.command(cls=Configured)
@in_data_folder
@configured(params=_params("EnsembleParams", "ensemble"))
def ensemble(params: Params, more: SetFlag = None, as_json: JsonFlag = False) -> None:
    """Train an ensemble whose members behave differently."""
    run_job("ensemble", params.asked() | parse_settings(more), None, as_json)


@train.command("reward-model", cls=Configured)
@in_data_folder
@configured(params=_params("RewardModelParams", "reward_model", snapshot=NOT_TAKEN))
def reward_model(
    params: Params,
    study: StudyFlag = None,
    snapshot: SnapshotFlag = None,
    answers: AnswersFlag = None,
    out: OutFlag = None,
    more: SetFlag = None,
    as_json: JsonFlag = False,
) -> None:
    """Learn a reward model from answers, with its accuracy on answers it did not see."""
    taking = _snapshot(study, snapshot, answers)
    run_job("reward_model", params.asked() | parse_settings(more), out, as_json, taking)


@train.command()
@in_data_folder
def align(
    study: StudyFlag = None,
    snapshot: SnapshotFlag = None,
    answers: AnswersFlag = None,
    recipe: Annotated[
        str,
        typer.Option(
            help="The algorithm: fine_tuning, instant, each_scene, each_scene_trained, conditioning_search or thesis."
        ),
    ] = "fine_tuning",
    seed: SeedFlag = 0,
    out: OutFlag = None,
    more: SetFlag = None,
    as_json: JsonFlag = False,
) -> None:
    """Turn answers into a policy."""
    taking = _snapshot(study, snapshot, answers)
    run_job("align", {"recipe": recipe, "seed": seed, **parse_settings(more)}, out, as_json, taking)


@train.command(cls=Configured)
@in_data_folder
@configured(params=_params("TrainDemonstrationsParams", "train_demonstrations", snapshot=NOT_TAKEN))
def demonstrations(
    params: TrainDemonstrationsParams,
    environment: Annotated[str, typer.Option(help="corridor, room or home.")] = "room",
    study: Annotated[str | None, typer.Option(help="Id of a study: what was kept there is learned from.")] = None,
    participant: Annotated[str | None, typer.Option(help="With --study, only this participant's (code).")] = None,
    answers: Annotated[
        str | None, typer.Option(help="With --study, whose paths: people (default), simulated or all.")
    ] = None,
    style: Annotated[
        str | None, typer.Option(help="A programmed demonstrator instead (simulated), such as field_of_view.")
    ] = None,
    per_pair: Annotated[int, typer.Option(min=1, max=10, help="With --style, demonstrations of each pair.")] = 4,
    person: Annotated[
        str, typer.Option(help="With --style, what the person does: still, or walks opposite or random.")
    ] = "still",
    snapshot: SnapshotFlag = None,
    out: OutFlag = None,
    more: SetFlag = None,
    as_json: JsonFlag = False,
) -> None:
    """Learn a personal controller from demonstrations."""
    from sqlalchemy import select

    from desirepath.store.demonstration_snapshots import take_demonstrations
    from desirepath.store.models import Participant
    from desirepath.store.simulated_demonstrations import take_simulated_demonstrations
    from desirepath.store.snapshots import check_whose

    if answers is not None and (study is None or participant is not None):
        raise ValueError(f"--answers {answers}: chooses among all of a study; it needs --study and no --participant")
    if sum(given is not None for given in (study, style, snapshot)) != 1:
        raise ValueError("give one of --study, --style and --snapshot")
    whose = check_whose(answers or "people")

    def taking(s: Session, files: ArtefactStore) -> str:
        if snapshot is not None:
            return snapshot
        if style is not None:
            return take_simulated_demonstrations(
                s, files, style=style, environment=environment, per_pair=per_pair, seed=params.seed, person=person
            ).id
        person_id = None
        if participant is not None:
            query = select(Participant.id).where(Participant.study_id == study, Participant.code == participant)
            person_id = s.scalars(query).one_or_none()
            if person_id is None:
                raise LookupError(f"--participant {participant}: nobody of that code takes part in {study}")
        return take_demonstrations(
            s, files, study_id=study or "", environment=environment, participant_id=person_id, whose=whose
        ).id

    asked = params.asked() | parse_settings(more)
    run_job("train_demonstrations", asked, out, as_json, taking, makes=style is not None)


@queries.command(cls=Configured)
@in_data_folder
@configured(params=_params("QueriesParams", "queries", ("members", "seed")))
def generate(
    params: Params,
    setup: Annotated[str, typer.Option(help="Name of a setup that an ensemble is shipped for.")] = "study_room",
    seed: SeedFlag = 1,
    out: OutFlag = None,
    more: SetFlag = None,
    as_json: JsonFlag = False,
) -> None:
    """Make queries from an ensemble's trajectories."""
    members = [f"{setup}/ensemble/{k}" for k in range(4)]
    asked = params.asked() | {"members": members, "seed": seed} | parse_settings(more)
    run_job("queries", asked, out, as_json)


@queries.command("list")
@in_data_folder
def list_queries(as_json: JsonFlag = False) -> None:
    """List the query sets that are shipped, and those of this installation."""
    from desirepath.learning.shipped_files import shipped_names

    shipped = [name for name in shipped_names() if "/queries" in name]
    here = [{"query_set": identity, "about": about} for identity, about in query_sets().items()]
    say({"query_sets": [*here, *({"query_set": name, "about": "shipped"} for name in shipped)]}, as_json)


@queries.command()
@in_data_folder
def show(
    name: Annotated[str, typer.Argument(help="A shipped query set such as study_room/queries_500, or a file.")],
    as_json: JsonFlag = False,
) -> None:
    """Show how the pairs of a query set differ.

    Spread per measure, correlations, and what a person would notice.
    """
    from desirepath.learning.policies.shipped import load_queries
    from desirepath.learning.queries.varied_queries import describe_differences

    say(describe_differences(load_queries(name)), as_json)


@in_data_folder
@takes_long("evaluating {policy} in {scenes} scenes")
def evaluate(
    policy: Annotated[
        str, typer.Argument(help="Id, path, or a shipped name: study_room/base, study_room/conditioned@farther=1.")
    ],
    scenes: Annotated[int, typer.Option(min=1)] = 2_000,
    seed: SeedFlag = 0,
    engine: Annotated[str, typer.Option(help="fast or pybullet.")] = "fast",
    as_json: JsonFlag = False,
) -> None:
    """Roll a policy out in fresh scenes and measure it."""
    from desirepath.learning.policies.evaluate import evaluate_policy

    say(evaluate_policy(find_policy(policy), n=scenes, seed=seed, engine=engine), as_json)


def find_policy(reference: str) -> DrivingPolicy:
    """The policy that was named on the command line: by id, path or shipped name, a conditioned one with its weights
    (`ID@farther=1`). Raises LookupError.
    """
    from desirepath.learning.policies.shipped import policy_conditioned_on

    return policy_conditioned_on(policy_file(reference), reference)


def policy_file(reference: str) -> bytes:
    """The stored policy that `find_policy` reads, whatever stands behind `@`. Raises LookupError."""
    from desirepath.jobs.kinds import ANY_POLICY
    from desirepath.learning.policies.shipped import names_policy
    from desirepath.learning.shipped_files import resolve, shipped_names
    from desirepath.store.artefacts import ArtefactError, load_artefact
    from desirepath.store.models import Artefact

    if names_policy(reference):
        return resolve(reference.partition("@")[0]).read_bytes()
    artefact_id = reference.partition("@")[0]
    database, files = open_store()
    with database.session() as s:
        if s.get(Artefact, artefact_id) is None:
            shipped = ", ".join(name for name in shipped_names() if "/queries" not in name and "/scenarios" not in name)
            raise LookupError(f"no policy {reference!r}: neither an id, a file nor shipped ({shipped})")
        artefact, content = load_artefact(s, files, artefact_id)
    if artefact.kind not in ANY_POLICY.split("|"):
        raise ArtefactError(f"artefact {artefact.id} ({artefact.name}) is a {artefact.kind}, not a policy")
    return content


def parse_settings(more: list[str] | None) -> dict[str, Any]:
    """`name=value` words; values are JSON where they can be, text otherwise."""
    parsed: dict[str, Any] = {}
    for word in more or []:
        name, equals, value = word.partition("=")
        if not equals:
            raise ValueError(f"--set {word!r}: write it as name=value")
        try:
            parsed[name] = json.loads(value)
        except json.JSONDecodeError:
            parsed[name] = value
    return parsed


def _snapshot(study: str | None, snapshot: str | None, answers: str | None) -> Taking:
    """Where a job's snapshot comes from, checked as far as it can be before anything is looked at."""
    from desirepath.store.snapshots import check_whose, take_snapshot

    if (study is None) == (snapshot is None):
        raise ValueError("give either --study or --snapshot")
    if snapshot is not None:
        if answers is not None:
            raise ValueError(f"--answers {answers}: chooses from a study; the answers of a snapshot are chosen already")
        return lambda _s, _files: snapshot
    whose = check_whose(answers or "people")
    return lambda s, files: take_snapshot(s, files, study_id=study, whose=whose).id


def run_job(
    kind: str,
    params: dict[str, Any],
    out: Path | None,
    as_json: bool,
    taking: Taking | None = None,
    *,
    makes: bool = False,
) -> None:
    """Enqueue, wait with progress on stderr, print the result. Raises RuntimeError if the job does not succeed.

    taking: takes the snapshot that it learns from, once nothing else can be refused any more. makes: the installation,
    where there is none; without a snapshot always.
    """
    with jobs_at_hand(makes=makes or taking is None) as finish_job:
        job, result = finish_job(kind, params, taking)
    if out is not None:
        _write(open_store()[1], result, out)
    say({"job": job, **result}, as_json)


class Finishing(Protocol):
    """Does a job: its kind, its parameters, and what takes its snapshot, to its id and result. Raises RuntimeError if
    it does not succeed."""

    def __call__(
        self, kind: str, params: dict[str, Any], taking: Taking | None = None
    ) -> tuple[str, dict[str, Any]]: ...


def check_params(kind: str, params: Mapping[str, Any], *, takes: bool) -> Params:
    """A job's parameters, read. takes: its snapshot is still to be taken, and stands as `NOT_TAKEN`. Raises
    JobParamsError."""
    from desirepath.jobs.kinds import get_kind

    return get_kind(kind).parse({**params, "snapshot": NOT_TAKEN} if takes else params)


@contextlib.contextmanager
def jobs_at_hand(*, makes: bool = True) -> Iterator[Finishing]:
    """Runs jobs, one after another. Brings a worker along, one for all of them, if nobody else takes them up. makes:
    an installation, where there is none."""
    own_worker: list[subprocess.Popen[bytes]] = []

    def finish_job(kind: str, params: dict[str, Any], taking: Taking | None = None) -> tuple[str, dict[str, Any]]:
        with working(f"{kind}: looking at what it needs"):
            parsed = check_params(kind, params, takes=taking is not None)
            from desirepath.jobs.kept_artefacts import find_artefact
            from desirepath.jobs.kinds import named_artefacts
            from desirepath.store.outbox import enqueue_job
            from desirepath.store.shipped_policies import register_shipped

            database, files = open_store(makes=makes)
            with database.transaction() as s:
                register_shipped(s, files)
            with database.transaction() as s:
                # what is not there is said now, not by a job that fails
                there = [name for name in named_artefacts(parsed) if name[0] != NOT_TAKEN]
                named = [find_artefact(s, reference, wanted) for reference, wanted in there]
                asked = parsed.model_dump(mode="json")
                if taking is not None:
                    asked["snapshot"] = taking(s, files)
                    kept = "demonstrations" if kind == "train_demonstrations" else "snapshot"
                    named.append(find_artefact(s, asked["snapshot"], kept))
                study = next((artefact.study_id for artefact in named if artefact.study_id is not None), None)
                job = enqueue_job(s, kind, asked, study_id=study, created_by=COMMAND_LINE).id
        state, result, error = follow_job(database, job, own_worker)
        if state != "succeeded":
            raise RuntimeError(f"job {job} {state}: {error or 'no reason given'}")
        return job, result

    try:
        yield finish_job
    finally:
        for worker in own_worker:
            worker.terminate()
            worker.wait(30)


def follow_job(
    database: Database, job: str, own_worker: list[subprocess.Popen[bytes]]
) -> tuple[str, dict[str, Any], str | None]:
    """Follow a job to its end; one more worker is started, and put into `own_worker`, if nobody takes the job up.
    Ctrl-C ends the command, not the job."""
    from desirepath.jobs.process import FINAL_STATES, start_worker
    from desirepath.store.models import Job

    began = time.monotonic()
    with _goes_on(database, job, own_worker), working(f"job {job}: waiting for a worker") as tell:
        while True:
            with database.session() as s:
                row = s.get_one(Job, job)
                state, progress, message = row.state, row.progress, row.message
                result, error = row.result or {}, row.error
            if state in FINAL_STATES:
                return state, result, error
            if own_worker and own_worker[0].poll() is not None:
                code = own_worker[0].returncode
                raise RuntimeError(
                    f"job {job} is {state}: the worker that this command had started ended with code {code}; "
                    f"`desirepath worker` starts one that takes the job up, `desirepath jobs cancel {job}` ends it"
                )
            if state == "queued" and not own_worker and time.monotonic() - began > WORKER_PATIENCE_S:
                own_worker.append(start_worker(get_settings(), sys.stderr, quiet=True))
            tell(f"job {job}: {state} {progress:.0%} {message}".rstrip())
            time.sleep(0.3)


@contextlib.contextmanager
def _goes_on(database: Database, job: str, own_worker: list[subprocess.Popen[bytes]]) -> Iterator[None]:
    """Ctrl-C in the block says what becomes of the job and how to end it."""
    from desirepath.store.models import Job

    try:
        yield
    except KeyboardInterrupt:
        with database.session() as s:
            taken = not own_worker and s.get_one(Job, job).state != "queued"
        goes_on = "goes on" if taken else "goes on with the next worker (`desirepath worker`)"
        ends = f"`desirepath jobs cancel {job}` ends it"
        typer.echo(f"\njob {job} {goes_on}; `desirepath jobs show {job}` shows it, {ends}", err=True)
        raise typer.Exit(INTERRUPTED) from None


def _write(files: ArtefactStore, result: dict[str, Any], out: Path) -> None:
    made = next((result[key] for key in ("policy", "reward_model", "query_set") if result.get(key)), None)
    if made is None:
        raise LookupError(f"the job made nothing that could be written to {out}; its result: {sorted(result)}")
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(files.get(made))
