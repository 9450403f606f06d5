"""What a monitoring system reads of this server (`/metrics`, Prometheus' text format): counts, times, states, no names.

For this machine, or for who has `DESIREPATH_METRICS_TOKEN`. Whether the server is well, in one word, says `/health`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from datetime import timedelta

from prometheus_client import CollectorRegistry, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.multiprocess import MultiProcessCollector
from prometheus_client.registry import Collector
from sqlalchemy import func, select

from desirepath.jobs.heartbeat import SILENT_S
from desirepath.jobs.leases import workers_silent_s
from desirepath.settings import Settings
from desirepath.store.database import Database, shared_now
from desirepath.store.models import Job, Session, WorkerProcess, utc_now
from desirepath.store.models import Response as Answer
from desirepath.web.core.disk import room_left

BUCKETS_S = (0.01, 0.025, 0.05, 0.1, 0.15, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
COUNTED_TOGETHER = "PROMETHEUS_MULTIPROC_DIR"  # the library's own name: it reads it when it is loaded
PRESENT_S = 60  # ours: whose page said something within this is here


class Monitoring:
    """Requests are counted as they end, everything else when it is asked for. Of several server processes of one
    machine each counts into the folder that their supervisor has named, and any of them tells the sum, with what those
    counted that were killed meanwhile."""

    def __init__(self) -> None:
        self._counted_together = os.environ.get(COUNTED_TOGETHER)
        self.registry = CollectorRegistry()
        self._requests = Histogram(
            "desirepath_request_seconds",
            "Time until a request's answer began, by route",
            ["method", "route", "status"],
            buckets=BUCKETS_S,
            registry=self.registry,
        )

    def count_answered(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request. route: its pattern, which holds nobody's token."""
        known = method if method in METHODS else "other"  # it is whatever its sender wrote
        self._requests.labels(known, route, str(status)).observe(seconds)

    def text(self, settings: Settings, database: Database) -> bytes:
        """Everything, in Prometheus' text format."""
        requests = self.registry
        if self._counted_together:
            requests = CollectorRegistry()
            MultiProcessCollector(requests, self._counted_together)  # type: ignore[no-untyped-call]
        return generate_latest(requests) + generate_latest(_once(_Standing(settings, database)))


def _once(collector: Collector) -> CollectorRegistry:
    registry = CollectorRegistry()
    registry.register(collector)
    return registry


class _Standing(Collector):
    """How sessions, answers, jobs, disk and worker stand now."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._settings, self._database = settings, database

    def describe(self) -> list[Metric]:
        return []  # known without asking the database

    def collect(self) -> Iterator[Metric]:
        """One family after the other."""
        with self._database.session() as s:
            by_state = s.execute(
                select(Session.state, Session.simulated, func.count()).group_by(Session.state, Session.simulated)
            ).all()
            recent = Session.last_seen_at > utc_now() - timedelta(seconds=PRESENT_S)
            present = s.scalar(select(func.count()).where(recent, Session.state == "active"))
            answers = s.scalar(select(func.count()).select_from(Answer))
            jobs = s.execute(select(Job.kind, Job.state, func.count()).group_by(Job.kind, Job.state)).all()
            silent = workers_silent_s(self._settings.data, s)
            heard_of = WorkerProcess.seen_at > shared_now(s) - timedelta(seconds=SILENT_S)
            workers = s.scalar(select(func.count()).select_from(WorkerProcess).where(heard_of))
        sessions = GaugeMetricFamily("desirepath_sessions", "Sessions by state", labels=["state", "simulated"])
        for state, simulated, number in by_state:
            sessions.add_metric([state, str(simulated).lower()], number)
        yield sessions
        yield GaugeMetricFamily("desirepath_present", f"Sessions seen within {PRESENT_S} s", value=present or 0)
        yield GaugeMetricFamily("desirepath_answers", "Answers stored", value=answers or 0)
        of_jobs = GaugeMetricFamily("desirepath_jobs", "Background jobs by kind and state", labels=["kind", "state"])
        for kind, state, number in jobs:
            of_jobs.add_metric([kind, state], number)
        yield of_jobs
        room = room_left(self._settings)
        yield GaugeMetricFamily(
            "desirepath_free_bytes", "Free on the fullest disk that is written on", value=room.free_mb * 2**20
        )
        yield GaugeMetricFamily(
            "desirepath_workers",
            f"Workers on all machines, heard of within {SILENT_S:.0f} s",
            value=workers or 0,
        )
        if silent is not None:
            yield GaugeMetricFamily(
                "desirepath_worker_silent_seconds",
                "Since any worker, on whichever machine, said that it lives",
                value=silent,
            )
