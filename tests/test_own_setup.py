"""A robot, a setup and a world that a laboratory brings, exactly as docs/extending.md says it."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select

from desirepath.installed import DATASETS
from desirepath.learning.alignment.conditioning_search import ConditioningSearchConfig, search_conditioning
from desirepath.learning.alignment.gate import GateRule
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.preferences import measures, setup_settings
from desirepath.learning.preferences.objectives import NAMES
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.preferences.setup_settings import longest_shown_s
from desirepath.learning.queries.queries import Query, QueryConfig, QuerySet
from desirepath.learning.queries.varied_queries import VariedConfig, generate_varied_queries
from desirepath.learning.rewards.weights import fit_weights
from desirepath.learning.shipped_files import load_card
from desirepath.learning.td3.conditioned_training import conditioned_config, train_conditioned
from desirepath.simulation import setups
from desirepath.simulation.fast import rollout
from desirepath.simulation.scenes import check_scene, draw_scenes
from desirepath.simulation.setups import SETUPS, SetupError, get_setup, setup_folders
from desirepath.simulation.worlds import WORLDS
from desirepath.store.artefacts import load_trajectory
from desirepath.store.models import Trial
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import create_study
from desirepath_stage import bodies, scene_nodes
from desirepath_stage.views import camera_for
from tests.fences import fences_of, install
from tests.study.small_protocol import small_protocol

SECTIONS = ("A robot and its setup", "A world")
TINY = "updates=100 --set n_envs=512 --set selection_scenes=50"  # many environments: few steps that imitate
CACHES = (
    *(setups._find, setups._read, measures._typical_differences, setup_settings.scene_bounds),
    *(getattr(setup_settings, name) for name in ("far_enough_m", "closeness", "middle", "longest_shown_s")),
)


def forget() -> None:
    for cached in CACHES:
        cached.cache_clear()
    WORLDS.__dict__.pop("modules", None)
    WORLDS._loaded.pop("passage", None)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A laboratory's folder with what the recipes write, its package installed, its setups named."""
    install([fence for section in SECTIONS for fence in fences_of("docs/extending.md", section)], tmp_path)
    own = (tmp_path / "setups/porter_room/setup.yaml").read_text()
    (tmp_path / "porter/porter_passage").mkdir()
    (tmp_path / "porter/porter_passage/setup.yaml").write_text(own.replace("name: study_room", "name: passage"))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("DESIREPATH_SETUPS", str(tmp_path / "setups"))
    monkeypatch.chdir(tmp_path)
    forget()
    yield tmp_path
    sys.modules.pop("porter", None)
    forget()


def body_radius_m(glb: bytes) -> float:
    """How far the opaque part of a body reaches from its middle, of a binary glTF file."""
    (length,) = struct.unpack_from("<I", glb, 12)
    described = json.loads(glb[20 : 20 + length])
    parts = [primitive for mesh in described["meshes"] for primitive in mesh["primitives"]]
    position = described["accessors"][parts[-1]["attributes"]["POSITION"]]
    return float(max(abs(position[side][0]) for side in ("min", "max")))


class Recorded:
    """Keeps what is put on the stage, by name."""

    def __init__(self) -> None:
        self.glb: dict[str, bytes] = {}

    def add_glb(self, name: str, data: bytes, **_: object) -> None:
        self.glb[name] = data

    def add_frame(self, name: str, **_: object) -> None:
        pass


