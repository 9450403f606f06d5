"""What pages show of a draft while it is edited: its forms and problems, what it costs, what can be named in it."""

from __future__ import annotations

import re
from typing import Any

from fastapi import Request

from desirepath.analysis.scale_wordings import INSTRUMENTS
from desirepath.grammar.source import ProtocolError, Source
from desirepath.store.query_sets import query_sets_here
from desirepath.study.protocol.freezing import FrozenProtocol, shipped_query_sets
from desirepath.study.protocol.outline import describe_stages, estimate_minutes
from desirepath.study.protocol.stages import STAGES
from desirepath.web.core.dependencies import Services, services_of
from desirepath.web.core.lab_frame import lab_language
from desirepath.web.lab.drafts import Draft
from desirepath.web.lab.preview import first_steps
from desirepath.web.lab.protocol_forms import protocol_form, stage_forms

_LANGUAGE = re.compile(r"\.[a-z]{2}\.md$")


def draft_view(request: Request, draft: Draft) -> dict[str, Any]:
    """What `editor_part.html` shows of a draft: `frozen` or its `problems`, and forms where it is YAML (`source`)."""
    services = services_of(request)
    frozen, problems = None, []
    with services.database.session() as s:
        sets = query_sets_here(s)
    try:
        frozen = draft.freeze(sets)
    except ProtocolError as wrong:
        problems = wrong.problems
    suggested = names_in(services, draft)
    try:
        source = Source(draft.file.name, draft.yaml)
    except ProtocolError:
        source = None
    forms = stage_forms(source, problems, suggested) if source else []
    known = [form.seconds for form in forms if form.seconds is not None]
    return {
        "draft": draft,
        "frozen": frozen,
        "stages": describe_stages(frozen.data, frozen.files) if frozen else [],
        "first_steps": first_steps(frozen) if frozen else {},
        "wrong_lines": {wrong.line for wrong in problems if wrong.file == draft.file.name},
        "veiled": None,
        "pilot": True,
        "name": frozen.title(lab_language(request)) if frozen else "",
        "problems": problems,
        "source": source,
        "forms": forms,
        "named": {one: f"{words.rpartition(',')[0]})" for one, words in sets.items()},  # name and setup
        "protocol_fields": protocol_form(source, suggested) if source else (),
        "kinds": [*STAGES],
        "minutes": estimate_minutes(frozen.protocol) if frozen else (sum(known) / 60,) * 2,
        "previews": _previews(draft, frozen, sets),
        "power": services.power.newest(frozen.hash) if frozen else None,
    }


def _previews(draft: Draft, frozen: FrozenProtocol | None, sets: dict[str, str]) -> dict[int, int]:
    """Index of a stage -> number of its first step in the preview, of those that can be looked at."""
    try:
        found, kept = (frozen, None) if frozen else draft.freeze_valid(sets)
    except ProtocolError:
        return {}
    first, keys = first_steps(found), [key for key, _ in found.protocol.keyed_stages]
    return dict(zip(range(len(keys)) if kept is None else kept, [first[key] for key in keys], strict=True))


def names_in(services: Services, draft: Draft) -> dict[str, list[str]]:
    """Key of a protocol -> what there is to name under it."""
    with services.database.session() as s:
        made = [*query_sets_here(s)]
    texts = sorted({f"texts/{_LANGUAGE.sub('.md', file.name)}" for file in (draft.folder / "texts").glob("*.md")})
    own = (file.stem for file in (draft.folder / "questionnaires").glob("*.yaml"))
    asked = sorted({*own, *INSTRUMENTS})
    sets = [*dict.fromkeys([*shipped_query_sets(), *made])]
    return {"text": texts, "use": asked, "questionnaire": asked, "query_set": sets}
