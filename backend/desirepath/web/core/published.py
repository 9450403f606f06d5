"""The contract as it is published: OpenAPI of every route, and TypeScript types of what pages send and are told.

`python -m desirepath.web.core.published` writes the types to `frontend/static/js/contract.d.ts`, as `make lint` does
before it checks the modules. They name every kind of step, so the file is not kept: a new kind would have to touch it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.openapi.utils import get_openapi
from pydantic import TypeAdapter
from pydantic.json_schema import models_json_schema
from starlette.responses import JSONResponse, Response

from desirepath.installed import FRONTEND
from desirepath.web.core.auth import SignedIn
from desirepath.web.core.contract import Refusal
from desirepath.web.core.lab_frame import lab_page
from desirepath.web.core.media import media_of
from desirepath_stage import orders

router = APIRouter(tags=["contract"])
TYPES = FRONTEND / "static" / "js" / "contract.d.ts"
ABOUT = "Every route of this server. Participants' routes need a session's link, all under /lab and /api/lab a sign-in."
HEAD = "// Made by `python -m desirepath.web.core.published` from the server's models; not to be edited.\n"
METHODS = ("get", "post", "put", "delete", "patch")


def openapi_of(application: FastAPI) -> dict[str, Any]:
    """OpenAPI 3.1 of the application. Routes that answer with no model answer with a page or a file (`media.py`)."""
    if application.openapi_schema is None:
        schema = get_openapi(
            title=application.title, version=application.version, description=ABOUT, routes=application.routes
        )
        _, refusal = models_json_schema([(Refusal, "serialization")], ref_template="#/components/schemas/{model}")
        components = schema.setdefault("components", {}).setdefault("schemas", {})
        components |= refusal["$defs"]
        refused = {"application/json": {"schema": {"$ref": "#/components/schemas/Refusal"}}}
        for (_, path), operation in operations(schema):
            for status, answer in operation["responses"].items():
                content = answer.get("content", {})
                if content.get("application/json", {"schema": True}).get("schema") == {}:
                    answer["content"] = {media_of(path): {}}
                elif status == "422":
                    answer |= {"description": "Refused", "content": refused}
        for unused in ("HTTPValidationError", "ValidationError"):
            components.pop(unused, None)
        application.openapi_schema = schema
    return application.openapi_schema


def operations(schema: Mapping[str, Any]) -> list[tuple[tuple[str, str], dict[str, Any]]]:
    """Every ((method, path), operation) of an OpenAPI document."""
    return [
        ((method, path), item[method]) for path, item in schema["paths"].items() for method in METHODS if method in item
    ]


@router.get("/api/docs", include_in_schema=False)
def docs(request: Request, user: SignedIn) -> Response:
    """The contract to be read: every route with what it takes and answers."""
    schema = openapi_of(request.app)
    by_tag: dict[str, list[tuple[tuple[str, str], dict[str, Any]]]] = {}
    for at, operation in operations(schema):
        by_tag.setdefault((operation.get("tags") or ["participant"])[0], []).append((at, operation))
    return lab_page(request, "lab/api_docs.html", by_tag=by_tag, types=typescript(schema["components"]["schemas"]))


@router.get("/api/docs/openapi.json", include_in_schema=False)
def document(request: Request, user: SignedIn) -> JSONResponse:
    """The same as OpenAPI, for programs."""
    return JSONResponse(openapi_of(request.app))


# ---- TypeScript ------------------------------------------------------------------------------------------------------


def typescript(schemas: Mapping[str, Any]) -> str:
    """One exported type per schema of OpenAPI's components, in the order of their names."""
    return "\n".join(_declared(name, schemas[name]) for name in sorted(schemas) if not name.startswith("Body_"))


def _declared(name: str, schema: Mapping[str, Any]) -> str:
    comment = f"/** {' '.join(schema['description'].split())} */\n" if schema.get("description") else ""
    if schema.get("type") != "object":
        return f"{comment}export type {name} = {_typed(schema)};\n"
    lines = [_property(key, of, key in schema.get("required", ())) for key, of in schema.get("properties", {}).items()]
    if more := schema.get("additionalProperties"):
        known = [*schema.get("properties", {}).values(), *([more] if isinstance(more, Mapping) else [{}])]
        lines.append(f"  [more: string]: {' | '.join(dict.fromkeys(map(_typed, known)))} | undefined;")
    return f"{comment}export interface {name} {{\n" + "\n".join(lines) + "\n}\n"


def _property(key: str, schema: Mapping[str, Any], required: bool) -> str:
    comment = f"  /** {' '.join(schema['description'].split())} */\n" if schema.get("description") else ""
    return f"{comment}  {key}{'' if required else '?'}: {_typed(schema)};"


def _typed(schema: Mapping[str, Any]) -> str:
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    if "const" in schema:
        return _literal(schema["const"])
    if "enum" in schema:
        return " | ".join(_literal(value) for value in schema["enum"])
    several = schema.get("anyOf") or schema.get("oneOf") or schema.get("allOf")
    if several:
        return " | ".join(dict.fromkeys(_typed(schema) for schema in several))
    kind = schema.get("type")
    if kind == "array":
        if "prefixItems" in schema:
            return f"[{', '.join(_typed(item) for item in schema['prefixItems'])}]"
        inner = _typed(schema.get("items", {}))
        return f"({inner})[]" if " " in inner else f"{inner}[]"
    if kind == "object":
        more = schema.get("additionalProperties")
        return f"{{ [key: string]: {_typed(more) if isinstance(more, Mapping) else 'any'} }}"
    names = {"string": "string", "integer": "number", "number": "number", "boolean": "boolean", "null": "null"}
    return names.get(str(kind), "any")


def _literal(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value).lower()


def types_now() -> str:
    """What pages and bots send and are told, and what the stage is ordered, as it should stand in `contract.d.ts`."""
    from desirepath.web.participant import replies, sent, steps

    sent_down = [(shape, "validation") for shape in orders.shapes()]
    models = [*_models(sent, "validation"), (steps.AnswerSent, "validation"), *sent_down]
    models += [*_models(replies, "serialization"), (Refusal, "serialization")]
    named = [(one.__name__, mode, TypeAdapter(one)) for one, mode in models]
    _, schema = TypeAdapter.json_schemas(named, ref_template="{model}")  # type: ignore[arg-type]
    return HEAD + "\n" + typescript(schema["$defs"])


def _models(module: ModuleType, mode: str) -> list[tuple[type, str]]:
    """The models that a module makes itself."""
    own = (model for model in vars(module).values() if isinstance(model, type) and model.__module__ == module.__name__)
    return [(model, mode) for model in own]


def main() -> None:
    """Write the types."""
    TYPES.write_text(types_now(), encoding="utf-8")


if __name__ == "__main__":
    main()
