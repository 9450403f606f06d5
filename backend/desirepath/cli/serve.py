"""`desirepath serve` and `desirepath worker`."""

from __future__ import annotations

import logging
from threading import Thread
from typing import TYPE_CHECKING, Annotated, Any

import structlog
import typer
from rich.console import Console

from desirepath.cli.output import COMMAND_LINE, JsonFlag, in_data_folder, log_to_stderr, say
from desirepath.collecting import without_collecting
from desirepath.installed import PROTOCOLS
from desirepath.settings import Settings, get_settings

if TYPE_CHECKING:
    from desirepath.web.core.dependencies import Services

DEMO_PROTOCOL = PROTOCOLS / "meet_your_robot_study.yaml"
DEMO_NAME = "Demo: meet the robot that learns from you"
EXAMPLE_PATIENCE_S = 20.0  # ours: several server processes load what visitors wait for in processes of their own
log = structlog.get_logger("desirepath.server")


def register(app: typer.Typer) -> None:
    """Add this module's commands to the main one."""
    app.command()(serve)
    app.command()(worker)
    app.command()(migrate)
    app.command()(password)
    app.command()(link)


@in_data_folder
def serve(
    demo: Annotated[bool, typer.Option("--demo", help="Open a demo study and print its link.")] = False,
    example: Annotated[
        bool | None,
        typer.Option("--example/--no-example", help="Bring a finished study of simulated people; default with --demo."),
    ] = None,
    port: Annotated[int | None, typer.Option(help="Port of the pages; the stage takes the next one.")] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    processes: Annotated[
        int, typer.Option(help="Server processes behind the same ports; more than one on PostgreSQL.")
    ] = 1,
) -> None:
    """Run the pages, the 3D stage and a background worker."""
    with without_collecting():
        from desirepath.store.database import Database
        from desirepath.store.worker_signals import remove_silent_pipes
        from desirepath.web.application import build_services
        from desirepath.web.replicas.only_server import only_server
        from desirepath.web.server import check_ports

    given: dict[str, Any] = {"port": port, "host": host}
    settings = Settings(**{name: value for name, value in given.items() if value is not None})
    with only_server(settings):
        if not settings.shares_ports:
            check_ports(settings)
        services = build_services(settings)
        try:
            _serve(services, demo=demo, example=demo if example is None else example, processes=processes)
        finally:
            remove_silent_pipes(services.database)
            for database in (services.database, Database(settings.jobs_database)):  # the worker's, which has ended
                database.close()


def _serve(services: Services, *, demo: bool, example: bool, processes: int) -> None:
    from desirepath.store.shipped_policies import register_shipped
    from desirepath.web.core.auth import ensure_first_user
    from desirepath.web.core.opening_link import is_closed, link_path
    from desirepath.web.replicas.supervisor import check_can_share, serve_many, serve_one
    from desirepath.web.server import run

    settings = services.settings
    check_can_share(services.database, processes)
    if settings.shares_ports:  # one of several; who started them has seen to everything else
        serve_one(services)
        return
    with services.database.one_starts():
        with services.database.transaction() as s:
            register_shipped(s, services.files)
            closed = is_closed(s, settings)
        password = ensure_first_user(services.database, by_link=closed)
        with services.database.transaction() as s:
            once = link_path(s, settings)
    link = _demo_link(services) if demo else None
    services.brings_example = example

    def announce() -> None:
        if example:
            Thread(target=_bring_example, args=(services,), daemon=True).start()
        here = settings.own_url
        console = Console()
        console.print("\n[bold]Desire Path is running.[/bold]")
        if link:
            console.print(f"  Participant    {here}{link}")
        console.print(f"  Experimenter   {here}{once or '/lab/studies'}", soft_wrap=True)
        console.print(f"  Analyst        {here}/lab/jobs")
        if once:
            console.print("  The experimenter's address signs in once, within an hour; another: desirepath link")
        if password:
            console.print(f"  Sign in as [bold]experimenter[/bold] with password [bold]{password}[/bold]")
            console.print("  (printed this once; change it after signing in)")
        if settings.data.stat().st_mode & 0o077:
            folder = settings.data.resolve()
            console.print(f"  Others on this machine may look into the data folder; shut it: chmod 700 {folder}")
        console.print("  Stop with Ctrl+C.\n")

    if processes > 1:
        serve_many(settings, services.peers, processes, on_ready=announce)
    else:
        run(services, on_ready=announce)


