"""Preference pairs as lines of JSON that Hugging Face's `datasets` and TRL open as they are: prompt, chosen, rejected.

Independent answers, practice and probes are splits of their own. Whose answers may be learned from is `who_counts`'s.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from desirepath.simulation.trajectory import Trajectory
from desirepath.store.who_counts import PROBE_ROLES, is_practice

FOLDER = "preference_pairs"
SPLITS = {
    "train": "independent answers to queries",
    "practice": "answers to practice trials",
    "probes": "queries that were asked again (repeat, swap) and triads (transitivity): no independent answers",
}
ROUNDED = 2  # decimals of metres, seconds and radians in the texts; exact numbers are in trajectories/


def text_of(trajectory: Trajectory) -> str:
    """A trajectory as one line of text: [[seconds, x m, y m, yaw rad], ...], poses at every control step."""
    rows = np.column_stack([trajectory.times, trajectory.poses.astype(np.float64)])
    return json.dumps((np.round(rows, ROUNDED) + 0.0).tolist(), separators=(",", ":"))


def prompt_of(trajectory: Trajectory) -> str:
    """What both trajectories of a pair were asked: the scene, as text."""
    return json.dumps({"scene": trajectory.scene.as_dict()}, sort_keys=True, separators=(",", ":"))


def write_pairs(
    out: Path, pairs: Iterable[Mapping[str, Any]], prompts: Mapping[str, str], texts: Mapping[str, str]
) -> None:
    """Write the splits that have answers, and a card that names them, into the data set's folder `out`.

    pairs: rows of table `pairs` whose answers may be learned from. prompts: by scene hash; texts: by trajectory.
    """
    lines: dict[str, list[str]] = {}
    for row in pairs:
        if row["kind"] != "query":
            continue
        split = "practice" if is_practice(row["role"]) else "probes" if row["role"] in PROBE_ROLES else "train"
        line = {
            "prompt": prompts[row["scene_hash"]],
            "chosen": texts[row["chosen"]],
            "rejected": texts[row["rejected"]],
            **{name: row[name] for name in ("response", "participant", "source", "role", "view", "query", "setup")},
            "chosen_trajectory": row["chosen"],
            "rejected_trajectory": row["rejected"],
            "chosen_shown": row["chosen_shown"],
        }
        lines.setdefault(split, []).append(json.dumps(line, ensure_ascii=False) + "\n")
    if not lines:
        return
    folder = out / FOLDER
    folder.mkdir()
    for split, of_split in lines.items():
        (folder / f"{split}.jsonl").write_text("".join(of_split), encoding="utf-8", newline="")
    (folder / "README.md").write_text(
        _card([split for split in SPLITS if split in lines]), encoding="utf-8", newline=""
    )


def _card(splits: Iterable[str]) -> str:
    """The dataset card: its head tells `datasets.load_dataset(FOLDER)` which file is which split."""
    splits = tuple(splits)
    head = "".join(f'  - split: {split}\n    path: "{split}.jsonl"\n' for split in splits)
    meaning = "".join(f"- `{split}`: {SPLITS[split]}\n" for split in splits)
    return (
        f"---\nconfigs:\n- config_name: default\n  data_files:\n{head}---\n# Preference pairs\n\n{meaning}\n"
        "`prompt` is the scene; `chosen` and `rejected` are `[[seconds, x m, y m, yaw rad], ...]` as text, the poses\n"
        "at every control step. TRL reads these three columns as its preference format; the exact arrays are in\n"
        "`../trajectories/`, by `chosen_trajectory` and `rejected_trajectory`. Answers of who was excluded, withdrew,\n"
        "took part in a pilot or did not agree that models learn from them are left out.\n"
    )
