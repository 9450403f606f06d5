"""Ways to use earlier people's answers, side by side: `python -m desirepath_experiments.benchmarks.people_before OUT`.

Today's prior (a hierarchy of normal distributions), a low-rank reward basis with simplex weights (LoRe), a variational
one (VPL), clusters (a mixture of prototypes), nobody before. Everybody is simulated; same people, same pairs. A settled
question's script; its result stays."""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.special import expit, logsumexp

from desirepath.learning.people.asked_pairs import asked_pairs
from desirepath.learning.people.card import member
from desirepath.learning.people.families.base import FamilyMember
from desirepath.learning.people.families.mixture import mix_members
from desirepath.learning.policies.shipped import load_step_basis
from desirepath.learning.preferences.advantage_process import AdvantageProcess
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.population_prior import (
    AS_SPREAD,
    LIKE_EVERYBODY,
    TYPICAL_STRENGTH,
    EarlierPerson,
    _directions,
    _weights,
    columns_of,
    prior_of_earlier,
)
from desirepath.learning.rewards.step_weights import step_differences

SETUP = "study_room"
AFTER, BEFORE = (0, 3, 5, 8, 15), (10, 30, 100)
NEW, ANSWERED = 10, 15
POPULATIONS = {
    "common:deep_network": "common:deep_network",
    "common:context": "common:context",
    "shifted": "common:context",  # those before; who is new is of common:deep_network
    "tastes:deep_network": "tastes:deep_network",
}
CONFIG = FreeConfig()
SHARE = CONFIG.before * (1 - CONFIG.nine)
torch.set_num_threads(1)


def person(population: str, number: int, seed: int) -> FamilyMember:
    """common: half what all of their population want; tastes: half what one of three groups wants."""
    kind, _, family = population.partition(":")
    own = member(f"{family}:{number + 1000 * seed}", SETUP)
    if kind == "family":
        return own
    group = 9000 + 10 * seed + (number % 3 if kind == "tastes" else 0)
    return mix_members(SETUP, (member(f"{family}:{group}", SETUP), 0.5), (own, 0.5))


# Each way: (seen (n, D), signs) of everybody before -> component(seen of answers, signs, seen of test, sharper) ->
# [(log share, log evidence, predicted)]


def gaussian(mean: np.ndarray, factor: np.ndarray, share: float = 1.0) -> Any:
    def component(seen: np.ndarray, signs: np.ndarray, test: np.ndarray, sharper: float) -> list[Any]:
        found = []
        for strength, probable in zip(CONFIG.strengths, CONFIG.prior, strict=True):
            process = AdvantageProcess.after(strength, (seen @ mean, seen @ factor), signs)
            predicted = process.predict((test @ mean, test @ factor), sharper)
            found.append((math.log(share * probable), process.log_evidence, predicted))
        return found

    return component


def hierarchy(seen: list[np.ndarray], signs: list[np.ndarray]) -> Any:
    return gaussian(*fit_hierarchy(seen, signs))


