"""Several server processes of one installation: what they tell each other, count together and ask of each other."""
