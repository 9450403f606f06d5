"""Markdown as safe HTML: a study's texts, and the manual of `docs/` as pages of the lab with what fits which page.

Its order is `mkdocs.yml`'s, by which `make docs` builds the same pages as a site. Raw HTML in a text is shown as text,
images are not fetched, but the manual's own are shown. The guides' routes are `lab/guide_pages.py`'s.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import yaml
from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup, escape

from desirepath.installed import DOCS, ROOT

HERE = "/lab/guides"


@dataclass(frozen=True)
class Chapter:
    """A part of the manual: its pages, by the names of their files."""

    title: str
    names: tuple[str, ...]


def _contents() -> tuple[Chapter, ...]:
    read = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    parts = [part for chapter in read for part in chapter.items()]
    pages = [(title, [files] if isinstance(files, str) else files) for title, files in parts]
    return tuple(Chapter(title, tuple(file.removesuffix(".md") for file in files)) for title, files in pages)


CONTENTS = _contents()
GUIDES = tuple(name for chapter in CONTENTS for name in chapter.names)
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
    "/lab/studies/{study_id}/paths": "asking-people#drawn-paths",
    "/lab/studies/{study_id}/coding": "asking-people#open-questions",
    "/lab/studies/{study_id}/robots": "experimenters-guide#a-real-robot",
    "/lab/studies/{study_id}/data": "experimenters-guide#data-and-report",
    "/lab/studies/{study_id}/answers": "experimenters-guide#data-and-report",
    "/lab/studies/{study_id}/report": "experimenters-guide#data-and-report",
    "/lab/studies/{study_id}/analysis": "analysts-guide#a-studys-report",
    "/lab/studies/{study_id}/team": "experimenters-guide#accounts-and-roles",
    "/lab/settings": "experimenters-guide#accounts-and-roles",
    "/lab/audit": "experimenters-guide#accounts-and-roles",
    "/lab/jobs": "analysts-guide#jobs",
    "/lab/recordings": "your-recordings",
    "/lab/snapshots": "analysts-guide",
    "/lab/policies": "analysts-guide#what-the-numbers-mean",
    "/lab/artefacts": "analysts-guide#what-the-numbers-mean",
    "/lab/compare": "analysts-guide#what-the-numbers-mean",
    "/lab/flow-field": "analysts-guide#flow-fields",
    "/lab/live": "policies#preference-conditioned-policies",
    "/lab/settings/setups": "extending#a-robot-and-its-setup",
    "/lab/explain": "analysts-guide#explanations",
}
"""Route, and all that begin with it -> the part of a guide that says most about it; the longest one counts."""
_MARKDOWN = MarkdownIt("commonmark", {"html": False, "typographer": True}).enable("table").disable("image")
_MANUAL = MarkdownIt("commonmark", {"html": False, "typographer": True}).enable("table")
PICTURE = re.compile(r"images/([\w-]+)-light\.webp#gh-light-mode-only")
"""Of a page, in the light scheme; beside it stands the dark one, as sites and GitHub choose between the two."""
PICTURE_SIZE = (800, 500)  # scripts/screens.py makes them


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
class Passage:
    """What stands under one heading, as plain words. level: 1 for the page's own title."""

    level: int
    anchor: str
    title: str
    words: str


@dataclass(frozen=True)
class Guide:
    """One page of the manual."""

    name: str
    html: Markup
    passages: tuple[Passage, ...]

    @property
    def title(self) -> str:
        return self.passages[0].title

    @property
    def sections(self) -> list[Passage]:
        return [passage for passage in self.passages if passage.level == 2]


@dataclass(frozen=True)
class Found:
    """A passage with all words that were looked for, and what stands around the first of them."""

    guide: Guide
    passage: Passage
    around: str


def fitting_guide(route: str) -> str:
    """Address of what fits a page; route: its pattern, as `/lab/studies/{study_id}`."""
    above = [fitting for fitting in FITTING if route == fitting or route.startswith(f"{fitting}/")]
    return f"{HERE}/{FITTING[max(above, key=len)]}" if above else HERE


