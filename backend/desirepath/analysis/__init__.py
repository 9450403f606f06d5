"""Numbers from trajectories, choices and ratings: metrics, Fréchet distances, tests, intervals, validated scales.

Pure functions on arrays: no database, no web. What a study's report tests and how it says so is `desirepath.report`'s.
"""
