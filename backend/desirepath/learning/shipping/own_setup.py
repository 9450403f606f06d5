"""Everything that studies need in a lab's own setup, made one after the other into its folder: base policy, conditioned
policy, queries of it, ensemble, queries of that. What is there already, made of the same description, is kept.
"""

from __future__ import annotations

import hashlib
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from desirepath.learning.cards import Card, card_path, file_sha256
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.policy import Policy
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.shipping import policies, query_sets
from desirepath.learning.shipping.storing import Request
from desirepath.learning.td3.base import BaseTraining, base_config
from desirepath.learning.td3.conditioned_training import conditioned_config
from desirepath.learning.td3.ensemble import PolicyEnsembleConfig
from desirepath.simulation.fast import evaluate
from desirepath.simulation.setups import Setup, SetupError, get_setup, is_shipped, setup_folders

GUIDED = {"guidance": 2.0, "let_go": 0.5, "smoothness": 0.2, "smoothness_wanted": 0.4}
"""Of conditioned policies: without, in a building of eight rooms, success falls by 8 points from the base policy's."""
REPORT_SCENES = 1_000  # of the base policy, whose success is told
SELECTION_SCENES = 400
BASE_UPDATES, SMOOTHING_UPDATES = 15_000, 5_000  # at most
CONDITIONED_UPDATES = 30_000
ENSEMBLE_STEPS = 15_000
"""Two thirds of what shipped policies take: the first pair shall be there a quarter of an hour after the files."""
PROBED_S = 2.0
ON_THE_WAY = ".training"  # folder in a setup's, of trainings that were interrupted
DEFINITION = "description"
"""The parent on each card that stands for the setup's files."""
DEFINING = (".yaml", ".yml", ".pgm", ".png", ".bmp", ".urdf")


class OnStage(Protocol):
    """Is told how far which stage is, and how many seconds are left of all, about."""

    def __call__(self, stage: str, fraction: float, metrics: dict[str, float], left_s: float) -> None: ...


def tell_nobody(stage: str, fraction: float, metrics: dict[str, float], left_s: float) -> None:
    """The callback of who does not want any."""


def keep_nothing(made: list[str]) -> None:
    """The callback of who takes what was made from the folder."""


@dataclass(frozen=True)
class SetupTrainingConfig:
    """How a setup's policies and queries are made. effort: part of the usual number of updates; little of it only shows
    that everything runs. randomise: base and conditioned policy learn with robots that get wrong what real ones do."""

    seed: int = 0
    queries: int = 200
    effort: float = 1.0
    threads: int = 2
    randomise: bool = False

    def command(self, name: str) -> str:
        """What makes the same again."""
        effort = f" --effort {self.effort:g}" if self.effort != 1 else ""
        return f"desirepath setups train {name} --seed {self.seed}{effort}{' --randomise' * self.randomise}"


@dataclass(frozen=True)
class SetupTrained:
    """success_rate: of the base policy in scenes that nothing was chosen on, with its 95 % interval. seconds: by stage,
    what it took now; nothing of what was kept. begun_anew: how often base training stood still."""

    success_rate: float
    interval: tuple[float, float]
    seconds: dict[str, float]
    policies: list[str]
    query_sets: list[str]
    begun_anew: int


class Stage(NamedTuple):
    """makes: artefacts of the folder, in order of their making; the last one's card says that the stage is done."""

    name: str
    makes: tuple[str, ...]
    make: Callable[[Request, SetupTrainingConfig], object]


def _base(request: Request, config: SetupTrainingConfig) -> object:
    usual = base_config(request.setup, config.seed)
    return policies.ship_base(
        request,
        replace(
            usual,
            updates=_part(min(BASE_UPDATES, usual.updates), config),
            smoothing_updates=_part(min(SMOOTHING_UPDATES, usual.smoothing_updates), config),
            random_transitions=_part(usual.random_transitions, config, least=5_000),
            guided_updates=_part(usual.guided_updates, config),
            checkpoints=4,
            selection_scenes=_part(SELECTION_SCENES, config),
            randomise=config.randomise,
        ),
    )


def _conditioned(request: Request, config: SetupTrainingConfig) -> object:
    usual = conditioned_config(Policy.load(request.path("base")), config.seed)
    few = replace(
        usual,
        updates=_part(CONDITIONED_UPDATES, config),
        base_transitions=_part(usual.base_transitions, config, least=5_000),
        selection_scenes=_part(usual.selection_scenes, config),
        strong_scenes=_part(SELECTION_SCENES, config),
        randomise=config.randomise,
    )
    return policies.ship_conditioned(request, few)


