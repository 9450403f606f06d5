"""How commands speak: people get tables and sentences, `--json` gets one object on stdout; logs, and what a long
command is just doing, go to stderr. And which installation they speak of: `--data`.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import json
import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, ParamSpec

import structlog
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from desirepath.collecting import interrupt_raises
from desirepath.os_errors import in_words
from desirepath.settings import get_settings
from desirepath.store.scrubbing import scrub

JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
COMMAND_LINE = "command line"  # who did it, where logs ask: there are no accounts here
PIPE_WIDTH = 200  # characters; a pipe has no width of its own
TOLD_EVERY_S = 10.0  # where nobody sees a line move: a log, a pipe
DATA = "DESIREPATH_DATA"
INTERRUPTED = 130  # exit code of what Ctrl-C ended, as typer and shells have it
P = ParamSpec("P")


def log_to_stderr(least: int = logging.INFO) -> None:
    """Everything logged goes to stderr, so that stdout holds only the answer; with DESIREPATH_LOGS=json every line is
    one JSON object. Tokens, passwords and cookies are taken out of both (`store/scrubbing.py`). least: the level below
    which nothing is said.

    The stream is looked up as each line is written: whoever replaced it meanwhile (a test, an embedding program) may
    have closed the one that stood when this ran.
    """
    logging.basicConfig(stream=sys.stderr, format="%(message)s")
    logging.getLogger().setLevel(least)
    as_json = os.environ.get("DESIREPATH_LOGS") == "json"
    if as_json:  # what other libraries log, too
        plain: Any = structlog.stdlib.ProcessorFormatter(
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                scrub,
                structlog.processors.JSONRenderer(default=str),
            ],
            foreign_pre_chain=[
                structlog.stdlib.add_log_level,
                structlog.stdlib.add_logger_name,
                structlog.processors.TimeStamper(fmt="iso", utc=True),
                structlog.processors.format_exc_info,
            ],
        )
        for handler in logging.getLogger().handlers:
            handler.setFormatter(plain)
    in_words = structlog.processors.KeyValueRenderer(key_order=["timestamp", "level", "event"])
    for chatty in ("httpx", "alembic"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            scrub,
            structlog.processors.JSONRenderer(default=str) if as_json else in_words,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(least),
        logger_factory=lambda *_names: structlog.PrintLogger(file=sys.stderr),
    )


def say(result: dict[str, Any], as_json: bool) -> None:
    """Print a command's result: one JSON object, or a readable table of its keys; a list of objects as a table."""
    if as_json:
        sys.stdout.write(json.dumps(result, default=str) + "\n")
        return
    facts = Table(show_header=False, box=None, pad_edge=False)
    lists: list[Table] = []
    for key, value in result.items():
        if isinstance(value, list) and value and all(isinstance(row, dict) for row in value):
            columns = list(dict.fromkeys(column for row in value for column in row))
            rows = Table(box=None, pad_edge=False)
            for number, column in enumerate(columns):  # the first names the row, for the next command: it stays whole
                width = max(len(_shown(row.get(column))) for row in value) if number == 0 else None
                rows.add_column(column.replace("_", " "), overflow="fold", min_width=width)
            for row in value:
                rows.add_row(*[_shown(row.get(column)) for column in columns])
            lists.append(rows)
        else:
            facts.add_row(key.replace("_", " "), _shown(value) if value != [] else "none")
    console = Console(width=None if sys.stdout.isatty() else PIPE_WIDTH)
    for table in ([facts] if facts.row_count else []) + lists:
        console.print(table)


def _shown(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.4g}"
    return escape(value if isinstance(value, str) else json.dumps(value, default=str))


def plain_errors(command: Callable[P, None]) -> Callable[P, None]:
    """Turn errors meant for people (no programming errors) into one line and exit code 1, no traceback."""

    @functools.wraps(command)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> None:
        log_to_stderr()
        try:
            with interrupt_raises():
                command(*args, **kwargs)
        except typer.Exit:
            raise  # the command has said what there is to say; typer's Exit is a RuntimeError
        except typer.Abort:
            if kwargs.get("as_json"):
                sys.stdout.write(json.dumps({"error": "not confirmed, nothing was done; --yes does not ask"}) + "\n")
            raise
        except (ValueError, LookupError, OSError, RuntimeError) as problem:
            words = in_words(problem)
            if kwargs.get("as_json"):
                sys.stdout.write(json.dumps({"error": words}) + "\n")
            Console(stderr=True).print(f"[red]error:[/red] {escape(words)}", highlight=False, soft_wrap=True)
            raise typer.Exit(1) from None

    return guarded


def in_data_folder(command: Callable[P, None]) -> Callable[..., None]:
    """`plain_errors`, with an option `--data` that names the installation for this one command."""
    inner = plain_errors(command)

    @functools.wraps(command)
    def placed(*args: Any, data: Path | None = None, **kwargs: Any) -> None:
        with _settings_of(data):
            inner(*args, **kwargs)

    option = typer.Option(help="Folder of the installation; default DESIREPATH_DATA, else ./data.", show_default=False)
    taken = inspect.signature(command, eval_str=True)
    more = inspect.Parameter(
        "data", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Annotated[Path | None, option]
    )
    placed.__signature__ = taken.replace(parameters=[*taken.parameters.values(), more])  # type: ignore[attr-defined]
    placed.__annotations__ = {name: one.annotation for name, one in placed.__signature__.parameters.items()}  # type: ignore[attr-defined]
    return placed


@contextlib.contextmanager
def _settings_of(data: Path | None) -> Iterator[None]:
    """The settings, and those of every process that is started, are of that folder in the block."""
    if data is None:
        yield
        return
    before = os.environ.get(DATA)
    os.environ[DATA] = str(data)
    get_settings.cache_clear()
    try:
        yield
    finally:
        os.environ.pop(DATA)
        if before is not None:
            os.environ[DATA] = before
        get_settings.cache_clear()


@contextlib.contextmanager
def working(what: str) -> Iterator[Callable[[str], None]]:
    """Say on stderr what is being done, at once and for as long as it is: on a terminal a line that moves, else a line
    every ten seconds. Yields a function that is told how far it is."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    began, ended = time.monotonic(), threading.Event()
    state = {"now": what}

    def line() -> str:
        return f"{state['now']}, {time.monotonic() - began:.0f} s"

    if console.is_terminal:
        with console.status(escape(what)) as status:
            yield lambda now: status.update(escape(now))
        return

    def go_on_telling() -> None:
        while not ended.wait(TOLD_EVERY_S):
            typer.echo(line(), err=True)

    typer.echo(what, err=True)
    threading.Thread(target=go_on_telling, daemon=True).start()
    try:
        yield lambda now: state.update(now=now)
    finally:
        ended.set()


def takes_long(what: str) -> Callable[[Callable[P, None]], Callable[P, None]]:
    """A command that says what it does while it does it. what: in words, `{name}` for its arguments."""

    def decorated(command: Callable[P, None]) -> Callable[P, None]:
        @functools.wraps(command)
        def telling(*args: P.args, **kwargs: P.kwargs) -> None:
            with working(what.format(**kwargs)):
                command(*args, **kwargs)

        return telling

    return decorated
