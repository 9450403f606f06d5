"""Keeps policies that came in as files, with a card that says from where and the lineage that the file names."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy.orm import Session

from desirepath.learning.policies.importing import ImportedPolicy
from desirepath.learning.policies.policy import FORMATS
from desirepath.store.artefact_upkeep import LONGEST_NAME
from desirepath.store.artefacts import ArtefactStore, save_artefact
from desirepath.store.models import Artefact

KINDS = {"foreign": "policy", "policy": "policy", "depth_controller": "depth_controller"}
"""Format of a stored policy -> its kind as an artefact; of others the format's name with `_policy`."""


def save_imported_policy(
    s: Session,
    files: ArtefactStore,
    imported: ImportedPolicy,
    *,
    name: str,
    by: str,
    now: datetime,
    study_id: str | None = None,
) -> tuple[Artefact, bool]:
    """The policy's artefact, and whether it is new: the same content is the same artefact, with its own card.

    It is made from the policy that it was exported of, where that is here: who is erased is erased with both. Raises
    ArtefactError where that one is quarantined.
    """
    policy = imported.policy
    content = policy.to_bytes()
    was_there = s.get(Artefact, policy.digest()) is not None
    kinds = (KINDS.get(one, f"{one}_policy") for one, cls in ((k, FORMATS[k]) for k in FORMATS) if type(policy) is cls)
    kind = next(kinds)
    made_from = s.get(Artefact, imported.made_from) if imported.made_from else None
    card = {
        "kind": kind,
        "name": name,
        "setup": policy.setup,
        "imported": {
            "files": [{"name": imported.file, "sha256": imported.sha256}],
            "by": by,
            "at": now.isoformat(timespec="seconds"),
        },
        "notes": list(imported.notes),
        "config": {"kind_of_network": type(policy).__name__},
        "results": {},
        "parents": {} if made_from is None else {f"exported: {made_from.name}": made_from.id},
    }
    kept = save_artefact(
        s,
        files,
        kind=kind,
        name=(name.strip() or f"imported: {imported.file}")[:LONGEST_NAME],
        setup=policy.setup,
        content=content,
        card=card,
        parents=[(made_from.id, "exported")] if made_from is not None and made_from.id != policy.digest() else [],
        study_id=study_id,
    )
    return kept, not was_there
