"""An installation with a signed-in experimenter, and a study that people have walked through, for the tests of /lab."""

from __future__ import annotations

import re
import shutil
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select, update

from desirepath.learning.shipped_files import resolve
from desirepath.settings import Settings
from desirepath.store.artefacts import save_artefact
from desirepath.store.models import Job, ProblemReport, Session, Study, StudyRole, TrajectoryRow, User, utc_now
from desirepath.store.outbox import enqueue_job
from desirepath.store.shipped_policies import policy_artefact, register_shipped
from desirepath.store.snapshots import take_snapshot
from desirepath.study.protocol.freezing import find_shipped_protocols, freeze
from desirepath.study.session import machine
from desirepath.study.session.finding import acting
from desirepath.study.session.joining import join_study
from desirepath.study.studies import create_study
from desirepath.web.application import build_services, create_application
from desirepath.web.core.auth import add_user, change_password, ensure_first_user
from desirepath.web.core.dependencies import Application, Services
from tests.answered_study import add_answered_study

PASSWORD = "seven quiet robots"
NAME = "Corridor pilot"
QUICK = next(file for file in find_shipped_protocols() if file.stem == "quick_preference_study")
ITEMS = (
    *("ease", "confidence", "mental_effort", "clarity", "naturalness"),
    *("spatial_understanding", "realism", "presence", "fun", "boredom"),
)
VALUES = {
    "information": {},
    "consent": {"given": True, "version": "2026-11"},
    "demographics": {"age": 44, "gender": "woman", "vision": "normal", "vr_experience": 1, "robotics_experience": 3},
    "instruction": {},
    "train.interface_items": dict.fromkeys(ITEMS, 4),
}


@pytest.fixture(scope="session")
def fresh_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data folder of an installation with one user, who changed the first password to PASSWORD; tests copy it."""
    data = tmp_path_factory.mktemp("installation") / "data"
    services = build_services(Settings(data=data, _env_file=None))
    first = ensure_first_user(services.database)
    assert first is not None
    with services.database.session() as s:
        user_id = s.scalars(select(User.id)).one()
    change_password(services.database, user_id, first, PASSWORD)
    services.database.close()
    return data


@pytest.fixture
def lab_services(
    request: pytest.FixtureRequest, tmp_path: Path, database_of: Callable[[Path], str]
) -> Iterator[Services]:
    """Services without a stage; with what a test asks for of `two_studies` and `walked`, else without studies."""
    if "two_studies" in request.fixturenames:
        data = request.getfixturevalue("two_studies_data")[0]
    elif "walked" in request.fixturenames:
        data = request.getfixturevalue("walked_services")[0]
    else:
        data = request.getfixturevalue("fresh_data")
    own = shutil.copytree(data, tmp_path / "data")
    found = build_services(Settings(data=own, database_url=database_of(own), _env_file=None))
    yield found
    found.database.close()


@pytest.fixture
def visitor(lab_services: Services) -> Iterator[TestClient]:
    """A browser in which nobody is signed in; does not follow redirects."""
    with TestClient(create_application(lab_services), follow_redirects=False) as client:
        yield client


def sign_in(client: TestClient, name: str = "experimenter", password: str = PASSWORD) -> TestClient:
    answered = client.post("/lab/sign-in", data={"name": name, "password": password})
    assert answered.status_code == 303, answered.text
    return client


@pytest.fixture
def lab(visitor: TestClient) -> TestClient:
    """The experimenter's browser."""
    return sign_in(visitor)


@pytest.fixture
def as_role(lab_services: Services) -> Callable[[str], TestClient]:
    """A signed-in browser of somebody who has only this role."""

    def enter(role: str) -> TestClient:
        name, password = f"a-{role}", add_user(lab_services.database, f"a-{role}", role)
        with lab_services.database.transaction() as s:
            s.execute(update(User).where(User.name == name).values(must_change_password=False))
        return sign_in(TestClient(create_application(lab_services), follow_redirects=False), name, password)

    return enter


def csrf(client: TestClient, page: str = "/lab/password") -> str:
    """The token that the forms of a page carry."""
    found = re.search(r'name="csrf" value="([^"]+)"', client.get(page).text)
    assert found
    return found.group(1)


@dataclass(frozen=True)
class Walked:
    """The study and the codes of its people."""

    id: str
    finished: str
    half_way: str
    fresh: str
    bot: str


@pytest.fixture(scope="session")
def walked_services(fresh_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Walked]:
    """Four participants: one finished with a comparison, one in the middle, one new, one simulated in the middle."""
    data = shutil.copytree(fresh_data, tmp_path_factory.mktemp("walked") / "data")
    services = build_services(Settings(data=data, _env_file=None))
    with services.database.transaction() as s:
        study = create_study(s, services.files, freeze(QUICK), name=NAME, created_by=None)
    finished = _walk(services, study, until=None)
    half_way = _walk(services, study, until="block.09", letters="b")
    with services.database.transaction() as s:
        s.add(ProblemReport(session_id=half_way[0], text="The picture <b>froze</b> once."))
    fresh = _walk(services, study, until="information")
    bot = _walk(services, study, until="block.03", simulated=True)
    services.database.close()
    return data, Walked(study.id, finished[1], half_way[1], fresh[1], bot[1])


@pytest.fixture
def walked(walked_services: tuple[Path, Walked]) -> Walked:
    """The study in this test's installation."""
    return walked_services[1]


