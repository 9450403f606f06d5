"""Studies as data sets: what they consist of, writing one, reading one back. Of the web they know nothing."""
