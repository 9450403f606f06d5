"""Analysts tidy up on pages: another name, the archive, and deleting what nothing depends on."""

from __future__ import annotations

import pytest
from sqlalchemy import select

from desirepath.jobs.kept_artefacts import free_name
from desirepath.store.models import Artefact, Audit, Job
from tests.web.lab_services import csrf


@pytest.fixture(autouse=True)
def ended(lab_services, two_studies):
    """The jobs that made the policies have ended; while they run, what they make is not deleted."""
    with lab_services.database.transaction() as s:
        for job in s.scalars(select(Job).where(Job.id.in_(two_studies.job.values()))):
            job.state = "succeeded"


def test_an_artefact_is_renamed_archived_and_restored(lab, lab_services, two_studies):
    policy = two_studies.policy["ours"]
    here, token = f"/lab/artefacts/{policy}", csrf(lab)
    page = lab.get(f"/lab/policies/{policy}").text
    assert f"{here}/upkeep" in page
    upkeep = lab.get(f"{here}/upkeep").text
    assert two_studies.snapshot["ours"] in upkeep  # made from
    assert "Nothing depends on it." in upkeep
    assert lab.post(f"{here}/rename", data={"csrf": token, "name": " Anna's third "}).status_code == 303
    assert "Anna&#39;s third" in lab.get("/lab/policies").text
    assert lab.post(f"{here}/rename", data={"csrf": token, "name": "two\nlines"}).status_code == 422
    assert lab.post(f"{here}/archive", data={"csrf": token}).status_code == 303
    listed = lab.get("/lab/policies").text
    assert policy not in listed
    assert "Show one archived" in listed
    assert policy in lab.get("/lab/policies?archived=1").text
    assert policy not in lab.get("/lab/jobs/new/evaluate").text  # offered no more
    assert "Anna&#39;s third" not in lab.get("/lab/flow-field").text
    assert lab.get(f"/lab/policies/{policy}").status_code == 200  # but there
    assert lab.post(f"{here}/restore", data={"csrf": token}).status_code == 303
    assert policy in lab.get("/lab/jobs/new/evaluate").text
    assert 'value="Anna&#39;s third"' in lab.get("/lab/flow-field").text
    with lab_services.database.session() as s:
        done = s.scalars(select(Audit).where(Audit.action.like("artefact_%")).order_by(Audit.id)).all()
    assert [one.action for one in done] == ["artefact_renamed", "artefact_archived", "artefact_restored"]
    assert {one.study_id for one in done} == {two_studies.ours}
    assert done[0].data["after"] == "Anna's third"


def test_only_what_nothing_depends_on_is_deleted_and_only_by_its_name(lab, lab_services, two_studies):
    snapshot, policy, token = two_studies.snapshot["ours"], two_studies.policy["ours"], csrf(lab)
    upkeep = lab.get(f"/lab/artefacts/{snapshot}/upkeep").text
    assert "policy of ours" in upkeep
    assert "cannot be deleted" in upkeep
    assert f"{snapshot}/delete" not in upkeep

    def delete(artefact_id: str, typed: str) -> int:
        sent = {"csrf": token, "typed": typed}
        return lab.post(f"/lab/artefacts/{artefact_id}/delete", data=sent).status_code

    with lab_services.database.session() as s:
        named = s.get_one(Artefact, snapshot).name
    assert delete(snapshot, named) == 409
    assert delete(policy, "yes") == 422
    assert delete(policy, "policy of ours") == 303
    assert lab.get(f"/lab/policies/{policy}").status_code == 404
    assert not lab_services.files.exists(policy)
    assert "cannot be deleted" in lab.get(f"/lab/artefacts/{two_studies.base}/upkeep").text  # ships with the product


def test_who_only_looks_or_is_of_another_study_tidies_nothing(colleague, two_studies):
    theirs, ours = two_studies.policy["theirs"], two_studies.policy["ours"]
    viewer, analyst = colleague("viewer"), colleague("member", "analyst")
    assert viewer.get(f"/lab/artefacts/{ours}/upkeep").status_code == 403
    assert "/upkeep" not in viewer.get(f"/lab/policies/{ours}").text
    assert analyst.get(f"/lab/artefacts/{ours}/upkeep").status_code == 200
    for one in (theirs, two_studies.base):  # what belongs to no study is not a study's analyst's to tidy
        assert analyst.get(f"/lab/artefacts/{one}/upkeep").status_code == 403
    assert "/upkeep" not in analyst.get(f"/lab/policies/{two_studies.base}").text


def test_names_tell_artefacts_of_one_study_apart(lab_services, two_studies):
    with lab_services.database.transaction() as s:
        assert free_name(s, "policy", "policy of ours") == "policy of ours (2)"
        assert free_name(s, "policy", "policy of nobody") == "policy of nobody"
        long = free_name(s, "policy", f"instant policy: {'A very long study ' * 12}, 15 answers of P-7, seed 3")
        assert len(long) <= 160
        assert long.startswith("instant policy: A very long study")
        assert long.endswith("15 answers of P-7, seed 3")


def test_a_form_offers_what_fits_the_setup_of_what_is_chosen(lab, two_studies):
    both = lab.get("/lab/compare").text
    assert "open_field/base" in both
    chosen = lab.get(f"/lab/compare?policy_a={two_studies.base}").text
    first, second = chosen.split('id="policy_b"')
    assert "open_field/base" in first  # the choice itself stays free
    assert "open_field/base" not in second
    assert "study_room/ensemble/1" in second
