"""Every published route is asked for what nobody would ask: whatever comes, nothing fails on our side.

Bounded: some requests per route with one fixed seed and one that is drawn anew and printed (`DESIREPATH_FUZZ_SEED` runs
it again). On SQLite, and on PostgreSQL where its programs are installed: that is stricter about texts.
"""

from __future__ import annotations

import json
import os
import random
import re
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from sqlalchemy import select, update

from backend.api.application import build_services, create_application
from backend.api.core.auth import add_user
from backend.api.core.dependencies import Services
from backend.api.core.published import openapi_of, operations
from backend.settings import Settings
from backend.store.dataset.writing import export_study
from backend.store.models import Study, User
from tests import postgres
from tests.api.lab_services import Walked, csrf, sign_in
from tests.api.participant_services import submit

REQUESTS_PER_ROUTE = int(os.environ.get("DESIREPATH_FUZZ_REQUESTS") or 5)
SEEDS = (2026, int(os.environ.get("DESIREPATH_FUZZ_SEED") or random.SystemRandom().randrange(10**6)))
HERE = ("127.0.0.1", 50_000)
# These end the sign-in that the others need, or never end; each has tests of its own.
LEFT_OUT = {"/lab/sign-out", "/lab/password", "/api/session/{token}/stream"}
TEXTS = (
    *("", " ", "x", "a\0b", "\0", "\ud83d", "💥" * 20, "x" * 33, "x" * 300, "x" * 5000, "../../../etc/passwd", "%00"),
    *("=1+1", "<b>", "{{7*7}}", "' OR 1=1 --", "-1", "0", "1e400", "NaN", "2026-13-45", "0001-01-01T00:00:00+14:00"),
    *("9999-12-31T23:59:59-14:00", "12345678", "a", "people", "open", "en", "true", "null", "[]", "\r\n", "\u202e"),
)
NUMBERS = (0, 1, -1, 2, 7, 10**9, 10**18, 10**30, -(10**30), 0.5, 1e308, -1e308, 2**53 + 1)
RUBBISH = (b"", b"{", b"[" * 700 + b"]" * 700, b"\xff\xfe\0", b'{"a":' * 600, b"9" * 5000)
ODD = ({}, [], [1], [[]], {"a": {"b": []}}, None, True, False, {"\0": "\0"}, {"x" * 300: 1}, ["x"] * 500)


class Asker:
    """Draws requests from the published contract; everything that it draws comes from its seed."""

    def __init__(self, document: Mapping[str, Any], known: Mapping[str, list[str]], seed: int) -> None:
        self.schemas, self.known = document["components"]["schemas"], known
        self.random = random.Random(seed)

    def address(self, path: str, operation: Mapping[str, Any]) -> str:
        """A path with its parameters filled in, and a query where the route has one."""

        def filled(match: re.Match[str]) -> str:
            name = match[1]
            if name in self.known and self.random.random() < 0.75:
                return self.random.choice(self.known[name])
            return quote(self.text() or "x", safe="", errors="replace")

        address = re.sub(r"\{(\w+)\}", filled, path)
        asked = [one for one in operation.get("parameters", ()) if one["in"] == "query" and self.random.random() < 0.6]
        query = "&".join(f"{one['name']}={quote(self.text(), errors='replace')}" for one in asked)
        return f"{address}?{query}" if query else address

    def text(self) -> str:
        return self.random.choice([*TEXTS, *(one for several in self.known.values() for one in several)])

    def anything(self) -> Any:
        return self.random.choice([self.text(), self.random.choice(NUMBERS), self.random.choice(ODD)])

    def value(self, schema: Mapping[str, Any], wild: float) -> Any:
        """A value of a schema; with probability `wild`, here and anywhere in it, something else."""
        if self.random.random() < wild:
            return self.anything()
        if "$ref" in schema:
            return self.value(self.schemas[schema["$ref"].rpartition("/")[2]], wild)
        several = schema.get("anyOf") or schema.get("oneOf")
        if several:
            return self.value(self.random.choice(several), wild)
        if "enum" in schema:
            return self.random.choice(schema["enum"])
        kind = schema.get("type")
        if kind == "object" and "properties" in schema:
            asked = [
                name
                for name in schema["properties"]
                if name in schema.get("required", ()) or self.random.random() < 0.7
            ]
            return {name: self.value(schema["properties"][name], wild) for name in asked}
        if kind == "object":
            return {self.text(): self.anything() for _ in range(self.random.randrange(4))}
        if kind == "array":
            least = schema.get("minItems", 0)
            size = self.random.randrange(least, schema.get("maxItems", 4) + 1) if least else self.random.randrange(5)
            return [self.value(schema.get("items", {}), wild / 4) for _ in range(min(size, 8))]
        if kind in ("integer", "number"):
            return self.random.choice(NUMBERS)
        return self.random.random() < 0.5 if kind == "boolean" else self.text()

    def body(self, operation: Mapping[str, Any]) -> dict[str, Any]:
        """Arguments of a request: its body as JSON or form, or plain rubbish."""
        content = operation.get("requestBody", {}).get("content", {})
        if not content or self.random.random() < 0.1:
            rubbish = self.random.choice(
                [b"", b"{", b"[" * 700 + b"]" * 700, b"\xff\xfe\0", b'{"a":' * 600, b"9" * 5000]
            )
            kind = self.random.choice(["application/json", "application/x-www-form-urlencoded", "text/plain", ""])
            return {"content": rubbish, "headers": {"content-type": kind} if kind else {}}
        kind = self.random.choice(sorted(content))
        given = self.value(content[kind]["schema"], self.random.choice([0.0, 0.05, 0.3]))
        if kind == "application/json":
            return {"content": json.dumps(given).encode(), "headers": {"content-type": kind}}
        if not isinstance(given, dict):
            return {"data": {"x": str(given)[:100].encode("utf-8", "replace").decode()}}
        return {"data": {k: str(v).encode("utf-8", "replace").decode() for k, v in given.items()}}


