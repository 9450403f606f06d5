"""A training on its way, in a file: what killed it takes half a minute of it, not all. The replay buffer is not kept;
whoever goes on fills another with what the policy does by then.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from numpy.typing import NDArray

from desirepath.learning.td3.td3 import Memory, Td3Agent
from desirepath.npz import NpzError, from_npz, to_npz

EVERY_S = 20.0
REFILLED = 100_000  # transitions


@dataclass(frozen=True)
class Kept:
    """What a file holds: the agent's memory, the running average of its actor, its updates and transitions."""

    memory: Memory
    average: torch.Tensor
    updates: int
    transitions: int


@dataclass
class TrainingFile:
    """Of a training with these settings: what another one left there is not gone on with."""

    path: Path
    settings: dict[str, Any]
    _written: float = field(default_factory=time.monotonic)

    def keep(self, agent: Td3Agent, average: torch.Tensor, transitions: int, *, every_s: float = EVERY_S) -> None:
        """Write it down, unless that was done just now."""
        if time.monotonic() - self._written < every_s:
            return
        self._written = time.monotonic()
        memory = agent.remember()
        header = {
            "settings": self._told(),
            "updates": agent.updates,
            "transitions": transitions,
            "steps": [state[0] for state in memory.optimisers],
        }
        arrays: dict[str, NDArray[Any]] = {f"flat_{k}": flat.numpy() for k, flat in enumerate(memory.flats)}
        for k, (_, first, second) in enumerate(memory.optimisers):
            arrays |= {f"first_{k}": first, f"second_{k}": second}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        partial = self.path.with_suffix(".partial")
        partial.write_bytes(to_npz(header, arrays | {"average": average.numpy()}))
        partial.replace(self.path)

    def find(self) -> Kept | None:
        """What was kept; None where nothing can be gone on with."""
        try:
            header, arrays = from_npz(self.path.read_bytes())
            if header["settings"] != self._told():
                return None
            flats = [torch.from_numpy(arrays[f"flat_{k}"].copy()) for k in range(4)]
            steps = enumerate(header["steps"])
            optimisers = [(done, arrays[f"first_{k}"].copy(), arrays[f"second_{k}"].copy()) for k, done in steps]
            average = torch.from_numpy(arrays["average"].copy())
        except (OSError, NpzError, KeyError):
            return None
        return Kept(Memory(flats, optimisers), average, header["updates"], header["transitions"])

    def forget(self) -> None:
        """The training is at its end."""
        self.path.unlink(missing_ok=True)

    def _told(self) -> Any:
        return json.loads(json.dumps(self.settings, default=str))
