"""Recordings and answers of one's own, taken in by page: what is in the files, which of it is what, how it looks on the
stage, and then a query set (and a snapshot of the answers) like any other.

The files and the reading are `recording_drafts.py`'s; the same by command is `desirepath queries inspect` and `import`.
"""

from __future__ import annotations

from collections.abc import Mapping as AnyMapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import yaml
from fastapi import APIRouter, Depends, Form, Request
from markupsafe import Markup
from pydantic import BaseModel
from sqlalchemy import or_, select
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData
from starlette.responses import FileResponse, RedirectResponse, Response

from desirepath.grammar.source import ProtocolError
from desirepath.recordings.csv_tables import SYNONYMS
from desirepath.recordings.importing import name_videos
from desirepath.recordings.mapping import ANGLES, LENGTHS, TIMES, Keys, Mapping, Topics
from desirepath.recordings.videos import MEDIA, is_video
from desirepath.simulation.setups import SETUPS
from desirepath.store.artefact_upkeep import LONGEST_NAME
from desirepath.store.imported_answers import ImportedAnswer, save_imported_answers
from desirepath.store.models import Artefact
from desirepath.store.query_sets import save_query_set
from desirepath.web.analyst.artefact_pages import artefact_href
from desirepath.web.analyst.example_recording import NAME as EXAMPLE
from desirepath.web.analyst.example_recording import example_recording
from desirepath.web.analyst.job_pages import read_form, studies_to_keep_in, study_of_new
from desirepath.web.analyst.recording_drafts import (
    MOST_BYTES,
    RecordingDraft,
    UploadError,
    begin_looking,
    begin_making,
    find_recording_draft,
    mapping_of,
    new_recording_draft,
    recording_drafts,
    take_in,
)
from desirepath.web.core import svg_figures
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.contract import form_of, reply_of
from desirepath.web.core.dependencies import Db, Files, TheServices, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page, rights_in
from desirepath.web.core.permits import may_with, seen_artefacts
from desirepath.web.core.roles import Right, Rights
from desirepath.web.stage.replay_stages import Replay

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])
UNITS = {"length": tuple(LENGTHS), "angle": tuple(ANGLES), "time": tuple(TIMES)}
WIDE = ("time", "run", "scene")  # of a table with columns per body, what is one column for all
CHOSEN = ("columns", "units", "topics", "robot")
"""Parts of a mapping that the form has fields for; all else stands in its text."""
FIELDS = (
    *(f"column.{ours}" for ours in SYNONYMS),
    *(f"unit.{what}" for what in UNITS),
    *(f"topic.{what}" for what in Topics.model_fields),
    *(f"robot.{what}" for what in Keys.model_fields),
    *("setup", "pairs", "count", "more"),
)


class Taken(BaseModel):
    """A file that was taken in, and where its upload goes on."""

    draft: str
    href: str


class Reading(BaseModel):
    """Whether files are being read."""

    working: bool


def _sees(request: Request, draft: RecordingDraft) -> bool:
    """Whether it is one's own, or one may analyse everywhere: people may be in it."""
    own = draft.read("sent").get("by") == request.state.sign_in.name
    return own or rights_in(request).studies("analyse") is None


def _draft(request: Request, services: TheServices, draft_id: str) -> RecordingDraft:
    found = find_recording_draft(services.settings.data, draft_id)
    if found is None or not _sees(request, found):
        raise LabRefusal(404, "no_recording_draft")
    return found


TheDraft = Annotated[RecordingDraft, Depends(_draft)]


@router.get("/lab/recordings")
def recordings(request: Request, database: Db, files: Files, services: TheServices) -> Response:
    """What was imported, with where it is from; uploads that were not kept yet; the door for new ones."""
    with database.session() as s:
        foreign = or_(Artefact.card["imported"].is_not(None), Artefact.card["recorded"].is_not(None))
        rows = select(Artefact).where(foreign, Artefact.kind.in_(("query_set", "snapshot")))
        found = [
            one
            for one in s.scalars(rows.where(seen_artefacts(rights_in(request))).order_by(Artefact.created_at.desc()))
            if one.card.get("imported") or one.card.get("recorded")  # JSON's null is not SQL's
        ]
        drafts = recording_drafts(services.settings.data) if rights_in(request).may("analyse") else []
        return lab_page(
            request,
            "analyst/recordings.html",
            found=found,
            drafts=[(one, one.read("sent"), one.files()) for one in drafts if _sees(request, one)],
            most_mb=MOST_BYTES // 2**20,
            example=not found and example_recording(s, files) is not None,
        )


