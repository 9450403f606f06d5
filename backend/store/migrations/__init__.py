"""Alembic's scripts: how the tables came to be what `models.py` says. A released file is never edited."""
