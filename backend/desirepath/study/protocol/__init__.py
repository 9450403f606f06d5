"""A study protocol: what a file may say, reading and checking it, freezing it into a study."""
