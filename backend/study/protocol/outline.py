"""A protocol for experimenters: its stages in words, how long it takes. What participants see is `pages.py`'s."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from backend.study.plan.counterbalancing import design_of
from backend.study.plan.planning import make_plan
from backend.study.plan.queries import placeholders
from backend.study.protocol.blocks import BlockBreak, BlockStage
from backend.study.protocol.demonstration_stages import CONTROLLERS, DemonstrationsStage, EvaluationStage
from backend.study.protocol.freezing import FrozenProtocol
from backend.study.protocol.named import questionnaires_of, texts_of
from backend.study.protocol.schema import Protocol
from backend.study.protocol.stages import ComparisonStage, StageEntry, stage_keys
from backend.study.protocol.texts import filled, local, variant

SECONDS_PER_DRIVE = 35  # ours: 6 m at about 0.2 m/s, and a press on the button
SECONDS_PER_PATH = 50  # drawn in about 10 s and driven at 0.2 m/s over 6 m, ours; redrawing included


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
        (language, filled(files.get(variant(name, language), files.get(name, "")), protocol))
        for name in dict.fromkeys(name for name, _ in texts_of(entry))
        for language in protocol.languages
    ]
    used = dict.fromkeys(name for name, _ in questionnaires_of(entry))
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


def expected_minutes(protocol: Protocol, *, seconds_per_drive: float = 9.0) -> float:
    """How long all appointments take by the protocol: two drives with letters and a choice per trial, half a minute per
    page, stages with `when` as if everybody met them, comprehension checks once.

    seconds_per_drive: of the study room's queries, spec 07 (9.8 s and less). Half a minute for a page is ours.
    """
    per_trial = 2 * (seconds_per_drive + 2.0) + 5.0
    trials = pages = resting_s = drawing_s = 0
    for entry in protocol.stages:
        stage = entry.stage
        if isinstance(stage, BlockStage):
            conditions = len(stage.conditions(0))
            trials += conditions * sum(one.queries.count + one.queries.probes.trials for one in stage.trials)
            pages += conditions * len(stage.before + stage.after) + (conditions - 1) * len(stage.between)
        elif isinstance(stage, DemonstrationsStage):
            drawing_s += stage.pairs * stage.per_pair * SECONDS_PER_PATH
        elif isinstance(stage, ComparisonStage):
            trials += stage.pairs
        elif isinstance(stage, EvaluationStage):
            drawn = [one.demonstrations for one in protocol.stages if one.demonstrations]
            drawing_s += sum(one.pairs for one in drawn) * len(CONTROLLERS) * SECONDS_PER_DRIVE
            pages += len(drawn) * len(CONTROLLERS)
        elif isinstance(stage, BlockBreak):
            resting_s += stage.at_least_s
            pages += 1
        else:
            pages += 1
    return round((trials * per_trial + pages * 30.0 + resting_s + drawing_s) / 60.0, 1)


def plan_preview(frozen: FrozenProtocol, seed: int, language: str | None = None) -> dict[str, Any]:
    """One participant's steps in words: {"protocol", "minutes", "orders", "steps": [{"key", "kind", "told"}]}.

    orders: how many different orders of conditions are filled evenly, 0 where they are drawn by lot. ValueError for a
    language that the protocol does not have.
    """
    languages = frozen.protocol.languages
    if language is not None and language not in languages:
        raise ValueError(f"language = {language!r}: must be one of {', '.join(languages)}")
    steps = make_plan(frozen.protocol, seed, placeholders(frozen.protocol))
    return {
        "protocol": frozen.protocol.protocol,
        "minutes": expected_minutes(frozen.protocol),
        "orders": len(design_of(frozen.protocol).rows),
        "steps": [
            {"key": step["key"], "kind": step["kind"], "told": _told(frozen, step, language or languages[0])}
            for step in steps
        ],
    }


def _told(frozen: FrozenProtocol, step: dict[str, Any], language: str) -> str:
    words = [str(step[name]) for name in ("role", "view") if name in step]
    if "text" in step and step["kind"] != "comprehension":
        words.append(frozen.text(step["text"], language)[0])
    elif "questionnaire" in step:
        words.append(local(frozen.questionnaires[step["questionnaire"]].title, language))
    if "when" in step:
        words.append(f"(when {step['when']['questionnaire']}.{step['when']['item']})")
    return " ".join(words)
