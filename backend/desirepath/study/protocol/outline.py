"""A protocol for experimenters: its stages in words, how long it takes. What participants see is the kinds' own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from desirepath.grammar.texts import local, variant
from desirepath.study.plan.counterbalancing import design_of
from desirepath.study.protocol.freezing import FrozenProtocol
from desirepath.study.protocol.planning import example_queries, make_plan
from desirepath.study.protocol.schema import Protocol, fill_in
from desirepath.study.protocol.stages import StageEntry, stage_keys
from desirepath.study.steps import PACE, Step


@dataclass(frozen=True)
class StageSummary:
    """One stage, readable. `key` is what plan steps carry as `stage`; `facts`: (word, value) pairs of its settings."""

    key: str
    kind: str
    facts: tuple[tuple[str, str], ...]
    texts: tuple[tuple[str, str], ...]  # (language, markdown)
    questionnaires: tuple[str, ...]


def describe_stages(protocol: dict[str, Any], files: dict[str, str]) -> list[StageSummary]:
    """The stages of a study's frozen protocol (`study.protocol`, `study.files`), one readable entry each."""
    known = {name: protocol[name] for name in Protocol.model_fields if name in protocol}
    parsed = Protocol.model_validate(known)
    return [
        _summary(key, entry, parsed, files) for key, entry in zip(stage_keys(parsed.stages), parsed.stages, strict=True)
    ]


def _summary(key: str, entry: StageEntry, protocol: Protocol, files: dict[str, str]) -> StageSummary:
    data = entry.stage.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    data.pop("text", None)
    if entry.when is not None:
        data["when"] = entry.when.model_dump(mode="json", by_alias=True, exclude_none=True)
    texts = [
        (language, fill_in(files.get(variant(name, language), files.get(name, "")), protocol))
        for name in dict.fromkeys(name for name, _ in entry.stage.texts())
        for language in protocol.languages
    ]
    used = dict.fromkeys(name for name, _ in entry.stage.questionnaires())
    return StageSummary(key, entry.kind, tuple(_facts(data)), tuple(texts), tuple(used))


def _facts(data: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(data, dict):
        for name, value in data.items():
            yield from _facts(value, f"{prefix} {name}".strip())
    elif isinstance(data, list) and data and isinstance(data[0], dict):
        for number, value in enumerate(data, 1):
            yield from _facts(value, f"{prefix} {number}")
    else:
        shown = ", ".join(map(str, data)) if isinstance(data, list) else str(data).lower()
        yield prefix.replace("_", " "), shown if not isinstance(data, str) else data


def estimate_minutes(protocol: Protocol) -> tuple[float, float]:
    """How long all appointments take by the protocol, and how long at most with further pairs: two trajectories with
    letters and a choice per trial, half a minute per page, stages with `when` as if everybody met them, comprehension
    checks once.
    """
    usual = sum(stage.seconds(PACE, protocol.all_stages) for stage in protocol.all_stages)
    further = sum(stage.further_seconds(PACE) for stage in protocol.all_stages)
    return round(usual / 60.0, 1), round((usual + further) / 60.0, 1)


def minutes_left(protocol: Protocol, plan: Sequence[Step], ahead: Iterable[Step]) -> float:
    """How long the steps `ahead` of a plan take, in minutes of the `minutes` that participants are told for all of it.

    A stage's time is spread evenly over its steps, that of its further ones over these.
    """
    steps, stages = Counter((step.stage, step.further) for step in plan), protocol.all_stages
    seconds = {
        (key, further): stage.further_seconds(PACE) if further else stage.seconds(PACE, stages)
        for key, stage in protocol.keyed_stages
        for further in (False, True)
    }
    left = sum(seconds[at] / steps[at] for at in ((step.stage, step.further) for step in ahead))
    return protocol.minutes * left / max(sum(stage.seconds(PACE, stages) for stage in stages), 1.0)


def plan_preview(frozen: FrozenProtocol, seed: int, language: str | None = None) -> dict[str, Any]:
    """One participant's steps in words: {"protocol", "minutes", "minutes_at_most", "orders", "steps"}.

    steps: [{"key", "kind", "description"}]; orders: how many different orders of conditions are filled evenly, 0 where
    they are drawn by lot. ValueError for a language that the protocol does not have.
    """
    languages = frozen.protocol.languages
    if language is not None and language not in languages:
        raise ValueError(f"language = {language!r}: must be one of {', '.join(languages)}")
    steps = make_plan(frozen.protocol, seed, example_queries(frozen.protocol))
    usual, most = estimate_minutes(frozen.protocol)
    return {
        "protocol": frozen.protocol.protocol,
        "minutes": usual,
        "minutes_at_most": most,
        "orders": len(design_of(frozen.protocol).rows),
        "steps": [
            {"key": step.key, "kind": step.kind, "description": _description(frozen, step, language or languages[0])}
            for step in steps
        ],
    }


def _description(frozen: FrozenProtocol, step: Step, language: str) -> str:
    words = [str(word) for word in (getattr(step, "role", None), step.view) if word is not None]
    if step.title_of is not None:
        what, name = step.title_of
        title = frozen.text(name, language)[0] if what == "text" else local(frozen.questionnaires[name].title, language)
        words.append(title)
    if step.when is not None:
        words.append(f"(when {step.when.questionnaire}.{step.when.item})")
    return " ".join(words)
