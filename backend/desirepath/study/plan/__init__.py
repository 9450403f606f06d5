"""A participant's plan: which steps, which queries, which order. Pure."""
