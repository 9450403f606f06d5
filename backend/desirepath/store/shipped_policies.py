"""Makes the policies that come with the product known to the database, with their cards and lineage.

Finding the shipped files lives in `learning/shipped_files.py`, checking them in `learning/policies/shipped.py`.
"""

from __future__ import annotations

from dataclasses import asdict
from functools import lru_cache
from typing import TYPE_CHECKING

from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.installed import DATASETS
from desirepath.simulation.setups import version
from desirepath.store.artefacts import ARTEFACT_KINDS, ArtefactError, ArtefactStore, save_artefact
from desirepath.store.models import Artefact

if TYPE_CHECKING:
    from desirepath.learning.cards import Card

REGISTERED = ("policy", "conditioned_policy", "adaptable_policy", "attention_policy")


def register_shipped(s: Session, files: ArtefactStore) -> list[Artefact]:
    """Store every shipped policy that is not stored yet; returns all. Raises LearningError for a damaged file."""
    from desirepath.learning.shipped_files import load_card, shipped_names

    names = [name for name in shipped_names() if load_card(name).kind in REGISTERED]
    return [register(s, files, name) for name in names]


def policy_artefact(s: Session, name: str) -> Artefact:
    """The artefact of a shipped policy, e.g. `study_room/base`. Raises ArtefactError if it is not registered."""
    from desirepath.learning.shipped_files import load_card

    sha = load_card(name).sha256
    artefact = s.get(Artefact, sha)
    if artefact is None:
        known = s.scalars(select(Artefact.name).where(Artefact.kind.in_(REGISTERED)).order_by(Artefact.name)).all()
        raise ArtefactError(f"policy {name!r} is not registered; registered are: {', '.join(known) or 'none'}")
    return artefact


def find_artefact(s: Session, called: str) -> Artefact | None:
    """The artefact of that id, or the shipped policy of that name; None where there is none."""
    artefact = s.get(Artefact, called)
    if artefact is None and (sha := _shipped_ids().get(called)) is not None:
        artefact = s.get(Artefact, sha)
    return artefact


def _shipped_ids() -> dict[str, str]:
    """Name -> id of every shipped policy."""
    return _look(version())


@lru_cache(maxsize=2)
def _look(version_of_setups: int) -> dict[str, str]:
    from desirepath.learning.shipped_files import load_card, shipped_names

    cards = ((name, load_card(name)) for name in shipped_names())
    return {name: card.sha256 for name, card in cards if card.kind in REGISTERED}


def shipped_name(artefact_id: str) -> str | None:
    """The name under which it was shipped, by which commands know it however it is called here; None: it was not."""
    return next((name for name, sha in _shipped_ids().items() if sha == artefact_id), None)


def came_with_product(artefact_id: str) -> bool:
    """Whether the product ships it, and not a lab's own setup, whose folder may hold policies and query sets too."""
    return artefact_id in _of_the_product()


@lru_cache(maxsize=1)
def _of_the_product() -> frozenset[str]:
    from desirepath.learning.cards import Card, card_path

    cards = (card_path(path) for path in DATASETS.glob("*/**/*.npz"))
    return frozenset(Card.load(card).sha256 for card in cards if card.is_file())


def register_parents(s: Session, files: ArtefactStore, card: Card) -> list[tuple[str, str]]:
    """The (artefact id, role) of what a card names as its parents; shipped ones are registered on the way.

    A parent that is neither stored nor shipped stays on the card only, and so does one of a kind that is never stored:
    the reward of a demonstration.
    """
    from desirepath.learning.shipped_files import load_card, shipped_names

    registered = []
    for name, sha in card.parents.items():
        if s.get(Artefact, sha) is None and name in shipped_names():
            shipped = load_card(name)
            if shipped.sha256 == sha and shipped.kind in ARTEFACT_KINDS:
                register(s, files, name)
        if s.get(Artefact, sha) is not None:
            registered.append((sha, name.partition("/")[2] or name))  # the role: `base`, `ensemble/0`
    return registered


def register(s: Session, files: ArtefactStore, name: str, job_id: str | None = None) -> Artefact:
    """Store that artefact of a setup's folder, unless it is stored. job_id: what made it here. Raises LearningError for
    a damaged file."""
    from desirepath.learning.shipped_files import load_card, resolve

    card = load_card(name)
    artefact = s.get(Artefact, card.sha256)
    if artefact is not None:
        return artefact
    from desirepath.learning.policies.shipped import load_shipped  # brings the simulator: not where all is known

    load_shipped(name)  # checks the file against its card
    return save_artefact(
        s,
        files,
        kind=card.kind,
        name=name,
        setup=card.setup,
        content=resolve(name).read_bytes(),
        card=asdict(card),
        parents=register_parents(s, files, card),
        job_id=job_id,
    )
