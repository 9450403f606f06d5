"""Reports as one HTML file that also prints: sections of sentences, tables and figures. What they say is the caller's.

A report's own template extends `printed.html` and fills its blocks `title`, `head` and `made`.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import jinja2

if TYPE_CHECKING:
    from desirepath.explain.pictures import Picture

_BELONGS = re.compile(r" (?:(?=[±%*])|(?<=[±<>=] )|(?=[=<>])(?<=\b\w |\) ))")
Shown = Mapping[str, str]
"""A figure as the template shows it: name, title, caption, svg in base64."""


@dataclass(frozen=True)
class Table:
    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]

    @property
    def worded(self) -> set[int]:
        """Columns in which words stand; numbers are aligned to the right."""
        return {k for row in self.rows for k, cell in enumerate(row) if cell[:1].isalpha()}


@dataclass(frozen=True)
class Section:
    """In this order: sentences, tables, points of a list, pictures."""

    title: str
    sentences: Sequence[str] = ()
    tables: Sequence[Table] = ()
    points: Sequence[str] = ()
    pictures: Sequence[Shown] = ()


def embed_picture(picture: Picture, folder: Path) -> Shown:
    """A figure that was saved to `folder`, to be put into the page."""
    return {
        "name": picture.name,
        "title": picture.title,
        "caption": picture.caption,
        "svg": base64.b64encode((folder / f"{picture.name}.svg").read_bytes()).decode(),
    }


def unbroken(text: str) -> str:
    """The text with numbers kept on one line with what belongs to them: < 0.001, 4.2 ± 0.3, 52 %, p = 0.03 ***."""
    return _BELONGS.sub("\u00a0", text)


def page(package: str, template: str, /, **values: object) -> str:
    """A package's template filled in; everything but our own markup is escaped. `sections` is what every report has."""
    loader = jinja2.ChoiceLoader([jinja2.PackageLoader(package, "."), jinja2.PackageLoader("desirepath.explain", ".")])
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, loader=loader)
    environment.filters["unbroken"] = unbroken
    return environment.get_template(template).render(**values)
