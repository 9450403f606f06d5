"""Run by the tools' Python: Minari opens the trajectories of a data set; what it read is written down."""

import json
import sys
from pathlib import Path

import minari

told = {}
for name in sys.argv[1:]:
    opened = minari.load_dataset(name)
    metadata = list(opened.storage.get_episode_metadata(opened.episode_indices))
    told[name] = {
        "episodes": opened.total_episodes,
        "steps": opened.total_steps,
        "first": {
            "trajectory": metadata[0]["trajectory"],
            "observations": opened[0].observations.tolist(),
            "actions": opened[0].actions.tolist(),
            "rewards": opened[0].rewards.tolist(),
            "pose": opened[0].infos["pose"].tolist(),
        },
        "trajectories": [one["trajectory"] for one in metadata],
        "ends": [[bool(one.terminations[-1]), bool(one.truncations[-1])] for one in opened],
        "early": [bool(one.terminations[:-1].any() or one.truncations[:-1].any()) for one in opened],
        "observation_space": opened.observation_space.shape,
        "within": all(opened.observation_space.contains(row) for one in opened for row in one.observations)
        and all(opened.action_space.contains(row) for one in opened for row in one.actions),
        "sampled": len(opened.sample_episodes(1)),
    }
Path("told.json").write_text(json.dumps(told))
