"""A rule as it is read: contractions written out, typing errors mended, German compounds by what they end in.

Only words that neither lexicon knows are touched. Each letter keeps its place in the text that was typed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

from desirepath.learning.words.lexicon import KEYS, Language, form_of, known_words, lexicon

LEAST, LEAST_CHANGED, LEAST_TWICE = 4, 6, 9
"""Letters of a word that is mended: at all, with another letter in it, with two slips."""
_WORD = re.compile(r"[^\W_]+(?:['’´`][^\W_]+)*", re.UNICODE)
_SIGNS = re.compile(r"[-=]>|→|⇒|=")  # "guests here = more distance"
_ES = re.compile(r"^(.{2,})['’´`]s$", re.IGNORECASE)
_RUN_TOGETHER = known_words(
    "wenns gehts ists gibts wirds darfs kanns solls habs hats ichs dus obs wos pressierts eilts wars"
)
_ENGLISH: Mapping[str, str] = {
    "abit": "a bit", "adn": "and", "alot": "a lot", "com": "come", "cos": "because", "cuz": "because", "dnt": "dont",
    "dotn": "dont", "everytime": "every time", "gimme": "give me", "gonna": "going to", "gotta": "have to",
    "hte": "the", "infront": "in front", "lemme": "let me", "n": "and", "neednt": "do not need to", "neva": "never",
    "nevr": "never", "nr": "near", "nver": "never", "pls": "please", "plz": "please", "rm": "room", "teh": "the",
    "theyre": "they are", "tho": "though", "thru": "through", "u": "you", "ur": "your", "w": "with",
    "wanna": "want to", "wehn": "when", "wen": "when", "whne": "when", "wiht": "with", "wont": "will not",
    "ya": "you", "youre": "you are", "yuo": "you",
}  # fmt: skip
_GERMAN: Mapping[str, str] = {
    "aufm": "auf dem", "aufn": "auf den", "ausm": "aus dem", "ausser": "außer", "bissel": "bisschen",
    "bissi": "bisschen", "dan": "dann", "hinterm": "hinter dem", "is": "ist", "ma": "mal", "mitm": "mit dem",
    "nciht": "nicht", "ne": "eine", "ned": "nicht", "nem": "einem", "nen": "einen", "ner": "einer", "net": "nicht",
    "nich": "nicht", "nichtt": "nicht", "nict": "nicht", "nit": "nicht", "nix": "nichts", "u": "und", "un": "und",
    "unterm": "unter dem", "vorm": "vor dem", "wech": "weg", "wek": "weg", "wen": "wenn", "wens": "wenn es",
}  # fmt: skip
_WITH_IS = known_words(
    "nobody noone somebody someone everybody everyone anybody anyone time who everything nothing one bathroom kitchen"
)
_TURNING = ("not", "undo", "avoid", "needless", "bad", "why", "less", "too", "suggest", "alone", "unless", "no_hurry")
_HEADS = (
    "sofa", "table", "chair", "bed", "cupboard", "lamp", "box", "pillar", "kitchen", "living_room", "bedroom",
    "bathroom", "dining_room", "study", "corridor", "doorway", "others", "wall", "furniture",
)  # fmt: skip
_NO_HEADS = known_words("tisch gang licht wand post posten bank party leute")


@dataclass(frozen=True)
class Mended:
    """text: to be read; starts, ends: of each of its letters, where that stood in the text that was typed."""

    text: str
    starts: tuple[int, ...]
    ends: tuple[int, ...]

    def typed(self, start: int, end: int) -> tuple[int, int]:
        """A stretch of `text`, as a stretch of what was typed."""
        if start >= len(self.starts):
            return (self.ends[-1], self.ends[-1]) if self.ends else (0, 0)
        return self.starts[start], self.ends[max(start, end - 1)] if end > start else self.starts[start]


def mend(text: str, language: Language) -> Mended:
    """Words and signs as the readers know them."""
    said, starts, ends, at = "", list[int](), list[int](), 0
    for start, end, new in sorted([*_signs(text), *_words(text, language)]):
        said += text[at:start] + new
        starts += [*range(at, start), *[start] * len(new)]
        ends += [*range(at + 1, start + 1), *[end] * len(new)]
        at = end
    rest = range(at, len(text))
    return Mended(said + text[at:], (*starts, *rest), (*ends, *(k + 1 for k in rest)))


def _signs(text: str) -> Iterator[tuple[int, int, str]]:
    for one in _SIGNS.finditer(text):
        yield one.start(), one.end(), ":"


def _words(text: str, language: Language) -> Iterator[tuple[int, int, str]]:
    for one in _WORD.finditer(text):
        word = one.group()
        new = _written_out(word, language) or _mended(form_of(word, language), language)
        if new is not None and new != form_of(word, language):
            yield one.start(), one.end(), new[0].upper() + new[1:] if word[0].isupper() else new


def _written_out(word: str, language: Language) -> str | None:
    form = form_of(word, language)
    if language == "en":
        if (short := _ES.match(word)) and short[1].lower() in _WITH_IS:
            return form_of(short[1], language) + " is"
        return _ENGLISH.get(form)
    if form in _RUN_TOGETHER:
        return form[:-1] + " es"
    if short := _ES.match(word):
        return form_of(short[1], language) + " es"
    return _GERMAN.get(form)


@lru_cache(maxsize=20_000)
def _mended(form: str, language: Language) -> str | None:
    """The word that was meant, where only one is likely; None for a word that stays."""
    known = _vocabulary(language)
    if len(form) < LEAST or form in known or not form.isalpha() or len(form) > 30:
        return None
    words = lexicon(language)
    if language == "de" and words.parted(form):
        return None
    ranked = [(rank, one) for one in _candidates(form, language) if (rank := _slip(form, one, language)) is not None]
    head = _head(form, language) if language == "de" else None
    if head and all(rank > 1 for rank, _ in ranked):
        return head
    if ranked:
        least = min(rank for rank, _ in ranked)
        best = [one for rank, one in ranked if rank == least]
        if len({known[one] for one in best}) == 1:
            return min(best)
    return None


def _slip(typed: str, known: str, language: Language) -> int | None:
    """How far a typed word is from a known one: 0 sounds the same, 1 two letters swapped, 2 one too many or too few, 3
    another letter, 4 two slips; None: another word. What turns a sentence round is only mended of the first two."""
    turns = not set(_TURNING).isdisjoint(_vocabulary(language)[known])
    if _sound(typed, language) == _sound(known, language):
        return 0
    if len(typed) == len(known):
        differ = [k for k in range(len(typed)) if typed[k] != known[k]]
        if len(differ) == 2 and differ[1] == differ[0] + 1 and sorted(typed) == sorted(known):
            return 1
        if len(differ) == 1 and differ[0] > 0 and not turns and len(typed) >= LEAST_CHANGED:
            k = differ[0]
            beside = any(pair in KEYS for pair in (typed[k] + known[k], known[k] + typed[k]))
            return 3 if beside and k < len(typed) - 1 else None
    if turns or typed[0] != known[0]:
        return None
    longer, shorter = (typed, known) if len(typed) > len(known) else (known, typed)
    if len(longer) == len(shorter) + 1 and len(shorter) > LEAST:
        inside = any(longer[:k] + longer[k + 1 :] == shorter for k in range(1, len(longer) - 1))
        return 2 if inside else None
    content = not _vocabulary(language)[known].isdisjoint(_HEADS)
    if (
        content
        and min(len(typed), len(known)) >= LEAST_TWICE
        and _distance(typed, known) == 2
        and typed[:2] == known[:2]
    ):
        return 4
    return None


def _distance(a: str, b: str) -> int:
    """Damerau and Levenshtein's, at most 3."""
    if abs(len(a) - len(b)) > 2:
        return 3
    before: list[int] = []
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, 1):
        now = [i]
        for j, y in enumerate(b, 1):
            least = min(row[j] + 1, now[j - 1] + 1, row[j - 1] + (x != y))
            if i > 1 and j > 1 and x == b[j - 2] and a[i - 2] == y:
                least = min(least, before[j - 2] + 1)
            now.append(least)
        before, row = row, now
    return min(row[-1], 3)


