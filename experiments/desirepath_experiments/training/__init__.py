"""Trainings of the laboratory: chapter 5's policies, gradients through the simulation, imitation of a search."""
