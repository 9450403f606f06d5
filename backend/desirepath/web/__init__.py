"""The web: routes, pages, the stage's door. `application.py` puts them together; who may do what is `core/roles.py`'s.

No rule of a study and no statistics: those are `desirepath.study`'s and `desirepath.report`'s.
"""
