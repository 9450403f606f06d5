"""Whether the analysis finds what was put in, and nothing else: counted over simulated cohorts."""
