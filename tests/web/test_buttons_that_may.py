"""Nobody is shown a button or a link that answers "your role does not allow this"."""

from __future__ import annotations

import html
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urljoin, urlsplit

import pytest

from desirepath.settings import Settings
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Application
from desirepath.web.core.roles import ROLES
from tests.web.lab_services import Walked, add_two_studies, enter_as

FORM = re.compile(r'<form[^>]*method="post"[^>]*action="([^"]*)"')
LINK = re.compile(r'<a [^>]*href="([^"#]*)')
LEFT_ALONE = ("/lab/sign-out", "/lab/language", "report.zip", ".onnx", "policy.zip")  # slow, or leave the role
ID = re.compile(r"[0-9a-f]{16,64}|P-[A-Z0-9]+|S\d{3}|(?<=preview/)\d+")
IN_THE_STUDY = (("viewer",), ("analyst",), ("experimenter",), ("experimenter", "analyst"), ("owner",))
COMBINED = [(role, ()) for role in ROLES] + [("member", here) for here in IN_THE_STUDY]
COMBINED += [("viewer", ("analyst",)), ("analyst", ("experimenter",))]


def named(one: str | tuple[str, ...]) -> str:
    return one if isinstance(one, str) else "+".join(one)


@pytest.fixture(scope="module")
def installation(
    walked_services: tuple[Path, Walked], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Application, SimpleNamespace]]:
    """One for all roles, as nothing that is asked of it here changes it: what pages draw is drawn once."""
    data, walked = walked_services
    own = shutil.copytree(data, tmp_path_factory.mktemp("for_all_roles") / "data")
    services = build_services(Settings(data=own, _env_file=None))
    yield create_application(services), add_two_studies(services, walked)
    services.database.close()


@pytest.mark.parametrize(("everywhere", "here"), COMBINED, ids=named)
def test_every_link_and_button_of_every_page_is_one_that_the_roles_may_use(
    installation: tuple[Application, SimpleNamespace], walked: Walked, everywhere: str, here: tuple[str, ...]
):
    application, two_studies = installation
    browser = enter_as(application, walked.id, everywhere, *here)
    ours = f"/lab/studies/{walked.id}"
    waiting = ["/lab/studies", "/lab/password"]
    if ROLES[everywhere] or here:
        waiting += [f"{ours}/now", f"{ours}/people/{walked.finished}", f"{ours}/team", "/lab/policies", "/lab/jobs"]
        waiting += [f"/lab/policies/{two_studies.policy['ours']}", f"/lab/jobs/{two_studies.job['ours']}"]
        waiting += [f"/lab/policies/{two_studies.base}", f"/lab/snapshots/{two_studies.snapshot['ours']}"]
    seen: set[str] = set()
    kinds: set[tuple[str, str, str]] = set()  # one page of every route and study is enough
    posted: set[str] = set()
    while waiting:
        address = waiting.pop()
        path = urlsplit(address).path
        foreign = two_studies.theirs if two_studies.theirs in path else ""
        kind = (ID.sub("ID", path), urlsplit(address).query.partition("=")[0], foreign)
        if kind in kinds or not path.startswith("/lab") or any(one in path for one in LEFT_ALONE):
            continue
        kinds.add(kind)
        if foreign and ROLES[everywhere]:
            continue  # may be looked at; it has answers and no protocol
        answered = browser.get(address)
        assert answered.status_code not in (403, 500), f"{everywhere} {here} is led to {address}"
        seen.add(path)
        if "text/html" not in answered.headers.get("content-type", ""):
            continue
        for action in FORM.findall(answered.text):
            target = urlsplit(urljoin(path, html.unescape(action))).path
            if ID.sub("ID", target) in posted or target in LEFT_ALONE:
                continue
            posted.add(ID.sub("ID", target))
            said = browser.post(target)  # without the form's token, so that nothing happens
            assert said.status_code == 403, (address, target)
            assert "This form is out of date" in said.text, f"{everywhere} {here} is shown {target} on {address}"
        waiting += [urljoin(address, html.unescape(link)) for link in LINK.findall(answered.text)]
    assert len(seen) > (20 if ROLES[everywhere] or here else 1), seen
