"""What an answer that is more than a choice of two says: how probable it is, by what its alternatives are worth to
somebody. One file per likelihood; what is then believed is `posterior.py`'s. Knows no protocol and no page.
"""