def _ensemble(request: Request, config: SetupTrainingConfig) -> object:
    usual = PolicyEnsembleConfig(seed=config.seed)
    few = replace(
        usual,
        steps=_part(ENSEMBLE_STEPS, config),
        base_transitions=_part(usual.base_transitions, config, least=5_000),
        selection_scenes=_part(SELECTION_SCENES, config),
    )
    return policies.ship_ensemble(request, few)


def _part(usual: int, config: SetupTrainingConfig, least: int = 50) -> int:
    return max(min(usual, least), round(usual * config.effort))


def stages_of(setup: Setup, config: SetupTrainingConfig) -> list[Stage]:
    """In the order in which they are made: what a first study needs comes first. Raises SetupError for a setup in which
    no base policy can be trained."""
    if is_shipped(setup_folders()[setup.name]):
        raise SetupError(f"setup {setup.name}: comes with the product; copy it under another name to train")
    if setup.solids or setup.reward.goal <= 0:
        raise SetupError(f"setup {setup.name}: nothing is trained where there is no lidar, or no reward for arriving")
    if config.randomise and setup.crowded:
        raise SetupError(f"setup {setup.name} has pedestrians: leave out `randomise`")
    members = tuple(f"ensemble/{k}" for k in range(PolicyEnsembleConfig().members))
    return [
        Stage("base", ("base",), _base),
        Stage("conditioned", ("conditioned",), _conditioned),
        Stage(
            "varied_queries",
            (f"queries_varied_{config.queries}",),
            lambda request, _: query_sets.ship_varied_queries(request),
        ),
        Stage("ensemble", members, _ensemble),
        Stage("queries", (f"queries_{config.queries}",), lambda request, _: query_sets.ship_queries(request)),
    ]


