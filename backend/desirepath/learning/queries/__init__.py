"""Queries: making them, and choosing which to ask next."""
