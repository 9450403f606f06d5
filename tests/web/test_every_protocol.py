"""Every page that the lab has about a study, opened for every protocol that comes with the product."""

from __future__ import annotations

import html
import re
from pathlib import Path
from urllib.parse import urljoin, urlsplit

import pytest

from desirepath.study.protocol.freezing import find_shipped_protocols, freeze
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import create_study
from tests.web.test_buttons_that_may import ID, LINK

MADE_IN_THE_BACKGROUND = (".zip", "/analysis/")  # their own tests wait for them


@pytest.mark.parametrize("protocol", find_shipped_protocols(), ids=lambda path: path.stem)
def test_every_page_of_a_study_of_every_shipped_protocol_opens(protocol: Path, lab, lab_services) -> None:
    services = lab_services
    with services.database.transaction() as s:
        study = create_study(s, services.files, freeze(protocol), name="Shipped", created_by=None)
    walk_in_process(services.database, services.files, study, 1, without_jobs=True)
    ours = f"/lab/studies/{study.id}"
    waiting = [f"{ours}/now", f"{ours}/people?show=simulated", f"{ours}/report?who=simulated"]
    seen: set[tuple[str, str]] = set()
    while waiting:
        address = waiting.pop()
        path, query = urlsplit(address).path, urlsplit(address).query
        sort = ID.sub("ID", path), query.partition("=")[0]
        if sort in seen or not path.startswith(ours) or any(part in path for part in MADE_IN_THE_BACKGROUND):
            continue
        seen.add(sort)
        answered = lab.get(address)
        assert answered.status_code < 400, f"{address}: {answered.status_code}"
        if path.endswith("/learnt"):  # what long pages ask for afterwards
            assert lab.get(address, headers={"X-Fragment": "1"}).status_code == 200
        if "text/html" in answered.headers.get("content-type", ""):
            waiting += [urljoin(address, html.unescape(link)) for link in LINK.findall(answered.text)]
        code = re.search(rf"{ours}/people/([\w-]+)", answered.text)
        if code and path.endswith("/people"):  # linked or not: nobody types an address and meets a fault
            assert lab.get(f"{ours}/people/{code[1]}/learnt").status_code in (200, 404)
    assert len(seen) > 10, seen
