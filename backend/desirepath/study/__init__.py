"""Studies: protocols, kinds of step, plans, sessions, simulated participants. Its rooms: docs/architecture.md.

No routes and no pages (`desirepath.web`), no training (`desirepath.jobs`), no analysis (`desirepath.report`).
"""
