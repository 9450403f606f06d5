"""The networks of chapter 4: spatial and temporal attention (section 4.4.5), ablations A1 to A3, baselines B1 to B3.

All turn states (`crowd_states.py`) into one feature vector and, for the critic with the action, into heads of
128-64-64. Training is the laboratory's (`training/pedestrians`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from desirepath.learning.pedestrians.crowd_states import PATH_POINTS, SECTORS, SIZES, Given
from desirepath.simulation.crowds.crowd_engine import COARSE_RANGES, GROUPS
from desirepath.simulation.setups import Limits, get_setup

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

CROWD_CORRIDOR = get_setup("crowd_corridor")

PER_SECTOR = SECTORS // GROUPS
PATH = 2 * PATH_POINTS
GAP_TIMES = 20.0  # ours: what moves by 0.1 m between two scans differs as much as what lies 2 m apart
LAST_LAYER = ("head.6.weight", "head.6.bias")  # of an actor
LAST_STD = 0.01  # of last layers at first
FIRST_NUMBERS = {"drawn": "He et al. 2015", "last_std": LAST_STD}  # in a training's key: change it with `initialise`


@dataclass(frozen=True)
class VariantOf:
    """given: its state. name: as in table 4.1."""

    given: Given
    name: str


VARIANTS: dict[str, VariantOf] = {
    "ours": VariantOf("points_and_groups", "OUR"),
    "no_spatial": VariantOf("points_and_groups", "A1: NO-SPATIAL"),
    "no_temporal": VariantOf("points", "A2: NO-TEMPORAL"),
    "no_tagd": VariantOf("two_scans", "A3: NO-TAGD"),
    "b1": VariantOf("three_scans", "B1: Liang et al."),
    "b2": VariantOf("coarse", "B2: Perez-D. et al."),
    "b3": VariantOf("ranges", "B3: Perez-D. et al."),
}


def perceptron(*sizes: int, last: bool = True) -> nn.Sequential:
    """Linear layers with ReLU between, and after the last where `last`."""
    layers: list[nn.Module] = []
    for before, after in itertools.pairwise(sizes):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*(layers if last else layers[:-1]))


def initialise(network: nn.Module) -> None:
    """Ours: numbers at first as He et al. 2015 draw them for ReLU, last layers near 0 (`head`, and what scores sectors
    and groups, which therefore count alike at first). With torch's own, signals fade from layer to layer, and networks
    with attention learn nothing from their first 50,000 states."""
    for layer in network.modules():
        if isinstance(layer, (nn.Linear, nn.Conv1d)):
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)
    for name, part in network.named_modules():
        if name == "head" or name.endswith(".score"):
            nn.init.normal_(part[-1].weight, std=LAST_STD)


class Attention(nn.Module):
    """y = sum_i softmax(S(e))_i F(e_i), e_i = E(u_i) (equations 4.2, 4.3): (b, 30, inputs) -> (b, 30)."""

    OUT = 30

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.embedding = perceptron(inputs, 256, 128, 64)
        self.score = perceptron(64, 60, 50, 1, last=False)
        self.feature = perceptron(64, 80, 50, self.OUT)

    def weights(self, vectors: Tensor) -> Tensor:
        """(b, 30), summing to 1."""
        scores: Tensor = self.score(self.embedding(vectors))
        return torch.softmax(scores[..., 0], dim=1)

    def forward(self, vectors: Tensor) -> Tensor:
        embedded = self.embedding(vectors)
        weights = torch.softmax(self.score(embedded), dim=1)
        attended: Tensor = (weights * self.feature(embedded)).sum(dim=1)
        return attended


def _sectors(points: Tensor, path: Tensor) -> Tensor:
    """(b, 30, 6 points and the path): the spatial stream's vectors."""
    cut = points.reshape(len(points), GROUPS, 2 * PER_SECTOR)
    return torch.cat([cut, path[:, None].expand(-1, GROUPS, -1)], dim=2)