def description_sha256(folder: Path) -> str:
    """Of everything in a setup's folder that says what it is: its YAML files, maps and robots."""
    digest = hashlib.sha256()
    for file in sorted(folder.iterdir()):
        if file.is_file() and file.suffix.lower() in DEFINING:
            digest.update(f"{file.name}\0{file.stat().st_size}\0".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()


def is_made(folder: Path, artefact: str, described: str, command: str) -> bool:
    """Whether that artefact lies there whole, made of this description, as this command makes it, and of what lies
    beside it now."""
    path = folder / f"{artefact}.npz"
    if not path.is_file() or not card_path(path).is_file():
        return False
    try:
        card = Card.load(card_path(path))
    except LearningError:
        return False
    beside = {name.partition("/")[2]: sha for name, sha in card.parents.items() if name.startswith(f"{folder.name}/")}
    return (
        card.sha256 == file_sha256(path)
        and card.command == command
        and card.parents.get(DEFINITION) == described
        and all((one := folder / f"{name}.npz").is_file() and file_sha256(one) == sha for name, sha in beside.items())
    )


def train_setup(
    name: str,
    config: SetupTrainingConfig | None = None,
    on_stage: OnStage = tell_nobody,
    on_made: Callable[[list[str]], None] = keep_nothing,
) -> SetupTrained:
    """Make what is not made yet, into the folder of the setup of that name. on_made: is told the names of each stage's
    artefacts once they lie there, first of those that lay there already. Raises SetupError, LearningError,
    SceneError."""
    config = config or SetupTrainingConfig()
    setup, folder = get_setup(name), setup_folders()[name]
    described = description_sha256(folder)
    stages, done = stages_of(setup, config), dict(stages_done(folder, config))
    command = config.command(name)
    left = [one for one in stages if not done[one.name]]
    on_made([f"{name}/{one}" for stage in stages if done[stage.name] for one in stage.makes])
    costs = expected_seconds(setup, config, [one.name for one in left])
    seconds: dict[str, float] = {}
    for stage in left:
        began = time.monotonic()

        def told(fraction: float, metrics: dict[str, float], stage: Stage = stage, began: float = began) -> None:
            later = sum(costs[one.name] for one in left[left.index(stage) + 1 :])
            took = time.monotonic() - began
            here = took * (1 - fraction) / fraction if fraction > 0.05 else costs[stage.name] * (1 - fraction)
            on_stage(stage.name, fraction, metrics, here + later)

        told(0.0, {})
        request = Request(
            name,
            config.seed,
            folder.parent,
            config.queries,
            on_progress=told,
            report_scenes=_part(REPORT_SCENES if stage.name == "base" else SELECTION_SCENES, config),
            report_sets=1,
            work=folder / ON_THE_WAY,
            command=command,
            made_of={DEFINITION: described},
        )
        stage.make(request, config)
        shutil.rmtree(folder / ON_THE_WAY, ignore_errors=True)
        seconds[stage.name] = round(time.monotonic() - began, 1)
        on_made([f"{name}/{one}" for one in stage.makes])
        told(1.0, {})
    return _told(folder, stages, seconds)


def _told(folder: Path, stages: list[Stage], seconds: dict[str, float]) -> SetupTrained:
    card = Card.load(card_path(folder / "base.npz"))
    first = card.results["first"]
    low, high = first["intervals"]["success_rate"]
    made = [f"{folder.name}/{one}" for stage in stages for one in stage.makes]
    return SetupTrained(
        first["success_rate"],
        (low, high),
        seconds,
        [one for one in made if "/queries_" not in one],
        [one for one in made if "/queries_" in one],
        len(card.results.get("begun_anew", ())),
    )


def expected_seconds(setup: Setup, config: SetupTrainingConfig, stages: list[str]) -> dict[str, float]:
    """By stage, about, from a look at how fast this machine learns and simulates there: PROBED_S and some scenes."""
    if not stages:
        return {}
    scene_set(setup.name, 2, purpose=Purpose.FIGURE, seed=1)  # what is compiled and read once
    began = time.monotonic()
    scenes = scene_set(setup.name, 24, purpose=Purpose.FIGURE, seed=2)
    drawing = (time.monotonic() - began) / len(scenes)
    usual = base_config(setup.name, config.seed)
    probed = replace(usual, random_transitions=2_560, buffer_size=50_000)
    training = BaseTraining(probed)
    while training.transitions <= probed.random_transitions:
        training.vector_step()
    evaluate(training.agent.act, setup, scenes[:2])
    began, before = time.monotonic(), training.agent.updates
    while time.monotonic() - began < PROBED_S:
        training.vector_step()
    per_update = (time.monotonic() - began) / (training.agent.updates - before)
    cloning = _part(usual.random_transitions, config) // usual.n_envs * usual.cloned // 2  # half as much work each
    after = min(BASE_UPDATES, usual.updates) + min(SMOOTHING_UPDATES, usual.smoothing_updates)
    updates = cloning + _part(after, config)
    conditioned = _part(CONDITIONED_UPDATES, config)
    steps = _part(ENSEMBLE_STEPS, config) * PolicyEnsembleConfig().members
    report = drawing * _part(REPORT_SCENES, config)
    found = {
        "base": 1.2 * per_update * updates + 2 * report + drawing * min(4_096, updates // 4),
        "conditioned": 2.0 * per_update * conditioned + report,
        "varied_queries": 14 * 0.02 * config.queries + 4 * drawing * config.queries,
        "ensemble": 1.5 * per_update * steps / min(config.threads, 2) + report,
        "queries": 0.02 * config.queries + 4 * drawing * config.queries,
    }
    return {name: round(found[name], 1) for name in stages}


def in_words(seconds: float) -> str:
    """`about 4 minutes`, `about 40 seconds`."""
    return f"about {seconds / 60:.0f} minutes" if seconds >= 90 else f"about {max(5, round(seconds, -1)):.0f} seconds"


def stages_done(folder: Path, config: SetupTrainingConfig) -> Iterator[tuple[str, bool]]:
    """Each stage's name and whether all that it makes is there."""
    described = description_sha256(folder)
    for stage in stages_of(get_setup(folder.name), config):
        yield stage.name, all(is_made(folder, made, described, config.command(folder.name)) for made in stage.makes)


def trained_already(folder: Path) -> dict[str, Any]:
    """What lies in a setup's folder: names of its artefacts, and the base policy's success where it has one."""
    names = sorted(
        path.relative_to(folder).with_suffix("").as_posix()
        for path in folder.glob("**/*.npz")
        if card_path(path).is_file()
    )
    success = None
    if "base" in names:
        success = Card.load(card_path(folder / "base.npz")).results.get("first", {}).get("success_rate")
    return {"artefacts": names, "success_rate": success}
