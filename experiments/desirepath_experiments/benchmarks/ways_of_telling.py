"""`desirepath benchmark telling`: four ways to say what one prefers, by the same simulated people: 15 choices, four
drawn paths, sliders, a sentence. How far the weights that come out are from those that these people have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.estimates import mean_estimate, wilson
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.shipped import load_conditioned, load_queries
from desirepath.learning.preferences.from_paths import NOISE_OF_INTERVALS, WeightsOfPaths, credible
from desirepath.learning.preferences.measures import measures, typical_differences
from desirepath.learning.preferences.objectives import NAMES, OPPOSITES, gains, preference_weights
from desirepath.learning.preferences.oracles import HELD_OUT, TUNING, ResponseModel, make_oracle
from desirepath.learning.preferences.posterior import Posterior, weights_of_shares
from desirepath.learning.preferences.spans import seen_in
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import OnProgress, no_progress
from desirepath.learning.words.lexicon import Language
from desirepath.learning.words.understanding import words_reader
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory
from desirepath_experiments.benchmarks.word_judging import labelled_sentences

Doubles = NDArray[np.float64]
PEOPLE = tuple(name for name, one in {**TUNING, **HELD_OUT}.items() if one.weights is not None)
WAYS = ("choices", "paths", "sliders", "words", "nothing")
LEVEL = 0.9


@dataclass(frozen=True)
class TellingConfig:
    """candidates: weights that paths are compared with; imagined: rollouts of other weights that a drawing person has
    in mind; wobble_m: of the drawing hand; looks: how often a tuner tries a slider; blur: a tuner's error in what a
    rollout is worth, in typical differences.
    """

    setup: str = "study_room"
    answers: int = 15
    paths: int = 4
    scenes: int = 12
    candidates: int = 600
    imagined: int = 40
    wobble_m: float = 0.08
    looks: int = 24
    slider_scenes: int = 3
    blur: float = 0.2
    lapse_rate: float = 0.1


def benchmark_telling(
    seeds: Sequence[int] = (0, 1, 2), config: TellingConfig | None = None, on_progress: OnProgress = no_progress
) -> dict[str, Any]:
    """Every person by every way under every seed. error: Euclidean distance of the weights, largest 1, from the true
    ones; covered: shares inside their interval of 90 %. Intervals: bootstrap of 95 % over people, each their mean over
    seeds.
    """
    config = config or TellingConfig()
    rows: list[dict[str, Any]] = []
    for number, seed in enumerate(seeds):
        rows += _Seed(config, seed).rows()
        on_progress((number + 1) / len(seeds), {"rows": len(rows)})
    return {
        "setup": config.setup,
        "people": list(PEOPLE),
        "seeds": list(seeds),
        "ways": {way: _summary([row for row in rows if row["way"] == way]) for way in WAYS},
        "rows": rows,
    }


class _Seed:
    """What one seed draws: scenes, candidates, and what the conditioned policy does there."""

    def __init__(self, config: TellingConfig, seed: int) -> None:
        self.config, self.seed = config, seed
        self.random = np.random.default_rng([seed, 161])
        self.conditioned: ConditionedPolicy = load_conditioned(f"{config.setup}/conditioned")
        self.queries = load_queries(f"{config.setup}/queries_varied_200").queries
        self.scenes = list(scene_set(config.setup, config.scenes, purpose=Purpose.FIGURE, seed=seed + 1))
        self.prior = Posterior.prior(config.setup)
        drawn = self.prior.sample(config.candidates + config.imagined).weights.astype(np.float64)
        self.random.shuffle(drawn)
        imagined, candidates = drawn[: config.imagined], drawn[config.imagined :]
        self.imagined = [self.rolled_out(weights_of_shares(shares)) for shares in imagined]
        measured = np.array([measures(self.rolled_out(weights_of_shares(shares))) for shares in candidates])
        even = np.full(len(candidates), 1 / len(candidates))
        self.candidates = WeightsOfPaths(config.setup, candidates, measured, even)

    def rolled_out(self, weights: NDArray[np.float32], scenes: Sequence[Scene] | None = None) -> list[Trajectory]:
        policy = self.conditioned.at(np.asarray(weights, np.float32))
        return list(rollout(get_setup(self.config.setup), policy.rollout_policy, scenes or self.scenes))

    def rows(self) -> list[dict[str, Any]]:
        found = []
        for name in PEOPLE:
            shares = _shares(np.asarray({**TUNING, **HELD_OUT}[name].weights, np.float64))
            for way, (given, interval) in {
                "choices": self.by_choices(name),
                "paths": self.by_paths(shares),
                "sliders": (self.by_sliders(shares), None),
                "words": (self.by_words(shares), None),
                "nothing": (np.zeros(len(NAMES)), None),
            }.items():
                found.append({"person": name, "seed": self.seed, "way": way} | _judged(shares, given, interval))
        return found

    def by_choices(self, name: str) -> tuple[Doubles, tuple[Doubles, Doubles]]:
        """The posterior after random pairs, as `benchmark asking` asks them."""
        oracle = make_oracle(name, **vars(ResponseModel(self.config.lapse_rate)), seed=self.seed)
        asked = [self.queries[k] for k in self.random.choice(len(self.queries), self.config.answers, replace=False)]
        chosen = [choice == 0 for choice in oracle.choices(asked)]
        posterior = Posterior.from_answers(self.config.setup, seen_in(asked), chosen)
        ends = credible(posterior.weights.astype(np.float64), posterior.masses(), LEVEL)
        return posterior.mean_weights().astype(np.float64), ends

    def by_paths(self, shares: Doubles) -> tuple[Doubles, tuple[Doubles, Doubles]]:
        """Drawn: of what the person can imagine, the rollout worth most to them, with a hand's wobble."""
        scenes = self.random.choice(len(self.scenes), self.config.paths, replace=False)
        drawn = []
        for scene in scenes:
            imagined = [one[scene] for one in self.imagined]
            best = imagined[int(np.argmax(self.worth(shares, imagined)))]
            drawn.append(self.wobbled(best))
        measured, chosen = measures(drawn), scenes.astype(np.int64)
        mass = self.candidates.given(chosen, measured)
        wide = self.candidates.given(chosen, measured, NOISE_OF_INTERVALS)
        given = weights_of_shares(mass @ self.candidates.shares).astype(np.float64)
        return given, credible(self.candidates.shares, wide, LEVEL)

    def by_sliders(self, shares: Doubles) -> Doubles:
        """A slider at a time is put elsewhere and stays there if the rollouts look better to them."""
        some = self.random.choice(len(self.scenes), self.config.slider_scenes, replace=False)
        scenes = [self.scenes[k] for k in some]
        now = np.zeros(len(NAMES), np.float32)
        for _ in range(self.config.looks):
            k = int(self.random.integers(len(NAMES)))
            tried = now.copy()
            tried[k] = float(self.random.choice([0.0, 0.25, 0.5, 0.75, 1.0]))
            for a, b in OPPOSITES:
                if k in (a, b) and tried[k] > 0:
                    tried[a + b - k] = 0.0
            if self.seen(shares, tried, scenes) > self.seen(shares, now, scenes):  # both looked at anew
                now = tried
        return now.astype(np.float64)

    def by_words(self, shares: Doubles) -> Doubles:
        """A plain test sentence for every objective that they prefer, English and German by turns."""
        language: Language = "en" if self.seed % 2 == 0 else "de"
        known = labelled_sentences("test", language)
        said = []
        for k in np.argsort(-shares):
            plain = [one.sentence for one in known if one.said == (NAMES[k],) and one.case == "plain"]
            if shares[k] > 0:
                said.append(str(self.random.choice(plain)).rstrip("!."))
        got = words_reader(language).understand(". ".join(said)[:300])
        return preference_weights(got.weights).astype(np.float64)

    def seen(self, shares: Doubles, weights: NDArray[np.float32], scenes: Sequence[Scene]) -> float:
        worth = float(np.mean(self.worth(shares, self.rolled_out(weights, scenes))))
        return worth + float(self.random.normal(0, self.config.blur))

    def worth(self, shares: Doubles, trajectories: Sequence[Trajectory]) -> Doubles:
        """What trajectories are worth to the person, in typical differences."""
        scaled: Doubles = gains(measures(trajectories) / typical_differences(self.config.setup)) @ shares
        return scaled

    def wobbled(self, trajectory: Trajectory) -> Trajectory:
        """The path as a hand draws it: off by smooth noise, its ends where they were."""
        n = len(trajectory.poses)
        knots = self.random.normal(0, self.config.wobble_m, (6, 2))
        knots[[0, -1]] = 0
        at = np.linspace(0, 5, n)
        off = np.column_stack([np.interp(at, np.arange(6), knots[:, k]) for k in range(2)])
        poses = trajectory.poses.copy()
        poses[:, :2] += off.astype(poses.dtype)
        return replace(trajectory, poses=poses)


