"""Pages of the manual that are written by the product itself: `python -m desirepath_experiments.manual` (`make docs`).

`docs/command-line.md` is made of the commands' own help, `docs/python.md` of docstrings, `docs/results.md` of stored
results (`results_page.py`). Tests tell when one is not what would be written now.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import typer

import desirepath
from desirepath.cli.main import GROUPS, app
from desirepath.installed import DOCS, ROOT
from desirepath.study.protocol.instruments import list_instruments
from desirepath_experiments.results_page import results

ELSEWHERE = ("benchmark", "ship")
"""Of the laboratory, and long: their `--help` says what they take."""
STORED = ("to_parts", "from_parts", "to_bytes", "from_bytes")
"""Methods of stored formats."""
EVERYWHERE = ("as_json", "data")
"""Options that every command has."""
GRAMMAR = """
# Command line

`desirepath NOUN VERB`: the nouns are plural (`prolific` is a service), and a verb means the same for all of them.

| noun | verbs |
|---|---|
NOUNS

What is no thing is asked for directly: `train WHAT` learns something as a job, `drive POLICY` drives a robot, and
`serve`, `worker`, `migrate`, `password`, `link`, `backup` and `restore` are about the installation. With
`experiments` installed there are `benchmark NAME` (measuring) and `ship WHAT SETUP` (making what is shipped), which
are long and not here, and `reproduce CHAPTER`.

Older names still answer and are not listed: `evaluate`, `export` and `report` are `policies evaluate`,
`studies export` and `studies report`; `study`, `setup` and `robot` are the plural nouns.

**Everywhere.** `--data FOLDER` names the installation, else the variable `DESIREPATH_DATA` does, else it is `./data`.
`--json` prints one object on stdout, an error as `{"error": ...}`; tables and sentences are for people. What a long
command is just doing goes to stderr: on a terminal a line that moves, elsewhere a line every ten seconds. Only
`serve`, `worker` and `drive` have no `--json`: they do not end.

| exit code | means |
|---|---|
| 0 | done |
| 1 | refused or failed, with the reason on stderr; of a `check`, that the file is not valid |
| 2 | asked wrongly: no such command, option or value |
| 130 | ended by Ctrl-C; a job that was waited for goes on |

**Completion.** `desirepath --install-completion` adds it to the shell that you use (bash, zsh, fish), from the next
window on; `desirepath --show-completion` prints it instead. Then `desirepath pol<Tab> ev<Tab>` becomes
`desirepath policies evaluate`.

**Settings** are environment variables `DESIREPATH_...`; `backend/desirepath/settings.py` lists them. Where plain pip
would bring a build of torch for graphics cards, set `DESIREPATH_TORCH_INDEX` before `make` to the index that has the
one for processors.

