"""The sketches of all policies that come with the product, the example study's among them: one small file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict

from desirepath.explain.sketches import SHIPPED, draw_sketch
from desirepath.learning.policies.policy import read_policy
from desirepath.learning.shipped_files import load_card, resolve, shipped_names
from desirepath.learning.shipping.storing import Request
from desirepath.store.example_study import packed_policies
from desirepath.store.shipped_policies import REGISTERED
from desirepath.study.personalising.live_rollouts import scenes_of


def ship_sketches(request: Request) -> None:
    """Draw them anew; a line for each, by the sha256 of its file."""
    lines = []
    for sha, content in _policies():
        policy = read_policy(content).driving()
        drawn = draw_sketch(policy.rollout_policy, scenes_of(policy.setup)[0])
        lines.append(f'"{sha}":{json.dumps(asdict(drawn), separators=(",", ":"))}')
    (request.folder / SHIPPED.name).write_text("{" + ",\n".join(lines) + "}\n", encoding="utf-8")


def _policies() -> Iterator[tuple[str, bytes]]:
    for name in shipped_names():
        if load_card(name).kind in REGISTERED:
            yield load_card(name).sha256, resolve(name).read_bytes()
    yield from packed_policies().items()
