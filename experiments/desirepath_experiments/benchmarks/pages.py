"""`desirepath benchmark pages`: restart to the first page, every page of the lab, and many who join at once.

The installation that is measured is made in `many_studies.py`.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import numpy as np
from sqlalchemy import func, select, update

from desirepath.cli.loopback import loopback_server
from desirepath.settings import Settings
from desirepath.store.database import Database
from desirepath.store.models import Participant, Study, User
from desirepath.web.core.auth import FIRST_USER, change_password, ensure_first_user, reset_password
from desirepath_experiments.benchmarks.many_studies import PROTOCOL, make_studies
from desirepath_experiments.benchmarks.processes import processor_s

RESTART_BAR_S, LAB_BAR_MS, JOIN_BAR_MS = 3.0, 300.0, 500.0
PASSWORD = "benchmark of all pages"  # noqa: S105  of an account on loopback, in a folder of the benchmark's own
LINK = re.compile(r'href="(/lab/[^"#]*)"')
ID = re.compile(r"[0-9a-f]{32,64}|\d+")
SAMPLES = 3  # pages of one kind, e.g. three people of three studies
LOOKS = 3  # at each page; the first one counts as any other
NO_PAGES = ("/lab/sign-out",)


class PagesBenchmarkError(RuntimeError):
    """Something was answered that is no page; says what."""


def benchmark_pages(
    *,
    studies: int = 20,
    participants: int = 31,
    restarts: int = 5,
    joining: int = 40,
    rounds: int = 5,
    data: Path | None = None,
    tell: Callable[[str], None] = lambda words: None,
) -> dict[str, Any]:
    """What people wait for, on an installation of `studies` studies of `participants` people each.

    restart_s: from starting `desirepath serve` to the sign-in page read to its end, median and slowest. lab_p95_ms: of
    every look at every kind of lab page that a link leads to (three pages of a kind, three looks each, one after
    another, the first look at a page included); `lab_pages` lists the kinds, slowest first, and
    `lab_pages_above_the_bar` those whose own 95 % is above it. join_p95_ms: from sending to the answer, `joining`
    people sending in the same moment, `rounds` times, each in another study. `bars`: what each should be below; `met`:
    whether it is.
    data: a folder to keep the installation in, or one from before. Raises PagesBenchmarkError.
    """
    load = [round(value, 2) for value in os.getloadavg()]
    with tempfile.TemporaryDirectory(prefix="desirepath-benchmark-") as folder:
        settings = Settings(data=data or Path(folder), database_url=None, artefacts_url=None)
        settings.data.mkdir(parents=True, exist_ok=True)
        made = make_studies(settings, studies, participants, tell)
        tokens = _prepared(settings, made)
        tell("restarts")
        started = [_restarted(settings) for _ in range(restarts)]
        with loopback_server(settings, worker=False) as (url, server):
            tell("lab pages")
            found = _lab_pages(url)
            tell("joining")
            before = processor_s(server.pid)
            waits = [asyncio.run(_joined(url, tokens[n % len(tokens)], joining)) for n in range(rounds)]
            join_processor_ms = (processor_s(server.pid) - before) * 1e3 / (joining * rounds)
    looks = np.concatenate([np.concatenate(pages) for pages in found.values()])
    joins = np.concatenate(waits)
    result = {
        "restart_s": round(float(np.median([wall for wall, _ in started])), 2),
        "lab_p95_ms": round(float(np.percentile(looks, 95)), 1),
        "join_p95_ms": round(float(np.percentile(joins, 95)), 1),
    }
    bars = {"restart_s": RESTART_BAR_S, "lab_p95_ms": LAB_BAR_MS, "join_p95_ms": JOIN_BAR_MS}
    pages = sorted((_row(kind, looked) for kind, looked in found.items()), key=lambda row: -row["p95_ms"])
    return {
        "studies": studies,
        "participants": participants,
        "protocol": PROTOCOL.stem,
        **result,
        "bars": bars,
        "met": {name: result[name] <= bar for name, bar in bars.items()},
        "slowest_restart_s": round(max(wall for wall, _ in started), 2),
        "restart_processor_s": round(float(np.median([used for _, used in started])), 2),
        "slowest_lab_page_ms": round(float(looks.max()), 1),
        "slowest_join_ms": round(float(joins.max()), 1),
        "join_processor_ms": round(join_processor_ms, 1),
        "joining_at_once": joining,
        "lab_looks": len(looks),
        "lab_pages_above_the_bar": [row["page"] for row in pages if row["p95_ms"] > LAB_BAR_MS],
        "lab_pages": pages,
        "cores": os.cpu_count(),
        "load_average": {"before": load, "after": [round(value, 2) for value in os.getloadavg()]},
    }


def _row(kind: str, looked: list[list[float]]) -> dict[str, Any]:
    every = np.concatenate(looked)
    return {
        "page": kind,
        "p95_ms": round(float(np.percentile(every, 95)), 1),
        "median_ms": round(float(np.median(every)), 1),
        "first_ms": round(max(looks[0] for looks in looked), 1),
    }


def _prepared(settings: Settings, made: list[str]) -> list[str]:
    """An owner with PASSWORD, and the studies open for anybody; returns their recruiting tokens."""
    database = Database(settings.database)
    first = ensure_first_user(database) or reset_password(database, FIRST_USER)
    with database.transaction() as s:
        user = s.scalars(select(User.id).where(User.name == FIRST_USER)).one()
        s.execute(update(Study).where(Study.id.in_(made)).values(state="open"))
        people = select(func.count()).where(Participant.study_id == Study.id).scalar_subquery()
        # Runs before may have left people in some: the fullest ones come last.
        tokens = list(s.scalars(select(Study.recruiting_token).where(Study.id.in_(made)).order_by(people)))
    change_password(database, user, first, PASSWORD)
    database.close()
    return tokens


def _restarted(settings: Settings) -> tuple[float, float]:
    """Seconds of the wall clock until the first page, and the server's processor seconds by then."""
    began = time.perf_counter()
    with loopback_server(settings) as (url, server):
        answered = httpx.get(f"{url}/lab/sign-in", trust_env=False)
        wall = time.perf_counter() - began
        if answered.status_code != 200:
            raise PagesBenchmarkError(f"/lab/sign-in answered {answered.status_code}")
        return wall, processor_s(server.pid)


