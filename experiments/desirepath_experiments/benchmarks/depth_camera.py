"""The fast engine's depth camera against PyBullet's software renderer: the same frames, and how fast, in one run."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.depth_camera import DEPTH_CAMERA, WIDE_CAMERA, Sights, person_of
from desirepath.simulation.fast import FastEngine
from desirepath.simulation.setups import get_setup
from desirepath_experiments.benchmarks.reference_camera import ReferenceCamera

OFF_M = 0.05
ROUNDS = 5
VIEWS = 5  # robot poses per scene, each with the person facing another way


def benchmark_depth(
    setup: str = "home", *, frames: int = 1_000, seconds: float = 6.0, seed: int = 0, wide: bool = False
) -> dict[str, Any]:
    """Both cameras from the same poses in drawn scenes of the setup, people included, then both in turns for `seconds`.

    Errors are in metres over all pixels of all frames, those at the range included. Poses: where robots come to under
    random actions. PyBullet's scenes are built outside the time that counts; seconds are processor time, one core each.
    Raises ValueError for fewer frames than views of one scene.
    """
    if frames < VIEWS:
        raise ValueError(f"frames = {frames}: at least {VIEWS}")
    camera = WIDE_CAMERA if wide else DEPTH_CAMERA
    count = -(-frames // VIEWS)
    scenes = scene_set(setup, count, purpose=Purpose.BENCHMARK, seed=seed)
    random = np.random.default_rng(seed)
    engine = FastEngine(get_setup(setup), count, auto_reset=False, scenes=scenes)
    sights, errors, of_person = Sights(scenes), [], []
    people = np.array([person_of(scene) for scene in scenes])
    views = []
    for _ in range(VIEWS):
        for _ in range(6):
            engine.step(np.asarray(random.uniform(-1, 1, (count, 2)), dtype=np.float32))
        people[:, 2] = random.uniform(-np.pi, np.pi, count)
        ours = sights.pictures(camera, engine.poses, people)
        with_person = ours != sights.pictures(camera, engine.poses, np.full_like(people, np.nan))
        views.append((engine.poses.copy(), people.copy(), ours, with_person))
    spent, made = {"fast": 0.0, "pybullet": 0.0}, {"fast": 0, "pybullet": 0}
    with ReferenceCamera(camera) as reference:
        for i, scene in enumerate(scenes):
            reference.build(scene)
            for poses, persons, ours, with_person in views:
                reference.move_person(persons[i, :3].tolist())
                apart = np.abs(reference.picture(poses[i].tolist()) - ours[i])
                errors.append(apart.ravel())
                of_person.append(apart[with_person[i]])
        for _ in range(ROUNDS):
            begin = time.process_time()
            while (took := time.process_time() - begin) < seconds / ROUNDS / 2:
                sights.pictures(camera, engine.poses, people)
                made["fast"] += count
            spent["fast"] += took
            begin = time.process_time()
            while (took := time.process_time() - begin) < seconds / ROUNDS / 2:
                which = int(random.integers(count))
                if made["pybullet"] % 20 == 0:  # another scene, outside the time that counts
                    paused = time.process_time()
                    reference.build(scenes[which])
                    begin += time.process_time() - paused
                    standing = which
                reference.raw_picture(engine.poses[standing].tolist())
                made["pybullet"] += 1
            spent["pybullet"] += took
    every, person = np.concatenate(errors), np.concatenate(of_person)
    rate = {who: made[who] / spent[who] for who in made}
    return {
        "fast_frames_per_s": rate["fast"],
        "pybullet_frames_per_s": rate["pybullet"],
        "ratio": rate["fast"] / rate["pybullet"],
        "median_error_m": float(np.median(every)),
        "mean_error_m": float(every.mean()),
        "share_off_by_5_cm": float((every > OFF_M).mean()),
        "person_median_error_m": float(np.median(person)) if len(person) else None,
        "person_share_off_by_5_cm": float((person > OFF_M).mean()) if len(person) else None,
        "frames": count * VIEWS,
        "pixels": [camera.columns, camera.rows],
        "fov_rad": camera.fov_rad,
        "setup": setup,
        "renderer": "ER_TINY_RENDERER",
        "threads": 1,
        "seconds_are": "processor time",
        "seed": seed,
    }