@pytest.fixture(scope="session")
def two_studies_data(
    walked_services: tuple[Path, Walked], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, SimpleNamespace]:
    """The walked study and another one, each with what was learned from it: see `add_two_studies`; tests copy it."""
    data = shutil.copytree(walked_services[0], tmp_path_factory.mktemp("two_studies") / "data")
    services = build_services(Settings(data=data, _env_file=None))
    found = add_two_studies(services, walked_services[1])
    services.database.close()
    return data, found


@pytest.fixture
def two_studies(two_studies_data: tuple[Path, SimpleNamespace], walked: Walked) -> SimpleNamespace:
    """Both studies in this test's installation."""
    return two_studies_data[1]


def add_two_studies(services: Services, walked: Walked) -> SimpleNamespace:
    """`ours` is the walked study; `theirs` another one. Each with a snapshot, a policy made from it and its job; the
    other study's policy was made on the command line, so that only its lineage tells whose answers it is made of."""
    with services.database.transaction() as s:
        register_shipped(s, services.files)
        base = policy_artefact(s, "study_room/base").id
    theirs = add_answered_study(services.database, services.files, participants=2, answers=6)
    found = SimpleNamespace(ours=walked.id, theirs=theirs, base=base, snapshot={}, policy={}, job={})
    with services.database.transaction() as s:
        for name, study, whose in (("ours", walked.id, "all"), ("theirs", theirs, "simulated")):
            snapshot = take_snapshot(s, services.files, study_id=study, whose=whose)
            job = enqueue_job(s, "align", {"snapshot": snapshot.id}, study_id=study if name == "ours" else None)
            policy = save_artefact(
                s, services.files, kind="policy", name=f"policy of {name}", setup=snapshot.setup,
                content=_policy_of(name), card={"results": {}}, parents=[(snapshot.id, "answers")],
                study_id=job.study_id, job_id=job.id,
            )  # fmt: skip
            found.snapshot[name], found.policy[name], found.job[name] = snapshot.id, policy.id, job.id
    return found


def _policy_of(name: str) -> bytes:
    """The shipped base policy in an archive of its own, so that it is another artefact."""
    archive = BytesIO(resolve("study_room/base").read_bytes())
    with zipfile.ZipFile(archive, "a") as opened:
        opened.comment = name.encode()
    return archive.getvalue()


@pytest.fixture
def colleague(lab_services: Services, two_studies: SimpleNamespace) -> Callable[..., TestClient]:
    """A signed-in browser of somebody with a role in the installation, and others in our study."""
    application = create_application(lab_services)
    return lambda everywhere, *here: enter_as(application, two_studies.ours, everywhere, *here)


def enter_as(application: Application, study_id: str, everywhere: str, *here: str) -> TestClient:
    """A new account with a role in the installation and others in one study, signed in in a browser of its own."""
    database, name = application.services.database, "-".join(("a", everywhere, *here))
    password = add_user(database, name, everywhere)
    with database.transaction() as s:
        s.execute(update(User).where(User.name == name).values(must_change_password=False))
        user = s.scalars(select(User).where(User.name == name)).one()
        s.add_all(StudyRole(user_id=user.id, study_id=study_id, role=one, given_by="x") for one in here)
    return sign_in(TestClient(application, follow_redirects=False), name, password)


def _walk(
    services: Services, study: Study, *, until: str | None, letters: str = "aab", simulated: bool = False
) -> tuple[str, str]:
    """Answer every step before `until` on a clock of our own that ends now, with these letters in turn. Returns session
    id and participant code."""
    now = utc_now() - timedelta(minutes=20)
    with services.database.transaction() as s:
        session, token = join_study(s, study, language="en", simulated=simulated, files=services.files)
        session_id, code = session.id, session.participant.code
    while True:
        with services.database.session() as s:
            view = machine.current(s, s.get_one(Session, session_id))
        if view.key == until or view.kind == "debriefing":
            break
        value = VALUES.get(view.key, {"choice": letters[view.index % len(letters)]})
        if view.kind == "meet_your_robot":
            value = {"agreement": 4, "weights": view.payload["start"]}
        if view.kind == "wait":
            _finish_training(services, session_id)
        with acting(services.database, token, request="test", now=now) as (s, session):
            if view.kind == "wait":
                machine.settle(s, services.files, session, now=now)
                continue
            if view.kind in ("trial", "comparison"):
                drives = {"a": view.trial["duration_a_s"], "b": view.trial["duration_b_s"]}
                play = machine.start_trial(s, session, view.key, request_id=None, now=now)
                for drive, seconds in drives.items():
                    now += timedelta(seconds=seconds + 2.5)
                    play = machine.trajectory_seen(s, session, view.key, drive, play.playback_id, now=now)
                now += timedelta(seconds=1.5)
            request_id = f"{session_id}-{view.key}"
            machine.submit(s, services.files, session, view.key, value, request_id=request_id, client_time=now, now=now)
    with acting(services.database, token, request="test", now=utc_now()):
        pass  # the page was heard of just now
    return session_id, code


def _finish_training(services: Services, session_id: str) -> None:
    """Write what a training would have left: it takes most of a minute, and jobs have tests of their own."""
    with services.database.transaction() as s:
        job = s.scalars(select(Job).where(Job.session_id == session_id)).first()
        drives = list(s.scalars(select(TrajectoryRow.id).order_by(TrajectoryRow.id).limit(12)))
        pairs = [{"base": drives[2 * n], "own": drives[2 * n + 1], "look_alike": n == 2} for n in range(6)]
        job.state, job.result = "succeeded", {"policy": "0" * 64, "passed": True, "comparisons": pairs}
