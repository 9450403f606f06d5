"""A robot's own routes, opened by its token, and what pages are shown of where it is."""
