"""Every published route is asked for what nobody would ask: whatever comes, nothing fails on our side, and what is
answered is what the contract says.

Bounded: some requests per route, on SQLite with a fixed seed, and where PostgreSQL's programs are installed on that,
which is stricter about texts, with one that is drawn anew and printed (`DESIREPATH_FUZZ_SEED` runs it again).
"""

from __future__ import annotations

import json
import os
import random
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice, product
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import jsonschema
import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute
from fastapi.testclient import TestClient
from sqlalchemy import select, update

from desirepath.settings import Settings
from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Artefact, Job, Response, Study, User
from desirepath.store.shipped_policies import register_shipped
from desirepath.web.application import build_services, create_application
from desirepath.web.core.auth import add_user
from desirepath.web.core.dependencies import Services
from desirepath.web.core.media import MEDIA
from desirepath.web.core.published import openapi_of, operations
from desirepath.web.lab.drafts import draft_from_shipped
from tests import postgres
from tests.answered_study import add_answered_study
from tests.web.analyst_services import work_with
from tests.web.lab_services import Walked, csrf, sign_in
from tests.web.participant_services import submit

REQUESTS_PER_ROUTE = int(os.environ.get("DESIREPATH_FUZZ_REQUESTS") or 2)
SEEDS = (2026, int(os.environ.get("DESIREPATH_FUZZ_SEED") or random.SystemRandom().randrange(10**6)))
DATABASES = ("sqlite", "postgresql")
HERE = ("127.0.0.1", 50_000)
# These end the sign-in that the others need, or never end; each has tests of its own.
LEFT_OUT = {"/lab/sign-out", "/lab/password", "/api/session/{token}/stream"}
# Not published: they lead elsewhere, or are the contract itself.
UNLISTED = {"/", "/lab", "/metrics", "/api/docs", "/api/docs/openapi.json"}
FORMS = {"application/x-www-form-urlencoded", "multipart/form-data"}
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
        if "const" in schema:
            return schema["const"]
        if "enum" in schema:
            return self.random.choice(schema["enum"])
        kind = schema.get("type")
        if kind == "object" and "properties" in schema:
            said, needed = schema["properties"], schema.get("required", ())
            asked = [name for name in said if name in needed or self.random.random() < 0.7]
            return {name: self.known_or(name, said[name], wild) for name in asked}
        if kind == "object":
            return {self.text(): self.anything() for _ in range(self.random.randrange(4))}
        if kind == "array":
            least = schema.get("minItems", 0)
            size = self.random.randrange(least, schema.get("maxItems", 4) + 1) if least else self.random.randrange(5)
            return [self.value(schema.get("items", {}), wild / 4) for _ in range(min(size, 8))]
        if kind in ("integer", "number"):
            return self.random.choice(NUMBERS)
        return self.random.random() < 0.5 if kind == "boolean" else self.text()

    def known_or(self, name: str, schema: Mapping[str, Any], wild: float) -> Any:
        """What leads somewhere by that name, or a value of the schema."""
        if name in self.known and self.random.random() < 0.5:
            return self.random.choice(self.known[name])
        return self.value(schema, wild)

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


