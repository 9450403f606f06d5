"""Background work: the queue (DBOS), the worker, and what each kind of job does with snapshots and artefacts.

How policies and reward models are learned lives in `learning` and `demonstrations`; no page lives here.
"""
