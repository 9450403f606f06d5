"""The loop that every training here has: step on until a mark, look, go on. What is looked at is the algorithm's."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence


def checkpoints(step: Callable[[], int], marks: Sequence[int], between: Callable[[int], None]) -> Iterator[int]:
    """Yields at each of the rising `marks` once it is reached, with how much is done by then; at most one per step.

    step: one step of a training; returns how much is done (updates, or steps of the environments). between: called
    with that after a step that reached no mark, to tell progress.
    """
    for mark in marks:
        while (done := step()) < mark:
            between(done)
        yield done
