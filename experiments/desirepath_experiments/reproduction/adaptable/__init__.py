"""Chapter 5 made anew: rewards from demonstrations, adaptable policies, baselines; tables, figures and the report.

Everything is simulated: those who demonstrate are the programmed demonstrators.
"""
