"""The words that the reader knows, of `datasets/words/lexicon_*.txt`: a text as tokens, each with its senses.

Inflected forms, small typing errors and German separable verbs are found here; what a sentence says is not.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import Literal, get_args

from desirepath.installed import DATASETS

Language = Literal["en", "de"]
LANGUAGES: tuple[Language, ...] = get_args(Language)
FOLDER = DATASETS / "words"
LONGEST = 300  # ours: characters of a sentence that is read; a long spoken wish has about 200
MOST_WORDS = 80
MOST_BETWEEN = 9  # words of a clause that a separable verb's particle is looked for in
LONGEST_WORD = 40  # letters; nobody's word is longer
UNKNOWN = frozenset({"unknown"})
SURELY_MISTYPED = 7  # letters; with one wrong letter, a shorter word is as likely another word: "closet", "master"


def known_words(text: str) -> frozenset[str]:
    """Words written with spaces between."""
    return frozenset(text.split())


_ENDINGS: Mapping[Language, str] = {
    "en": "s es d ed ing er est ly",
    "de": "e en em er es n s t st et est te ten ter tes tem tet end ende enden ere eren erer erem eres ste sten ster "
    "stes stem",
}
_FEW_ENDINGS: Mapping[Language, str] = {"en": "s ed ing", "de": "e en st t"}  # in phrases
_PREFIXES: Mapping[str, str] = {
    one: sense
    for sense, some in {
        "pass": "vorbei vorueber",
        "near": "heran ran nah nahe naeher",
        "far": "weg fern fort",
        "filler": "entlang herum umher hinterher hinein hinaus heraus herein zurueck dazu durch hin her los ab an auf "
        "aus um ein mit nach vor zu weiter",
    }.items()
    for one in some.split()
}
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue"})
_WORD = re.compile(r"[^\W_]+(?:['’][^\W_]+)*", re.UNICODE)
_ENDS = re.compile(r"[.!?;:…\n]|\s[-–—]\s|—")
_LARGE = known_words(
    "close near fast far quick quickly slow slowly closely long short jerky sharp bumpy early late wobbly wild rough "
    "harsh hectic sudden abrupt soft smooth narrow tight hasty high"
)
_VERBS = known_words("close near slow smooth")
_BEFORE_TOO = known_words(
    "is was were are be been being way much far bit little went goes go came comes come drove drives drive moved moves "
    "got gets get passed passes rode rides ran runs felt feels seems seemed looks me it turns stays stayed and not "
    "still also always often just simply really takes took robot"
)
_OBJECTS = known_words("down up a an the my your its it me us that this in on")
_RATHER = known_words("rather prefer preferred prefers than favour from sooner")
KEYS = "qwertyuiop asdfghjkl zxcvbnm qwertzuiop yxcvbnm"
"""Keys beside each other, English and German."""
_SHORTENED = re.compile(r"^(it|that|there|what|he|she|here)['’]s$", re.IGNORECASE)


@dataclass(frozen=True)
class Word:
    """One word: from `start` to `end` of the text, as it is compared, and what stands between it and the word before:
    `.` an end of a sentence, `?` that of a question, `,` a comma, or nothing."""

    start: int
    end: int
    form: str
    before: str = ""
    capital: bool = False


@dataclass(frozen=True)
class Token:
    """Words that have a sense together."""

    senses: frozenset[str]
    words: tuple[Word, ...]

    def __contains__(self, sense: str) -> bool:
        return sense in self.senses

    def any(self, *senses: str) -> bool:
        return not self.senses.isdisjoint(senses)

    @property
    def before(self) -> str:
        return self.words[0].before

    @property
    def form(self) -> str:
        return " ".join(word.form for word in self.words)


def form_of(word: str, language: Language) -> str:
    """A word as it is compared: small, without accents and apostrophes, a drawn-out letter twice; German umlauts
    however they are typed."""
    plain = word.lower().replace("ß", "ss")
    if language == "de":
        plain = plain.translate(_UMLAUTS)
    plain = unicodedata.normalize("NFKD", plain)
    plain = "".join(letter for letter in plain if not unicodedata.combining(letter) and letter not in "'’")
    return re.sub(r"(.)\1{2,}", r"\1\1", plain)


def words_of(text: str, language: Language) -> list[Word]:
    """The words of a text, `MOST_WORDS` at most."""
    found: list[Word] = []
    end = 0
    for one in _WORD.finditer(text):
        if len(found) >= MOST_WORDS:
            break
        between = text[end : one.start()]
        before = ""
        if found and _ENDS.search(between):
            before = "?" if "?" in between else "."
        elif "," in between or "(" in between or ")" in between:
            before = ","
        end = one.end()
        said = one.group()[:LONGEST_WORD]
        capital = said[0].isupper() and bool(found) and before not in (".", "?")
        if language == "en" and (short := _SHORTENED.match(said)):
            cut = one.start() + len(short[1])
            found.append(Word(one.start(), cut, form_of(short[1], language), before, capital))
            found.append(Word(cut, one.end(), "is"))
        else:
            found.append(Word(one.start(), one.end(), form_of(said, language), before, capital))
    return found


@dataclass(frozen=True)
class Lexicon:
    """entries: forms of a word or phrase -> senses; apart: first and last form of a phrase with others between, as of
    German separable verbs, -> senses; nearly: a form with one letter left out -> known words."""

    language: Language
    entries: Mapping[tuple[str, ...], frozenset[str]]
    apart: Mapping[str, Mapping[str, frozenset[str]]]
    nearly: Mapping[str, tuple[str, ...]]
    longest: int

    def tokens(self, text: str, mends: bool = True) -> list[Token]:
        """The text as tokens, the longest known phrase first; no phrase goes across punctuation. mends: typing errors,
        which is no use where most words are another lexicon's."""
        words = words_of(text, self.language)
        words = self._corrected(words) if mends else words
        found: list[Token] = []
        at = 0
        while at < len(words):
            most = 1
            while most < self.longest and at + most < len(words) and not words[at + most].before:
                most += 1
            if (apart := self._apart(words, at)) is not None:
                found.append(Token(apart, (words[at],)))
                at += 1
                continue
            for many in range(most, 0, -1):
                senses = self.entries.get(tuple(word.form for word in words[at : at + many]))
                if senses:
                    found.append(Token(senses, tuple(words[at : at + many])))
                    break
            else:
                many = 1
                found.append(self._guessed(words[at], mends))
            at += many
        return found

    def _apart(self, words: list[Word], at: int) -> frozenset[str] | None:
        """The senses of a verb whose particle stands later in the clause, at its end: "Stoß ... an"."""
        particles = self.apart.get(words[at].form)
        if particles is None:
            return None
        for k in range(at + 1, min(at + MOST_BETWEEN, len(words))):
            if words[k].before:
                return None
            ends = k + 1 == len(words) or bool(words[k + 1].before) or words[k + 1].form in ("und", "oder", "and")
            if words[k].form in particles and (ends or len(words[k].form) > 3):
                return particles[words[k].form]
        return None

    @cached_property
    def _turning(self) -> frozenset[frozenset[str]]:
        """Senses that nobody's typing error may be taken for: a wish turned round by it would be the opposite."""
        turning = {"not", "undo", "avoid", "needless", "bad", "why", "less", "too", "suggest"}
        return frozenset(senses for senses in self.entries.values() if senses & turning)

    def known(self, text: str) -> tuple[int, int]:
        """(words known as they stand, words): by which a text's language is told."""
        words = words_of(text, self.language)
        return sum((word.form,) in self.entries or word.form.isdigit() for word in words), len(words)

    @cached_property
    def forms(self) -> frozenset[str]:
        """Every word of an entry."""
        return frozenset(form for forms in self.entries for form in forms) | self.apart.keys()

    def _corrected(self, words: list[Word]) -> list[Word]:
        """The words with typing errors mended, so that phrases are found of them, too: "slwo down", "way to fast"."""
        found = [word if word.form in self.forms else self._respelled(word) for word in words]
        if self.language == "en":
            for k, word in enumerate(found):
                if word.form in ("to", "2") and _means_too(found, k):
                    found[k] = replace(word, form="too")
        return found

    def _respelled(self, word: Word) -> Word:
        short = re.sub(r"(.)\1", r"\1", word.form)  # "slooow"
        if (short,) in self.entries and len(short) > 1:
            return replace(word, form=short)
        if word.form.isdigit() or (self.language == "de" and self.parted(word.form)):
            return word
        close = {known for form in _shorter(word.form) for known in self.nearly.get(form, ())}
        if any(self.entries[(known,)] in self._turning for known in close):
            return word
        close = {known for known in close if _one_slip(word.form, known)}
        senses = {self.entries[(known,)] for known in close}
        return replace(word, form=min(close)) if len(senses) == 1 else word

    def _guessed(self, word: Word, mends: bool) -> Token:
        if word.form.isdigit():
            return Token(frozenset({"filler"}), (word,))
        if not mends:
            return Token(UNKNOWN, (word,))
        likely = self.entries.get((self._respelled(word).form,))  # of a word that is known in phrases only
        return Token(likely or (self.parted(word.form) if self.language == "de" else None) or UNKNOWN, (word,))

    def parted(self, form: str) -> frozenset[str] | None:
        """The senses of prefix and verb of a separable verb: `vorbeizurasen` is past, and fast."""
        for cut in range(min(len(form) - 3, 9), 1, -1):
            sense = _PREFIXES.get(form[:cut])
            if sense is None:
                continue
            rest = form[cut:]
            for verb in (rest, rest.removeprefix("zu"), rest.removeprefix("ge")):
                senses = self.entries.get((verb,))
                if senses and len(verb) > 2:
                    both = (senses | {sense}) - {"keep", "go", "filler", "good"}
                    return frozenset(both or {"go"}) | ({"inf"} if verb == rest[2:] else set())
        return None


