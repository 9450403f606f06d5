"""What goes wrong in learning because of the data or settings somebody gave."""

from __future__ import annotations


class LearningError(ValueError):
    """Data or a setting that cannot be learned from; names it and says what would work."""


class TooFewAnswers(LearningError):
    """Fewer answers about two different trajectories than what was asked for needs."""


class OppositeWeights(LearningError):
    """Two preference weights above 0 that exclude each other."""