def test_a_larger_robot_with_another_lidar_trains_drives_in_a_session_and_is_seen(lab, database, files):
    notebook: dict[str, object] = {}
    exec((lab / "notebook.py").read_text(), notebook)
    policy, setup = Policy.load(lab / "porter_room.npz"), get_setup("porter_room")
    assert (setup.robot.radius_m, setup.robot.lidar.range_m) == (0.3, 8.0)
    assert policy.setup == "porter_room"
    assert notebook["trajectories"][0].observations.shape[1] == 6 + 27
    assert np.abs(np.diff(notebook["trajectories"][0].poses[:, :2], axis=0)).max() <= 0.8 * 0.2 + 1e-6

    # A session: three pairs of drives, one at half speed, shown to a simulated participant.
    scenes = draw_scenes("porter_passage", range(3))
    here = replace(policy, setup="porter_passage")
    slowly = lambda seen: np.clip(here.act(seen), -1, 0)  # noqa: E731
    pairs = zip(*(rollout(get_setup("porter_passage"), act, scenes) for act in (here.act, slowly)), strict=True)
    QuerySet(
        "porter_passage", tuple(Query(scene, a, b, (0, 1)) for scene, (a, b) in zip(scenes, pairs, strict=True)), {}
    ).save(lab / "pairs.npz")
    block = {"block": {"view": "top_down", "trials": [{"queries": {"count": 3}}]}}
    (lab / "protocol").mkdir()
    frozen = small_protocol(lab / "protocol", [block], query_set=str(lab / "pairs.npz"))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Porter", created_by=None)
    assert walk_in_process(database, files, study, 1)["completed"] == 1
    with database.session() as s:
        shown = load_trajectory(files, s.scalars(select(Trial.trajectory_a)).first())

    # The stage shows it in its size, beside what was there before.
    seen = {}
    for scene in (shown.scene, draw_scenes("study_room", [1])[0]):
        api = Recorded()
        scene_nodes.build(api, "/s", scene, "top_down", camera_for(scene, "top_down"), (bodies.NEUTRAL,))
        seen[scene.setup] = body_radius_m(api.glb["/s/robot0/body"])
    assert seen == {"porter_passage": pytest.approx(0.3, rel=0.03), "study_room": pytest.approx(0.18, rel=0.03)}