def _shorter(form: str) -> Iterator[str]:
    """The form, and it with each letter left out: two words with one slip between them share one of these."""
    yield form
    if 4 <= len(form) <= 20:
        for k in range(len(form)):
            yield form[:k] + form[k + 1 :]


def _one_slip(typed: str, known: str) -> bool:
    """Whether one letter explains it: in its neighbour's place, its neighbour's key in a long word, or one too many or
    too few. Of the last, an end like "-d" or "-s" is no slip, but another word: "closed", "besides"."""
    if min(len(typed), len(known)) < 4:
        return False
    if len(typed) == len(known):
        differ = [k for k in range(len(typed)) if typed[k] != known[k]]
        if len(differ) == 1:
            keys = {typed[differ[0]] + known[differ[0]], known[differ[0]] + typed[differ[0]]}
            return differ[0] > 0 and len(typed) >= SURELY_MISTYPED and any(key in KEYS for key in keys)
        a, b = (differ[0], differ[-1]) if differ else (0, 0)
        return len(differ) == 2 and b == a + 1 and typed[a] == known[b] and typed[b] == known[a]
    longer, shorter = (typed, known) if len(typed) > len(known) else (known, typed)
    if len(longer) != len(shorter) + 1 or len(shorter) < 5 or typed[0] != known[0]:
        return False
    doubled = longer[-1] == longer[-2]
    return any(longer[:k] + longer[k + 1 :] == shorter for k in range(len(longer) - (not doubled)))


