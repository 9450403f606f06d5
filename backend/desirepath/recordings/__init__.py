"""Trajectories recorded elsewhere: files of others into scenes, trajectories and query sets, and out again.

A file per format reads bounded input into `recording.Recording`; `resampling.py` and `conversion.py` make trajectories
of setups of it, on arrays alone; `pairs.py` makes queries. Nothing here knows the database: `store` keeps the sets.
"""
