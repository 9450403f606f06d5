"""Every command and option that README and guides give is one that there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer

from desirepath.cli.main import app
from desirepath.deploy.ros.__main__ import parser
from tests.fences import DOCUMENTS

GIVEN = re.compile(r"desirepath ((?:[a-z][a-z-]*\b ?)+[^`\n#&]*)")


@pytest.mark.parametrize("guide", DOCUMENTS, ids=lambda path: path.name)
def test_commands_in_the_guides_are_there(guide: Path) -> None:
    unknown = []
    for line in GIVEN.findall(guide.read_text(encoding="utf-8")):
        words, named = line.replace("|", " ").split(), []
        command = typer.main.get_command(app)
        while words and words[0] in getattr(command, "commands", {}):
            named.append(words.pop(0))
            command = command.commands[named[-1]]  # type: ignore[attr-defined]
            unknown += [(line, f"{named[-1]}: an old name")] * command.hidden
        options = {
            option for one in command.get_params(typer.Context(command)) for option in (*one.opts, *one.secondary_opts)
        } | {"--help"}
        if named == ["drive"]:  # the node reads its options itself
            options |= {"--ros-args", *parser("drive")._option_string_actions}
        given = [word.strip("()[].,;:").partition("=")[0] for word in words]
        unknown += [(line, word) for word in given if named and word.startswith("--") and word not in options]
        if named and hasattr(command, "commands") and words and words[0].islower() and words[0].isalpha():
            unknown.append((line, words[0]))
    assert not unknown
