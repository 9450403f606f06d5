"""Policies as they are named on the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from desirepath.cli import study
from desirepath.cli.science import find_policy
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.shipped import load_policy
from desirepath.settings import Settings
from desirepath.store.shipped_policies import policy_artefact, register_shipped


def test_a_stored_conditioned_policy_is_named_by_id_and_wants(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(study, "get_settings", lambda: Settings(data=tmp_path, _env_file=None))
    database, files = study.open_store(makes=True)
    with database.transaction() as s:
        register_shipped(s, files)
        conditioned, base = (policy_artefact(s, f"study_room/{name}").id for name in ("conditioned", "base"))
    told, shipped = find_policy(f"{conditioned}@farther=1"), load_policy("study_room/conditioned@farther=1")
    assert all(np.array_equal(a, b) for a, b in zip(told.actor, shipped.actor, strict=True))
    assert find_policy(base).setup == "study_room"
    with pytest.raises(LearningError, match="takes no preference weights"):
        find_policy(f"{base}@farther=1")
    with pytest.raises(LookupError, match="neither an id"):
        find_policy("study_room/nobody@farther=1")
