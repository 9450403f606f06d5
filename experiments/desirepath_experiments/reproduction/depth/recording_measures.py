"""How well encoder and predictor do on a recording that they have not seen: metres lost, pictures to look at."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.depth.states import bearings, detect_person
from desirepath.perception.beta_vae import DepthEncoder
from desirepath.perception.predictor import STEPS, PersonPredictor
from desirepath.simulation.depth_camera import DEPTH_CAMERA, CameraNoise
from desirepath_experiments.reproduction.depth.encoding import thin_parts
from desirepath_experiments.reproduction.depth.recording import Recording

Floats = NDArray[np.float32]
AT_ONCE = 64
NEAR_M = 3.0  # a person nearer than this is what matters
SHOWN = 6


def _latents(recording: Recording, encoder: DepthEncoder, random: np.random.Generator) -> Floats:
    """(t * n, 32) of noisy pictures of all steps."""
    latents = []
    for begin in range(0, recording.size, AT_ONCE):
        frames = recording.frames(DEPTH_CAMERA, np.arange(begin, min(begin + AT_ONCE, recording.size)))
        latents.append(encoder.latents(CameraNoise().applied(frames, DEPTH_CAMERA, random)))
    return np.concatenate(latents)


def prediction_set(recording: Recording, encoder: DepthEncoder) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """(sequences (m, 5, 36), next latents, next people, whether the person is in view before and after)."""
    times, robots = recording.episodes.shape
    latents = _latents(recording, encoder, np.random.default_rng(3)).reshape(times, robots, -1)
    flat = recording.poses.reshape(-1, 3), recording.people.reshape(-1, 4)
    person = detect_person(DEPTH_CAMERA, *flat).reshape(times, robots, 3)
    step = np.concatenate([person[:, :, 1:], recording.actions, latents], axis=2)
    windows, after = [], []
    for t in range(STEPS, times):
        within = ~recording.begins[t - STEPS + 1 : t + 1].any(axis=0)  # all of one episode
        windows.append(np.moveaxis(step[t - STEPS : t, within], 0, 1))
        after.append((latents[t, within], person[t, within], person[t - 1, within]))
    next_latents, next_person, last_person = (np.concatenate(part) for part in zip(*after, strict=True))
    seen = (next_person[:, 0] > 0) & (last_person[:, 0] > 0)
    return np.concatenate(windows).astype(np.float32), next_latents, next_person[:, 1:], seen


def prediction_errors(recording: Recording, encoder: DepthEncoder, predictor: PersonPredictor) -> dict[str, Any]:
    """Where the person is next, metres off, where they are in view: the predictor, constant velocity, standing still.

    Constant velocity goes on as from the step before to the last one: in the robot's own frame, which is all that the
    predictor has, and in the world's, for a robot that knows how it moved itself. Latents: share of the variance of
    their change that is predicted.
    """
    sequences, latents, people, seen = prediction_set(recording, encoder)
    before = seen & (sequences[:, -2, 0] > 0)
    if not before.any():
        return {"n": 0}
    predicted_latents, predicted = predictor.next(sequences)
    last, earlier = sequences[:, -1, :2], sequences[:, -2, :2]

    def off(guess: Floats) -> float:
        return float(np.linalg.norm(_place(guess[before]) - _place(people[before]), axis=1).mean())

    turned = last.copy()
    went_on = 2 * _place(last) - _place(earlier)
    turned[:, 0] = np.hypot(*went_on.T) / DEPTH_CAMERA.range_m
    turned[:, 1] = np.arctan2(went_on[:, 1], went_on[:, 0]) / np.pi
    change = np.square(latents - sequences[:, -1, 4:]).sum()
    return {
        "n": int(before.sum()),
        "predictor_m": off(predicted),
        "constant_velocity_m": off(turned),
        "constant_velocity_in_the_world_m": _world_error(recording),
        "standing_m": off(last),
        "latent_change_predicted": float(1 - np.square(latents - predicted_latents).sum() / change),
    }


def _world_error(recording: Recording) -> float:
    """Mean distance (m) of people from where a constant velocity puts them, where they were in view three times."""
    times, robots = recording.episodes.shape
    flat = recording.poses.reshape(-1, 3), np.nan_to_num(recording.people.reshape(-1, 4), nan=1e6)
    seen = DEPTH_CAMERA.sees(*flat).reshape(times, robots)
    places = np.nan_to_num(recording.people[:, :, :2], nan=1e6)
    together = seen[2:] & seen[1:-1] & seen[:-2] & ~recording.begins[2:] & ~recording.begins[1:-1]
    off = np.linalg.norm(places[2:] - 2 * places[1:-1] + places[:-2], axis=2)[together]
    return float(off.mean()) if len(off) else 0.0


def _place(person: Floats) -> NDArray[np.float64]:
    away, bearing = person[:, 0] * DEPTH_CAMERA.range_m, person[:, 1] * np.pi
    return np.stack([away * np.cos(bearing), away * np.sin(bearing)], axis=1)


def _masks(recording: Recording, which: NDArray[np.int64], clean: Floats) -> dict[str, NDArray[np.bool_]]:
    person = clean != recording.frames(DEPTH_CAMERA, which, alone=True)
    return {"all": np.ones_like(person), "person": person, "thin": thin_parts(clean) & ~person}


def reconstruction(recording: Recording, encoder: DepthEncoder, frames: int = 512) -> dict[str, dict[str, float]]:
    """Metres between decoded and clean pictures of noisy ones: of all pixels, the person's, and of what is thin.

    kept: share of those pixels whose decoded depth is nearer to the thing than to what is behind it by at least half:
    for the person, within 0.5 m; for thin things, within 0.3 m.
    """
    random = np.random.default_rng(11)
    which = np.unique(random.integers(recording.size, size=frames))
    errors: dict[str, list[NDArray[np.float32]]] = {"all": [], "person": [], "thin": []}
    for begin in range(0, len(which), AT_ONCE):
        part = which[begin : begin + AT_ONCE]
        clean = recording.frames(DEPTH_CAMERA, part)
        decoded = encoder.frames(encoder.latents(CameraNoise().applied(clean, DEPTH_CAMERA, random)))
        for name, mask in _masks(recording, part, clean).items():
            errors[name].append(np.abs(decoded - clean)[mask])
    by_part = {}
    for name, parts in errors.items():
        together = np.concatenate(parts)
        if len(together):
            by_part[name] = {
                "pixels": float(len(together)),
                "median_m": float(np.median(together)),
                "mean_m": float(together.mean()),
                "kept": float((together < (0.3 if name == "thin" else 0.5)).mean()),
            }
    return by_part


def shown_frames(recording: Recording, encoder: DepthEncoder) -> dict[str, NDArray[np.float32]]:
    """Six pictures with a near person and six with thin legs: clean, as seen, decoded; (12, rows, columns) metres."""
    away, _ = bearings(recording.poses.reshape(-1, 3), np.nan_to_num(recording.people.reshape(-1, 4), nan=1e6))
    seen = DEPTH_CAMERA.sees(recording.poses.reshape(-1, 3), np.nan_to_num(recording.people.reshape(-1, 4), nan=1e6))
    random = np.random.default_rng(12)
    some = np.unique(random.integers(recording.size, size=400))
    thin = thin_parts(recording.frames(DEPTH_CAMERA, some)).sum(axis=(1, 2))
    near = np.flatnonzero(seen & (away < NEAR_M) & (away > 0.8))
    chosen = np.concatenate(
        [near[random.permutation(len(near))[:SHOWN]], some[np.argsort(-thin, kind="stable")[: 4 * SHOWN : 4]]]
    )
    clean = recording.frames(DEPTH_CAMERA, chosen)
    noisy = CameraNoise().applied(clean, DEPTH_CAMERA, random)
    return {"shown_clean": clean, "shown_seen": noisy, "shown_decoded": encoder.frames(encoder.latents(noisy))}
