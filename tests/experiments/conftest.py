"""Experiments are tried on the same small parts as what they measure."""

from tests.learning.conftest import distance_answers, study_queries, tiny_base, tiny_config

__all__ = ["distance_answers", "study_queries", "tiny_base", "tiny_config"]
