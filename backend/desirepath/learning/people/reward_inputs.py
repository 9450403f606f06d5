"""What a reward network of others is given: which of our numbers, in which unit, scale and order. Conversions only; the
rest of a manifest is `reward_manifest.py`'s."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from desirepath.simulation.setups import Setup

Of = Literal["observation", "action", "next_observation"]
MOST_COLUMNS = 512
LIDAR = "lidar"  # in a list of columns: all sectors, in the scan's order
UNITS: dict[str, dict[str, float]] = {  # unit of ours -> unit of theirs -> how many of these make one of ours
    "m": {"m": 1.0, "cm": 100.0, "mm": 1000.0},
    "rad": {"rad": 1.0, "deg": 180 / math.pi},
    "m/s": {"m/s": 1.0, "km/h": 3.6},
    "rad/s": {"rad/s": 1.0, "deg/s": 180 / math.pi},
    "1": {"1": 1.0},
}


class Lidar(BaseModel):
    """In which order a scan's sectors come. first_deg: bearing at which the first one begins (0 ahead, 90 left, 180 or
    -180 behind); turns: which way the next ones lie."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    first_deg: float = Field(ge=-360, le=360)
    turns: Literal["counter_clockwise", "clockwise"]

    def order(self, sectors: int) -> list[int]:
        """Which of our sectors (from straight ahead, counter-clockwise) stands where. Raises ValueError."""
        width = 360 / sectors
        first = self.first_deg / width
        if not math.isclose(first, round(first), abs_tol=1e-6):
            raise ValueError(
                f"lidar.first_deg = {self.first_deg:g}: must be a multiple of a sector's {width:g} degrees"
            )
        start = round(first)
        if self.turns == "counter_clockwise":
            return [(start + k) % sectors for k in range(sectors)]
        return [(start - 1 - k) % sectors for k in range(sectors)]


class InputColumn(BaseModel):
    """One input of the network: (our quantity in `unit`) * scale + offset."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    unit: str
    scale: float = Field(allow_inf_nan=False)
    offset: float = Field(allow_inf_nan=False)


class InputPart(BaseModel):
    """Some of the network's inputs, side by side. form: `export`, as this product's data sets and ONNX files have them,
    or `si`, the same quantities unscaled in metres, radians and seconds; or else each column. lidar: the scan's order,
    wherever it is not the export's."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    of: Of
    form: Literal["export", "si"] | None = None
    columns: tuple[InputColumn, ...] | None = Field(None, min_length=1, max_length=MOST_COLUMNS)
    lidar: Lidar | None = None

    @model_validator(mode="after")
    def _stated(self) -> InputPart:
        if (self.form is None) == (self.columns is None):
            raise ValueError('state either form ("export" or "si") or columns with name, unit, scale and offset each')
        scanned = self.of != "action" and (
            self.form == "si" or any(column.name.startswith(LIDAR) for column in self.columns or ())
        )
        if scanned and self.lidar is None:
            raise ValueError(
                'state the order of the scan, as "lidar": {"first_deg": 0, "turns": "counter_clockwise"} (0: ahead)'
            )
        if self.form == "export" and self.lidar is not None:
            raise ValueError("form export has the export's own order of the scan; leave lidar out, or use form si")
        return self


@dataclass(frozen=True)
class Conversion:
    """How the network's inputs are made of our steps: (n, ours)[:, of] * scale + offset. names: (quantity, unit) of
    each."""

    of: NDArray[np.intp]
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]
    names: tuple[tuple[str, str], ...]

    def __call__(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        return (values[:, self.of].astype(np.float64) * self.scale + self.offset).astype(np.float32)


@dataclass(frozen=True)
class Quantity:
    """A number of ours: where it stands among the part's, its unit; value * scale + offset is in that unit."""

    at: int
    unit: str
    scale: float
    offset: float = 0.0


def quantities(setup: Setup, of: Of) -> dict[str, Quantity]:
    """What a part of our steps holds, by name, in its order."""
    if of == "action":
        limits = setup.robot.limits
        half = (limits.v_max - limits.v_min) / 2
        return {
            "linear_velocity": Quantity(0, "m/s", half, limits.v_min + half),
            "angular_velocity": Quantity(1, "rad/s", limits.w_max),
        }
    return {
        str(row["name"]): Quantity(at, str(row["unit"]), float(str(row["divided_by"])))
        for at, row in enumerate(setup.observation_layout())
    }


def conversion(setup: Setup, parts: tuple[InputPart, ...]) -> Conversion:
    """All parts side by side; the steps that it is given are their `of` parts, side by side in the same order.

    Raises ValueError that names the column, its value and what would work."""
    at: list[int] = []
    scale: list[float] = []
    offset: list[float] = []
    names: list[tuple[str, str]] = []
    before = 0
    for part in parts:
        known = quantities(setup, part.of)
        for column in _columns(part, known):
            quantity = known[column.name]
            if column.unit not in UNITS[quantity.unit]:
                allowed = ", ".join(UNITS[quantity.unit])
                raise ValueError(f"{part.of}.{column.name}: unit = {column.unit!r}: must be one of {allowed}")
            each = UNITS[quantity.unit][column.unit] * column.scale
            at.append(before + quantity.at)
            names.append((f"{part.of}.{column.name}", _unit_of(column)))
            scale.append(quantity.scale * each)
            offset.append(quantity.offset * each + column.offset)
        before += len(known)
    return Conversion(np.array(at, dtype=np.intp), np.array(scale), np.array(offset), tuple(names))


def _unit_of(column: InputColumn) -> str:
    """Its unit, with what it is scaled and moved by."""
    scaled = f" × {column.scale:.4g}" if column.scale != 1 else ""
    return f"{column.unit}{scaled}{f' {column.offset:+.4g}' if column.offset else ''}"


def _columns(part: InputPart, known: dict[str, Quantity]) -> list[InputColumn]:
    """The part's columns one by one, those of a scan under the names of our sectors."""
    if part.form == "export":
        return [
            InputColumn(
                name=name, unit=quantity.unit, scale=1 / quantity.scale, offset=-quantity.offset / quantity.scale
            )
            for name, quantity in known.items()
        ]
    beams = [name for name in known if name.startswith(LIDAR)]
    order = part.lidar.order(len(beams)) if part.lidar is not None and beams else []
    stated = part.columns or _in_si(known)
    columns: list[InputColumn] = []
    for column in stated:
        if column.name == LIDAR and beams:
            columns += [column.model_copy(update={"name": beams[k]}) for k in order]
        elif column.name in beams:
            k = beams.index(column.name)
            columns.append(column.model_copy(update={"name": beams[order[k]]}))
        elif column.name in known:
            columns.append(column)
        else:
            names = [name for name in known if name not in beams] + (
                [LIDAR, f"{beams[0]} ... {beams[-1]}"] if beams else []
            )
            raise ValueError(f"{part.of}: name = {column.name!r}: must be one of {', '.join(names)}")
    return columns


def _in_si(known: dict[str, Quantity]) -> tuple[InputColumn, ...]:
    return tuple(InputColumn(name=name, unit=quantity.unit, scale=1.0, offset=0.0) for name, quantity in known.items())
