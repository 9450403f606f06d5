"""Markdown of a study's texts to safe HTML. Raw HTML in the text is shown as text, images are not fetched. The line
`<!-- more -->`, after which participants' pages fold a text away (templates/participant/long_text.html), is left out.
"""

from __future__ import annotations

from markdown_it import MarkdownIt
from markupsafe import Markup

_MARKDOWN = MarkdownIt("commonmark", {"html": False, "typographer": True}).enable("table").disable("image")


def prose(text: str, shift: int | None = None) -> Markup:
    """HTML of a markdown `text`. Links open in a new tab, so that nobody loses the step they are in.

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