@router.post("/lab/recordings/example")
def try_example(database: Db, files: Files, services: TheServices, user: CheckedCsrf) -> Response:
    """Two runs of a simulated robot as an upload of one's own, to see what becomes of recordings."""
    with database.session() as s:
        table = example_recording(s, files)
    if table is None:
        raise LabRefusal(404, "no_recording_draft")
    draft = new_recording_draft(services.settings.data, user.name)
    (draft.recordings / EXAMPLE).write_text(table, encoding="utf-8")
    return RedirectResponse(f"/lab/recordings/{draft.id}", status_code=303)


@router.post("/api/lab/recordings/files", response_model=Taken)
async def upload(
    request: Request, services: TheServices, user: CheckedCsrf, name: str, draft: str = "", answers: bool = False
) -> Response:
    """Take in one file, as `application/octet-stream`: a recording, a zip of a folder, pairs.csv, or answers. draft:
    of an earlier file; without one it is a new upload."""
    data = services.settings.data
    found = _draft(request, services, draft) if draft else await run_in_threadpool(new_recording_draft, data, user.name)
    try:
        await take_in(found, Path(name).name if answers else name, request.stream(), answers=answers)
    except UploadError as problem:
        if not draft:
            found.discard()
        raise LabRefusal(
            409 if problem.code == "busy" else 422, "recording_not_taken", problem=_told(request, problem)
        ) from None
    return reply_of(Taken, {"draft": found.id, "href": f"/lab/recordings/{found.id}"})


@router.get("/api/lab/recordings/{draft_id}", response_model=Reading)
def reading(draft: TheDraft) -> Response:
    """For the page, which waits."""
    return reply_of(Reading, {"working": draft.is_working})


@router.get("/lab/recordings/{draft_id}")
def draft_page(
    request: Request, draft: TheDraft, services: TheServices, pair: int = 0, stage: bool = False
) -> Response:
    """What is in the files, the mapping, and what becomes of them. pair: which one is drawn; stage: in 3D, too."""
    if not draft.read("found") and not draft.is_working and draft.files():
        with suppress(UploadError):  # somebody else just began
            begin_looking(services.settings, draft)
    return _page(request, draft, pair=pair, stage=stage)


@router.get("/lab/recordings/{draft_id}/videos/{name:path}", response_class=Response)
def draft_video(draft: TheDraft, name: str) -> Response:
    """A video that was uploaded, to be looked at before it is kept."""
    films = [one for one in draft.recordings.rglob("*") if is_video(one)]
    found = name_videos(films, draft.recordings).get(name)
    if found is None:
        raise LabRefusal(404, "no_recording_draft")
    return FileResponse(found, media_type=MEDIA[found.suffix.lower()])


@router.post("/lab/recordings/{draft_id}", openapi_extra=form_of(FIELDS))
def make(
    request: Request,
    draft: TheDraft,
    services: TheServices,
    user: CheckedCsrf,
    form: Annotated[FormData, Depends(read_form)],
) -> Response:
    """Keep the mapping and make a query set of the recordings by it, to be looked at."""
    given = {name: str(form.get(name) or "").strip() for name in FIELDS}
    try:
        mapping = _mapping_in(given)
    except ProtocolError as wrong:
        return _page(request, draft, problems=[str(one) for one in wrong.problems], given=given, status=422)
    if given["setup"] not in _setups():
        return _page(request, draft, problems=[f"setup = {given['setup']!r}"], given=given, status=422)
    count = int(given["count"]) if given["count"].isdecimal() and len(given["count"]) < 5 else 200
    pairs = given["pairs"] if given["pairs"] in ("given", "proposed") else None
    asked = {"setup": given["setup"], "pairs": pairs, "count": max(1, min(count, 2_000))}
    try:
        begin_making(services.settings, draft, mapping, asked)
    except UploadError as busy:
        return _page(request, draft, problems=[_told(request, busy)], given=given, status=409)
    return RedirectResponse(f"/lab/recordings/{draft.id}#made", status_code=303)


@router.post("/lab/recordings/{draft_id}/keep")
def keep(
    request: Request,
    draft: TheDraft,
    database: Db,
    files: Files,
    user: CheckedCsrf,
    name: Annotated[str, Form()] = "",
    study: Annotated[str, Form()] = "",
) -> Response:
    """Keep the query set, and the answers as a snapshot, in a study or in none; the upload itself goes."""
    name = " ".join(name.split())[:LONGEST_NAME]
    try:
        with draft.claimed():
            kept = _kept(draft, database, files, rights_in(request), name, study, user.name)
            if kept is not None:
                draft.discard()
    except UploadError as busy:
        return _page(request, draft, problems=[_told(request, busy)], status=409)
    if kept is None:
        return _page(request, draft, problems=[_words(request)("recordings.no_name")], status=422)
    leads_to, details = kept
    audit_details(request, **details)
    return RedirectResponse(leads_to, status_code=303)


