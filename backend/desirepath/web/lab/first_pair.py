"""What a study asks, at a glance: the first pair of its query set from above, both robots on their way in real time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from markupsafe import Markup
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.artefacts import ArtefactError, ArtefactStore, load_trajectory
from desirepath.store.models import Artefact, Study
from desirepath.store.query_sets import queries_of
from desirepath.web.core import svg_figures


@dataclass(frozen=True)
class FirstPair:
    study: Study
    picture: Markup


def draw_first_pair(s: DatabaseSession, files: ArtefactStore, studies: list[Study], t: Any) -> FirstPair | None:
    """Of the newest study that people can join and that asks pairs; None where there is none, or a file is gone."""
    for study in studies:
        materials = study.protocol.get("materials", {}).get("query_set")
        kind = s.scalar(select(Artefact.kind).where(Artefact.id == materials))
        if study.state != "open" or kind != "query_set":
            continue
        try:
            query = queries_of(s, files, materials, whole=False)[0]
            both = [load_trajectory(files, name) for name in (query.trajectory_a, query.trajectory_b)]
        except ArtefactError:
            return None
        drawn = svg_figures.rollouts(both[0].scene, both, names="AB", title=t("lab.first_pair.title"), moving=True)
        return FirstPair(study, Markup(drawn))  # noqa: S704  drawn by us, texts escaped there
    return None
