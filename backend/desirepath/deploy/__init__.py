"""A policy on a robot: from a scan, odometry, a goal and people to a command, as in every engine.

NumPy and the standard library of Python 3.10 to 3.13 only (onnxruntime where a policy of others needs it), and nothing
of the house outside itself: an exported bundle takes these files along.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from desirepath.deploy.controller import Controller
    from desirepath.deploy.inputs import Command, Odometry, Person, Scan

__all__ = ["Command", "Controller", "Odometry", "Person", "Scan"]


def __getattr__(name: str) -> Any:
    """What a stack of one's own needs, when it is asked for: engines read other files here."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{'controller' if name == 'Controller' else 'inputs'}"), name)
