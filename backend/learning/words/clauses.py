"""A sentence taken apart: its words with their places, the pieces it falls into, and what part each has in it.

Rules of English and German that a bag of words cannot know: "rather A than B", "A, even if B", "you may A if it B".
What a piece is about is the model's (`understanding.py`).
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from backend.learning.words.phrases import Language

LONGEST = 300  # ours: characters of a sentence that is read; a long spoken wish has about 200
MOST_WORDS = 80
Part = Literal["plain", "preferred", "lesser", "conceded"]
"""plain: said by itself; preferred: more of it than of something; lesser: that something; conceded: put up with."""


@dataclass(frozen=True)
class Word:
    """One word: as it stands from `start` to `end`, and as it is compared."""

    start: int
    end: int
    form: str


@dataclass(frozen=True)
class Piece:
    """A stretch of the sentence. strictly: the lesser is given up, not only less important; closes: nothing may be
    joined across its end; foremost: said to matter most; group: pieces of one comparison have the same.
    """

    words: tuple[Word, ...]
    part: Part = "plain"
    strictly: bool = True
    closes: bool = False
    foremost: bool = False
    group: int = 0

    @property
    def judged(self) -> list[Word]:
        """What it is judged by: in comparisons without the words that only compare."""
        kept = [word for word in self.words if self.part == "plain" or word.form not in _ONLY_COMPARE]
        return kept or list(self.words)

    @property
    def forms(self) -> list[str]:
        return [word.form for word in self.judged]


@dataclass(frozen=True)
class Grammar:
    """The words that decide which part a piece has. All are of `form`, so without accents."""

    hard: frozenset[str]
    soft: frozenset[str]
    than: str
    cues: str
    swaps: str
    ranks: str
    instead: str
    short_than: frozenset[str]
    puts: str
    as_much: str
    conceding: str
    allowing: str
    provided: str
    choosing: str
    foremost: str
    pairs: str


def known_words(text: str) -> frozenset[str]:
    """Words in the form in which they are compared, written with spaces between."""
    return frozenset(text.split())


GRAMMARS: Mapping[Language, Grammar] = {
    "en": Grammar(
        hard=known_words("but however yet otherwise except because although though"),
        soft=known_words("and or while plus also then so"),
        than="than",
        cues=r"\b(rather|sooner|prefer|better|more|less|worse|over|instead|matters?|counts?|worth|earlier|\w+er)\b",
        swaps=r"\b(less (important|about|interested|for|of)|worse|matters less|counts less)\b",
        ranks=r"\b(more (important|than|about)|(matters?|means?|worth|counts?) more|less|worse|prefer)\b",
        instead=r"\b(rather than|instead of)\b",
        short_than=known_words("over before above beats outweighs"),
        puts=r"\b(prefer|take|choose|value|put|comes?|goes|pick|favou?r|beats|outweighs)\b",
        as_much=r"\bso much\b",
        conceding=r"\beven (if|when|though|at)|\b(although|though|no matter if|whatever)\b",
        allowing=r"\b(may|can|could|might|allowed|fine)\b",
        provided=r"\b(if|as long as|so long as|provided)\b",
        choosing=r"\b(choose|decide|choice|chose)\b",
        foremost=r"\b(above all|first of all|mainly|especially|first and foremost|priority|most)\b",
        pairs=r"\b((left|back|to|up|now|on|more|nice|safe) and \w+|slow and (safe|steady)"
        r"|(not|dont|be|go|drive|come|move|get) so \w+)\b",
    ),
    "de": Grammar(
        hard=known_words("aber jedoch allerdings sonst ansonsten denn weil hauptsache obwohl"),
        soft=known_words("und oder sowie dann dabei sondern also"),
        than="als",
        cues=r"\b(lieber|eher|besser|mehr|wichtiger|weniger|schlimmer|wert|anders|unwichtiger|\w+er)\b",
        swaps=r"\b(weniger (wichtig|um|auf|an)|schlimmer|unwichtiger)\b",
        ranks=r"\b(wichtiger|mehr|weniger|unwichtiger|schlimmer|bedeutet)\b",
        instead=r"\b(statt|anstatt|anstelle|und nicht)\b",
        short_than=known_words("vor uber"),
        puts=r"\b(geht|gehen|kommt|kommen|steht|stehen|geh)\b",
        as_much=r"\b(nicht|weniger) so (?:sehr|viel|wichtig)\b",
        conceding=r"\b(auch|selbst|sogar) (wenn|falls)\b|\b(obwohl|notfalls)\b",
        allowing=r"\b(darf|darfst|kann|kannst|konnte|durfen|konnen|ruhig)\b",
        provided=r"\b(wenn|solange|sofern|falls)\b",
        choosing=r"\b(entscheiden|wahlen|wahl|entscheidest)\b",
        foremost=r"\b(vor allem|(am|das) wichtigsten?|hauptsache|in erster linie|(ins)?besondere?s?|zuerst)\b",
        pairs=r"\b((hin|links|kreuz|nach|ruhig|drum|ganz|ab|auf) und \w+|langsam und sicher)\b",
    ),
}  # fmt: skip

_ONLY_COMPARE = known_words(
    "rather sooner prefer better important matters matter counts worth means id would "
    "lieber eher besser wichtiger zahlt zahlen bedeutet wert lieb sondern"
)
_WORD = re.compile(r"[^\W_]+(?:['’][^\W_]+)*", re.UNICODE)
_PREFERRED_TO = re.compile(
    r"^(.*\bprefer\w* (?!to\b).+?) to "
    r"(?!me\b|people|us\b|humans|the |walls|furniture|obstacles|things|be\b|have\b|go\b|drive)"
)
_ENDS = re.compile(r"[.!?;:…\n]|\s[-–—]\s|—")


def form_of(word: str) -> str:
    """A word as it is compared: small, without accents and apostrophes, a drawn-out letter once."""
    plain = unicodedata.normalize("NFKD", word.lower().replace("ß", "ss"))
    plain = "".join(letter for letter in plain if not unicodedata.combining(letter) and letter not in "'’")
    return re.sub(r"(.)\1{2,}", r"\1", plain)


def words_of(text: str) -> list[Word]:
    """The words of a sentence, `MOST_WORDS` at most."""
    found = [Word(one.start(), one.end(), form_of(one.group())) for one in _WORD.finditer(text)]
    return found[:MOST_WORDS]


def clauses_of(text: str, language: Language) -> list[Piece]:
    """The pieces that a sentence falls into, with the part each has, in order."""
    grammar = GRAMMARS[language]
    found: list[Piece] = []
    for stretch in _closed_stretches(text, words_of(text), grammar):
        found += _parts(stretch, grammar, group=len(found) + 1)
    return [small for piece in found for small in _softly_split(text, piece, grammar)]


def _closed_stretches(text: str, words: list[Word], grammar: Grammar) -> list[list[Word]]:
    """Split at full stops and at `but`; a word that also says which part it has stays at its stretch's head."""
    stretches: list[list[Word]] = [[]]
    for number, word in enumerate(words):
        between = text[words[number - 1].end : word.start] if number else ""
        if _ENDS.search(between) or word.form in grammar.hard:
            stretches.append([])
        stretches[-1].append(word)
    return [one for one in stretches if one]


