"""Pictures of what a policy does and why: flow fields, attributions, figures with their data, printed reports.

What is computed here is drawn here; tables and tests of a study are `desirepath.report`'s, pages `desirepath.web`'s.
"""
