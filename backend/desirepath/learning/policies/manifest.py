"""What a policy of a setup is given and what it gives, as a manifest says it to other people's programs, and whether
somebody's manifest says the same. Nothing is converted: a robot or lidar that differs is named and refused."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

from desirepath.learning.errors import LearningError
from desirepath.simulation.setups import CONTROL_DT_S, SETUPS, Setup, SetupError, get_setup

MANIFEST_BYTES = 256 * 1024
MOST_SAID = 6  # differences in one message
FURTHER = (
    *("setup", "network", "value_functions", "recovery", "slowing", "policy_sha256"),
    *("robot", "goal_radius_m", "conditioning"),
)
"""Fields of a manifest that are the policy's, not its setup's."""


def setup_manifest(setup: Setup) -> dict[str, Any]:
    """Inputs in order with units and scale, the lidar, outputs with scaling, the rate."""
    limits, lidar = setup.robot.limits, setup.robot.lidar
    return {
        "observation": {
            "dtype": "float32",
            "shape": [setup.observation_size],
            "layout": setup.observation_layout(),
        },
        "lidar": None  # walls and obstacles are known, see the layout
        if setup.solids
        else {
            "beams": lidar.beams,
            "sectors": lidar.sectors,
            "range_m": lidar.range_m,
            "height_m": lidar.height_m,
            "pooling": "minimum per sector",
            "field_of_view_rad": lidar.field_of_view_rad,
            "mounted_at": [lidar.x_m, lidar.y_m, lidar.yaw_rad],
            "order": "from straight ahead, counter-clockwise",
        },
        "action": {
            "dtype": "float32",
            "range": [-1.0, 1.0],
            "layout": [
                {"name": "linear_velocity", "unit": "m/s", "range": [limits.v_min, limits.v_max]},
                {"name": "angular_velocity", "unit": "rad/s", "range": [-limits.w_max, limits.w_max]},
            ],
            "scaling": "linear: -1 is the lower end of the range in units, +1 the upper",
        },
        "angles": "counter-clockwise positive, wrapped to (-pi, pi]",
        "control_rate_hz": round(1 / CONTROL_DT_S),
        "bearing_range_rad": [-math.pi, math.pi],
    }


def robot_manifest(setup: Setup) -> dict[str, Any]:
    """What driving such a robot needs beside it: its body, how quickly its speeds may change, where it has arrived."""
    robot = setup.robot
    return {
        "robot": {
            "name": robot.name,
            "radius_m": robot.radius_m,
            "footprint": None if robot.footprint is None else [list(corner) for corner in robot.footprint],
            "height_m": robot.height_m,
            "v_change": robot.limits.v_change,
            "w_change": robot.limits.w_change,
        },
        "goal_radius_m": setup.goal_radius_m,
    }


def read_manifest(content: bytes, named: str) -> dict[str, Any]:
    """A manifest's JSON. Raises LearningError."""
    if len(content) > MANIFEST_BYTES:
        raise LearningError(f"{named}: a manifest of {len(content):,} bytes; at most {MANIFEST_BYTES:,} are read")
    return json_object(content, f"{named}: its manifest is")


def json_object(content: bytes, what: str) -> dict[str, Any]:
    """What JSON of others says. what: `FILE: its manifest is`, for errors. Raises LearningError for anything else."""
    try:
        value = json.loads(content)
    except (ValueError, RecursionError) as problem:
        raise LearningError(f"{what} no JSON: {str(problem)[:200]}") from None
    if not isinstance(value, dict):
        raise LearningError(f"{what} {type(value).__name__}, must be an object")
    return value


def agreed_setup(manifest: dict[str, Any], wanted: str, named: str) -> Setup:
    """The setup that somebody's manifest is for: `wanted`, or the one that it names. Raises LearningError that names
    every field which is missing or says otherwise, and which setups would do."""
    name = wanted or manifest.get("setup")
    try:
        setup = get_setup(str(name))
    except SetupError as problem:
        raise LearningError(
            f"{named}: manifest field 'setup' = {name!r}: {problem}; or name one with --setup"
        ) from None
    differing = list(_differences(manifest, setup_manifest(setup)))
    if not differing:
        return setup
    others = [
        other.name
        for other in SETUPS.values()
        if other.name != setup.name and next(_differences(manifest, setup_manifest(other)), None) is None
    ]
    would_do = (
        f"; it fits {', '.join(others)}: name it with --setup"
        if others
        else f"; needed is a policy for this robot and lidar (`desirepath setups show {setup.name}` says it all)"
    )
    more = f"; and {len(differing) - MOST_SAID} more" if len(differing) > MOST_SAID else ""
    told = "; ".join(differing[:MOST_SAID])
    raise LearningError(f"{named}: the manifest does not fit setup {setup.name}: {told}{more}{would_do}")


def _differences(found: dict[str, Any], expected: dict[str, Any]) -> Iterator[str]:
    """In words; none where both say the same."""
    known = {*expected, *FURTHER}
    if unknown := sorted(set(found) - known):
        yield f"field {unknown[0][:60]!r} is unknown here; known are {', '.join((*expected, *FURTHER))}"
    yield from _differing("", {name: value for name, value in found.items() if name in expected}, expected)


def _differing(path: str, found: Any, expected: Any) -> Iterator[str]:
    if isinstance(expected, dict) and isinstance(found, dict):
        at = f"{path}." if path else ""
        for unknown in sorted(set(found) - set(expected)):
            yield f"field '{at}{unknown[:60]}' is unknown here; known are {', '.join(expected)}"
        for name, value in expected.items():
            if name in found:
                yield from _differing(f"{at}{name}", found[name], value)
            else:
                yield f"field '{at}{name}' is missing; the setup's is {_short(value)}"
    elif isinstance(expected, list) and isinstance(found, list) and len(found) == len(expected):
        for number, (one, value) in enumerate(zip(found, expected, strict=True)):
            yield from _differing(f"{path}[{number}]", one, value)
    elif isinstance(expected, list) and isinstance(found, list):
        yield f"field {path!r} has {len(found)} entries; the setup's has {len(expected)}"
    elif not _same(found, expected):
        yield f"field {path!r} = {_short(found)}; the setup's is {_short(expected)}"


def _same(found: Any, expected: Any) -> bool:
    if isinstance(expected, int | float) and isinstance(found, int | float) and not isinstance(found, bool):
        return math.isclose(found, expected, rel_tol=1e-5, abs_tol=1e-6)
    return bool(found == expected)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:79]}…"
