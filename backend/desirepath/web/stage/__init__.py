"""The 3D stage's door, and what joins it with the session machine."""
