"""Reading `setup.yaml`: what it may say, and what is wrong with one, by line and field."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from desirepath.grammar.error_words import meant, parse
from desirepath.grammar.parts import Part, Slug
from desirepath.grammar.source import Problem, ProtocolError, Source, file_text
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath.simulation.setup_parts import ConditioningSettings, DemonstrationSettings, PreferenceSettings
from desirepath.simulation.setups import SETUP_FILE, CoreReward, NearPenalty, Robot, Setup, SetupError
from desirepath.simulation.worlds import WORLDS


class World(Part):
    """Where scenes come from. people: who walks in them beside the person; without it nobody does."""

    name: Slug
    people: CrowdConditions | None = None


class Observation(Part):
    """What a policy is told, besides the goal; `Setup` says in which order. person: where the person is; velocity: its
    own; solids: so many walls and obstacles instead of a lidar scan; pedestrians: of so many nearest ones how they
    move; path_points: places of the path ahead; extractors: networks read lidar and the rest by one each.
    """

    person: bool
    velocity: bool
    solids: int = Field(0, ge=0, le=64)
    pedestrians: int = Field(0, ge=0, le=20)
    path_points: int = Field(0, ge=0, le=5)
    distance_scale_m: float = Field(10.0, gt=0, le=1_000)
    extractors: bool = True


class Task(Part):
    """What the robot is for: its reward, when a goal is reached, how many steps of 0.2 s it has, its discount."""

    reward: CoreReward
    near: NearPenalty | None = None
    goal_radius_m: Annotated[float, Field(gt=0, le=10)]
    max_steps: Annotated[int, Field(ge=1, le=10_000)]
    gamma: Annotated[float, Field(gt=0, le=1)]
    observation: Observation


class SetupFile(Part):
    """A whole `setup.yaml`. What it does not say of preferences and conditioning is computed where it is needed; paths
    are drawn where it says `demonstrations`."""

    robot: Robot
    world: World
    task: Task
    preferences: PreferenceSettings = PreferenceSettings()
    conditioning: ConditioningSettings = ConditioningSettings()
    demonstrations: DemonstrationSettings | None = None


def check_setup(folder: Path) -> Setup:
    """The setup in that folder, whose name it bears. Raises ProtocolError with every problem, by line and field."""
    path = folder / SETUP_FILE
    source = Source(str(path), file_text(path))
    found = parse(source, SetupFile)
    task, observed, known = found.task, found.task.observation, list(WORLDS)
    problems: list[Problem] = []
    if found.world.name not in known:
        problem = f"no such world; one of {', '.join(known)}{meant(found.world.name, known)}"
        problems.append(source.problem(("world", "name"), problem))
    if observed.pedestrians and found.world.people is None:
        where = ("task", "observation", "pedestrians")
        problems.append(source.problem(where, "must be 0, or world.people say who walks"))
    if problems:
        raise ProtocolError(problems)
    return Setup(
        name=folder.name,
        robot=found.robot,
        world=found.world.name,
        people=found.world.people,
        reward=task.reward,
        near=task.near,
        goal_radius_m=task.goal_radius_m,
        max_steps=task.max_steps,
        gamma=task.gamma,
        with_person=observed.person,
        with_velocity=observed.velocity,
        solids=observed.solids,
        pedestrians=observed.pedestrians,
        path_points=observed.path_points,
        distance_scale_m=observed.distance_scale_m,
        extractors=observed.extractors,
        preferences=found.preferences,
        conditioning=found.conditioning,
        demonstrations=found.demonstrations,
    )


def read_setup(folder: Path) -> Setup:
    """As `check_setup`. Raises SetupError."""
    try:
        return check_setup(folder)
    except ProtocolError as wrong:
        raise SetupError(str(wrong)) from None