@pytest.fixture(scope="session")
def busy_data(walked_services: tuple[Path, Walked], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The walked study, another one of simulated participants, and what analysts made of that."""
    data = shutil.copytree(walked_services[0], tmp_path_factory.mktemp("busy") / "data")
    services = build_services(Settings(data=data, _env_file=None))
    with services.database.transaction() as s:
        register_shipped(s, services.files)
    work_with(services, add_answered_study(services.database, services.files, participants=2, answers=8))
    services.database.close()
    return data


@pytest.fixture
def installation(request: pytest.FixtureRequest, busy_data: Path, tmp_path: Path) -> Iterator[Services]:
    """Studies that people have walked through and analysts have worked with, and nobody's browser."""
    data = shutil.copytree(busy_data, tmp_path / "data")
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
    with services.database.session() as s:
        jobs = list(s.scalars(select(Job.id)))
        answers = [  # some that can be replayed, some that cannot
            one
            for seen in (Response.trial_id.is_not(None), Response.trial_id.is_(None))
            for one in s.scalars(select(Response.id).where(seen).limit(3))
        ]
        artefacts = list(s.scalars(select(Artefact.id).where(Artefact.kind.in_(("evaluation", "snapshot"))))) * 3
        artefacts += s.scalars(select(Artefact.id).where(Artefact.kind.in_(("policy", "reward_model"))))
        policies = ["study_room/base", "open_field/base", *artefacts[-2:]]
    draft = draft_from_shipped(services.settings.data, "quick_preference_study")
    return {
        "token": tokens,
        "recruiting_token": [link],
        "key": ["information", "consent", "block.01"],
        "study_id": [walked.id],
        "study": [walked.id],
        "code": [walked.finished, walked.half_way, walked.fresh, walked.bot],
        "who": ["people", "simulated"],
        "number": ["0", "3"],
        "setup": ["study_room"],
        "name": [
            "base",
            "policies-light.webp",
            "experimenter",
            "transitions",
            "experimenters-guide",
            "report.html",
            "first_seed=1.svg",
        ],
        "kind_name": ["train", "align", "compare", "evaluate"],
        "job_id": jobs,
        "artefact_id": artefacts,
        "response_id": answers,
        "draft_id": [draft.id],
        "policy": policies,
        "policy_a": policies,
        "policy_b": policies,
        "snapshot": artefacts[:3],
        "measure": ["time_s", "path_length_m"],
        "scene": ["0", "1", "29"],
        "environment": ["corridor", "room"],
        "pair": ["0", "3"],
        "side": ["a", "b"],
    }


def as_viewer(services: Services, application: FastAPI) -> TestClient:
    """The browser of somebody who may only look."""
    password = add_user(services.database, "viewer", "viewer")
    with services.database.transaction() as s:
        s.execute(update(User).where(User.name == "viewer").values(must_change_password=False))
    browser = TestClient(application, follow_redirects=False, client=HERE, raise_server_exceptions=False)
    return sign_in(browser, "viewer", password)


def astray(document: Mapping[str, Any], operation: Mapping[str, Any], answered: httpx.Response) -> str | None:
    """What of an answer is not what the contract says."""
    media, status = answered.headers.get("content-type", "").partition(";")[0], answered.status_code
    if status >= 500:
        return f"{status}: {answered.text[:200]}"
    if 300 <= status < 400 or (media == "text/html" and status >= 400):
        return None
    if status >= 400:
        schema: Any = {"$ref": "#/components/schemas/Refusal"}
    else:
        published = operation["responses"].get(str(status), {}).get("content", {})
        if media not in published and (published or answered.content):
            return f"{status} {media or 'nothing'}, published is {sorted(published)}"
        schema = published.get(media, {}).get("schema") if media == "application/json" else None
    if schema is not None:
        wrong = jsonschema.Draft202012Validator({**schema, "components": document["components"]})
        for error in wrong.iter_errors(answered.json()):
            return f"{status}: {error.json_path} {error.message[:200]}"
    return None


@pytest.mark.parametrize(
    ("installation", "seed"), list(zip(DATABASES, SEEDS, strict=True)), ids=DATABASES, indirect=["installation"]
)
@pytest.mark.timeout(600)
def test_no_request_whatsoever_fails_on_our_side(
    installation: Services, walked: Walked, seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with capsys.disabled():  # told at once, or a run that is killed would keep it to itself
        print(f"DESIREPATH_FUZZ_SEED={seed}", flush=True)
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
            if wrong := astray(document, operation, answered):
                failed.append((number, method, path, address[:200], str(body)[:300], wrong))
            if answered.status_code == 401 and who == 0:
                tokens[0] = csrf(sign_in(browser))
    assert not failed, f"DESIREPATH_FUZZ_SEED={seed}: {failed}"
    with installation.database.session() as s:
        assert s.scalars(select(User.name)).all()
    export_study(installation.database, installation.files, walked.id, tmp_path / "out")


# Nothing that these show is here: no path was drawn, no draft is of a running study's next protocol.
NOT_THERE = {
    "/lab/studies/{study_id}/paths/{environment}-{pair}.svg",
    "/lab/studies/{study_id}/paths/{environment}-{pair}.csv",
    "/lab/studies/{study_id}/revise/{draft_id}",
    "/lab/studies/{study_id}/revise/{draft_id}/preview/{number}",
    # no OpenID provider is set here; with one: test_openid.py
    "/lab/sign-in/openid",
    "/lab/sign-in/openid/return",
    "/lab/account/identity/begin",
    # the study asks nothing in one's own words, and nobody thinks aloud
    "/lab/studies/{study_id}/voices/{response_id}.webm",
    "/lab/studies/{study_id}/coding/{item}",
    "/lab/studies/{study_id}/coding/{item}/differences",
    "/lab/studies/{study_id}/coding/{item}/codings.csv",
    # nobody asked for these figures and ways, no session stands at a trial
    "/api/session/{token}/trial-data",
    "/lab/attention/outcome",
    "/lab/compare/policies.csv",
    "/lab/compare/policies.svg",
    "/lab/explain/figures",
    "/lab/flow-field/figure",
    "/lab/flow-field/{name}",
    "/lab/explain/{letter}/{name}",
    "/lab/live/paths",
    "/lab/new/{draft_id}/power/{name}",
    "/lab/studies/{study_id}/power/{name}",
    # nothing of others was uploaded: test_recording_uploads.py, test_setup_pages.py, test_reward_files.py
    "/api/lab/recordings/{draft_id}",
    "/lab/recordings/{draft_id}",
    "/lab/recordings/{draft_id}/videos/{name}",
    "/lab/settings/setups/{name}/setup.zip",
    "/lab/settings/setups/{name}/picture.png",
    "/lab/rewards/{artefact_id}",
    "/lab/rewards/{artefact_id}/plan.svg",
    "/lab/rewards/{artefact_id}/steps.csv",
    # no robot was let in: test_robots.py
    "/api/robot",
    "/api/robot/bundle",
    "/api/robot/orders",
    "/api/session/{token}/robot/{key}/stream",
    "/api/lab/studies/{study_id}/robots/{robot_id}/stream",
    "/lab/studies/{study_id}/robots/{robot_id}",
    "/lab/studies/{study_id}/robot-runs/{run_id}.mcap",
    # no study shows videos: frontend/test_video_study.py
    "/api/session/{token}/trials/{key}/video/{side}",
    "/lab/videos/{artefact_id}",
}
FULL_REPORT = "/lab/studies/{study_id}/analysis/"  # another process makes it: tests/web/test_analysis_pages.py


def every_route(routes: Iterable[Any]) -> Iterator[APIRoute]:
    """The routes of an application, those of its routers too."""
    for route in routes:
        if isinstance(route, APIRoute):
            yield route
        elif hasattr(route, "original_router"):
            yield from every_route(route.original_router.routes)


def test_every_page_and_file_is_answered_as_published(busy_data: Path, walked: Walked, tmp_path: Path) -> None:
    """A route is a page, a file, a stream, or JSON of a model: whoever adds one that is none of these finds it here."""
    services = build_services(Settings(data=shutil.copytree(busy_data, tmp_path / "data"), _env_file=None))
    application = create_application(services)
    document = openapi_of(application)
    assert {one.path for one in every_route(application.routes) if not one.include_in_schema} == UNLISTED
    for (method, path), operation in operations(document):
        sent = operation.get("requestBody", {}).get("content", {})
        assert set(sent) <= {*FORMS, "application/json", "application/octet-stream", "audio/webm"}, (method, path)
        for status, told in operation["responses"].items():
            content = told.get("content", {})
            assert set(content) <= {*MEDIA.values(), "text/event-stream", "video/mp4", "video/webm", "audio/webm"}, (
                method,
                path,
                status,
            )
            if path.endswith((".json", "/content", "/{name}")):
                continue  # a file
            for schema in (one["application/json"]["schema"] for one in (sent, content) if "application/json" in one):
                assert "$ref" in schema or schema["title"] == "Joining", f"{method} {path}: JSON of no model"
    with TestClient(application, follow_redirects=False, client=HERE, raise_server_exceptions=False) as browser:
        known = known_words(services, walked, browser)
        sign_in(browser)
        unseen, wrong = set(), []
        for (method, path), operation in operations(document):
            if method != "get" or path in LEFT_OUT or path.startswith(FULL_REPORT):
                continue
            names = re.findall(r"\{(\w+)\}", path)
            seen = False
            tries = 5 if path in NOT_THERE else 300
            for words in islice(product(*(known.get(name, ["x"]) for name in names)), tries):
                services.limiter.storage.reset()
                answered = browser.get(re.sub(r"\{\w+\}", "{}", path).format(*words))
                if told := astray(document, operation, answered):
                    wrong.append((path, words, told))
                seen = seen or answered.is_success or answered.is_redirect
                if answered.is_success:
                    break
            if not seen:
                unseen.add(path)
    services.database.close()
    assert wrong == []
    assert unseen <= NOT_THERE, sorted(unseen - NOT_THERE)