def _shares(weights: Doubles) -> Doubles:
    shares: Doubles = weights / weights.sum()
    return shares


def _judged(shares: Doubles, given: Doubles, interval: tuple[Doubles, Doubles] | None) -> dict[str, Any]:
    true = shares / shares.max()
    given = given / given.max() if given.max() > 0 else given
    inside = None if interval is None else (interval[0] <= shares + 1e-6) & (shares <= interval[1] + 1e-6)
    covered = None if inside is None else float(np.mean(inside))
    wanted = None if inside is None else float(np.mean(inside[shares > 0]))
    return {
        "error": float(np.linalg.norm(true - given)),
        "foremost": bool(given.max() > 0 and given.argmax() == true.argmax()),
        "covered": covered,
        "covered_of_preferred": wanted,
    }


def _summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    people = sorted({row["person"] for row in rows})

    def mean(name: str) -> dict[str, float] | None:
        if rows[0][name] is None:
            return None
        own = np.array([np.mean([row[name] for row in rows if row["person"] == one]) for one in people])
        return mean_estimate(own).as_dict()

    hits = sum(row["foremost"] for row in rows)
    return {
        "n": len(rows),
        "error": mean("error"),
        "foremost": mean("foremost"),
        "foremost_wilson": wilson(hits, len(rows)).as_dict(),
        "covered": mean("covered"),
        "covered_of_preferred": mean("covered_of_preferred"),
    }