class AttentionExtractor(nn.Module):
    """Both streams, or one of them; with two scans, the spatial stream twice (A3)."""

    def __init__(self, variant: str) -> None:
        super().__init__()
        self.variant = variant
        self.spatial = Attention(2 * PER_SECTOR + PATH) if variant != "no_spatial" else None
        self.temporal: Attention | None = None
        if variant == "no_tagd":
            self.temporal = Attention(2 * PER_SECTOR + PATH)
        elif variant != "no_temporal":
            self.temporal = Attention(4 + PATH)
        self.size = Attention.OUT * ((self.spatial is not None) + (self.temporal is not None))

    def streams(self, states: Tensor) -> list[tuple[Attention, Tensor]]:
        """Each stream with the vectors that it is given."""
        points, path = states[:, : 2 * SECTORS], states[:, -PATH:]
        pairs = []
        if self.spatial is not None:
            pairs.append((self.spatial, _sectors(points, path)))
        if self.temporal is not None:
            if self.variant == "no_tagd":
                vectors = _sectors(states[:, 2 * SECTORS : 4 * SECTORS], path)
            else:
                groups = states[:, 2 * SECTORS : 2 * SECTORS + 4 * GROUPS].reshape(-1, GROUPS, 4)
                older, newer = groups[:, :, :2], groups[:, :, 2:]
                vectors = torch.cat([newer, GAP_TIMES * (newer - older), path[:, None].expand(-1, GROUPS, -1)], dim=2)
            pairs.append((self.temporal, vectors))
        return pairs

    def forward(self, states: Tensor) -> Tensor:
        return torch.cat([stream(vectors) for stream, vectors in self.streams(states)], dim=1)