def _said(words: list[Word] | tuple[Word, ...]) -> str:
    return " ".join(word.form for word in words)


def _cut(words: list[Word], at: int, skip: int = 1) -> tuple[tuple[Word, ...], tuple[Word, ...]]:
    return tuple(words[:at]), tuple(words[at + skip :])


def _index(words: list[Word], said: re.Match[str]) -> tuple[int, int]:
    """Where in the words a match of their text begins, and how many words it has."""
    before = _said(words)[: said.start()].split()
    return len(before), len(said.group().split())


def _parts(words: list[Word], grammar: Grammar, group: int) -> list[Piece]:
    """One stretch as one piece, or as the two or three of a comparison or concession."""
    said = _said(words)
    foremost = bool(re.search(grammar.foremost, said))
    chosen = re.match(r"(?:if|wenn)\b.*", said)
    if chosen and (at := re.search(grammar.choosing, said)):
        last = re.search(r"\b(then|dann)\b", said)
        if last and last.start() > at.start():
            begins, many = _index(words, last)
            return [Piece(_cut(words, begins, many)[1], "preferred", group=group, foremost=True, closes=True)]
    conceded = re.search(grammar.conceding, said)
    if conceded:
        begins, many = _index(words, conceded)
        before, after = _cut(words, begins, many)
        parts = [Piece(after, "conceded", group=group, closes=True)]
        return ([Piece(before, "preferred", group=group, foremost=foremost, closes=True)] if before else []) + parts
    compared = _compared(words, said, grammar)
    if compared is not None:
        first, second, swapped, ranked = compared
        first_part: Part = "lesser" if swapped else "preferred"
        second_part: Part = "preferred" if swapped else "lesser"
        return [
            Piece(first, first_part, strictly=not ranked, group=group, foremost=foremost, closes=True),
            Piece(second, second_part, strictly=not ranked, group=group, closes=True),
        ]
    provided = re.search(grammar.provided, said)
    if provided and (allowed := re.search(grammar.allowing, said)) and allowed.start() < provided.start():
        before, after = _cut(words, *_index(words, provided))
        return [
            Piece(before, "conceded", group=group, closes=True),
            Piece(after, "preferred", group=group, closes=True, foremost=foremost),
        ]
    return [Piece(tuple(words), closes=True, foremost=foremost, group=group)]


