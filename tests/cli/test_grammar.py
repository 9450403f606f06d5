"""The command line has one grammar: plural nouns with verbs, the same options everywhere; what is published stays."""

from __future__ import annotations

import re
from collections.abc import Iterator

import click
import pytest
import typer

from desirepath.cli.main import GROUPS, app

LASTING = {"serve", "worker", "drive"}  # they do not end
PUBLISHED = (
    *("evaluate", "export", "report", "drive", "words read", "robot check", "setup check", "setup train"),
    *("queries import", "policies import", "policies export"),
    *(f"study {verb}" for verb in ("validate", "create", "simulate", "live", "power")),
    *(f"benchmark {name}" for name in ("simulate", "train", "align", "serve", "people", "faults", "robot", "live")),
)


def commands(group: click.Command, *named: str) -> Iterator[tuple[str, click.Command]]:
    """Every command that is listed, by its words."""
    for name, command in getattr(group, "commands", {}).items():
        if not command.hidden:
            yield from commands(command, *named, name)
    if not hasattr(group, "commands"):
        yield " ".join(named), group


ROOT = typer.main.get_command(app)
COMMANDS = dict(commands(ROOT))


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_takes_json_and_data_and_says_what_it_does_in_a_line(name: str) -> None:
    command = COMMANDS[name]
    options = {option for parameter in command.get_params(click.Context(command)) for option in parameter.opts}
    assert {"--data", "--json"} - options <= ({"--json"} if name in LASTING else set())
    (said, *_) = str(command.help).split("\n\n")
    assert re.fullmatch(r"[A-Z][^\n]{8,98}[.?]", said)


def test_nouns_are_plural_and_what_can_be_listed_is() -> None:
    named = [name.split() for name in COMMANDS if " " in name and not name.startswith(("train ", "benchmark "))]
    assert {noun for noun, _ in named} == set(GROUPS)
    assert all(noun.endswith("s") for noun in GROUPS if noun != "prolific")  # a service's name
    assert {noun for noun, verb in named if verb == "list"} == set(GROUPS) - {"words"}


@pytest.mark.parametrize("name", PUBLISHED)
def test_what_was_published_still_answers(name: str) -> None:
    command = ROOT
    for word in name.split():
        command = command.commands[word]  # type: ignore[attr-defined]
    assert not hasattr(command, "commands")
