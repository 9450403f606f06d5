"""What somebody wishes of a robot in a sentence of their own, English or German: plain words to preference weights.

Offline and small. Neither web nor database; what a study makes of it is `study/kinds/words.py`'s.
"""
