"""The sketches of all policies that come with the product: one small file beside them."""

from __future__ import annotations

import json
from dataclasses import asdict

from desirepath.explain.sketches import SHIPPED, draw_sketch
from desirepath.learning.policies.policy import read_policy
from desirepath.learning.shipped_files import load_card, resolve, shipped_names
from desirepath.learning.shipping.storing import Request
from desirepath.store.shipped_policies import REGISTERED


def ship_sketches(request: Request) -> None:
    """Draw them anew; a line for each, by the sha256 of its file."""
    names = [name for name in shipped_names() if load_card(name).kind in REGISTERED]
    lines = []
    for number, name in enumerate(names, start=1):
        drawn = draw_sketch(read_policy(resolve(name).read_bytes()).driving())
        lines.append(f'"{load_card(name).sha256}":{json.dumps(asdict(drawn), separators=(",", ":"))}')
        request.on_progress(number / len(names), {})
    (request.folder / SHIPPED.name).write_text("{" + ",\n".join(lines) + "}\n", encoding="utf-8")