def _bring_example(services: Services) -> None:
    """The example study, once in an installation's life, and not while anybody waits for the first page."""
    from desirepath.store.example_study import add_example

    services.prepared.wait(EXAMPLE_PATIENCE_S)
    try:
        add_example(services.database, services.files)
    except Exception:
        log.exception("the example study could not be brought")
    services.brings_example = False


def _demo_link(services: Services) -> str:
    """The demo study's recruiting link; the study is made on the first start."""
    from sqlalchemy import select

    from desirepath.store.models import Study
    from desirepath.study.protocol.freezing import freeze
    from desirepath.study.studies import create_study

    with services.database.transaction() as s:
        study = s.scalars(select(Study).where(Study.name == DEMO_NAME, Study.state == "open")).first()
        if study is None:
            study = create_study(s, services.files, freeze(DEMO_PROTOCOL), name=DEMO_NAME, created_by=None)
        return f"/join/{study.recruiting_token}"


@in_data_folder
def worker(
    parent: Annotated[int | None, typer.Option(hidden=True, help="Process to end with; `serve` gives its own.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say only what goes wrong.")] = False,
) -> None:
    """Run a background worker: picks up jobs and trains."""
    from desirepath.jobs.worker import run_worker

    if quiet:
        log_to_stderr(logging.WARNING)
    run_worker(get_settings(), parent=parent)


@in_data_folder
def migrate(as_json: JsonFlag = False) -> None:
    """Bring the database to this version's tables.

    Before the first process of a new version starts beside old ones.
    """
    from desirepath.cli.study import open_store
    from desirepath.store.database import newest_revision

    open_store(makes=True)[0].close()
    say({"revision": newest_revision()}, as_json)


@in_data_folder
def link(as_json: JsonFlag = False) -> None:
    """Print a new address that signs the experimenter in once, while no password is set.

    The one before stops.
    """
    from desirepath.cli.study import open_store
    from desirepath.web.core.opening_link import link_path
    from desirepath.web.replicas.only_server import running_server

    settings, (database, _) = get_settings(), open_store()
    with database.transaction() as s:
        once = link_path(s, settings)
    if once is None:
        raise ValueError(
            "the installation is open to others, or the experimenter has a password: sign in with it, or get a new one "
            "by `desirepath password`"
        )
    address = f"{running_server(settings) or settings.local_url}{once}"
    if as_json:
        say({"address": address}, as_json)
    else:
        typer.echo(address)  # whole, however narrow the terminal is


@in_data_folder
def password(
    name: Annotated[str, typer.Argument(help="Name of the account.")] = "experimenter",
    without_second_factor: Annotated[
        bool, typer.Option(help="Also forget its second factor: app and recovery codes are lost.")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Give an account a new password, to be changed at sign-in; sign it out everywhere."""
    from sqlalchemy import select

    from desirepath.cli.study import open_store
    from desirepath.store.audit import record
    from desirepath.store.models import User
    from desirepath.web.core import second_factor
    from desirepath.web.core.auth import reset_password

    database, _ = open_store()
    made = reset_password(database, name)
    with database.transaction() as s:
        record(s, "password_reset", by=COMMAND_LINE, name=name)
        if without_second_factor:
            second_factor.remove(s, s.scalars(select(User.id).where(User.name == name)).one())
            record(s, "second_factor_removed", by=COMMAND_LINE, name=name)
    say({"name": name, "password": made}, as_json)
