"""Markdown as safe HTML: a study's texts, and the guides of `docs/` as pages of the lab with what fits which page.

Raw HTML in a text is shown as text, images are not fetched. The guides' routes are `lab/guide_pages.py`'s.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from functools import lru_cache

from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup

from desirepath.installed import DOCS

HERE = "/lab/guides"
GUIDES = (
    "experimenters-guide",
    "protocol-reference",
    "analysts-guide",
    "participants-guide",
    "data-dictionary",
)
FITTING = {
    "/lab/new": "experimenters-guide#a-new-study",
    "/lab/new/{draft_id}": "protocol-reference",
    "/lab/studies": "experimenters-guide",
    "/lab/studies/{study_id}/protocol": "protocol-reference",
    "/lab/studies/{study_id}/revise": "protocol-reference#changing-a-running-study",
    "/lab/studies/{study_id}/power": "experimenters-guide#a-new-study",
    "/lab/studies/{study_id}/recruit": "experimenters-guide#recruiting-and-paying",
    "/lab/studies/{study_id}/payments": "experimenters-guide#recruiting-and-paying",
    "/lab/studies/{study_id}/now": "experimenters-guide#watching",
    "/lab/studies/{study_id}/people": "experimenters-guide#watching",
    "/lab/studies/{study_id}/people/{code}": "experimenters-guide#excluding-withdrawing-erasing",
    "/lab/studies/{study_id}/paths": "experimenters-guide#drawn-paths",
    "/lab/studies/{study_id}/data": "experimenters-guide#data-and-report",
    "/lab/studies/{study_id}/answers": "experimenters-guide#data-and-report",
    "/lab/studies/{study_id}/report": "experimenters-guide#data-and-report",
    "/lab/studies/{study_id}/analysis": "analysts-guide#a-studys-report",
    "/lab/studies/{study_id}/team": "experimenters-guide#accounts-and-roles",
    "/lab/settings": "experimenters-guide#accounts-and-roles",
    "/lab/audit": "experimenters-guide#accounts-and-roles",
    "/lab/jobs": "analysts-guide#jobs",
    "/lab/recordings": "experimenters-guide#your-recordings",
    "/lab/snapshots": "analysts-guide",
    "/lab/policies": "analysts-guide#what-the-numbers-mean",
    "/lab/artefacts": "analysts-guide#what-the-numbers-mean",
    "/lab/compare": "analysts-guide#what-the-numbers-mean",
    "/lab/flow-field": "analysts-guide#flow-fields",
    "/lab/explain": "analysts-guide#what-moved-the-robot",
}
"""Route, and all that begin with it -> the part of a guide that says most about it; the longest one counts."""
_MARKDOWN = MarkdownIt("commonmark", {"html": False, "typographer": True}).enable("table").disable("image")


def prose(text: str, shift: int | None = None) -> Markup:
    """HTML of a study's markdown `text`. Links open in a new tab, so that nobody loses the step they are in. The line
    `<!-- more -->`, after which participants' pages fold it away (templates/participant/long_text.html), is left out.

    Headings keep their level but never rise above h2, as the page's own heading is the h1; with `shift` they move down
    by that many levels instead.
    """
    tokens = _MARKDOWN.parse(text.replace("<!-- more -->", ""))
    for token in tokens:
        if token.type in ("heading_open", "heading_close"):
            level = int(token.tag[1])
            token.tag = f"h{max(2, level) if shift is None else min(6, level + shift)}"
        for child in token.children or ():
            if child.type == "link_open":
                child.attrs.update(target="_blank", rel="noopener noreferrer")
    # Markup: the renderer escapes everything that came from the text (html=False).
    return Markup(_MARKDOWN.renderer.render(tokens, _MARKDOWN.options, {}))  # noqa: S704


@dataclass(frozen=True)
class Guide:
    """One guide. sections: (anchor, words) of its second-level headings."""

    name: str
    title: str
    html: Markup
    sections: tuple[tuple[str, str], ...]
    anchors: frozenset[str]


def fitting_guide(route: str) -> str:
    """Address of what fits a page; route: its pattern, as `/lab/studies/{study_id}`."""
    above = [fitting for fitting in FITTING if route == fitting or route.startswith(f"{fitting}/")]
    return f"{HERE}/{FITTING[max(above, key=len)]}" if above else HERE


@lru_cache(maxsize=len(GUIDES))
def guide(name: str) -> Guide:
    """Raises KeyError for a guide that there is not."""
    if name not in GUIDES:
        raise KeyError(name)
    tokens = _MARKDOWN.parse((DOCS / f"{name}.md").read_text(encoding="utf-8"))
    headings: list[tuple[str, str, str]] = []
    for opened, words in itertools.pairwise(tokens):
        if opened.type == "heading_open":
            title = "".join(child.content for child in words.children or ())
            anchor = _anchor(title)
            opened.attrSet("id", anchor)
            headings.append((opened.tag, anchor, title))
    for token in tokens:
        _lead_on(token.children or ())
    # Markup: the renderer escapes everything that came from the text (html=False).
    shown = Markup(_MARKDOWN.renderer.render(tokens, _MARKDOWN.options, {}))  # noqa: S704
    sections = tuple((anchor, title) for tag, anchor, title in headings if tag == "h2")
    return Guide(name, headings[0][2], shown, sections, frozenset(anchor for _, anchor, _ in headings))


def _anchor(words: str) -> str:
    """As GitHub makes it, so that links between the files work here and there."""
    return re.sub(r"[^\w\- ]", "", words.strip().lower()).replace(" ", "-")


def _lead_on(tokens: list[Token] | tuple[()]) -> None:
    """Links to a guide lead to its page; those to other files of the repository have nothing to lead to here."""
    for token in tokens:
        if token.type != "link_open":
            continue
        address = str(token.attrGet("href") or "")
        name, _, part = address.partition("#")
        if name.removesuffix(".md") in GUIDES:
            token.attrSet("href", f"{HERE}/{name.removesuffix('.md')}{'#' + part if part else ''}")
        elif "://" in address:
            token.attrs.update(target="_blank", rel="noopener noreferrer")