def _lab_pages(url: str) -> dict[str, list[list[float]]]:
    """Kind of page (its address with * for ids and numbers) -> milliseconds of each look at each page of the kind."""
    seen: dict[str, list[list[float]]] = defaultdict(list)
    with httpx.Client(base_url=url, timeout=60.0, trust_env=False) as client:
        signed = client.post("/lab/sign-in", data={"name": FIRST_USER, "password": PASSWORD})
        if signed.status_code != 303:
            raise PagesBenchmarkError(f"signing in answered {signed.status_code}")
        waiting, known = ["/lab/studies"], {"/lab/studies", *NO_PAGES}
        while waiting:
            address = waiting.pop(0)
            kind = _kind(address)
            if len(seen[kind]) >= SAMPLES:
                continue
            looks, page = [], ""
            for _ in range(LOOKS):
                began = time.perf_counter()
                with client.stream("GET", address) as answered:
                    is_page = answered.headers.get("content-type", "").startswith("text/html")
                    if answered.status_code >= 500:
                        raise PagesBenchmarkError(f"{address} answered {answered.status_code}")
                    if not is_page or answered.status_code != 200:  # a file to download, a way on, a page that is gone
                        break
                    page = answered.read().decode()
                looks.append((time.perf_counter() - began) * 1e3)
            if not looks:
                continue
            seen[kind].append(looks)
            for link in LINK.findall(page):
                link = link.replace("&amp;", "&")
                if link not in known:
                    known.add(link)
                    waiting.append(link)
    return {kind: looked for kind, looked in seen.items() if looked}


def _kind(address: str) -> str:
    parts = urlsplit(address)
    names = "&".join(sorted(pair.partition("=")[0] for pair in parts.query.split("&") if pair))
    return ID.sub("*", parts.path) + (f"?{names}" if names else "")


async def _joined(url: str, token: str, people: int) -> list[float]:
    """Milliseconds that each of them waits from sending to the end of the answer, all sending in the same moment.

    Connections are open before, and spoken to by hand: a client library would be slower than the server.
    """
    parts = urlsplit(url)
    body = json.dumps({"simulated": True, "language": "en"}).encode()
    head = f"POST /join/{token} HTTP/1.1\r\nHost: {parts.netloc}\r\nConnection: close\r\n"
    head += f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n"
    ready = asyncio.Barrier(people)

    async def one() -> float:
        reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
        await ready.wait()
        began = time.perf_counter()
        writer.write(head.encode() + body)
        answered = await reader.read()
        waited = (time.perf_counter() - began) * 1e3
        writer.close()
        if b" 201 " not in answered.partition(b"\r\n")[0]:
            raise PagesBenchmarkError(f"joining answered {answered[:300].decode(errors='replace')}")
        return waited

    return list(await asyncio.gather(*(one() for _ in range(people))))
