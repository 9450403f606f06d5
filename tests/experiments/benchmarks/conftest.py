"""Fixtures that benchmarks share with learning."""

from tests.learning.conftest import tiny_config

__all__ = ["tiny_config"]