_SOUNDS: Mapping[Language, tuple[tuple[re.Pattern[str], str], ...]] = {
    "de": (
        (re.compile(r"(.)\1"), r"\1"), (re.compile(r"chs"), "ks"), (re.compile(r"([aeiou])h(?=[^aiou]|$)"), r"\1"),
        (re.compile(r"ai"), "ei"), (re.compile(r"ae?u"), "eu"), (re.compile(r"ae"), "e"), (re.compile(r"ie"), "i"),
        (re.compile(r"ck"), "k"), (re.compile(r"tz"), "z"), (re.compile(r"v|ph"), "f"), (re.compile(r"dt|th"), "t"),
        (re.compile(r"y"), "i"), (re.compile(r"d$"), "t"), (re.compile(r"g$"), "k"),
        (re.compile(r"e([nlr])$"), r"\1"), (re.compile(r"(.)\1"), r"\1"),
    ),
    "en": (
        (re.compile(r"(.)\1"), r"\1"), (re.compile(r"ck"), "k"), (re.compile(r"ph"), "f"),
        (re.compile(r"c(?=[^eiyh]|$)"), "k"), (re.compile(r"[oae]r(s?)$"), r"er\1"), (re.compile(r"e([nl])$"), r"\1"),
        (re.compile(r"ght"), "t"), (re.compile(r"(?<=..[^aeiou])e$"), ""), (re.compile(r"ie"), "ei"),
        (re.compile(r"(.)\1"), r"\1"),
    ),
}  # fmt: skip