class ConvolutionExtractor(nn.Module):
    """B1: two 1-D convolutions over three scans; B2, B3: three over one; the path (and goal) by a perceptron.

    Channels, kernels and strides are ours: the thesis names the numbers of layers.
    """

    def __init__(self, variant: str) -> None:
        super().__init__()
        self.channels = 3 if variant == "b1" else 1
        self.rays = COARSE_RANGES if variant == "b2" else SECTORS
        kernels = [(self.channels, 32, 5), (32, 32, 3)] if variant == "b1" else [(1, 32, 5), (32, 32, 3), (32, 32, 3)]
        layers: list[nn.Module] = []
        for inputs, outputs, kernel in kernels:
            layers += [nn.Conv1d(inputs, outputs, kernel, 2, kernel // 2, padding_mode="circular"), nn.ReLU()]
        reduced = self.rays
        for _ in kernels:
            reduced = (reduced + 1) // 2
        self.scans = nn.Sequential(*layers, nn.Flatten(), nn.Linear(32 * reduced, 128), nn.ReLU())
        self.rest = SIZES[VARIANTS[variant].given] - self.channels * self.rays
        self.path = perceptron(self.rest, 64, 32)
        self.size = 128 + 32

    def forward(self, states: Tensor) -> Tensor:
        scans = states[:, : self.channels * self.rays].reshape(-1, self.channels, self.rays)
        return torch.cat([self.scans(scans), self.path(states[:, -self.rest :])], dim=1)


def extractor(variant: str) -> AttentionExtractor | ConvolutionExtractor:
    """The part of a network that reads states. Raises KeyError for an unknown variant."""
    if VARIANTS[variant].given in ("points_and_groups", "points", "two_scans"):
        return AttentionExtractor(variant)
    return ConvolutionExtractor(variant)


class Actor(nn.Module):
    """(b, states) -> (b, 2) in [-1, 1]."""

    def __init__(self, variant: str) -> None:
        super().__init__()
        self.variant = variant
        self.read = extractor(variant)
        self.head = perceptron(self.read.size, 128, 64, 64, 2, last=False)
        initialise(self)

    def forward(self, states: Tensor) -> Tensor:
        return torch.tanh(self.head(self.read(states)))


TURN_GAIN = 2.5  # rad/s per rad off the wished direction
_TURNS_RAD, _ABOUT_RAD = (0.0, 0.13, -0.13, 0.3, -0.3, 0.55, -0.55, 0.9, -0.9), (1.4, -1.4, 2.1, -2.1, 3.1)
COMMANDS = np.array(
    [(turn, speed) for speed in (1.0, 0.5) for turn in _TURNS_RAD] + [(turn, 0.5) for turn in _ABOUT_RAD] + [(0, 0)]
)
"""(24, 2): directions off the robot's own, rad, and speeds, m/s; the last stands."""


def actions_of_commands(limits: Limits) -> Floats:
    """(24, 2) actions in [-1, 1] of COMMANDS."""
    turn, speed = COMMANDS.T
    v = speed * np.clip(np.cos(turn), 0.0, None) ** 2
    w = np.clip(TURN_GAIN * turn, -limits.w_max, limits.w_max)
    return scale_commands(v, w, limits)


def scale_commands(v: Doubles, w: Doubles, limits: Limits) -> Floats:
    """(..., 2) actions in [-1, 1] of speeds m/s and turns rad/s."""
    scaled: Doubles = np.stack([2 * (v - limits.v_min) / (limits.v_max - limits.v_min) - 1, w / limits.w_max], axis=-1)
    return scaled.astype(np.float32)


class Chooser(Actor):
    """What every one of COMMANDS is predicted to cost; its action is the cheapest one's. Ours, for
    imitation: two ways around somebody do not average to a way between them.

    tables: costs are predicted that many times, in different units; which: by whose it acts.
    """

    def __init__(self, variant: str, tables: int = 1, which: int = 0) -> None:
        super().__init__(variant)
        self.tables, self.which = tables, which
        self.head = perceptron(self.read.size, 128, 64, 64, tables * len(COMMANDS), last=False)
        initialise(self)
        self.register_buffer(
            "actions", torch.as_tensor(actions_of_commands(CROWD_CORRIDOR.robot.limits)), persistent=False
        )

    def costs(self, states: Tensor) -> Tensor:
        """(b, tables, 24), the dearest 1."""
        tables: Tensor = self.head(self.read(states))
        return tables.reshape(-1, self.tables, len(COMMANDS))

    def forward(self, states: Tensor) -> Tensor:
        return self.get_buffer("actions")[self.costs(states)[:, self.which].argmin(dim=1)]

    def alone(self) -> Chooser:
        """The same with nothing but the table by which it acts."""
        policy = Chooser(self.variant)
        rows = slice(self.which * len(COMMANDS), (self.which + 1) * len(COMMANDS))
        policy.load_state_dict({name: v[rows] if name in LAST_LAYER else v for name, v in self.state_dict().items()})
        return policy


class Critic(nn.Module):
    """(b, states), (b, 2) -> (b,): the action joins the features (ours: the thesis does not say where)."""

    def __init__(self, variant: str) -> None:
        super().__init__()
        self.read = extractor(variant)
        self.head = perceptron(self.read.size + 2, 128, 64, 64, 1, last=False)
        initialise(self)

    def forward(self, states: Tensor, actions: Tensor) -> Tensor:
        value: Tensor = self.head(torch.cat([self.read(states), actions], dim=1))
        return value[:, 0]


def attention_weights(actor: Actor, states: Tensor) -> dict[str, Tensor]:
    """What an attention actor looks at: `spatial` and `temporal` (b, 30) where it has that stream, each summing to 1.

    Raises ValueError for an actor without attention.
    """
    if not isinstance(actor.read, AttentionExtractor):
        raise ValueError(f"{actor.variant} has no attention; {', '.join(list(VARIANTS)[:4])} have")
    with torch.no_grad():
        return {
            "spatial" if stream is actor.read.spatial else "temporal": stream.weights(vectors)
            for stream, vectors in actor.read.streams(states)
        }


def actor_acts(actor: Actor) -> Callable[[NDArray[np.float32]], NDArray[np.float32]]:
    """The actor as a function of states (n, size) -> actions (n, 2)."""

    def act(states: NDArray[np.float32]) -> NDArray[np.float32]:
        with torch.no_grad():
            actions: NDArray[np.float32] = actor(torch.as_tensor(states)).numpy()
        return actions

    return act


def actor_to_arrays(actor: Actor) -> dict[str, NDArray[np.float32]]:
    """The actor's numbers by name, for a file without pickled objects."""
    return {name: value.detach().cpu().numpy() for name, value in actor.state_dict().items()}


def actor_from_arrays(variant: str, arrays: dict[str, NDArray[Any]]) -> Actor:
    """Read `actor_to_arrays` back: an actor, or a chooser by its outputs. Raises KeyError for an unknown variant."""
    outputs = len(arrays[LAST_LAYER[1]])
    actor = Actor(variant) if outputs == 2 else Chooser(variant)
    actor.load_state_dict({name: torch.as_tensor(np.array(value)) for name, value in arrays.items()})
    return actor
