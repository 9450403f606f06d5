"""Policies: their networks, how they are stored, evaluated, exported and found."""
