"""What a study protocol may say as a whole. What each of its stages may say is its kind's (`kinds/`, `block.py`), what
questionnaires may `grammar/questionnaires.py`'s; reading files is `freezing.py`'s, checks across keys `checking.py`'s.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal

from pydantic import Field

from desirepath.grammar.parts import Address, Code, FileName, Language, Localized, Part, Slug
from desirepath.grammar.source import Path
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.study.frozen import Quota
from desirepath.study.plan.asked_queries import Needs, Sample
from desirepath.study.plan.counterbalancing import Assignment
from desirepath.study.protocol.stages import StageEntry, T, stage_keys
from desirepath.study.steps import PACE, Stage

UPRIGHT, LARGE = (320, 480), (740, 500)  # ours: the smallest phone's window; the room beside its bars


class DeviceGate(Part):
    """What a device must have before the consent; what is not named is not asked. Sizes in CSS pixels of the window.

    Where no size is named, it goes by what is shown: a room from above fits a phone held upright (`UPRIGHT`), a view
    from inside it and drawing do not (`LARGE`). pointers: `fine` is a mouse or pen, `coarse` a finger. frame rates in
    pictures per second, measured on the page; below `light_below` a lighter scene is shown before anybody is refused
    below `min_frame_rate`. headset: the immersive view can (`offered`) or must (`required`) be seen with one.
    head_pose: where the head is and which way it faces is stored, 30 times a second while one is worn.
    """

    webgl: bool = True
    min_width: int | None = Field(None, ge=200, le=4000)
    min_height: int | None = Field(None, ge=200, le=4000)
    pointers: list[Literal["fine", "coarse"]] = Field(["fine", "coarse"], min_length=1)
    min_frame_rate: float | None = Field(None, gt=0, le=120)
    light_below: float | None = Field(None, gt=0, le=120)
    headset: Literal["offered", "required"] | None = None
    head_pose: bool = False


class ScreenOut(Part):
    """The last page of somebody who cannot go on (comprehension check, quota); as a debriefing."""

    text: FileName
    completion_code: Code = "random"
    return_url: Address | None = None


class Protocol(Part):
    """A study protocol. `query_set`: name of a shipped set, id of one made here, or a `.npz` file beside it."""

    protocol: Slug
    version: int = Field(ge=1)
    title: Localized
    languages: list[Language] = Field(min_length=1)
    welcome: Localized | None = Field(None, description="first sentence of the page people join on; default by stages")
    minutes: int = Field(15, ge=1, le=240, description="how long a session takes, as participants are told")
    participants: int | None = Field(None, ge=1, description="how many people are taken in; default as many as come")
    link_valid_days: int = Field(14, ge=1, le=365, description="how long a session can be continued")
    contact: str | None = Field(None, max_length=200, description="whom participants may ask; default the lab's")
    licence: str | None = Field(None, max_length=200, description="of the data, written into every export")
    citation: str | None = Field(None, max_length=400, description="how to cite the data")
    assignment: Assignment = Assignment()
    symmetry: Literal["none", "left_right"] = Field(
        "none", description="left_right: nobody minds on which side the robot passes, so no answer is read as a side"
    )
    query_set: str | None = Field(
        None, min_length=1, max_length=300, description="needed where the protocol has a block"
    )
    sample: Sample = Sample()
    payment: Localized | None = Field(None, description="how payment stands, also for who stops early or withdraws")
    device: DeviceGate | None = None
    motor_sound: Literal["silent", "offered", "heard"] = Field(
        "silent",
        description="of robots on the stage; offered: participants switch it on; heard: they can switch it off",
    )
    quotas: list[Quota] = []
    screen_out: ScreenOut | None = Field(None, description="default: a page in the product's own words")
    analysis: AnalysisPlan | None = Field(None, description="what the report tests, declared before the data")
    stages: list[StageEntry] = Field(min_length=1)

    def stages_of(self, kind: type[T]) -> list[T]:
        """The stages of that class, in order."""
        return [entry.stage for entry in self.stages if isinstance(entry.stage, kind)]

    def stage_of(self, kind: type[T]) -> T | None:
        """The first stage of that class, None where there is none."""
        return next(iter(self.stages_of(kind)), None)

    @property
    def asked_of_devices(self) -> DeviceGate:
        """What the welcome page asks of a device, with the sizes that the stages need where none is named."""
        gate = self.device or DeviceGate()
        if gate.min_width is not None or gate.min_height is not None:
            return gate
        from_above = all(stage.views <= {"top_down"} and not stage.draws for stage in self.all_stages)
        width, height = UPRIGHT if from_above else LARGE
        return gate.model_copy(update={"min_width": width, "min_height": height})

    @property
    def needs(self) -> Needs:
        """What one participant needs of the query set."""
        return sum((entry.stage.needs() for entry in self.stages), Needs())

    @property
    def keyed_stages(self) -> list[tuple[str, Stage]]:
        """The stages with their names in plans."""
        return list(zip(stage_keys(self.stages), self.all_stages, strict=True))

    @property
    def all_stages(self) -> list[Stage]:
        return [entry.stage for entry in self.stages]

    @property
    def told_minutes(self) -> str:
        """How long a session takes in the words that participants are told: a span where further pairs may come."""
        further = round(sum(stage.further_seconds(PACE) for stage in self.all_stages) / 60.0)
        return f"{self.minutes}–{self.minutes + further}" if further else str(self.minutes)


def json_schema(of: type[Part] = Protocol) -> dict[str, Any]:
    """JSON Schema of a protocol, or of a questionnaire's file, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | of.model_json_schema(by_alias=True)


# ---- the files that it names, and its numbers in their texts --------------------------------------------------------


def all_texts(protocol: Protocol) -> Iterator[tuple[str, Path]]:
    """Every text with where it is named in the file."""
    for index, entry in enumerate(protocol.stages):
        for name, path in entry.stage.texts():
            yield name, ("stages", index, entry.kind, *path)
    if protocol.screen_out:
        yield protocol.screen_out.text, ("screen_out", "text")


def all_questionnaires(protocol: Protocol) -> Iterator[tuple[str, Path]]:
    """Every questionnaire with where it is named in the file."""
    for index, entry in enumerate(protocol.stages):
        for name, path in entry.stage.questionnaires():
            yield name, ("stages", index, entry.kind, *path)


MAXIMA = ("pairs_per_block",)  # of the longest condition; all others add up over what one participant meets


def text_numbers(protocol: Protocol) -> dict[str, int | str]:
    """What a text may name in braces: name -> number; `minutes` is a span where further pairs may come."""
    numbers = dict.fromkeys(
        (
            "pairs",
            "practice_pairs",
            "further_pairs",
            "comparison_pairs",
            "blocks",
            "pairs_per_block",
            "places",
            "paths",
        ),
        0,
    )
    for entry in protocol.stages:
        for name, number in entry.stage.numbers().items():
            before = numbers.get(name, 0)
            numbers[name] = max(before, number) if name in MAXIMA else before + number
    return {"minutes": protocol.told_minutes, **numbers}


def fill_in(text: str, protocol: Protocol) -> str:
    """The text with `{minutes}`, `{pairs}` and so on as numbers."""
    for name, number in text_numbers(protocol).items():
        text = text.replace(f"{{{name}}}", str(number))
    return text
