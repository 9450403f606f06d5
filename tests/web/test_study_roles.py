"""Roles in single studies: they add up, hold in that study only, and are given by its owners."""

from __future__ import annotations

import re

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import delete, select

from desirepath.store.models import Artefact, Audit, Job, Study, StudyRole, User
from desirepath.store.outbox import enqueue_job
from desirepath.web.core.roles import CHANGING, Right, rights_of, rule_of
from tests.web.lab_services import NAME, csrf

REFUSED = "Your role does not allow this"


def test_roles_add_up():
    found = rights_of("viewer", [("a", "analyst"), ("a", "experimenter"), ("b", "owner")])
    assert found.may(Right.ANALYSE, "a")
    assert found.may(Right.RUN, "a")
    assert not found.may(Right.MANAGE, "a")
    assert found.may(Right.MANAGE, "b")
    assert not found.may(Right.MANAGE)  # of the installation
    assert found.may(Right.LOOK, "c")
    assert not found.may(Right.ANALYSE, "c")
    assert found.studies(Right.LOOK) is None
    assert found.studies(Right.RUN) == {"a", "b"}


def test_who_has_no_role_in_any_study_is_told_so_and_sees_nothing(colleague, two_studies):
    stranger = colleague("member")
    listed = stranger.get("/lab/studies")
    assert listed.status_code == 200
    assert "You have no role in any study yet" in listed.text
    assert two_studies.ours not in listed.text
    for page in (
        f"/lab/studies/{two_studies.ours}/now",
        "/lab/jobs",
        "/lab/policies",
        "/lab/snapshots",
        "/lab/compare",
    ):
        assert stranger.get(page).status_code == 403, page
    assert stranger.get("/lab/password").status_code == 200


@pytest.mark.parametrize("roles", [("viewer",), ("experimenter", "analyst"), ("owner",)], ids="+".join)
def test_a_role_in_one_study_opens_nothing_of_another(colleague, two_studies, visitor, roles):
    member = colleague("member", *roles)
    paths = visitor.app.openapi()["paths"]
    named = {
        "study_id": two_studies.theirs,
        "artefact_id": two_studies.policy["theirs"],
        "job_id": two_studies.job["theirs"],
    }
    tried = 0
    for path, methods in paths.items():
        found = [name for name in named if f"{{{name}}}" in path]
        if not found or not path.startswith(("/lab", "/api/lab")):
            continue
        for method in methods:
            address = re.sub(r"\{[^}]*\}", "x", path.replace(f"{{{found[0]}}}", named[found[0]]))
            if rule_of(method.upper(), path) is None or "{pair}" in path:
                continue
            said = member.request(method.upper(), address)
            assert said.status_code == 403, (method, path)
            tried += 1
    assert tried > 60
    their_snapshot = f"/lab/snapshots/{two_studies.snapshot['theirs']}"
    assert member.get(their_snapshot).status_code == 403
    assert member.get(f"/lab/snapshots/{two_studies.snapshot['ours']}").status_code == 200
    assert member.get(f"/lab/flow-field?policy_a={two_studies.policy['theirs']}").status_code == 404


def test_lists_hold_what_is_ours_and_what_belongs_to_no_study(colleague, two_studies):
    member = colleague("member", "analyst")
    pages = {page: member.get(page).text for page in ("/lab/studies", "/lab/jobs", "/lab/snapshots", "/lab/policies")}
    everything = "".join(pages.values())
    for name in ("snapshot", "policy", "job"):
        assert getattr(two_studies, name)["ours"] in everything, name
        assert getattr(two_studies, name)["theirs"] not in everything, name
    assert two_studies.theirs not in everything
    assert two_studies.base in pages["/lab/policies"]
    assert two_studies.policy["theirs"] not in member.get(f"/lab/policies/{two_studies.base}").text
    form = member.get("/lab/jobs/new/align").text
    assert two_studies.snapshot["ours"] in form
    assert two_studies.snapshot["theirs"] not in form


def test_an_experimenter_of_a_study_may_be_given_the_right_to_start_jobs_in_it(colleague, two_studies, lab_services):
    both = colleague("member", "experimenter", "analyst")
    assert both.get(f"/lab/studies/{two_studies.ours}/recruit").status_code == 200
    form = {"csrf": csrf(both), "policy": two_studies.base, "scenes": "20", "seed": "0"}
    started = both.post("/lab/jobs/new/evaluate", data=form)
    assert started.status_code == 303, started.text
    with lab_services.database.session() as s:
        job = s.get_one(Job, started.headers["location"].rsplit("/", 1)[1])
    assert job.study_id == two_studies.ours  # of what belongs to no study, but theirs to cancel
    assert both.post(f"/lab/jobs/{job.id}/cancel", data={"csrf": csrf(both)}).status_code == 303
    page = both.get("/lab/jobs/new/evaluate").text
    assert f"It will belong to the study “{NAME}”." in page
    with lab_services.database.transaction() as s:
        user = s.scalars(select(User).where(User.name == "a-member-experimenter-analyst")).one()
        s.add(StudyRole(user_id=user.id, study_id=two_studies.theirs, role="analyst", given_by="x"))
    page = both.get("/lab/jobs/new/evaluate").text
    assert f'<option value="{two_studies.ours}">{NAME}</option>' in page
    started = both.post("/lab/jobs/new/evaluate", data=form | {"study": two_studies.ours, "seed": "1"})
    with lab_services.database.transaction() as s:
        job = s.get_one(Job, started.headers["location"].rsplit("/", 1)[1])
        assert job.study_id == two_studies.ours  # not the newest
        s.execute(delete(StudyRole).where(StudyRole.study_id == two_studies.theirs))
    foreign = both.post("/lab/jobs/new/evaluate", data=form | {"policy": two_studies.policy["theirs"]})
    assert foreign.status_code == 422
    assert "belongs to a study in which your role starts no jobs" in foreign.text
    taken = both.post("/lab/snapshots", data={"csrf": csrf(both), "study": two_studies.theirs, "answers": "simulated"})
    assert (taken.status_code, REFUSED in taken.text) == (403, True)
    only_runs = colleague("member", "experimenter")
    assert only_runs.get("/lab/jobs/new").status_code == 403
    assert only_runs.get("/lab/new").status_code == 403  # new studies are the installation's