def _kept(
    draft: RecordingDraft, database: Db, files: Files, rights: Rights, name: str, study: str, by: str
) -> tuple[str, dict[str, Any]] | None:
    """Where what was kept is, and what the audit log says; None without a name or where nothing was made."""
    from desirepath.learning.queries.queries import QuerySet

    made = draft.read("made")
    if not name or "imported" not in made or not draft.queries.is_file():
        return None
    query_set = QuerySet.load(draft.queries)
    films = [one for one in draft.recordings.rglob("*") if is_video(one)]
    for film in films:
        files.put(film.read_bytes())  # before anybody waits for the transaction
    card = {"imported": {**made["imported"], "by": by, "mapping": made["mapping"]}}
    with database.transaction() as s:
        study_id = study_of_new(s, rights, None, study)
        stored = save_query_set(s, files, query_set, name=name, card=card, videos=films, study_id=study_id)
        if not may_with(s, rights, Right.ANALYSE, stored):
            raise LabRefusal(409, "kept_elsewhere")
        leads_to = artefact_href(stored)
        details = {"artefact": stored.id, "files": len(made["imported"]["files"])}
        if given := made.get("answers"):
            answers = [ImportedAnswer(one["line"], one["query"], one["choice"], one["person"]) for one in given]
            source = made["imported"]["files"][-1]
            snapshot = save_imported_answers(s, files, stored, answers, name=name, source=source, study_id=study_id)
            details["snapshot"] = snapshot.id
            leads_to = artefact_href(snapshot)
    return leads_to, details


@router.post("/lab/recordings/{draft_id}/discard")
def discard(request: Request, draft: TheDraft, user: CheckedCsrf) -> Response:
    audit_details(request, sent_by=draft.read("sent").get("by", ""), files=len(draft.files()))
    draft.discard()
    return RedirectResponse("/lab/recordings", status_code=303)


# ---- the page --------------------------------------------------------------------------------------------------------


def _page(
    request: Request,
    draft: RecordingDraft,
    *,
    pair: int = 0,
    stage: bool = False,
    problems: list[str] | None = None,
    given: AnyMapping[str, str] | None = None,
    status: int = 200,
) -> Response:
    found, made, asked = draft.read("found"), draft.read("made"), draft.read("asked")
    try:
        mapping = mapping_of(draft.mapping_yaml or yaml.safe_dump(found.get("mapping") or {}))
    except ProtocolError:
        mapping = Mapping()
    shown = _shown(request, draft, made, pair, stage) if draft.queries.is_file() and not draft.is_working else {}
    return lab_page(
        request,
        "analyst/recording_draft.html",
        status=status,
        draft=draft,
        sent=draft.read("sent"),
        files=draft.files(),
        found=found,
        made=made,
        asked=asked,
        problems=problems or [],
        fields=_fields(found, mapping, given or {}),
        units={
            what: (choices, _value(given, f"unit.{what}", getattr(mapping.units, what)))
            for what, choices in UNITS.items()
        },
        more=given["more"] if given else _more(mapping),
        setups=_setups(),
        setup=_value(given, "setup", asked.get("setup")),
        pairs=_value(given, "pairs", asked.get("pairs")),
        count=_value(given, "count", asked.get("count") or 200),
        **shown,
    )


def _value(given: AnyMapping[str, str] | None, name: str, otherwise: Any) -> Any:
    return given[name] if given else otherwise


