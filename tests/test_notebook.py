"""`import desirepath`: the README's example runs as it stands, and loading the package loads nothing heavy."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import desirepath as dp
from desirepath.learning.errors import LearningError

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def example() -> dict[str, Any]:
    """The names that the README's example leaves behind."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, Any] = {}
    exec(code, names)
    return names


def test_the_example_learns_what_its_person_wants(example: dict[str, Any]) -> None:
    weights = example["posterior"].weights
    assert max(weights, key=weights.__getitem__) == "farther"
    mine, base = (dp.evaluate(example[name], n=200) for name in ("mine", "base"))
    assert mine["min_human_distance_m"] > base["min_human_distance_m"] + 0.2
    assert mine["success_rate"] > 0.9
    observation, _ = example["env"].reset(seed=1)
    assert observation.shape == (dp.get_setup("study_room").observation_size,)


def test_fitting_at_once_believes_the_same_as_answering_in_turn(example: dict[str, Any]) -> None:
    asked = list(example["queries"].queries[:4])
    answers = [True, False, True, True]
    in_turn = dp.Posterior.prior("study_room")
    for query, answer in zip(asked, answers, strict=True):
        in_turn = in_turn.update(query, answer)
    at_once = dp.Posterior.fit(asked, answers)
    assert at_once.weights == pytest.approx(in_turn.weights)
    assert np.all((at_once.predict(asked) > 0) & (at_once.predict(asked) < 1))


def test_what_cannot_be_is_refused_by_name() -> None:
    with pytest.raises(LearningError, match=r"Posterior\.prior"):
        dp.Posterior.fit([], [])
    with pytest.raises(AttributeError, match="wishes"):
        dp.wishes  # noqa: B018


@pytest.mark.parametrize("name", dp.__all__)
def test_every_public_name_is_there_and_says_what_it_is(name: str) -> None:
    assert getattr(dp, name).__doc__


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = "import sys, desirepath; print([n for n in ('numpy', 'torch', 'numba', 'fastapi') if n in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
