"""Texts per language: the one in somebody's language, the file of a language."""

from __future__ import annotations


def local(text: dict[str, str], language: str) -> str:
    """The text in that language, in the first one it has otherwise."""
    return text.get(language) or next(iter(text.values()))


def variant(name: str, language: str) -> str:
    """`texts/consent.md` in German is `texts/consent.de.md`."""
    stem, dot, ending = name.rpartition(".")
    return f"{stem}.{language}{dot}{ending}" if dot else f"{name}.{language}"
