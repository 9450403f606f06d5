"""Which files a protocol names, and where: texts and questionnaires, of stages and inside blocks. Reads nothing."""

from __future__ import annotations

from collections.abc import Iterator

from desirepath.grammar.source import Path
from desirepath.study.protocol.schema import Protocol


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
