"""Chapter 3's recordings: person modes in homes, an avoider rolled out, an encoder that learns from what it saw."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.demonstrations.depth.episodes import MODES, EpisodePool, Episodes, home_episodes, people_of
from desirepath.installed import DATASETS
from desirepath.learning.cards import file_sha256
from desirepath.learning.shipped_files import load_card
from desirepath.perception.beta_vae import LATENTS, DepthEncoder, VaeConfig
from desirepath.perception.predictor import INPUTS, STEPS, PersonPredictor, PredictorConfig, fit_predictor
from desirepath.simulation.depth_camera import DEPTH_CAMERA, CameraNoise
from desirepath.simulation.fast import make_engine
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.depth.encoding import EncoderTraining, pixel_weights
from desirepath_experiments.reproduction.depth.recording import Recording, record

HOME = get_setup("home")


class Straight:
    """Drives on at half speed."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        return np.zeros((len(observations), 2), dtype=np.float32)


@pytest.fixture(scope="module")
def episodes() -> Episodes:
    return home_episodes(draw_scenes("home", range(4)), MODES[:4])


@pytest.fixture(scope="module")
def recording(episodes: Episodes) -> Recording:
    return record(Straight(), episodes, steps=30, robots=8)  # type: ignore[arg-type]


def test_people_walk_stand_or_are_not_there_as_their_mode_says(episodes: Episodes):
    engine = make_engine(HOME, 8, pool=EpisodePool(episodes, 0))
    before = {}
    for i, number in enumerate(engine.seeds):
        before[i] = (int(number), people_of(engine.rows)[i])
    actions = np.tile(np.array([-1.0, 0.0], dtype=np.float32), (8, 1))
    for _ in range(10):
        engine.step(actions)  # everybody stands still: only people move
    after = people_of(engine.rows)
    seen = set()
    for i, (number, person) in before.items():
        mode = episodes.modes[number]
        if engine.seeds[i] != number or engine.steps[i] != 10:
            continue
        seen.add(mode)
        if mode == "absent":
            assert np.isnan(person).all()
        elif mode == "static":
            assert (after[i] == person).all()
        else:
            assert np.hypot(*(after[i] - person)[:2]) > 0.1
    assert {"absent", "static"} <= seen


def test_who_is_absent_is_neither_seen_nor_hit(episodes: Episodes):
    rows = episodes.rows()
    absent = episodes.modes.index("absent")
    assert np.isnan(people_of(rows)[absent]).all()
    assert rows[absent, 7] > 100


def test_a_recording_knows_where_episodes_begin(recording: Recording):
    assert recording.size == 30 * 8
    assert recording.begins[0].all()
    later = recording.begins[1:] & (recording.episodes[1:] >= 0)
    jumped = np.hypot(*np.moveaxis(np.diff(recording.poses[:, :, :2], axis=0), 2, 0)) > 0.2
    assert (later | ~jumped).all()  # nobody jumps within an episode


def test_a_training_of_the_encoder_that_was_left_goes_on_as_if_it_had_not_been(recording: Recording):
    config = VaeConfig(batches=6, batch_size=4)

    def training(state: dict[str, np.ndarray] | None = None) -> EncoderTraining:
        return EncoderTraining(recording, (DEPTH_CAMERA,), CameraNoise(), config, state)

    whole, left = training(), training()
    whole.run(6)
    left.run(3)
    going_on = training(left.state())
    going_on.run(6)
    assert going_on.curve == pytest.approx(whole.curve)
    frames = recording.frames(DEPTH_CAMERA, np.arange(4))
    assert np.allclose(going_on.encoder().latents(frames), whole.encoder().latents(frames), atol=1e-5)


def test_near_things_people_and_thin_legs_count_more():
    clean = np.full((1, 80, 128), 4.0, dtype=np.float32)
    clean[0, :, :40], clean[0, :, 60:62], clean[0, :, 100:] = 1.0, 3.0, 3.0
    alone = clean.copy()
    alone[0, :, 100:] = 4.0  # the person stands before the wall
    weights = pixel_weights(clean, alone, 6.0, VaeConfig())[0, 40]
    assert weights[0] > weights[50]
    assert weights[61] > 4 * weights[50]
    assert weights[120] > 4 * weights[50]


def test_the_encoder_learns_and_comes_back_from_its_file(recording: Recording):
    alike = VaeConfig(batches=40, batch_size=16, near=100.0, person_weight=1.0, thin_weight=1.0)
    training = EncoderTraining(recording, (DEPTH_CAMERA,), CameraNoise(), alike)
    training.run(alike.batches)
    encoder, curve = training.encoder(), training.curve
    assert np.mean(curve[-5:]) < 0.8 * np.mean(curve[:5])
    frames = recording.frames(DEPTH_CAMERA, np.arange(6))
    latents = encoder.latents(frames)
    assert latents.shape == (6, LATENTS)
    data = encoder.to_bytes()
    assert len(data) < 1_000_000
    again = DepthEncoder.from_bytes(data)
    assert np.abs(again.latents(frames) - latents).max() < 0.02
    assert again.frames(latents).shape == frames.shape
    with pytest.raises(ValueError, match="not a desirepath depth encoder"):
        DepthEncoder.from_bytes(b"something else")


def test_the_shipped_encoder_and_predictor_are_small_and_do_what_their_cards_say(recording: Recording):
    encoder_path, predictor_path = (DATASETS / "home" / f"depth_{what}.npz" for what in ("encoder", "predictor"))
    assert encoder_path.stat().st_size + predictor_path.stat().st_size < 2_000_000
    card = load_card("home/depth_encoder")
    assert card.sha256 == file_sha256(encoder_path)
    assert load_card("home/depth_predictor").parents == {"home/depth_encoder": card.sha256}
    encoder = DepthEncoder.from_bytes(encoder_path.read_bytes())
    frames = recording.frames(DEPTH_CAMERA, np.arange(0, recording.size, 4))
    seen = CameraNoise().applied(frames, DEPTH_CAMERA, np.random.default_rng(0))
    off = np.abs(encoder.frames(encoder.latents(seen)) - frames)
    assert off.mean() < 2 * card.results["reconstruction"]["all"]["mean_m"]
    predictor = PersonPredictor.from_bytes(predictor_path.read_bytes())
    latents, people = predictor.next(np.zeros((3, STEPS, INPUTS), dtype=np.float32))
    assert (latents.shape, people.shape) == ((3, LATENTS), (3, 2))


def test_the_predictor_learns_who_walks_on_and_comes_back_from_its_file():
    random = np.random.default_rng(0)
    place, speed = random.uniform(-0.5, 0.5, (400, 2)), random.uniform(-0.05, 0.05, (400, 2))
    walked = place[:, None] + np.arange(STEPS + 1)[None, :, None] * speed[:, None]
    sequences = np.zeros((400, STEPS, INPUTS), dtype=np.float32)
    sequences[:, :, :2] = walked[:, :STEPS]
    following = walked[:, STEPS].astype(np.float32)
    fitted = fit_predictor(
        sequences, np.zeros((400, LATENTS), np.float32), following, np.ones(400, bool), PredictorConfig(batches=300)
    )
    predictor = PersonPredictor.from_bytes(PersonPredictor(fitted).to_bytes())
    _, people = predictor.next(sequences)
    standing = np.linalg.norm(sequences[:, -1, :2] - following, axis=1).mean()
    assert np.linalg.norm(people - following, axis=1).mean() < 0.5 * standing
