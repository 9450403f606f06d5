"""What comes with the product is known to a fresh database, with its lineage."""

from __future__ import annotations

import pytest
from sqlalchemy import func, select

from desirepath.learning.shipped_files import load_card
from desirepath.store.artefacts import ArtefactError, ArtefactStore, lineage, load_artefact
from desirepath.store.database import Database
from desirepath.store.models import Artefact, TrajectoryRow
from desirepath.store.query_sets import import_query_set, queries_of
from desirepath.store.shipped_policies import policy_artefact, register_shipped


def test_shipped_policies_are_registered_once_with_cards_and_lineage(database: Database, files: ArtefactStore):
    with database.session() as s, pytest.raises(ArtefactError, match="is not registered; registered are: none"):
        policy_artefact(s, "study_room/base")
    for _ in range(2):
        with database.transaction() as s:
            names = {artefact.name for artefact in register_shipped(s, files)}
    assert {"study_room/base", "open_field/base", "study_room/ensemble/0"} <= names
    with database.session() as s:
        assert s.scalar(select(func.count()).select_from(Artefact)) == len(names)
        base = policy_artefact(s, "study_room/base")
        assert (base.kind, base.setup, base.simulated) == ("policy", "study_room", False)
        assert base.id == base.card["sha256"] == load_card("study_room/base").sha256
        assert len(load_artefact(s, files, base.id, kind="policy")[1]) > 1_000
        member = lineage(s, policy_artefact(s, "study_room/ensemble/0").id)
        assert [(parent.role, parent.artefact.id) for parent in member.parents] == [("base", base.id)]


def test_the_shipped_query_set_can_be_asked(database: Database, files: ArtefactStore):
    with database.transaction() as s:
        artefact = import_query_set(s, files, "study_room/queries_500")
    with database.transaction() as s:
        assert import_query_set(s, files, "study_room/queries_500").id == artefact.id
    with database.session() as s:
        queries = queries_of(s, files, artefact.id)
        assert len(queries) == 500
        assert len({query.id for query in queries}) == len(queries)
        assert s.scalar(select(func.count()).select_from(TrajectoryRow)) == 2 * len(queries)
        assert {parent.role for parent in lineage(s, artefact.id).parents} == {f"ensemble/{k}" for k in range(4)}
