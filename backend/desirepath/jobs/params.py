"""What parameters of jobs are made of: their base class, defaults with their source, what several kinds share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticUndefined

from desirepath.grammar.parts import OneOf
from desirepath.learning.rewards.kinds import FITTINGS
from desirepath.simulation.setups import own_setups, setups_with, trainable_setups

SetupName = Annotated[str, OneOf(lambda: setups_with("conditioned"))]
TrainedSetup = Annotated[str, OneOf(trainable_setups)]
OwnSetup = Annotated[str, OneOf(own_setups)]
# backend/desirepath/learning/scene_sets.py: a set has so many scenes, and a purpose more sets than anybody will count
MOST_SCENES = 10_000
LARGEST_SEED = 9_999
MOST_NAMED = 10_000  # characters of a list of snapshots


class Params(BaseModel):
    """Base of all parameters: nothing unknown, nothing changed later."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def asked(self) -> dict[str, Any]:
        """What differs from the defaults, JSON-ready: enough to ask for the same again."""
        return self.model_dump(mode="json", exclude_defaults=True)


def from_source(source: str, default: Any = PydanticUndefined, *, advanced: bool = False, **limits: Any) -> Any:
    """A parameter with its default's source; `advanced` ones are folded away on the form."""
    return Field(default, json_schema_extra={"source": source, "advanced": advanced}, **limits)


def artefact(kind: str, default: Any = PydanticUndefined) -> Any:
    """A parameter that names an artefact: its id, or the name of a shipped one such as `study_room/base`. kind: several
    with `|` between them."""
    return Field(default, min_length=1, json_schema_extra={"source": "yours", "artefact": kind})


if TYPE_CHECKING:
    ModelName = str
else:
    ModelName = FITTINGS.literal
