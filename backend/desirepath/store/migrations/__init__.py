"""Alembic's scripts: how the tables came to be what `models` says. A released file is never edited."""
