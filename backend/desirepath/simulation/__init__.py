"""Scenes, setups, robots and people, rollouts: the fast engine and the PyBullet reference engine.

No learning, no database, no web: import it in a notebook.
"""
