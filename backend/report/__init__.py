"""A study's report: tidy rows, the declared analysis, findings, text, figures, power.

Tests themselves are `backend.analysis`'s; nothing here writes to the database.
"""
