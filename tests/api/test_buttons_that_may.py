"""Nobody is shown a button or a link that answers "your role does not allow this"."""

from __future__ import annotations

import html
import re
from urllib.parse import urljoin, urlsplit

import pytest

from backend.api.core.roles import CHANGING, ROLES, Rule, may
from tests.api.lab_services import Walked

FORM = re.compile(r'<form[^>]*method="post"[^>]*action="([^"]*)"')
LINK = re.compile(r'<a [^>]*href="([^"#]*)')
LEFT_ALONE = ("/lab/sign-out", "/lab/language", "report.zip", ".onnx", "policy.zip")  # slow, or leave the role


ID = re.compile(r"[0-9a-f]{16,64}|P-[A-Z0-9]+|S\d{3}|(?<=preview/)\d+")


def rule_for(path: str) -> Rule | None:
    """The rule of what is posted there."""
    patterns = sorted(CHANGING, key=lambda pattern: pattern.count("{"))
    return next((CHANGING[one] for one in patterns if re.fullmatch(re.sub(r"\{[^}]+\}", "[^/]+", one), path)), None)


@pytest.mark.parametrize("role", ROLES)
def test_every_link_and_button_of_every_page_is_one_that_the_role_may_use(as_role, walked: Walked, role: str):
    browser = as_role(role)
    here = f"/lab/studies/{walked.id}"
    waiting = ["/lab/studies", here + "/now", f"{here}/people/{walked.finished}", "/lab/policies", "/lab/jobs"]
    seen: set[str] = set()
    kinds: set[tuple[str, str]] = set()  # one page of every route is enough
    while waiting:
        address = waiting.pop()
        path = urlsplit(address).path
        kind = (ID.sub("ID", path), urlsplit(address).query.partition("=")[0])
        if kind in kinds or not path.startswith("/lab") or any(one in path for one in LEFT_ALONE):
            continue
        kinds.add(kind)
        answered = browser.get(address)
        assert answered.status_code != 403, f"{role} is led to {address}"
        seen.add(path)
        if "text/html" not in answered.headers.get("content-type", ""):
            continue
        for action in FORM.findall(answered.text):
            target = urlsplit(urljoin(path, html.unescape(action))).path
            rule = rule_for(target)
            assert rule is not None, (address, target)
            assert may(role, rule.right), f"{role} is shown a button for {target} on {address}"
        waiting += [urljoin(address, html.unescape(link)) for link in LINK.findall(answered.text)]
    assert len(seen) > 20, seen