def test_a_viewer_of_everything_may_be_analyst_of_one_study(colleague, two_studies):
    one = colleague("viewer", "analyst")
    assert one.get(f"/lab/studies/{two_studies.theirs}/answers").status_code == 200
    token = csrf(one)
    for study, status in ((two_studies.ours, 303), (two_studies.theirs, 403)):
        taken = one.post("/lab/snapshots", data={"csrf": token, "study": study, "answers": "all"})
        assert taken.status_code == status, taken.text
    assert f"/lab/jobs/new/align?snapshot={two_studies.snapshot['ours']}" in one.get("/lab/snapshots").text
    assert f"/lab/jobs/new/align?snapshot={two_studies.snapshot['theirs']}" not in one.get("/lab/snapshots").text


def test_what_was_learned_from_another_study_is_looked_at_and_not_taken_away(colleague, two_studies, lab_services):
    """One may look everywhere and is analyst of ours: that opens no file made of the other study's answers."""
    one, theirs, ours = colleague("viewer", "analyst"), two_studies.policy["theirs"], two_studies.policy["ours"]
    shown = one.get(f"/lab/policies/{theirs}")
    assert shown.status_code == 200
    for link in (f"/lab/artefacts/{theirs}/content", f"/lab/policies/{theirs}/policy.zip"):
        assert link not in shown.text
        assert one.get(link).status_code == 403
    assert f"evaluate?policy={theirs}" not in shown.text, "no evaluation of it is offered, which would be refused"
    assert one.get(f"/lab/artefacts/{ours}/content").status_code == 200
    assert f"evaluate?policy={ours}" in one.get(f"/lab/policies/{ours}").text


def test_a_job_that_works_on_both_studies_is_hidden_before_it_has_made_anything(colleague, two_studies, lab_services):
    pair = {"policy_a": two_studies.policy["ours"], "policy_b": two_studies.policy["theirs"]}
    with lab_services.database.transaction() as s:
        job = enqueue_job(s, "compare", pair, study_id=two_studies.ours).id
        alone = enqueue_job(s, "evaluate", {"policy": two_studies.policy["ours"]}, study_id=two_studies.ours).id
    member, everywhere = colleague("member", "analyst"), colleague("viewer")
    assert everywhere.get(f"/lab/jobs/{job}").status_code == 200
    listed = member.get("/lab/jobs").text
    assert (job in listed, alone in listed) == (False, True)
    assert member.get(f"/lab/jobs/{job}").status_code in (403, 404)
    assert member.get(f"/lab/jobs/{alone}").status_code == 200


def test_an_owner_of_the_study_gives_roles_in_it_and_nowhere_else(colleague, two_studies, lab_services):
    owner, ada = colleague("member", "owner"), colleague("member")
    team = f"/lab/studies/{two_studies.ours}/team"
    assert ada.get(team).status_code == 403
    token = csrf(owner)

    def give(**form: object) -> TestClient:
        return owner.post(team, data={"csrf": token, **form})

    assert give(name="a-member", roles=["analyst", "experimenter"]).status_code == 303
    assert ada.get("/lab/jobs/new").status_code == 200  # from the next click on
    assert "/recruit" in ada.get(team).text
    assert "<form" not in ada.get(team).text.partition("<main")[2]  # who may only look is shown no button
    assert ada.post(team, data={"csrf": csrf(ada), "name": "a-member-owner", "roles": []}).status_code == 403
    assert give(name="a-member", roles="king").status_code == 422
    assert give(name="nobody", roles="viewer").status_code == 404
    assert give(name="a-member-owner", roles=[]).status_code == 422  # an owner is always left
    assert owner.post(team.replace(two_studies.ours, two_studies.theirs), data={"csrf": token}).status_code == 403
    assert owner.get("/lab/settings").status_code == 403
    assert give(name="a-member").status_code == 303
    assert ada.get(team).status_code == 403
    with lab_services.database.session() as s:
        done = s.scalars(select(Audit).where(Audit.action == "study_roles_changed", Audit.outcome == "done")).all()
    assert [(one.by, one.study_id, one.data) for one in done] == [
        ("a-member-owner", two_studies.ours, {"name": "a-member", "before": [], "after": ["analyst", "experimenter"]}),
        ("a-member-owner", two_studies.ours, {"name": "a-member", "before": ["analyst", "experimenter"], "after": []}),
    ]


def test_an_account_that_is_removed_has_no_role_left(colleague, lab, lab_services, two_studies):
    colleague("member", "analyst", "viewer")
    assert f"/lab/studies/{two_studies.ours}/team" in lab.get("/lab/settings").text
    gone = lab.post("/lab/settings/accounts/a-member-analyst-viewer/remove", data={"csrf": csrf(lab)})
    assert gone.status_code == 303
    with lab_services.database.session() as s:
        assert s.scalars(select(StudyRole)).all() == []


def test_what_is_made_for_a_study_on_the_command_line_is_that_studys(two_studies, lab_services):
    with lab_services.database.session() as s:
        assert s.get_one(Artefact, two_studies.policy["theirs"]).study_id is None
        assert s.get_one(Study, two_studies.theirs)
    assert "/lab/studies/{study_id}/team" in CHANGING