Compared = tuple[tuple[Word, ...], tuple[Word, ...], bool, bool]


def _compared(words: list[Word], said: str, grammar: Grammar) -> Compared | None:
    """(first, second, whether the second is preferred, whether the lesser still matters) of a comparison."""
    swapped = bool(re.search(grammar.swaps, said))
    ranked = bool(re.search(grammar.ranks, said))
    much = re.search(grammar.as_much, said)
    if much:
        begins, many = _index(words, much)
        rest = words[begins + many :]
        links = [k for k, word in enumerate(rest) if word.form in ("as", "wie", "als", "sondern")]
        if links:
            before = tuple(words[:begins]) + tuple(rest[: links[-1]])
            return before, tuple(rest[links[-1] + 1 :]), True, True
    preferred = re.search(_PREFERRED_TO, said)
    if preferred:
        return *_cut(words, len(preferred[1].split())), False, True
    instead = re.search(grammar.instead, said)
    if instead:
        begins, many = _index(words, instead)
        if begins:
            return *_cut(words, begins, many), False, ranked
    for at, word in enumerate(words):
        if word.form == grammar.than and 0 < at < len(words) - 1 and re.search(grammar.cues, _said(words[:at])):
            return *_cut(words, at), swapped, ranked
    for at, word in enumerate(words):
        inside = 0 < at < len(words) - 1
        if inside and word.form in grammar.short_than and (len(words) <= 5 or re.search(grammar.puts, said)):
            return *_cut(words, at), swapped, True
    return None


def _softly_split(text: str, piece: Piece, grammar: Grammar) -> list[Piece]:
    """At commas and `and`; whether the parts are read together again is the model's to say."""
    together = {
        number
        for pair in re.finditer(grammar.pairs, _said(piece.words))
        for number in range(
            len(_said(piece.words)[: pair.start()].split()), len(_said(piece.words)[: pair.end()].split())
        )
    }
    parts: list[list[Word]] = [[]]
    for number, word in enumerate(piece.words):
        between = text[piece.words[number - 1].end : word.start] if number else ""
        links = word.form in grammar.soft and number not in together
        if ("," in between or links) and parts[-1]:
            parts.append([])
        if not links:
            parts[-1].append(word)
    kept = [tuple(one) for one in parts if one]
    if not kept:
        return []
    small = [
        replace(piece, words=one, closes=False, foremost=bool(re.search(grammar.foremost, _said(one)))) for one in kept
    ]
    return [*small[:-1], replace(small[-1], closes=True)]
