"""Roles and the audit log: who may do what on the signed-in pages, and what is kept of it."""

from __future__ import annotations

import re

import pytest
from sqlalchemy import select

from desirepath.store.models import Audit, Note, Participant, Session, Study
from desirepath.web.core.dependencies import Services
from desirepath.web.core.roles import CHANGING, ROLES, SHOWING, Right, Rights, rights_of, rule_of
from tests.web.lab_services import csrf, sign_in


def may(role: str, right: Right | None) -> bool:
    return right is None or rights_of(role).may(right)


def entries(services: Services, **where: str) -> list[Audit]:
    with services.database.session() as s:
        return list(s.scalars(select(Audit).filter_by(**where).order_by(Audit.id)))


def test_every_route_that_changes_something_stands_in_the_table(visitor):
    paths = visitor.app.openapi()["paths"]
    lab = {
        (m.upper(), path) for path, methods in paths.items() if path.startswith(("/lab", "/api/lab")) for m in methods
    }
    known = {("POST", route) for route in CHANGING} | {("GET", route.replace(":path", "")) for route in SHOWING}
    assert known <= lab
    open_to_everybody = [("POST", "/lab/sign-in"), ("POST", "/lab/sign-in/code")]
    assert [one for one in sorted(lab) if rule_of(*one) is None] == open_to_everybody


@pytest.mark.parametrize("role", sorted(ROLES))
def test_a_role_reaches_what_its_rights_say_and_nothing_else(role, as_role):
    client = as_role(role)
    for route, rule in CHANGING.items():  # without a form's token, so that nothing happens where it is allowed
        said = client.post(re.sub(r"\{[^}]*\}", "none", route))
        assert said.status_code == 403
        told = "This form is out of date" if may(role, rule.right) else "Your role does not allow this"
        assert told in said.text, route
    for route, rule in SHOWING.items():
        if not may(role, rule.right):
            said = client.get(re.sub(r"\{[^}]*\}", "none", route))
            assert (said.status_code, "Your role does not allow this" in said.text) == (403, True), route
    listed = client.get("/lab/studies")
    assert (listed.status_code, "/lab/jobs" in listed.text) == (200, may(role, Right.LOOK))


def test_pages_offer_only_what_the_role_may_do(as_role, lab, walked):
    person = f"/lab/studies/{walked.id}/people/{walked.finished}"
    viewer, analyst, experimenter = (as_role(role) for role in ("viewer", "analyst", "experimenter"))
    assert "<form" not in viewer.get(person).text.partition("<main")[2]
    assert "/recruit" not in viewer.get(f"/lab/studies/{walked.id}/now").text
    assert "/lab/settings" not in analyst.get("/lab/studies").text
    assert f"{person}/exclude" in experimenter.get(person).text
    assert f"{person}/erase" in lab.get(person).text
    assert "/export" in analyst.get(f"/lab/studies/{walked.id}/data").text
    assert "/export" not in viewer.get(f"/lab/studies/{walked.id}/data").text
    for data in (f"people/{walked.finished}/learnt.csv", "protocol.yaml", "analysis/people/x.csv"):
        assert viewer.get(f"/lab/studies/{walked.id}/{data}").status_code == 403
    assert "protocol.yaml" not in viewer.get(f"/lab/studies/{walked.id}/protocol").text
    assert "/revise" not in analyst.get(f"/lab/studies/{walked.id}/protocol").text


def test_a_new_role_holds_from_the_next_click_on(lab, lab_services, as_role):
    ada = as_role("viewer")
    assert ada.get("/lab/new").status_code == 403
    token = csrf(lab)
    assert lab.post("/lab/settings/accounts/a-viewer/role", data={"csrf": token, "role": "king"}).status_code == 422
    given = lab.post("/lab/settings/accounts/a-viewer/role", data={"csrf": token, "role": "experimenter"})
    assert given.status_code == 303
    assert ada.get("/lab/new").status_code == 200
    changed = entries(lab_services, action="role_changed")
    assert [(e.by, e.role, e.outcome, e.data) for e in changed] == [
        ("experimenter", "owner", "done", {"name": "a-viewer", "as_role": "experimenter"})
    ]