def fit_hierarchy(seen: list[np.ndarray], signs: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Today's, over any columns that are about standard normal: mean and factor."""
    rank = seen[0].shape[1]
    mean, spread = np.zeros(rank), np.eye(rank)
    for _ in range(3):
        root = np.linalg.cholesky(spread)
        of = [_weights(rows, one, mean, root) for rows, one in zip(seen, signs, strict=True)]
        means = np.stack([weights for weights, _ in of])
        mean = means.sum(0) / (len(seen) + LIKE_EVERYBODY)
        apart = means - mean
        total = AS_SPREAD * np.eye(rank) + apart.T @ apart + np.sum([unsure for _, unsure in of], axis=0)
        spread = total / (AS_SPREAD + len(seen))
    return mean, np.linalg.cholesky(spread)


def clusters(seen: list[np.ndarray], signs: list[np.ndarray], count: int, seed: int) -> Any:
    """A mixture of prototypes: expectation and maximisation; one spread within them."""
    rank, n = seen[0].shape[1], len(seen)
    random = np.random.default_rng([seed, 7, count])
    first = np.stack([_weights(r, s, np.zeros(rank), np.eye(rank))[0] for r, s in zip(seen, signs, strict=True)])
    centres = first[random.choice(n, count, replace=False)]
    for _ in range(20):
        near = np.square(first[:, None] - centres).sum(2).argmin(1)
        centres = np.stack([first[near == k].mean(0) if (near == k).any() else centres[k] for k in range(count)])
    belongs = np.eye(count)[near]
    means, spread = np.zeros((count, rank)), np.eye(rank)
    for turn in range(5):
        root = np.linalg.cholesky(spread)
        of = [[_weights(r, s, m, root) for m in means] for r, s in zip(seen, signs, strict=True)]
        if turn:
            evidence = np.array(
                [
                    [AdvantageProcess.after(TYPICAL_STRENGTH, (r @ m, r @ root), s).log_evidence for m in means]
                    for r, s in zip(seen, signs, strict=True)
                ]
            ) + np.log(shares)
            belongs = np.exp(evidence - logsumexp(evidence, axis=1, keepdims=True))
        weights = np.array([[w for w, _ in row] for row in of])  # (n, count, rank)
        means = np.einsum("nk,nkr->kr", belongs, weights) / (belongs.sum(0) + LIKE_EVERYBODY)[:, None]
        apart = weights - means
        total = AS_SPREAD * np.eye(rank) + np.einsum("nk,nkr,nks->rs", belongs, apart, apart)
        total += sum(belongs[i, k] * of[i][k][1] for i in range(n) for k in range(count))
        spread = total / (AS_SPREAD + n)
        shares = (belongs.sum(0) + 1) / (n + count)
    root = np.linalg.cholesky(spread)
    each = [gaussian(m, root, share) for m, share in zip(means, shares, strict=True)]
    return lambda *given: [row for one in each for row in one(*given)]


def by_samples(weights: np.ndarray) -> Any:
    """Weights (samples, D) that somebody may have, all as probable before any answer."""

    def component(seen: np.ndarray, signs: np.ndarray, test: np.ndarray, sharper: float) -> list[Any]:
        logs = -np.logaddexp(0, -(weights @ seen.T) * signs).sum(1) if len(signs) else np.zeros(len(weights))
        evidence = float(logsumexp(logs) - math.log(len(logs)))
        masses = np.exp(logs - logsumexp(logs))
        return [(0.0, evidence, masses @ expit(weights @ test.T))]

    return component


def lore(seen: list[np.ndarray], signs: list[np.ndarray], rank: int, seed: int) -> Any:
    """R = a V with everybody's a in the simplex; a new one's a by what it makes of their answers, of 4,000 drawn."""
    torch.manual_seed(seed)
    x = torch.tensor(np.concatenate([r * s[:, None] for r, s in zip(seen, signs, strict=True)]), dtype=torch.float32)
    who = torch.tensor(np.repeat(np.arange(len(seen)), [len(s) for s in signs]))
    basis = (torch.randn(rank, x.shape[1]) * 2).requires_grad_()
    logits = (torch.randn(len(seen), rank) * 0.1).requires_grad_()
    optimiser = torch.optim.Adam([basis, logits], lr=0.1)
    for _ in range(500):
        optimiser.zero_grad()
        weights = torch.softmax(logits, 1) @ basis
        loss = torch.nn.functional.softplus(-(x * weights[who]).sum(1)).sum()
        loss = loss + basis.square().sum() / (2 * TYPICAL_STRENGTH) + logits.square().sum() / 8
        loss.backward()
        optimiser.step()
    drawn = np.random.default_rng([seed, 9]).normal(0, 2, (4_000, rank))
    simplex = np.exp(drawn - logsumexp(drawn, axis=1, keepdims=True))
    return by_samples(simplex @ basis.detach().numpy().astype(np.float64))


class Variational(torch.nn.Module):
    """Encoder of a set of answers, mean and spread of z; decoder from z to weights."""

    def __init__(self, columns: int, latent: int = 8, hidden: int = 64) -> None:
        super().__init__()
        self.one = torch.nn.Sequential(
            torch.nn.Linear(columns, hidden), torch.nn.ReLU(), torch.nn.Linear(hidden, hidden), torch.nn.ReLU()
        )
        self.all = torch.nn.Sequential(
            torch.nn.Linear(hidden + 1, hidden), torch.nn.ReLU(), torch.nn.Linear(hidden, 2 * latent)
        )
        self.decoder = torch.nn.Sequential(
            torch.nn.Linear(latent, hidden), torch.nn.ReLU(), torch.nn.Linear(hidden, columns)
        )
        self.latent = latent

    def encode(self, answers: torch.Tensor, mask: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        count = mask.sum(1, keepdim=True)
        pooled = (self.one(answers) * mask[..., None]).sum(1) / count.clamp(min=1)
        both = self.all(torch.cat([pooled, count / ANSWERED], 1))
        return both[:, : self.latent], both[:, self.latent :].clamp(-6, 3)


def vpl(seen: list[np.ndarray], signs: list[np.ndarray], seed: int) -> Any:
    """The evidence lower bound, given some of somebody's answers, of all of them."""
    torch.manual_seed(seed)
    x = torch.tensor(np.stack([r * s[:, None] for r, s in zip(seen, signs, strict=True)]), dtype=torch.float32)
    model = Variational(x.shape[2])
    optimiser = torch.optim.Adam(model.parameters(), lr=2e-3, weight_decay=1e-4)
    for _ in range(1_200):
        rows = torch.randint(len(x), (min(len(x), 32),))
        of = x[rows]
        sizes = torch.randint(0, ANSWERED + 1, (len(of), 1))
        mask = (torch.rand(len(of), ANSWERED).argsort(1) < sizes).float()
        mean, log_spread = model.encode(of, mask)
        z = mean + log_spread.exp() * torch.randn_like(mean)
        margin = (of * model.decoder(z)[:, None]).sum(2)
        apart = 0.5 * (mean.square() + (2 * log_spread).exp() - 1 - 2 * log_spread).sum(1)
        loss = (torch.nn.functional.softplus(-margin).sum(1) + apart).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    with torch.no_grad():
        drawn = model.decoder(torch.randn(4_000, model.latent)).numpy().astype(np.float64)
    by_prior = by_samples(drawn)
    def component(seen: np.ndarray, signs: np.ndarray, test: np.ndarray, sharper: float) -> list[Any]:
        answers = torch.zeros(1, ANSWERED, test.shape[1])
        mask = torch.zeros(1, ANSWERED)
        answers[0, : len(signs)] = torch.tensor(seen * signs[:, None], dtype=torch.float32)
        mask[0, : len(signs)] = 1
        with torch.no_grad():
            mean, log_spread = model.encode(answers, mask)
            weights = model.decoder(mean + log_spread.exp() * torch.randn(500, model.latent)).numpy()
        predicted = expit(weights.astype(np.float64) @ test.T).mean(0)
        return [(0.0, by_prior(seen, signs, test, sharper)[0][1], predicted)]

    return component


class Room:
    def __init__(self, seed: int) -> None:
        self.seed, self.pairs = seed, asked_pairs(SETUP, seed, asked=400, test=300)
        basis = load_step_basis(SETUP)
        steps = step_differences(basis, self.pairs.trajectories)
        directions = _directions(SETUP, self.pairs.differences)
        in_directions = columns_of(self.pairs.differences) @ directions
        self.seen = np.concatenate([in_directions, steps], 1) / math.sqrt(2)
        self.truly: dict[tuple[str, int], np.ndarray] = {}
        self.free: dict[tuple[str, int, int], Any] = {}

    def better(self, population: str, number: int) -> np.ndarray:
        if (population, number) not in self.truly:
            who = person(population, number, self.seed)
            self.truly[population, number] = self.pairs.better(who.scores(self.pairs.in_turn)) > 0
        return self.truly[population, number]

    def answered(self, number: int) -> np.ndarray:
        return np.random.default_rng([self.seed, 81, number]).choice(self.pairs.asked, ANSWERED, replace=False)

    def without(self, population: str, number: int, after: int) -> Any:
        """The posterior without anybody before, after so many answers."""
        key = (population, number, after)
        if key not in self.free:
            truly, asked = self.better(population, number), self.answered(number)
            for n in range(ANSWERED + 1):
                believed = (
                    FreePosterior.prior(SETUP)
                    if not n
                    else believed.updated(self.pairs.differences[[asked[n - 1]]], bool(truly[asked[n - 1]]))
                )
                if n in AFTER:
                    self.free[population, number, n] = believed
        return self.free[key]


def earlier_ways(room: Room, population: str, count: int) -> tuple[Any, dict[str, Any]]:
    people = [(room.better(population, 100 + k), room.answered(100 + k)) for k in range(count)]
    earlier = [EarlierPerson(room.pairs.differences[asked], truly[asked]) for truly, asked in people]
    seen = [room.seen[asked] for _, asked in people]
    signs = [np.where(truly[asked], 1.0, -1.0) for truly, asked in people]
    seed = room.seed
    return prior_of_earlier(SETUP, earlier), {
        "hierarchy": hierarchy(seen, signs),
        "clusters_3": clusters(seen, signs, 3, seed),
        **{f"lore_{k}": lore(seen, signs, k, seed) for k in (6, 12)},
        "vpl": vpl(seen, signs, seed),
    }


def mixed(logs: list[float], predicted: list[np.ndarray]) -> np.ndarray:
    masses = np.exp(np.array(logs) - logsumexp(logs))
    return masses @ np.stack(predicted)


def measure(room: Room, before: Any, ways: dict[str, Any], new: str, number: int) -> dict[str, dict[str, float]]:
    """Accuracy on the test pairs by way ("+": within the mixture that studies use), after each number of answers."""
    truly, asked, test = room.better(new, number), room.answered(number), room.pairs.test
    differences, signs = room.pairs.differences[test], np.where(truly[asked], 1.0, -1.0)
    found: dict[str, dict[str, float]] = {}

    def note(name: str, after: int, predicted: np.ndarray) -> None:
        ties = np.abs(predicted - 0.5) < 1e-9
        right = np.where(ties, 0.5, (predicted > 0.5) == truly[test])
        found.setdefault(name, {})[str(after)] = float(right.mean())
        loss = -np.log(np.clip(np.where(truly[test], predicted, 1 - predicted), 1e-4, 1)).mean()
        found.setdefault(f"{name} loss", {})[str(after)] = float(loss)

    for after in AFTER:
        free = room.without(new, number, after)
        note("nobody", after, free.predict(differences))
        if before is None:
            continue
        note("today", after, replace(free, before=before).predict(differences))
        sharper = free._sharper
        nine = [math.log(CONFIG.nine) + free.nine_log_evidence]
        others = [way.process.log_evidence + way.prior + math.log((1 - CONFIG.before)) for way in free._ways]
        known = [free._few.predict(differences.seen)]
        known += [way.process.predict(seen, sharper) for way, seen in free._of(differences)]
        rows = asked[:after]
        heavy = replace(free, before=before, config=replace(CONFIG, nine=0.05, families=0.57, before=0.9 / 0.95))
        note("today++", after, heavy.predict(differences))
        for name, way in ways.items():
            parts = way(room.seen[rows], signs[:after], room.seen[test], sharper)
            alone = [share + evidence for share, evidence, _ in parts]
            predicted = [p for _, _, p in parts]
            note(name, after, mixed(alone, predicted))
            within = [log + math.log(SHARE) for log in alone]
            note(f"{name}+", after, mixed([*nine, *others, *within], [*known, *predicted]))
            less = [log + math.log(0.1 / (1 - SHARE)) for log in (*nine, *others)]
            most = [log + math.log(0.9) for log in alone]
            note(f"{name}++", after, mixed([*less, *most], [*known, *predicted]))
    return found


def main(out: Path, seeds: list[int]) -> None:
    rows: list[dict[str, Any]] = json.loads(out.read_text()) if out.exists() else []
    done = {(row["population"], row["before"], row["seed"]) for row in rows}
    for seed in seeds:
        room = Room(seed)
        for name, population in POPULATIONS.items():
            new = "common:deep_network" if name == "shifted" else population
            for count in BEFORE:
                if (name, count, seed) in done:
                    continue
                began = time.time()
                before, ways = earlier_ways(room, population, count)
                made = time.time() - began
                for number in range(NEW):
                    measured = measure(room, before, ways, new, number)
                    rows.append({"population": name, "before": count, "seed": seed, "person": number, **measured})
                out.write_text(json.dumps(rows))
                mine = [r for r in rows if (r["population"], r["before"], r["seed"]) == (name, count, seed)]
                print(seed, name, count, round(made), round(time.time() - began), flush=True)
                for way in mine[0]:
                    if isinstance(mine[0][way], dict) and not way.endswith("loss"):
                        print("   ", f"{way:14s}", [round(float(np.mean([r[way][str(a)] for r in mine])), 3) for a in AFTER], flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), [int(seed) for seed in sys.argv[2:]])
