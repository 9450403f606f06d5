"""Rules that last: in which situation a robot should drive otherwise, and how, or where it must not drive.

`rule.py` what a rule is, `reading.py` a sentence as one, `obeying.py` the policy that drives by them, `obedience.py`
how far it does. Neither web nor database; what a study makes of them is `study/kinds/rules.py`'s.
"""
