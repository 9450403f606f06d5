"""Background work: the queue (DBOS), the worker, and what each kind of job does with snapshots and artefacts.

How policies and reward models are learned lives in `backend.learning` and `backend.demonstrations`; no page lives here.
"""
