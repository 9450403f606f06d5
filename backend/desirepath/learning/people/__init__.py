"""Simulated people outside the list: preferences that no weighing of the nine objectives says, as families on a card.

What is learned from their answers lives elsewhere and knows nothing of this room. Everything they answer is simulated
and marked as such.
"""
