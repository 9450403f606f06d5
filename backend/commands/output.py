"""How commands speak: people get tables and sentences, `--json` gets one object on stdout; logs go to stderr."""

from __future__ import annotations

import functools
import json
import logging
import sys
from collections.abc import Callable
from typing import Annotated, Any, ParamSpec

import structlog
import typer
from rich.console import Console
from rich.table import Table

JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
P = ParamSpec("P")


def log_to_stderr() -> None:
    """Everything logged goes to stderr, so that stdout holds only the answer."""
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(message)s")
    for chatty in ("httpx", "alembic"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.processors.KeyValueRenderer(key_order=["timestamp", "level", "event"]),
        ],
        logger_factory=structlog.PrintLoggerFactory(file=sys.stderr),
    )


def say(result: dict[str, Any], as_json: bool) -> None:
    """Print a command's result: one JSON object, or a readable table of its keys."""
    if as_json:
        sys.stdout.write(json.dumps(result, default=str) + "\n")
        return
    table = Table(show_header=False, box=None, pad_edge=False)
    for key, value in result.items():
        shown = f"{value:.4g}" if isinstance(value, float) else value
        table.add_row(key.replace("_", " "), shown if isinstance(shown, str) else json.dumps(shown, default=str))
    Console().print(table)


def plain_errors(command: Callable[P, None]) -> Callable[P, None]:
    """Turn errors meant for people (no programming errors) into one line and exit code 1, no traceback."""

    @functools.wraps(command)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> None:
        log_to_stderr()
        try:
            command(*args, **kwargs)
        except typer.Exit:
            raise  # the command has said what there is to say; typer's Exit is a RuntimeError
        except (ValueError, LookupError, OSError, RuntimeError) as problem:
            if kwargs.get("as_json"):
                sys.stdout.write(json.dumps({"error": str(problem)}) + "\n")
            Console(stderr=True).print(f"[red]error:[/red] {problem}", highlight=False, soft_wrap=True)
            raise typer.Exit(1) from None

    return guarded
