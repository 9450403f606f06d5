"""Runs the product: pages on one port, the 3D stage's door on the next, viser on loopback, a worker beside them.

One process; several side by side are `replicas/supervisor.py`'s."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import structlog
import uvicorn
from starlette.types import ASGIApp

from desirepath import freed_memory
from desirepath.collecting import without_collecting
from desirepath.jobs.process import start_worker
from desirepath.settings import Settings, in_url
from desirepath.study.personalising import next_query
from desirepath.web.application import create_application, create_stage_application
from desirepath.web.core.dependencies import Services
from desirepath.web.core.draft_folders import forget_drafts
from desirepath.web.core.heads import BoundedProtocol
from desirepath_stage.stage_server import StageServer

PREPARE_AFTER_S = 1.0  # ours
EVERY_ADDRESS = ("0.0.0.0", "::")  # noqa: S104
DATE_EVERY_S = 1.0
log = structlog.get_logger("desirepath.server")


class ServerError(OSError):
    """The server cannot start; says why and what would work."""


class _Server(uvicorn.Server):
    """Two servers share one event loop, so signals are handled once, by `run`."""

    stopping: asyncio.Event

    async def main_loop(self) -> None:
        """Keep the Date header true, once a second instead of looking ten times whether to end."""
        while not (await self.on_tick(0) or self.stopping.is_set()):
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self.stopping.wait(), DATE_EVERY_S)

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


def check_ports(settings: Settings) -> None:
    """Raise ServerError if the pages' or the stage's port is taken."""
    for port in (settings.port, settings.port + 1):
        try:
            listening_on(settings, port).close()
        except socket.gaierror as problem:
            raise ServerError(
                f"host = {settings.host!r}: {problem.strerror}; give a name or address of this machine, "
                "such as 127.0.0.1 or ::1"
            ) from None
        except OSError as problem:
            raise ServerError(
                f"port {port} on {settings.host} cannot be used ({problem.strerror}); "
                "choose another with --port (the stage takes the one after it)"
            ) from None


def run(services: Services, *, on_ready: Callable[[], None] | None = None) -> None:
    """Serve until SIGINT or SIGTERM, then stop in order. A worker that dies is started again."""
    settings = services.settings
    freed_memory.share_arenas()
    if not settings.shares_ports:
        check_ports(settings)
    presenter, notices = services.presenter, services.notices
    stages = presenter.server = StageServer(
        port=0, on_connect=presenter.on_connect, on_disconnect=presenter.on_disconnect
    )
    with without_collecting():
        doors: list[tuple[ASGIApp, socket.socket]] = [
            (create_application(services), listening_on(settings, settings.port)),
            (create_stage_application(services), listening_on(settings, settings.port + 1)),
        ]
        if notices.shared:
            inner = listening_on(settings, 0)
            doors.append((create_stage_application(services, inner=True), inner))
            notices.start()
            services.peers.begin(f"{_peer_host(settings)}:{inner.getsockname()[1]}")

    def ready() -> None:
        threading.Thread(target=_prepare, args=(services,), daemon=True).start()
        if on_ready is not None:
            on_ready()

    try:
        with asyncio.Runner(loop_factory=uvicorn.Config(doors[0][0]).get_loop_factory()) as runner:
            runner.run(_serve(settings, doors, ready))
    finally:
        services.peers.end()
        stages.stop()
        notices.close()


def listening_on(settings: Settings, port: int) -> socket.socket:
    """A socket of the settings' host; 0: any free port. Other server processes may have the same where they share."""
    found = socket.getaddrinfo(settings.host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    family, _, _, _, address = min(found, key=lambda one: one[0] != socket.AF_INET)  # localhost is 127.0.0.1 first
    opened = socket.socket(family)
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if settings.shares_ports and port:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        opened.bind(address)
    except OSError:
        opened.close()
        raise
    return opened


def _peer_host(settings: Settings) -> str:
    if settings.peer_host:
        return in_url(settings.peer_host)
    return socket.gethostname() if settings.host in EVERY_ADDRESS else in_url(settings.host)


def _trusted(proxies: str) -> list[str]:
    """Addresses and networks with commas; those of IPv4 also as a server that listens on `::` sees them."""
    named = [proxy.strip() for proxy in proxies.split(",") if proxy.strip()]
    mapped = []
    for one in named:
        with contextlib.suppress(ValueError):
            network = ipaddress.IPv4Network(one)
            mapped.append(f"::ffff:{network.network_address}/{96 + network.prefixlen}")
    return named + mapped


def _prepare(services: Services) -> None:
    """What somebody would have to wait for later, loaded once the first page has had its time."""
    time.sleep(PREPARE_AFTER_S)
    try:
        import desirepath.learning.policies.shipped  # noqa: F401  with the simulator, half a second of a core

        next_query.prepare(services.database, services.files)
    except Exception:
        log.exception("the open studies' queries could not be measured; their sessions will say why")
    finally:
        services.prepared.set()


async def _serve(
    settings: Settings, doors: Sequence[tuple[ASGIApp, socket.socket]], on_ready: Callable[[], None]
) -> None:
    stopping = asyncio.Event()

    def server(application: ASGIApp) -> _Server:
        made = _Server(
            uvicorn.Config(
                application,
                http=BoundedProtocol,
                access_log=False,  # our own log holds no tokens and no query strings
                log_level="warning",
                ws="websockets-sansio",
                ws_max_size=65_536,  # browsers send the stage small messages only; the door checks them one by one
                ws_per_message_deflate=False,  # the stage's messages are compressed already; deflate costs a core
                timeout_graceful_shutdown=3,
                proxy_headers=True,
                forwarded_allow_ips=_trusted(settings.trusted_proxies),
            )
        )
        made.stopping = stopping
        return made

    servers = [server(application) for application, _ in doors]
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopping.set)
    tasks = [
        asyncio.create_task(one.serve(sockets=[listening])) for one, (_, listening) in zip(servers, doors, strict=True)
    ]
    while not all(server.started for server in servers) and not any(task.done() for task in tasks):
        await asyncio.sleep(0.01)
    if all(server.started for server in servers):
        on_ready()
    # Loading takes the worker and the queries' preparation some seconds of a core: not while nobody has seen a page.
    worker = asyncio.create_task(_keep_worker(settings, stopping)) if settings.worker else None
    giving_back = asyncio.create_task(_keep_giving_back(stopping))
    forgetting = asyncio.create_task(_keep_forgetting(settings, stopping))
    waiting = asyncio.create_task(stopping.wait())
    await asyncio.wait([waiting, *tasks], return_when=asyncio.FIRST_COMPLETED)
    for one in servers:
        one.should_exit = True
    stopping.set()
    await asyncio.gather(giving_back, forgetting, *tasks)
    if worker:
        await worker


