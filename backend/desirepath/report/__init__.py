"""A study's report: tidy rows, the declared analysis, findings, text, figures, power.

Tests themselves are `desirepath.analysis`'s; nothing here writes to the database.
"""