def _fields(found: AnyMapping[str, Any], mapping: Mapping, given: AnyMapping[str, str]) -> list[dict[str, Any]]:
    """The selects of the form: name, what may be chosen with a note each, what is chosen, whether it is needed."""
    selects: list[dict[str, Any]] = []

    def offer(name: str, choices: list[tuple[str, str]], value: str, *, needed: bool) -> None:
        selects.append({"name": name, "choices": choices, "value": given.get(name, value), "needed": needed})

    columns = found.get("columns") or []
    wide = bool(found.get("bodies"))
    for ours in SYNONYMS if columns else ():
        if wide and ours not in WIDE:
            continue
        guessed = next((one["head"] for one in columns if one["ours"] == ours), "")
        heads = [(one["head"], one["example"]) for one in columns]
        offer(f"column.{ours}", heads, mapping.columns.get(ours, guessed), needed=ours in ("time", "x", "y"))
    for what in Topics.model_fields if found.get("topics") else ():
        fitting = [(one["name"], f"{one['type']}, {one['count']}") for one in found["topics"] if what in one["fits"]]
        offer(f"topic.{what}", fitting, getattr(mapping.topics, what) or "", needed=what == "pose")
    if arrays := found.get("fields"):
        keys = mapping.robot or Keys(field=arrays[0]["name"])
        names = [(one["name"], ", ".join(one["names"]) or str(one["width"] or "?")) for one in arrays]
        offer("robot.field", names, keys.field, needed=True)
        places = [(str(k), "") for k in range(max([one["width"] for one in arrays] + [3]))][:64]
        for axis in ("x", "y", "yaw"):
            value = getattr(keys, axis)
            offer(f"robot.{axis}", places, "" if value is None else str(value), needed=axis != "yaw")
    return selects


def _mapping_in(given: AnyMapping[str, str]) -> str:
    """The mapping that a form says, as YAML. Raises ProtocolError."""
    rest = mapping_of(given["more"]).model_dump(exclude_unset=True, mode="json")
    of: dict[str, dict[str, str]] = {"column": {}, "unit": {}, "topic": {}, "robot": {}}
    for name, value in given.items():
        part, dot, what = name.partition(".")
        if dot:
            of[part][what] = value
    if any(of["column"].values()):
        rest["columns"] = {**rest.get("columns", {}), **{ours: head for ours, head in of["column"].items() if head}}
    if any(of["unit"].values()):
        rest["units"] = {what: unit for what, unit in of["unit"].items() if unit}
    if of["topic"]["pose"]:
        rest["topics"] = {what: topic or None for what, topic in of["topic"].items()}
    if of["robot"]["field"]:
        rest["robot"] = {
            what: value if what == "field" else int(value[:9])
            for what, value in of["robot"].items()
            if value and (what == "field" or value.isdecimal())
        }
    written: str = yaml.safe_dump(rest, allow_unicode=True, sort_keys=False) if rest else ""
    mapping_of(written)
    return written


def _more(mapping: Mapping) -> str:
    rest = mapping.model_dump(exclude_defaults=True, mode="json", exclude=set(CHOSEN))
    return str(yaml.safe_dump(rest, allow_unicode=True, sort_keys=False)) if rest else ""


def _setups() -> list[str]:
    """Those as whose robot a recording may be shown."""
    return [name for name, setup in SETUPS.items() if not setup.pedestrians and not setup.solids]


def _shown(
    request: Request, draft: RecordingDraft, made: AnyMapping[str, Any], pair: int, stage: bool
) -> dict[str, Any]:
    """One pair of what was made: from above, and on request on the stage. Runs of other scenes play by themselves."""
    from desirepath.learning.queries.queries import QuerySet

    queries = QuerySet.load(draft.queries).queries
    pair = pair if 0 <= pair < len(queries) else 0
    both = (queries[pair].trajectory_a, queries[pair].trajectory_b)
    t = _words(request)
    runs = [one.recorded.run if one.recorded else "" for one in both]
    names = [f"{letter}: {run}" for letter, run in zip("AB", runs, strict=True)]
    here = both[0].scene
    together = replace(both[1].scene, start=here.start, goal=here.goal) == here  # two runs never begin exactly alike
    at_once = (both[0], replace(both[1], scene=here)) if together else both
    plays = [Replay(at_once, tuple(names))] if together else [Replay((both[k],), (names[k],)) for k in (0, 1)]
    known = all(one.recorded is not None and "poses" in one.recorded.has for one in both)
    with services_of(request).database.session() as s:
        keep_in = studies_to_keep_in(s, rights_in(request))
    drawn = svg_figures.rollouts(both[0].scene, both, names=names, title=t("recordings.figure")) if known else ""
    return {
        "pair": pair,
        "pair_count": len(queries),
        "shown_pair": both,
        "names": names,
        "plan": Markup(drawn),  # noqa: S704 - made by us, texts escaped
        "stages": [services_of(request).replays.grant(one) for one in plays] if stage and known else [],
        "known": known,
        "keep_in": keep_in,
    }


def _words(request: Request) -> Any:
    return services_of(request).texts.get(lab_language(request))


def _told(request: Request, problem: UploadError) -> str:
    return str(_words(request)(f"recordings.errors.{problem.code}", **problem.values))
