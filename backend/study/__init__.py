"""Studies: protocols, kinds of step, plans, sessions, simulated participants. Its rooms: docs/architecture.md.

No routes and no pages (`backend.api`), no training (`backend.jobs`), no analysis (`backend.report`).
"""
