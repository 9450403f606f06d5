"""Chapter 5 reproduced: rewards from demonstrations, adaptable policies, baselines; tables, figures and the report.

Everything is simulated: those who demonstrate are the programmed demonstrators.
"""