Below, written by the commands themselves: what `desirepath COMMAND --help` says.
"""


def command_line() -> str:
    """The reference of all commands: what each does, its arguments and options."""
    root: Any = typer.main.get_command(app)
    listed = {name: command for name, command in root.commands.items() if not command.hidden}
    single = {name: command for name, command in listed.items() if not hasattr(command, "commands")}
    groups = {name: group for name, group in listed.items() if hasattr(group, "commands")}
    nouns = [f"| `{noun}` | {_verbs(group)} |" for noun, group in groups.items() if noun in GROUPS]
    lines = [GRAMMAR.replace("NOUNS", "\n".join(nouns)).strip()]
    for title, commands in {"desirepath": single, **{name: group.commands for name, group in groups.items()}}.items():
        if title in ELSEWHERE:
            continue
        lines += ["", f"## {title}"]
        for name, command in commands.items():
            if not command.hidden and name not in ELSEWHERE:
                words = ["desirepath", *([] if title == "desirepath" else [title]), name]
                lines += ["", *_command(" ".join(words), command)]
    return "\n".join(lines) + "\n"


def _verbs(group: Any) -> str:
    return ", ".join(f"`{verb}`" for verb, command in group.commands.items() if not command.hidden)


def _command(words: str, command: Any) -> Iterator[str]:
    shown = [one for one in command.params if one.name not in EVERYWHERE and not getattr(one, "hidden", False)]
    arguments = [one.name.upper() for one in shown if one.param_type_name == "argument"]
    yield from (f"### {' '.join([words, *arguments])}", "", _flat(command.help or ""))
    records = [one.get_help_record(typer.Context(command)) for one in shown]
    if any(records):
        yield from (
            "",
            "| takes | what it does |",
            "|---|---|",
            *(f"| `{_cell(names)}` | {_cell(said)} |" for names, said in filter(None, records)),
        )


def _cell(text: str) -> str:
    return _flat(text).replace("|", "\\|")


def python_interface() -> str:
    """What `import desirepath` offers, by signatures and docstrings, after the README's example."""
    (example,) = re.findall(r"^```python\n.*?^```$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE | re.DOTALL)
    lines = [
        "# Python",
        "",
        "In a notebook or a script; neither a server nor a database is needed.",
        "",
        "## In a notebook",
    ]
    lines += ["", example, "", "## Reference", "", "All of `desirepath`, as `import desirepath as dp` gives it."]
    for name in desirepath.__all__:
        lines += ["", *_named(f"{name}", getattr(desirepath, name))]
    return "\n".join(lines) + "\n"


def _named(name: str, what: Any) -> Iterator[str]:
    yield from (f"### {name}", "", _signed(name, what), *_said(what))
    for method, of in vars(what).items() if inspect.isclass(what) else ():
        function = of.__func__ if isinstance(of, classmethod | staticmethod) else of
        shown = function.fget if isinstance(function, property) else function
        if not method.startswith("_") and method not in STORED and inspect.isfunction(shown) and inspect.getdoc(shown):
            called = f"{name}.{method}"
            yield from ("", f"```text\n{called}\n```" if isinstance(function, property) else _signed(called, shown))
            yield from _said(shown)


def _signed(name: str, what: Callable[..., Any]) -> str:
    signature = inspect.signature(what)
    taken = [
        one.replace(annotation=_Bare(one.annotation))
        for one in signature.parameters.values()
        if one.name not in ("self", "cls")
    ]
    returns = "" if inspect.isclass(what) else f" -> {signature.return_annotation}"
    line = f"{name}({', '.join(map(str, taken))}){returns}"
    if len(line) >= 100:
        line = "\n".join([f"{name}(", *(f"    {one}," for one in taken), f"){returns}"])
    return f"```text\n{line}\n```"


class _Bare(str):
    """An annotation without the quotes that postponed ones have."""

    __repr__ = str.__str__


def _said(what: Any) -> Iterator[str]:
    for paragraph in (inspect.getdoc(what) or "").split("\n\n"):
        yield from ("", _flat(paragraph))


def _flat(text: str) -> str:
    return " ".join(text.split())


INSTRUMENTS = """
# Instruments

A protocol asks each by its name: `- questionnaire: {use: ueq_s}`. The report scores it by its own scoring, with
Cronbach's alpha and McDonald's omega, and names its source; the data dictionary of every export has items, scoring and
terms. A file beside the protocol, `questionnaires/NAME.yaml`, replaces the shipped one of that name. The study keeps
its own copy of every word.

- **Words in one language only**: a session in another language shows the original, and says so.
- **Words not shipped**: we found no terms that allow it. `desirepath studies instruments NAME` prints a file with
  keys, reversed items and scoring; fill in the words, which you know the terms of, and put it beside the protocol.
- Not here, for the same reason: MDMT, HRIES and Körber's TiA.
- The **colour vision** check is ours and no diagnostic. Ishihara's plates are not in it.

What follows is written from the files in `study_protocols/instruments`
(`desirepath studies instruments --json`); n is the number of items.
"""


def instruments() -> str:
    """The shipped instruments, from their files: a table, then each with its source and terms."""
    listed = list_instruments()
    lines = [
        INSTRUMENTS.strip(),
        "",
        "| `use` | known as | measures | n | words | scores |",
        "|---|---|---|---|---|---|",
    ]
    keys = ("name", "known_as", "measures", "items", "words", "scores")
    lines += [
        f"| {' | '.join(_cell(f'`{of[key]}`' if key == 'name' else str(of[key])) for key in keys)} |" for of in listed
    ]
    for of in listed:
        lines += ["", f"## {of['name']}", "", f"- Source: {of['source']}", f"- Terms: {of['terms']}"]
        lines += [f"- German: {of['german']}"] if of["german"] else []
    return "\n".join(lines) + "\n"


PAGES = {"instruments": instruments, "command-line": command_line, "python": python_interface, "results": results}


def main(names: Sequence[str]) -> None:
    """Write the pages of these names, or all."""
    for name in names or PAGES:
        (DOCS / f"{name}.md").write_text(PAGES[name](), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