@lru_cache(maxsize=50_000)
def _sound(form: str, language: Language) -> str:
    """What is heard of a word, so that spellings of the same sound compare as equal."""
    for pattern, sound in _SOUNDS[language]:
        form = pattern.sub(sound, form)
    return form


@lru_cache(maxsize=2)
def _vocabulary(language: Language) -> Mapping[str, frozenset[str]]:
    """Every word of both lexica, with its senses; of a word of phrases only, the word itself."""
    found: dict[str, set[str]] = {}
    for name in ("rules", "lexicon"):
        one = lexicon(language, name)
        for forms, senses in one.entries.items():
            if len(forms) == 1:
                found.setdefault(forms[0], set()).update(senses)
        for form in one.forms:
            found.setdefault(form, set())
    return {form: frozenset(senses or {f"'{form}'"}) for form, senses in found.items()}


@lru_cache(maxsize=2)
def _by_start(language: Language) -> Mapping[str, tuple[str, ...]]:
    """Words by how they sound, and by their first letter and the length."""
    found: dict[str, list[str]] = {}
    for form in _vocabulary(language):
        if len(form) >= LEAST and form.isalpha():
            found.setdefault("=" + _sound(form, language), []).append(form)
            found.setdefault(f"{form[0]}{len(form)}", []).append(form)
    return {key: tuple(forms) for key, forms in found.items()}


def _candidates(form: str, language: Language) -> set[str]:
    near = _by_start(language)
    keys = ["=" + _sound(form, language), *(f"{form[0]}{len(form) + k}" for k in (-2, -1, 0, 1, 2))]
    keys.append(f"{form[1]}{len(form)}")  # the first two swapped
    return {one for key in keys for one in near.get(key, ())}


def _head(form: str, language: Language) -> str | None:
    """What a compound ends in, of furniture, rooms and people: "Ohrensessel", "Einbauschrank", "Wohnküche"."""
    known = _vocabulary(language)
    for cut in range(2, len(form) - 3):
        end = form[cut:]
        if end in known and end not in _NO_HEADS and not known[end].isdisjoint(_HEADS):
            return end
    return None
