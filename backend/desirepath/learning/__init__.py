"""Learning: policies, the diverse ensemble, queries, reward models and alignment (thesis ch. 6).

Science only: no web, no database, no clock in a result. One file per algorithm, its loss beside its equation number.
"""