async def _keep_giving_back(stopping: asyncio.Event) -> None:
    """Give freed memory back now and then."""
    while not stopping.is_set():
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(stopping.wait(), freed_memory.EVERY_S)
        await asyncio.to_thread(freed_memory.give_back)


async def _keep_forgetting(settings: Settings, stopping: asyncio.Event) -> None:
    """Delete forgotten uploads at the start and daily."""
    while not stopping.is_set():
        await asyncio.to_thread(forget_drafts, settings.data)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(stopping.wait(), 86_400)


async def _keep_worker(settings: Settings, stopping: asyncio.Event) -> None:
    """Start the worker, start it again when it dies (never faster than every two seconds), stop it with us."""
    while not stopping.is_set():
        process = start_worker(settings)
        ended = asyncio.create_task(asyncio.to_thread(process.wait))
        stopped = asyncio.create_task(stopping.wait())
        await asyncio.wait([ended, stopped], return_when=asyncio.FIRST_COMPLETED)
        stopped.cancel()
        if stopping.is_set():
            process.terminate()
            try:
                await asyncio.to_thread(process.wait, 10)
            except subprocess.TimeoutExpired:
                process.kill()
            return
        log.warning("the worker ended and is started again", exit_code=process.returncode)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(stopping.wait(), 2.0)
