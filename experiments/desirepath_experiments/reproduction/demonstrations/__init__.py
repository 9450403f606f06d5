"""Chapter 2 reproduced: the plan of its tasks, what each computes, numbers, figures and the report.

Everything is simulated: those who demonstrate are the programmed demonstrators.
"""
