"""What can be explained and how, without torch: pages and commands name it, `attribution.py` does it."""

from __future__ import annotations

from typing import Literal, cast, get_args

Method = Literal["integrated_gradients", "saliency", "smooth_grad"]
Command = Literal["speed", "turning"]
METHODS: tuple[Method, ...] = get_args(Method)
COMMANDS: tuple[Command, ...] = get_args(Command)
"""In the order of the actions."""


class AttributionError(ValueError):
    """An explanation that cannot be made; names the field, the value and what would work."""


def check_method(method: str, command: str) -> tuple[Method, Command]:
    """The same, if they are known. Raises AttributionError that names those that are."""
    for field, value, known in (("method", method, METHODS), ("command", command, COMMANDS)):
        if value not in known:
            raise AttributionError(f"{field} = {value!r}: must be one of {', '.join(known)}")
    return cast("Method", method), cast("Command", command)