@pytest.fixture(params=["sqlite", "postgresql"])
def installation(
    request: pytest.FixtureRequest, walked_services: tuple[Path, Walked], tmp_path: Path
) -> Iterator[Services]:
    """A study that people have walked through, and nobody's browser."""
    data = shutil.copytree(walked_services[0], tmp_path / "data")
    file = data / "desirepath.sqlite"
    if request.param == "sqlite":
        services = build_services(Settings(data=data, _env_file=None))
        yield services
        services.database.close()
        return
    with postgres.holding(request.getfixturevalue("postgres_server"), file) as url:
        services = build_services(Settings(data=data, database_url=url, _env_file=None))
        yield services
        services.database.close()


def known_words(services: Services, walked: Walked, people: TestClient) -> dict[str, list[str]]:
    """What leads somewhere, by the names of path parameters: sessions at several places among them."""
    with services.database.session() as s:
        link = s.scalars(select(Study.recruiting_token).where(Study.id == walked.id)).one()
    tokens = []
    for k in range(4):
        body = {"language": "en", "simulated": k % 2 == 1}
        tokens.append(people.post(f"/join/{link}", json=body).json()["token"])
    for token in tokens[2:]:
        submit(people, token, "information", {})
    return {
        "token": tokens,
        "recruiting_token": [link],
        "key": ["information", "consent", "block.01"],
        "study_id": [walked.id],
        "code": [walked.finished, walked.half_way, walked.fresh, walked.bot],
        "who": ["people", "simulated"],
        "number": ["0", "3"],
        "name": ["experimenter"],
        "kind_name": ["train", "align"],
    }


def as_viewer(services: Services, application: FastAPI) -> TestClient:
    """The browser of somebody who may only look."""
    password = add_user(services.database, "viewer", "viewer")
    with services.database.transaction() as s:
        s.execute(update(User).where(User.name == "viewer").values(must_change_password=False))
    browser = TestClient(application, follow_redirects=False, client=HERE, raise_server_exceptions=False)
    return sign_in(browser, "viewer", password)


@pytest.mark.parametrize("seed", SEEDS, ids=["fixed", "drawn"])
@pytest.mark.timeout(600)
def test_no_request_whatsoever_fails_on_our_side(
    installation: Services, walked: Walked, seed: int, tmp_path: Path
) -> None:
    print(f"DESIREPATH_FUZZ_SEED={seed}")
    application = create_application(installation)
    document = openapi_of(application)
    failed = []
    with TestClient(application, follow_redirects=False, client=HERE, raise_server_exceptions=False) as browser:
        asker = Asker(document, known_words(installation, walked, browser), seed)
        browsers = [sign_in(browser), as_viewer(installation, application)]
        tokens = [csrf(one) for one in browsers]
        routes = [one for one in operations(document) if one[0][1] not in LEFT_OUT]
        for number, ((method, path), operation) in enumerate(routes * REQUESTS_PER_ROUTE):
            address, body = asker.address(path, operation), asker.body(operation) if method == "post" else {}
            who = int(asker.random.random() < 0.2)  # else the owner, who may do everything
            headers = body.pop("headers", {}) | ({"X-CSRF": tokens[who]} if asker.random.random() < 0.9 else {})
            installation.limiter.storage.reset()  # or most would be refused for being too many
            answered = browsers[who].request(method, address, headers=headers, **body)
            if answered.status_code >= 500:
                failed.append((number, method, path, address[:200], str(body)[:300], answered.text[:100]))
            if answered.status_code == 401 and who == 0:
                tokens[0] = csrf(sign_in(browser))
    assert not failed
    with installation.database.session() as s:
        assert s.scalars(select(User.name)).all()
    export_study(installation.database, installation.files, walked.id, tmp_path / "out")