@lru_cache
def guide(name: str) -> Guide:
    """Raises KeyError for a guide that there is not."""
    if name not in GUIDES:
        raise KeyError(name)
    tokens = _MANUAL.parse((DOCS / f"{name}.md").read_text(encoding="utf-8"))
    for token in tokens:
        token.children = [child for child in map(_shown, token.children) if child] if token.children else token.children
    passages = tuple(_passages(tokens))
    for token in tokens:
        _lead_on(token.children or ())
    # Markup: the renderer escapes everything that came from the text (html=False).
    return Guide(name, Markup(_MANUAL.renderer.render(tokens, _MANUAL.options, {})), passages)  # noqa: S704


def _shown(token: Token) -> Token | None:
    """A picture as the browser's scheme wants it, in place of the two that stand in the text; other images are not
    fetched."""
    if token.type != "image":
        return token
    found = PICTURE.fullmatch(str(token.attrGet("src")))
    if found is None:
        return None
    (width, height), of = PICTURE_SIZE, f"{HERE}/images/{found[1]}"
    picture = Token("html_inline", "", 0)
    picture.content = (
        f'<picture><source media="(prefers-color-scheme: dark)" srcset="{of}-dark.webp">'
        f'<img src="{of}-light.webp" alt="{escape(token.content)}" width="{width}" height="{height}" loading="lazy">'
        "</picture>"
    )
    return picture


def find(words: str) -> list[Found]:
    """Passages of the manual with words that begin with each of these: those first that have them whole (or as a
    plural) in their heading, then anywhere; then those with longer words in their heading."""
    wanted = words.casefold().split()
    found = []
    for page in map(guide, GUIDES):
        for passage in page.passages:
            if wanted and _has(wanted, f"{passage.title} {passage.words}"):
                around = max(0, next(_beginnings(wanted[0], passage.words.casefold()), 0) - 60)
                found.append(Found(page, passage, passage.words[around : around + 200]))

    def rank(one: Found) -> tuple[bool, ...]:
        title, text = one.passage.title, one.passage.words
        whole, whole_anywhere = _has(wanted, title, whole=True), _has(wanted, f"{title} {text}", whole=True)
        return not whole, not whole_anywhere, not _has(wanted, title)

    return sorted(found, key=rank)


def _has(words: Sequence[str], text: str, *, whole: bool = False) -> bool:
    """Whether the text has words that begin with each of these; whole: that are these, or a plural."""
    folded = text.casefold()
    return all(any(not whole or _ends(word, folded, place) for place in _beginnings(word, folded)) for word in words)


def _beginnings(word: str, text: str) -> Iterator[int]:
    place = text.find(word)
    while place >= 0:
        if not _is_of_word(text[place - 1 : place]):
            yield place
        place = text.find(word, place + 1)


def _ends(word: str, text: str, place: int) -> bool:
    after = text[place + len(word) :][:2]
    return not _is_of_word(after[:1]) or (after[:1] == "s" and not _is_of_word(after[1:]))


def _is_of_word(character: str) -> bool:
    return character.isalnum() or character == "_"


def _passages(tokens: list[Token]) -> Iterator[Passage]:
    """Give every heading its anchor, and say what stands below it."""
    places = [place for place, token in enumerate(tokens) if token.type == "heading_open"]
    for place, end in itertools.pairwise([*places, len(tokens)]):
        title = _plain(tokens[place + 1])
        tokens[place].attrSet("id", anchor_of(title))
        yield Passage(
            int(tokens[place].tag[1]), anchor_of(title), title, " ".join(map(_plain, tokens[place + 3 : end]))
        )


def _plain(token: Token) -> str:
    """Its words without marks: of a paragraph, of a table's cell, of code."""
    if token.children is None:
        return token.content
    return "".join(child.content or " " for child in token.children if child.type != "html_inline")


def anchor_of(words: str) -> str:
    """Of a heading's words. As GitHub makes it, so that links between the files work here and there."""
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