def test_the_audit_log_keeps_who_did_what_and_what_was_refused(lab, lab_services, as_role, walked):
    person = f"/lab/studies/{walked.id}/people/{walked.half_way}"
    viewer = as_role("viewer")
    assert viewer.post(f"{person}/exclude", data={"csrf": csrf(viewer), "reason": "no"}).status_code == 403
    token = csrf(lab)
    assert lab.post(f"{person}/exclude", data={"csrf": token, "reason": ""}).status_code == 422
    assert lab.post(f"{person}/exclude", data={"csrf": token, "reason": "asleep"}).status_code == 303
    assert lab.post(f"/lab/studies/{walked.id}/state", data={"csrf": token, "state": "closed"}).status_code == 303
    told = [(e.by, e.action, e.outcome, e.data) for e in entries(lab_services) if e.action != "signed_in"]
    assert told == [
        ("a-viewer", "participant_excluded", "refused", {}),
        ("experimenter", "participant_excluded", "done", {}),
        ("experimenter", "study_state_changed", "done", {"state": "closed"}),
    ]
    page = lab.get("/lab/audit?action=participant_excluded").text
    assert page.count(f"/people/{walked.half_way}") == 2
    assert "refused by the role" in page
    assert "No" in lab.get("/lab/audit?by=nobody").text


def test_an_erasure_takes_the_notes_and_the_entries_about_the_person(lab, lab_services, walked):
    person = f"/lab/studies/{walked.id}/people/{walked.half_way}"
    token = csrf(lab)
    assert lab.post(f"{person}/notes", data={"csrf": token, "text": "  "}).status_code == 422
    assert lab.post(f"{person}/notes", data={"csrf": token, "text": "came late"}).status_code == 303
    with lab_services.database.session() as s:
        session_id = s.scalars(select(Session.id).join(Participant).where(Participant.code == walked.half_way)).one()
    about = {"csrf": token, "text": "second try", "session": session_id}
    assert lab.post(f"{person}/notes", data=about).status_code == 303
    foreign = f"/lab/studies/{walked.id}/people/{walked.finished}/notes"
    assert lab.post(foreign, data=about).status_code == 404  # that session is somebody else's
    with lab_services.database.session() as s:
        first, second = s.scalars(select(Note).order_by(Note.created_at)).all()
    assert [(n.text, n.written_by, n.session_id) for n in (first, second)] == [
        ("came late", "experimenter", None),
        ("second try", "experimenter", session_id),
    ]
    assert lab.post(f"{person}/notes/{first.id}/remove", data={"csrf": token}).status_code == 303
    assert "came late" not in lab.get(person).text
    assert "second try" in lab.get(person).text
    assert len(entries(lab_services, action="note_written")) == 2
    with lab_services.database.session() as s:
        typed = s.get_one(Study, walked.id).name
    assert lab.post(f"{person}/erase", data={"csrf": token, "typed": typed}).status_code == 303
    with lab_services.database.session() as s:
        assert s.scalars(select(Note)).all() == []
    assert entries(lab_services, action="note_written") == []
    assert [(e.by, e.participant_id, e.data) for e in entries(lab_services, action="participant_erased")] == [
        ("experimenter", None, {})
    ]


def test_owner_has_every_right_and_viewer_only_looks():
    assert all(may("owner", right) for right in Right)
    assert [right for right in Right if may("viewer", right)] == [Right.LOOK]
    assert rights_of("nobody", [("a study", "king")]) == Rights(in_study={"a study": frozenset()})
    assert not any(may("member", right) for right in Right)


def test_failed_sign_ins_and_what_changed_in_the_settings_are_in_the_audit_log(visitor, lab_services):
    visitor.post("/lab/sign-in", data={"name": "experimenter", "password": "wrong"})
    visitor.post("/lab/sign-in", data={"name": "seven quiet robots", "password": ""})  # typed into the wrong field
    sign_in(visitor)
    form = {"csrf": csrf(visitor), "help_contact": "Dr. Who"}
    assert visitor.post("/lab/settings", data=form).status_code == 303
    with lab_services.database.session() as s:
        refused = list(s.scalars(select(Audit).where(Audit.action == "sign_in_refused").order_by(Audit.id)))
        (changed,) = s.scalars(select(Audit).where(Audit.action == "settings_changed"))
    assert [(one.by, one.outcome) for one in refused] == [("experimenter", "refused"), ("-", "refused")]
    assert changed.data == {"contact": {"before": "", "after": "Dr. Who"}}
    page = visitor.get("/lab/audit").text
    assert "failed to sign in" in page
    assert "unknown account" in page
    assert "seven quiet robots" not in page
    assert "before</span>" in page


def test_one_person_may_be_experimenter_and_analyst(as_role, walked):
    both = as_role("researcher")
    assert both.get(f"/lab/studies/{walked.id}/recruit").status_code == 200
    assert both.get("/lab/jobs/new").status_code == 200
    assert both.get("/lab/settings").status_code == 403
    assert ROLES["researcher"] == ROLES["experimenter"] | ROLES["analyst"]
