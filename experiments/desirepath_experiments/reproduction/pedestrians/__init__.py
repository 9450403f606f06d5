"""Chapter 4 reproduced: attention networks, ablations, baselines and planners among pedestrians; table 4.1."""
