"""Networks of others: which are read at all, and the process of its own that reads and runs them."""
