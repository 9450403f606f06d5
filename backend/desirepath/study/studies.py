"""Opens studies and finds them. Taking participants in is `joining.py`'s, later protocols are `revising.py`'s."""

from __future__ import annotations

import secrets

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.learning.queries.choosing import STRATEGIES
from desirepath.simulation.setups import setups_with
from desirepath.store.artefacts import ArtefactError, ArtefactStore
from desirepath.store.events import log_event
from desirepath.store.models import Artefact, Study, new_id
from desirepath.store.query_sets import StoredQuery, import_query_set, queries_of
from desirepath.study.kinds.demonstration import DemonstrationsStage
from desirepath.study.kinds.importance_ranking import ImportanceRankingStage
from desirepath.study.kinds.method_comparison import TaughtByMethods
from desirepath.study.kinds.order import OrderStage
from desirepath.study.plan.asked_queries import Needs
from desirepath.study.protocol.freezing import FrozenProtocol
from desirepath.study.protocol.planning import PlanError, make_plan
from desirepath.study.protocol_rows import FIRST, protocol_row
from desirepath.study.refusals import Refused

TOKEN_BYTES = 24


class StudyError(ValueError):
    """A study that cannot be opened; says why and what would work."""


def create_study(
    s: DatabaseSession,
    files: ArtefactStore,
    frozen: FrozenProtocol,
    *,
    name: str,
    created_by: str | None,
    query_set: Artefact | None = None,
) -> Study:
    """Open a study with its own frozen copy of the protocol.

    query_set: an artefact of the store; default the one that the protocol names, brought into the store if it is not
    there yet. Raises StudyError for a query set that is missing, empty or too small, or a name that is empty.
    """
    if not name.strip():
        raise StudyError("name: a study needs one")
    materials = materials_of(s, files, frozen, query_set)
    study = Study(
        id=new_id(),
        name=name.strip()[:200],
        protocol_name=frozen.protocol.protocol,
        protocol_version=frozen.protocol.version,
        protocol_yaml=frozen.yaml,
        protocol={**frozen.data, "materials": materials},
        files=frozen.files,
        protocol_hash=frozen.hash,
        recruiting_token=secrets.token_urlsafe(TOKEN_BYTES),
        seed=frozen.protocol.assignment.seed,
        created_by=created_by,
    )
    s.add(study)
    s.flush()
    log_event(s, "study_created", study_id=study.id, protocol=study.protocol_name, hash=study.protocol_hash)
    return study


def materials_of(
    s: DatabaseSession, files: ArtefactStore, frozen: FrozenProtocol, query_set: Artefact | None = None
) -> dict[str, str | None]:
    """The query set's id and the setup of what is shown; no query set where only paths are drawn.

    Raises StudyError for a query set that is missing or cannot fill a plan.
    """
    wanted = frozen.query_set
    if wanted is None and query_set is None:
        taught = frozen.protocol.stage_of(TaughtByMethods)
        setup = taught.setup if taught is not None else frozen.stage(DemonstrationsStage).environment
        return {"query_set": None, "setup": setup}
    try:
        artefact = query_set or import_query_set(s, files, wanted or "")
        _require_kind(artefact, frozen.protocol.needs)
        _require_shown(artefact, frozen)
        _require_recorded(artefact, frozen)
        queries = queries_of(s, files, artefact.id)
        _require_several(artefact, frozen)
        _require_same_room(artefact, frozen)
    except ValueError as problem:
        raise StudyError(f"query_set = {wanted!r}: {problem}") from problem
    try:
        make_plan(frozen.protocol, 0, queries)
    except PlanError as problem:
        advice = "generate more (`desirepath queries generate`) or ask for fewer"
        raise StudyError(f"query_set = {wanted!r}: {problem}; {advice}") from problem
    return {"query_set": artefact.id, "setup": artefact.setup}


def _require_kind(artefact: Artefact, needs: Needs) -> None:
    """Raise ArtefactError where rankings are asked of queries, or choices of a ranking set."""
    ranks, chooses = needs.ranked + needs.practised > 0, needs.queries + needs.triads > 0
    if ranks and chooses:
        raise ArtefactError("importance_ranking needs a ranking set, blocks and ratings need queries; make two studies")
    if (artefact.kind == "ranking_set") != ranks:
        holds, needed = ("rankings", "queries") if chooses or not ranks else ("queries", "a ranking set")
        raise ArtefactError(f"{artefact.name} holds {holds}; this protocol needs {needed}")


