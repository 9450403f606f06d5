"""What every part of a protocol file is made of: strict models, short texts per language, patterns with their words."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.config import JsonDict
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

Localized = Annotated[dict[str, str], Field(min_length=1)]
"""A text in each of the protocol's languages: {en: ..., de: ...}."""
FileName = Annotated[str, Field(min_length=1, max_length=200, examples=["texts/page.md"])]
Version = Annotated[str, Field(min_length=1, max_length=40)]
PATTERNS = {
    r"^[a-z][a-z0-9_]*$": "must be lower-case letters, digits and _, beginning with a letter",
    r"^[A-Za-z0-9-]{4,40}$": "must be random, or 4 to 40 letters, digits and -",
    r"^https://\S+$": "must be an address that begins with https://",
    r"^[a-z]{2}$": "must be a language code of two lower-case letters, such as en",
}
"""Every pattern of a protocol, in words for the person who wrote it."""
_SLUG, _CODE, _ADDRESS, _LANGUAGE = PATTERNS
Slug = Annotated[str, Field(pattern=_SLUG, max_length=60)]
Code = Annotated[str, Field(pattern=_CODE)]
Address = Annotated[str, Field(pattern=_ADDRESS, max_length=400)]
Language = Annotated[str, Field(pattern=_LANGUAGE)]
Value = Annotated[str, Field(min_length=1, max_length=60)]
"""What is stored of a chosen answer."""


class OneOf:
    """Of an annotated string: it is one of what `names` gives when it is asked; more come while a server runs. Errors
    and the published schema say them as a Literal's."""

    def __init__(self, names: Callable[[], Iterable[str]]) -> None:
        self.names = names

    def _check(self, given: str) -> str:
        known = list(self.names())
        if given not in known:
            quoted = [repr(name) for name in known]
            listed = " or ".join([", ".join(quoted[:-1]), quoted[-1]] if len(quoted) > 1 else quoted)
            raise PydanticKnownError("literal_error", {"expected": listed})
        return given

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {**handler(schema), "enum": list(self.names())}


class Part(BaseModel):
    """Base of everything in a protocol: an unknown key is an error, nothing changes once it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def an_example(written: JsonDict) -> ConfigDict:
    """Of a part whose needed keys do not make one by themselves; errors and editors show it."""
    return ConfigDict(json_schema_extra={"examples": [written]})
