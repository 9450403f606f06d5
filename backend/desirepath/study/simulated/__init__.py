"""Simulated participants: what they answer, and how they reach a study (HTTP, in process)."""