def _require_shown(artefact: Artefact, frozen: FrozenProtocol) -> None:
    """Raise ArtefactError where a factor says to show what the ranking set does not have."""
    stage = frozen.protocol.stage_of(ImportanceRankingStage)
    factors = {*(stage.each or ()), *(stage.one_of or ())} if stage is not None else set()
    attended = any("attention" in query for query in artefact.card["stored_queries"])
    if "attention" in factors and not attended:
        raise ArtefactError(
            f"the factor attention needs a policy's attention, {artefact.name} has none; use a set such as "
            "crowd_corridor/scenarios_24 (`desirepath ship ranking-set crowd_corridor`)"
        )
    if "outline" in factors and attended:
        raise ArtefactError(f"the factor outline is of things, {artefact.name} ranks people; use the factor attention")


def _require_recorded(artefact: Artefact, frozen: FrozenProtocol) -> None:
    """Raise ArtefactError where a protocol needs of recordings what was not recorded."""
    if (recorded := artefact.card.get("recorded")) is None:
        return
    stages, has = frozen.protocol.all_stages, set(recorded["has"])
    through_eyes = sorted({view for stage in stages for view in stage.views} - {"top_down"})
    chosen_by = {entry.queries.choose for stage in stages for entry in getattr(stage, "trials", ())} - {"random"}
    by_steps = sorted(name for name in chosen_by if STRATEGIES[name].beyond)
    fed_back = ["feedback"] * any(getattr(stage, "feedback", None) is not None for stage in stages)
    needs = {
        "people": [
            *fed_back,
            *(f"view {view}" for view in through_eyes),
            *(f"choose: {name}" for name in sorted(chosen_by)),
        ],
        "observations": ["train"] * any(stage.begins == "train" for stage in stages)
        + [f"choose: {name}" for name in by_steps],
    }
    for part, wanted in needs.items():
        if wanted and part not in has:
            raise ArtefactError(
                f"{part} were not recorded, {wanted[0]} needs them; choose: random, the view top_down, ratings, "
                "measures and the report work without"
            )


def _require_several(artefact: Artefact, frozen: FrozenProtocol) -> None:
    """Raise ArtefactError where several trajectories of a scene are to be shown and are not to be had."""
    stages = frozen.protocol.all_stages
    if not any(isinstance(stage, OrderStage) or getattr(stage, "orders", ()) for stage in stages):
        return
    if artefact.card.get("recorded") is not None:
        raise ArtefactError("order shows several trajectories of one scene; each recording has a scene of its own")
    if artefact.setup not in setups_with("conditioned"):
        raise ArtefactError(f"order needs a conditioned policy of {artefact.setup} for further trajectories; train one")


def _require_same_room(artefact: Artefact, frozen: FrozenProtocol) -> None:
    """Raise ArtefactError where paths count at once beside queries of another setup: one posterior is of one setup."""
    for stage in frozen.protocol.stages_of(DemonstrationsStage):
        if stage.at_once and stage.environment != artefact.setup:
            raise ArtefactError(
                f"demonstrations count at once in {stage.environment}, and these queries are of {artefact.setup}; "
                f"choose queries of {stage.environment}"
            )


def study_by_link(s: DatabaseSession, recruiting_token: str) -> Study:
    """The study of a recruiting link. Raises Refused 404 `unknown`."""
    study = s.scalars(select(Study).where(Study.recruiting_token == recruiting_token)).first()
    if study is None:
        raise Refused(404, "unknown", "This link does not lead to a study.")
    return study


def queries_of_study(
    s: DatabaseSession, files: ArtefactStore, study: Study, number: int = FIRST, *, whole: bool = True
) -> list[StoredQuery]:
    """The queries that the study draws from, none where only paths are drawn; number: of its protocol; whole: every
    file is looked for, as in `queries_of`."""
    query_set = protocol_row(s, study, number).protocol["materials"]["query_set"]
    return queries_of(s, files, query_set, whole=whole) if query_set is not None else []
