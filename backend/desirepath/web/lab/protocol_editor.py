"""The editor of a draft: a text or a change comes in, and the YAML, its problems and its forms go out.

What a change does to the text is `grammar/editing.py`'s; how forms come about, `protocol_forms.py`'s.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Request
from pydantic import Field, JsonValue
from starlette.responses import Response

from desirepath.grammar import editing
from desirepath.grammar.editing import EditError
from desirepath.grammar.source import DEEPEST, LONGEST, Path, Problem, ProtocolError, Source
from desirepath.grammar.text_files import as_text
from desirepath.study.protocol.schema import json_schema
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.contract import Reply, Sent, reply_of
from desirepath.web.core.dependencies import TheServices
from desirepath.web.core.lab_frame import lab_language, lab_page
from desirepath.web.lab.draft_view import draft_view, names_in
from desirepath.web.lab.drafts import Draft, DraftError
from desirepath.web.lab.new_study import TheDraft
from desirepath.web.lab.protocol_forms import example_at

router = APIRouter(prefix="/lab/new", dependencies=[Depends(check_csrf)], tags=["new study"])

Place = Annotated[list[str | int], Field(min_length=1, max_length=DEEPEST)]
Index = Annotated[int, Field(ge=0, le=10_000)]


class Set(Sent):
    """Give a field a value; null takes it out."""

    do: Literal["set"]
    path: Place
    value: JsonValue


class Remove(Sent):
    do: Literal["remove"]
    path: Place


class Insert(Sent):
    """Put what may stand there into the list, of several things that `kind`."""

    do: Literal["insert"]
    path: Place
    index: Index
    kind: Annotated[str | None, Field(max_length=100)] = None


class Move(Sent):
    do: Literal["move"]
    path: Place
    index: Index
    to: Index


class Edit(Sent):
    """The text as it stands in the editor, and what is to be changed in it, if anything. seen: `Edited.mark` of what
    this window last saw of it."""

    seen: Annotated[str, Field(max_length=32)]
    yaml: Annotated[str, Field(max_length=LONGEST)]
    change: Annotated[Set | Remove | Insert | Move, Field(discriminator="do")] | None = None


class FoundProblem(Reply):
    """line: in the YAML, 1-based; of another file 1. message: with the field."""

    line: int
    message: str


class Edited(Reply):
    """yaml: after the change; refused: why it was not made, in the page's language; part: the forms, as HTML; None
    where the text is no YAML, so that those of before may stay. mark: of the text that is kept."""

    yaml: str
    mark: str
    refused: str | None
    problems: list[FoundProblem]
    part: str | None


class MayBeWritten(Reply):
    """protocol: its JSON Schema; names: key -> what there is to name under it."""

    protocol: dict[str, Any]
    names: dict[str, list[str]]


@router.get("/{draft_id}/schema.json", response_model=MayBeWritten)
def schema(services: TheServices, draft: TheDraft) -> Response:
    """What the editor completes from."""
    return reply_of(MayBeWritten, {"protocol": json_schema(), "names": names_in(services, draft)})


@router.post("/{draft_id}/edit", response_model=Edited)
def edit(request: Request, services: TheServices, draft: TheDraft, user: CheckedCsrf, sent: Edit) -> Response:
    """Make a change, keep the text, say what is wrong with it, and show its stages."""
    t = services.texts.get(lab_language(request))
    text, refused = as_text(sent.yaml), None
    if sent.seen != draft.mark and text != draft.yaml:
        refused = t("editor.changed_elsewhere")
        answer: dict[str, Any] = {"yaml": text, "mark": sent.seen, "refused": refused, "problems": [], "part": None}
        return reply_of(Edited, answer)
    if sent.change is not None:
        try:
            text = changed(text, sent.change)
        except EditError as wrong:
            refused = t("editor.refused", field=wrong.field)
        except ProtocolError:
            refused = t("editor.no_yaml")
    try:
        draft.save(text)
    except DraftError as problem:
        refused = t(f"lab.draft_errors.{problem.code}", **problem.values)
        answer = {"yaml": text, "mark": draft.mark, "refused": refused, "problems": [], "part": None}
        return reply_of(Edited, answer)
    shown = draft_view(request, draft)
    part = None
    if shown["source"] is not None:
        part = bytes(lab_page(request, "lab/editor_part.html", live=True, **shown).body).decode()
    found = [
        {"line": wrong.line if wrong.file == draft.file.name else 1, "message": _told(wrong, draft)}
        for wrong in shown["problems"]
    ]
    answer = {"yaml": text, "mark": draft.mark, "refused": refused, "problems": found, "part": part}
    return reply_of(Edited, answer)


def changed(text: str, change: Set | Remove | Insert | Move) -> str:
    """The text with that change. Raises EditError, or ProtocolError for a text that is no YAML."""
    path: Path = tuple(change.path)
    match change:
        case Set(value=None) | Remove():
            return editing.remove(text, path)
        case Set(value=value):
            return editing.set_value(text, path, value)
        case Move(index=index, to=to):
            return editing.move(text, path, index, to)
        case Insert(index=index, kind=kind):
            languages = Source("protocol.yaml", text).data.get("languages")
            try:
                value = example_at(path, kind, languages if isinstance(languages, list) else ())
            except (KeyError, ValueError):
                raise EditError(path, "takes nothing more") from None
            return editing.insert(text, path, index, value)


def _told(problem: Problem, draft: Draft) -> str:
    where = "" if problem.file == draft.file.name else f"{problem.file}:{problem.line}: "
    return f"{where}{problem.field}: {problem.message}"
