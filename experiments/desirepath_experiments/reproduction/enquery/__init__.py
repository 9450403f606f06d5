"""Chapter 6 reproduced: budgets and plan of its tasks, what each computes, numbers, figures and the report.

Everything is simulated: the one who answers is the thesis's oracle.
"""
