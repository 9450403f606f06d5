"""Which files a protocol names, and where: texts and questionnaires, of stages and inside blocks. Reads nothing."""

from __future__ import annotations

from collections.abc import Iterator

from backend.study.grammar.source import Path
from backend.study.protocol.blocks import BlockQuestionnaire, BlockStage
from backend.study.protocol.demonstration_stages import EvaluationStage
from backend.study.protocol.schema import Protocol
from backend.study.protocol.stages import ComprehensionStage, QuestionnaireStage, StageEntry, TrainStage


def questionnaires_of(entry: StageEntry) -> Iterator[tuple[str, Path]]:
    """(name, where in the stage it is named) of a stage's questionnaires."""
    stage = entry.stage
    if isinstance(stage, QuestionnaireStage | ComprehensionStage):
        yield stage.use, ("use",)
    elif isinstance(stage, EvaluationStage):
        yield stage.questionnaire, ("questionnaire",)
    elif isinstance(stage, TrainStage) and stage.meanwhile:
        yield stage.meanwhile.questionnaire, ("while", "questionnaire")
    elif isinstance(stage, BlockStage):
        for place in ("before", "after", "between"):
            for n, one in enumerate(getattr(stage, place)):
                if isinstance(one.part, BlockQuestionnaire):
                    yield one.part.use, (place, n, "questionnaire", "use")


def texts_of(entry: StageEntry) -> Iterator[tuple[str, Path]]:
    """(name of a markdown text, where in the stage it is named); in blocks one per condition that it differs in."""
    stage = entry.stage
    if isinstance(stage, BlockStage):
        for place in ("before", "after", "between"):
            for n, one in enumerate(getattr(stage, place)):
                if not isinstance(one.part, BlockQuestionnaire):
                    conditions = (c for group in range(len(stage.groups)) for c in stage.conditions(group))
                    for name in sorted({condition.filled(one.part.text) for condition in conditions}):
                        yield name, (place, n, one.kind, "text")
        return
    text = getattr(stage, "text", None)
    if text is not None:
        yield text, ("text",)


def all_texts(protocol: Protocol) -> Iterator[tuple[str, Path]]:
    """Every text with where it is named in the file."""
    for index, entry in enumerate(protocol.stages):
        for name, path in texts_of(entry):
            yield name, ("stages", index, entry.kind, *path)
    if protocol.screen_out:
        yield protocol.screen_out.text, ("screen_out", "text")


def all_questionnaires(protocol: Protocol) -> Iterator[tuple[str, Path]]:
    """Every questionnaire with where it is named in the file."""
    for index, entry in enumerate(protocol.stages):
        for name, path in questionnaires_of(entry):
            yield name, ("stages", index, entry.kind, *path)
