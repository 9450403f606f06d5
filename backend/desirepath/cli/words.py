"""`desirepath words read`: what is understood of a wish in plain words, as participants' pages read it."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from desirepath.cli.output import JsonFlag, in_data_folder
from desirepath.learning.words.lexicon import LANGUAGES, LONGEST, Language

if TYPE_CHECKING:
    from desirepath.learning.rules.obedience import Obedience
    from desirepath.learning.rules.rule import Rule

commands = typer.Typer(help="Wishes in plain words.", no_args_is_help=True)
LanguageFlag = Annotated[Language, typer.Option(help="In which it is expected to be written.")]


@commands.callback()
def _group() -> None:
    """Wishes in plain words."""


@commands.command()
@in_data_folder
def read(
    text: Annotated[str, typer.Argument(help=f"The wish, at most {LONGEST} characters.")],
    language: LanguageFlag = LANGUAGES[0],
    as_json: JsonFlag = False,
) -> None:
    """Say what is understood of a sentence, what is not, and what contradicts itself."""
    from desirepath.learning.words.understanding import words_reader

    got = words_reader(language).understand(text)
    understood = got.as_dict(text)
    if as_json:
        typer.echo(json.dumps(understood, ensure_ascii=False))
        return
    if got.language != language:
        typer.echo(f"read as {'German' if got.language == 'de' else 'English'}")
    for wish in understood["understood"]:
        typer.echo(f"{wish['direction']} {wish['objective']:20} {wish['weight']:<5g} {wish['words']!r}")
    for question in got.questions:
        words = text[question.start : question.end]
        typer.echo(f"asked back ({question.about}): {words!r}: {' or '.join(question.offered)}?")
    for start, end in got.not_understood:
        typer.echo(f"not understood: {text[start:end]!r}")
    if not understood["understood"] and not got.questions and not got.not_understood:
        typer.echo("nothing is said about driving")


@commands.command()
@in_data_folder
def rule(
    text: Annotated[str, typer.Argument(help=f"The rule, at most {LONGEST} characters.")],
    language: LanguageFlag = LANGUAGES[0],
    homes: Annotated[int, typer.Option(min=0, max=2_000, help="Measure in so many homes whether it is obeyed.")] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Say what is understood of a rule that lasts: when it holds, what is then wished, where not to drive."""
    from desirepath.learning.rules.reading import read_rule

    got = read_rule(text, language)
    asked = [
        {"about": one.about, "words": text[one.start : one.end], "offered": list(one.offered)} for one in got.asked
    ]
    found = {"context": sorted(got.rule.context), "change": sorted(got.rule.changes), "asked": asked}
    measured = _measure(got.rule, homes) if homes and got.rule.complete else None
    if as_json:
        typer.echo(json.dumps(found | ({"measured": asdict(measured)} if measured else {}), ensure_ascii=False))
        return
    typer.echo(f"when: {', '.join(sorted(got.rule.context))}")
    typer.echo(f"then: {', '.join(sorted(got.rule.changes)) or 'nothing is said about driving'}")
    for one in asked:
        typer.echo(f"asked back ({one['about']}): {one['words']!r} {' or '.join(one['offered'])}".rstrip())
    if measured:
        share, before = measured.obeyed, measured.without
        typer.echo(
            f"obeyed in {share.value:.0%} of the steps in which it holds ({share.low:.0%} to {share.high:.0%}), "
            f"without the rule in {before.value:.0%}; {measured.homes} homes, simulated"
        )


def _measure(rule: Rule, homes: int) -> Obedience:
    from desirepath.learning.rules.homes import rule_scene
    from desirepath.learning.rules.obedience import measure_obedience
    from desirepath.learning.scene_sets import Purpose, first_seed

    return measure_obedience(rule, [rule_scene(first_seed(Purpose.REPORT, 0) + number) for number in range(homes)])