def _means_too(words: Sequence[Word], at: int) -> bool:
    """ "way to fast", "it came to close to me", "to many detours"; not "slow to fast", "to close the door"."""
    if at + 1 >= len(words) or words[at + 1].before:
        return False
    large, after = words[at + 1].form, words[at + 2].form if at + 2 < len(words) and not words[at + 2].before else ""
    if large in ("many", "much"):
        return after not in ("people", "persons", "of")
    before = words[at - 1].form if at and not words[at].before else ""
    if large not in _LARGE or after in _OBJECTS or any(word.form in _RATHER for word in words[:at]):
        return False
    return before in _BEFORE_TOO or (not before and large not in _VERBS) or words[at].form == "2"


def _expanded(entry: str, language: Language) -> Iterator[str]:
    """`(a|b|)` as one of them each, and `*` as the word and its endings."""
    parts = [part[1:-1].split("|") if part.startswith("(") else [part] for part in re.split(r"(\([^)]*\))", entry)]
    for chosen in product(*parts):
        said = "".join(chosen)
        ends = [word for word in said.split() if word.endswith("*")]
        yield said.replace("*", "")
        for word in ends:
            stem = word[:-1]
            for ending in (_FEW_ENDINGS if " " in said else _ENDINGS)[language].split():
                whole = stem[:-1] + ending if stem.endswith("e") and ending[0] == "e" else stem + ending
                if not re.search(r"(.)\1\1", whole):  # which `form_of` would take for a drawn-out letter
                    yield said.replace(word, whole, 1).replace("*", "")


@lru_cache(maxsize=4)
def lexicon(language: Language, name: str = "lexicon") -> Lexicon:
    """The shipped lexicon of that name. Raises ValueError for a line that is no `sense: entries`."""
    entries: dict[tuple[str, ...], set[str]] = {}
    apart: dict[str, dict[str, frozenset[str]]] = {}
    compared = lru_cache(maxsize=None)(form_of)  # many phrases have the same words
    file = FOLDER / f"{name}_{language}.txt"
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        sense, colon, listed = line.partition(": ")
        if not colon:
            raise ValueError(f"{file.name} line {number}: {line[:40]!r} is not `sense: entry | entry`")
        for entry in re.split(r"\s\|\s", listed):  # a bar in brackets has no spaces around it
            for said in _expanded(entry.strip(), language):
                forms = tuple(compared(word, language) for word in said.split())
                if ".." in said.split():
                    apart.setdefault(forms[0], {})[forms[-1]] = frozenset({sense})
                elif forms:
                    entries.setdefault(forms, set()).add(sense)
    whole = {forms: frozenset(senses - {"filler"} or senses) for forms, senses in entries.items()}
    nearly: dict[str, list[str]] = {}
    for forms in whole:
        if len(forms) == 1:
            for form in _shorter(forms[0]):
                nearly.setdefault(form, []).append(forms[0])
    return Lexicon(
        language, whole, apart, {form: tuple(some) for form, some in nearly.items()}, max(len(forms) for forms in whole)
    )