def test_the_commands_of_the_recipe_train_and_measure_it(lab):
    (commands,) = (one.text for one in fences_of("docs/extending.md", SECTIONS[0]) if one.language == "bash")
    assert "updates=600" in commands
    quickly = commands.replace("updates=600", TINY)
    search = {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    search["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    done = subprocess.run(["bash", "-ec", quickly], env=os.environ | search, cwd=lab, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    assert Policy.load(lab / "porter_room.npz").setup == "porter_room"
    assert "success" in done.stdout


def test_preferences_are_learned_in_an_own_setup_that_says_nothing_of_them(lab):
    """Everything that the shipped setups say in `preferences` and `conditioning` is computed from scenes and base."""
    here = lab / "setups/porter_room"
    own = here / "setup.yaml"
    # A lidar that the study room's network can read, as what a minute's training makes arrives nowhere.
    own.write_text(
        own.read_text().replace("beams: 270, sectors: 27, range_m: 8.0", "beams: 360, sectors: 60, range_m: 6.0")
    )
    base = replace(load_policy("study_room/base"), setup="porter_room")
    tiny = {"updates": 64, "base_transitions": 2_000, "buffer_size": 5_000, "n_envs": 32, "checkpoints": 1}
    config = replace(conditioned_config(base), **tiny, selection_scenes=12, strong_scenes=12, strong_share=-10.0)
    assert min(config.reward_weights.scales) > 0
    assert config.reward_weights.scales[NAMES.index("person_on_left")] == config.reward_weights.scales[3]
    conditioned = train_conditioned(base, config).policy
    conditioned.save(here / "conditioned.npz")
    card = replace(load_card("study_room/conditioned"), name="porter_room/conditioned", setup="porter_room")
    card.save(here / "conditioned.card.json")
    assert load_conditioned("porter_room/conditioned").scales == config.reward_weights.scales

    watched = QueryConfig(
        count=6, max_duration_s=longest_shown_s("porter_room"), min_gap_m=0.01, scenes_per_round=24, max_scenes=240
    )
    queries = generate_varied_queries(conditioned, VariedConfig(watched, settings=9)).queries
    answers = make_oracle("min-human-distance", seed=1).answer(queries)
    model = fit_weights(answers, PosteriorConfig(particles=2_000))
    assert (model.setup, sum(model.importance().values())) == ("porter_room", pytest.approx(1.0, abs=1e-4))
    searched = ConditioningSearchConfig(tried=8, copies=8, selection_scenes=12, gate=GateRule(scenes=20))
    personal = search_conditioning(conditioned, model.preference_weights(), base, searched)
    assert personal.policy.setup == "porter_room"
    assert rollout(get_setup("porter_room"), personal.policy.rollout_policy, draw_scenes("porter_room", [1]))

    own.write_text(own.read_text() + "preferences: {scales: {fahrter: 3.0}}\n")
    forget()
    with pytest.raises(SetupError, match=r"porter_room: preferences\.scales names 'fahrter'; known are farther"):
        conditioned_config(base)


def test_scenes_of_an_own_world_leave_the_robot_its_room(lab):
    assert {"porter_room", "porter_passage"} < set(SETUPS)
    for name in ("porter_room", "porter_passage"):
        for scene in draw_scenes(name, range(40)):
            check_scene(scene)
            assert scene == draw_scenes(name, [scene.seed])[0]
    assert draw_scenes("porter_room", [3])[0] != replace(draw_scenes("study_room", [3])[0], setup="porter_room")


def test_commands_and_forms_offer_it(lab):
    asked = """
from desirepath.jobs.kinds import get_kind
print(get_kind("train_base").parse({"setup": "porter_room"}).setup)
import gymnasium, desirepath.gymnasium_envs
print(gymnasium.make("desirepath/porter_passage-v0").reset(seed=1)[0].shape)
"""
    known = os.environ | {"PYTHONPATH": os.pathsep.join([str(lab), *sys.path])}
    told = subprocess.run([sys.executable, "-c", asked], env=known, capture_output=True, text=True, check=True)
    assert told.stdout.split("\n")[:2] == ["porter_room", "(33,)"]


@pytest.mark.parametrize(
    ("was", "instead", "problem"),
    [
        ("radius_m: 0.30", "radius_m: -0.3", r"setup.yaml:3: robot.radius_m = -0.3: .*greater than 0"),
        ("radius_m: 0.30", "radios_m: 0.3", "setup.yaml:3: robot.radios_m.* did you mean radius_m"),
        ("sectors: 27", "sectors: 28", "sectors = 28: must divide the 270 beams; what works: 27 sectors of 270"),
        ("v_max: 0.8", "v_max: 0.0", "setup.yaml:5: robot.limits: v_max = 0: must be above v_min"),
        ("name: study_room", "name: study_roon", "setup.yaml:8: world.name = .*did you mean study_room"),
        ("velocity: true", "velocity: true, pedestrians: 2", "observation.pedestrians = 2: must be 0, or world.people"),
        ("world:\n", "world:\n  people: {standing: [0, 1]}\n", "standing = .*one person at least stands"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_the_file_is_said_by_line_and_field(lab, was, instead, problem):
    path = lab / "setups/porter_room/setup.yaml"
    path.write_text(path.read_text().replace(was, instead, 1))
    with pytest.raises(SetupError, match=problem):
        get_setup("porter_room")


def test_two_setups_of_one_name_are_refused(lab, monkeypatch):
    (lab / "setups/porter_room").rename(lab / "setups/study_room")
    with pytest.raises(SetupError, match=r"study_room.*both have this name"):
        setup_folders()
    monkeypatch.setenv("DESIREPATH_SETUPS", str(lab / "nowhere"))
    with pytest.raises(SetupError, match="nowhere is no folder"):
        setup_folders()


def test_the_shipped_setups_drive_the_turtlebot():
    """Their folders are the registry; the same radius and height as always, and every world exists."""
    assert set(SETUPS) == {path.parent.name for path in DATASETS.glob("*/setup.yaml")}
    for setup in SETUPS.values():
        assert (setup.robot.name, setup.robot.radius_m, setup.robot.height_m) == ("turtlebot2", 0.18, 0.42)
        assert WORLDS[setup.world]
