"""Options of commands that are fields of configuration classes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import typer
from pydantic import BaseModel, Field
from typer.testing import CliRunner

from desirepath.cli.options import Configured, OptionsOf, configured
from desirepath.cli.output import JsonFlag, in_data_folder, say


@dataclass(frozen=True)
class Drawing:
    seeds: Annotated[tuple[int, ...], Field(description="Which ones are drawn.")] = (0, 1)
    share_m: Annotated[float, Field(ge=0, le=1, description="How much of it.")] = 0.5
    engine: Literal["fast", "slow"] = "fast"
    careful: bool = True
    out: Path | None = None
    hidden: str = "given"


class Job(BaseModel):
    snapshot: str
    names: tuple[str, ...] = ("a", "b")
    arms: tuple[Literal["ours", "theirs"], ...] = ("ours",)
    rate: float = Field(0.1, gt=0)


DRAWING = OptionsOf(f"{__name__}:Drawing", names={"share_m": "--share,--part"}, without=("hidden",))
app = typer.Typer()


@app.command(cls=Configured)
@in_data_folder
@configured(drawing=DRAWING, job=OptionsOf(f"{__name__}:Job", given={"snapshot": "0"}))
def draw(word: str, drawing: Drawing, job: Any, seed: int = 3, as_json: JsonFlag = False) -> None:
    say({"word": word, "seed": seed, "drawing": drawing.__dict__, "job": job.model_dump()}, as_json)


def told(*words: str) -> dict[str, Any]:
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.output)


def test_what_is_left_out_is_the_default_of_the_class():
    told_of = told("x")
    assert told_of["drawing"] == {**Drawing().__dict__, "seeds": [0, 1]}
    assert told_of["job"] == {"snapshot": "0", "names": ["a", "b"], "arms": ["ours"], "rate": 0.1}
    assert told_of["seed"] == 3


def test_fields_are_options_by_their_names_or_by_those_that_are_given():
    given = "--seeds 2-4,9 --part 0.25 --engine slow --no-careful --out o.png --names c,d --seed 8 --data d"
    told_of = told("x", *given.split(), "--arms", "theirs,ours")
    wanted = {"seeds": [2, 3, 4, 9], "share_m": 0.25, "engine": "slow", "careful": False, "out": "o.png"}
    assert told_of["drawing"] == wanted | {"hidden": "given"}
    assert (told_of["job"]["names"], told_of["job"]["arms"], told_of["seed"]) == (["c", "d"], ["theirs", "ours"], 8)


@pytest.mark.parametrize(
    ("words", "code", "problem"),
    [
        (["--share", "2"], 2, "less than or equal to 1"),
        (["--engine", "quick"], 2, "fast"),
        (["--hidden", "x"], 2, "--hidden"),
        (["--seeds", "1,two"], 1, "--seeds 1,two: whole numbers with commas, or FIRST-LAST"),
        (["--arms", "ours,nobodys"], 1, "'ours' or 'theirs'"),
        (["--rate", "0"], 1, "--rate 0.0: Input should be greater than 0"),
    ],
)
def test_what_cannot_be_names_the_option(words: list[str], code: int, problem: str):
    result = CliRunner().invoke(app, ["x", *words])
    assert result.exit_code == code
    assert problem in " ".join(result.output.replace("│", " ").split())


def test_help_says_what_the_fields_say():
    text = " ".join(CliRunner().invoke(app, ["--help"]).output.replace("│", " ").split())
    assert "Which ones are drawn. [default: 0,1]" in text
    assert "[0<=x<=1]" in text
