"""A sentence of plain words as preference weights, with what was understood, what was not, and what to ask back.

Which objective a piece is about says the model; what that means beside the other pieces say the rules below.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import combinations
from typing import cast

import numpy as np

from backend.learning.preferences.objectives import NAMES, OPPOSITES
from backend.learning.words.clauses import LONGEST, Part, Piece, Word, clauses_of, known_words
from backend.learning.words.model import NEGATORS, WordsModel, load_words_model
from backend.learning.words.phrases import OPPOSED, Language

Weights = dict[str, float]
SURE = 0.4  # probability from which a piece counts as understood; set on the development sentences
MENTIONED = 0.22  # from here it is asked back; below, it is not understood
FOREMOST_WEIGHT, FURTHER, LESSER = 1.0, 0.6, 0.25
SLIGHTLY = 0.5  # what is asked for "a bit" weighs half
JOINED_MOST = 4  # pieces that are read together
ALONE_COSTS = 0.3
CLEAR_ALONE = 0.6
OFFERED = {"care": ("farther", "slower_near_person", "smoother"), "side": ("person_on_left", "person_on_right")}
MOST_OFFERED = 3
OPPOSITE = {NAMES[a]: NAMES[b] for a, b in OPPOSITES} | {NAMES[b]: NAMES[a] for a, b in OPPOSITES}
_SLIGHT = {"en": ("bit", "little", "slightly", "somewhat"), "de": ("bisschen", "etwas", "wenig", "bisserl")}
_BARE: Mapping[Language, tuple[Mapping[str, str], frozenset[str]]] = {
    "en": (
        {"far": "+farther", "near": "+closer"},
        known_words("far near away off from to me very really stay keep remain please but and"),
    ),
    "de": ({"weit": "+farther"}, known_words("weit weg von mir ganz sehr bleib bleiben halte bitte aber und")),
}
"""Words that by themselves, or with these beside them, ask for something, though the model knows them best from
complaints ("too far away") or from much longer pieces."""
_BESIDE = known_words("me us people person human humans near beside past mir mich uns menschen leute nahe neben")
_PASSED_OVER = known_words(
    """a an the i it you he she we they and or but is are was be to of in on at for with that this so my your me us
    if as please robot dear very just then than not do does would should could can will it's i'd like want
    der die das ein eine einen ich du er es sie wir und oder aber ist sind war sein zu von in im am an auf fur mit
    dass so mein dein mir mich uns wenn als bitte roboter sehr dann nicht soll sollte kann wurde hatte gern mochte
    will doch mal auch noch schon ja nur"""
)


@dataclass(frozen=True)
class Mark:
    """Words from `start` to `end` that an objective was understood from; against: it was said not to matter as much."""

    start: int
    end: int
    objective: str
    against: bool = False


@dataclass(frozen=True)
class Question:
    """What was unclear, or contradicts itself, from `start` to `end`, and which objectives it may have meant."""

    start: int
    end: int
    offered: tuple[str, ...]


@dataclass(frozen=True)
class Understood:
    """weights: objective -> above 0, foremost first; not_understood: stretches (start, end) of the sentence."""

    weights: Weights
    marks: tuple[Mark, ...] = ()
    questions: tuple[Question, ...] = ()
    not_understood: tuple[tuple[int, int], ...] = ()

    @property
    def foremost(self) -> str | None:
        return next(iter(self.weights), None)


@dataclass
class _Read:
    """A piece with its label."""

    piece: Piece
    label: str
    probability: float
    second: tuple[str, ...] = field(default=())

    @property
    def about(self) -> str | None:
        return self.label[1:] if self.label[0] in "+-" else None

    @property
    def towards(self) -> bool:
        return self.label.startswith("+")

    @property
    def unsure(self) -> bool:
        return self.probability < SURE


class WordsReader:
    """Reads sentences of one language by a model."""

    def __init__(self, model: WordsModel) -> None:
        self.model = model

    def understand(self, text: str) -> Understood:
        """Raises ValueError for more than LONGEST characters."""
        if len(text) > LONGEST:
            raise ValueError(f"a sentence has at most {LONGEST} characters, not {len(text)}")
        read = self._read(clauses_of(text, self.model.language))
        wanted, lesser = _decided(read)
        contrary = _contradictions(read, wanted)
        for pair in contrary:
            for number in pair:
                wanted.pop(number, None)
        weights = _weighted(read, wanted, lesser, _SLIGHT[self.model.language])
        doubted = {number for pair in contrary for number in range(pair[0], pair[1] + 1)}
        marks = tuple(self._marks(read, set(weights), wanted, doubted))
        asked = [one for number, one in enumerate(read) if number not in doubted and _is_asked(one, weights)]
        questions = [_question(one) for one in asked] + [_which_of(read, pair) for pair in contrary]
        missed = [one for number, one in enumerate(read) if number not in doubted and _is_missed(one)]
        ordered = tuple(sorted(questions, key=lambda question: question.start))
        return Understood(weights, marks, ordered, tuple(map(_missed, missed)))

    # ---- which pieces are read together, and what each is about ------------------------------------------------------

    def _read(self, small: Sequence[Piece]) -> list[_Read]:
        runs: list[list[Piece]] = [[]]
        for piece in small:
            runs[-1].append(piece)
            if piece.closes:
                runs.append([])
        return [read for run in runs if run for read in self._joined(run)]

    def _joined(self, run: list[Piece]) -> list[_Read]:
        """The most probable way to read neighbouring pieces together or by themselves, every word counting the same."""
        spans = [(a, b) for a in range(len(run)) for b in range(a + 1, min(a + JOINED_MOST, len(run)) + 1)]
        reads = dict(zip(spans, self._labelled([_together(run[a:b]) for a, b in spans]), strict=True))
        alone = [reads[k, k + 1] for k in range(len(run))]
        best: list[tuple[float, int]] = [(0.0, 0)]
        for b in range(1, len(run) + 1):
            ways = [
                (best[a][0] + len(reads[a, b].piece.words) * float(np.log(reads[a, b].probability)) - ALONE_COSTS, a)
                for a in range(max(0, b - JOINED_MOST), b)
                if b - a == 1 or not (_say_two_things(alone[a:b]) or _says_otherwise(reads[a, b], alone[a:b]))
            ]
            best.append(max(ways))
        chosen: list[_Read] = []
        b = len(run)
        while b > 0:
            a = best[b][1]
            chosen.append(reads[a, b])
            b = a
        return chosen[::-1]

    def _labelled(self, some: Sequence[Piece]) -> list[_Read]:
        probabilities = self.model.probabilities([piece.forms for piece in some])
        found = []
        for piece, row in zip(some, probabilities, strict=True):
            order = np.argsort(-row)
            label = self.model.labels[order[0]]
            certain = float(row[order[0]])
            if piece.part == "preferred" and label[0] == "-" and label[1:] in OPPOSED:
                label = f"+{OPPOSITE[label[1:]]}"
            if label[0] in "+-":  # by itself a complaint asks for the same as a wish
                other = ("-" if label[0] == "+" else "+") + label[1:]
                certain += float(row[self.model.labels.index(other)]) if other in self.model.labels else 0.0
            bare = _bare(piece, self.model.language)
            if bare is not None:
                label, certain = bare, 1.0
            others = [self.model.labels[k] for k in order if self.model.labels[k][0] in "+-" and row[k] > 0.1]
            found.append(_Read(piece, label, min(certain, 1.0), tuple(dict.fromkeys(one[1:] for one in others))))
        return found

    def _marks(
        self, read: Sequence[_Read], weighed: set[str], wanted: Mapping[int, str], doubted: Collection[int]
    ) -> list[Mark]:
        found = []
        for number, one in enumerate(read):
            if one.about is None or one.unsure or number in doubted:
                continue
            objective = wanted.get(number, one.about)
            against = number not in wanted or objective not in weighed
            found += [Mark(a, b, objective, against) for a, b in self._telling(one)]
        return found

    def _telling(self, one: _Read) -> list[tuple[int, int]]:
        """The stretches of the piece that it was understood by: the fewest telling words without which it would not be
        understood so, and what denies them where it would say the contrary without that.
        """
        words = tuple(one.piece.judged)
        label = self._labels([words])[0]
        columns = [k for k, other in enumerate(self.model.labels) if other[1:] == label[1:]]
        named = [word for word in words if word.form not in _PASSED_OVER | NEGATORS] or list(words)
        chosen: list[Word] = []
        while len(chosen) < len(named) and self._held(words, [chosen], columns)[0] >= SURE:
            left = [word for word in named if word not in chosen]
            held = self._held(words, [[*chosen, word] for word in left], columns)
            chosen.append(left[int(np.argmin(held))])
        for word in chosen[:-1]:
            without = [other for other in chosen if other is not word]
            if self._held(words, [without], columns)[0] < SURE:
                chosen = without
        denied = [word for word in words if word.form in NEGATORS and word not in chosen]
        contrary = self._labels([tuple(w for w in words if w is not word) for word in denied]) if denied else []
        chosen += [word for word, other in zip(denied, contrary, strict=True) if other != label]
        return _stretches([word for word in words if word in chosen], words)

    def _labels(self, some: Sequence[Sequence[Word]]) -> list[str]:
        rows = self.model.probabilities([[word.form for word in words] for words in some])
        return [self.model.labels[int(np.argmax(row))] for row in rows]

    def _held(self, words: Sequence[Word], left_out: Sequence[Sequence[Word]], columns: Sequence[int]) -> list[float]:
        """How probable the objective still is without those words."""
        rows = self.model.probabilities([[w.form for w in words if w not in out] for out in left_out])
        return [float(row[columns].sum()) for row in rows]


def _stretches(chosen: list[Word], words: tuple[Word, ...]) -> list[tuple[int, int]]:
    """Neighbouring words as one stretch, also across one word that says nothing by itself."""
    found: list[tuple[int, int]] = []
    last = -2
    for place, word in enumerate(words):
        if word not in chosen:
            continue
        between = words[place - 1] if place == last + 2 else None
        if place == last + 1 or (between is not None and found and between.form in _PASSED_OVER):
            found[-1] = (found[-1][0], word.end)
        else:
            found.append((word.start, word.end))
        last = place
    return found


def _bare(piece: Piece, language: Language) -> str | None:
    """The label of a piece that is hardly more than one such word; None: it is more, or two of them."""
    asking, beside = _BARE[language]
    found = [asking[form] for form in piece.forms if form in asking]
    return found[0] if len(found) == 1 and beside.issuperset(piece.forms) else None


def _say_two_things(some: Sequence[_Read]) -> bool:
    """Whether two of the pieces surely say something, and not the same."""
    return len({one.about or one.label for one in some if one.label != "none" and one.probability >= CLEAR_ALONE}) > 1


def _says_otherwise(together: _Read, some: Sequence[_Read]) -> bool:
    """Whether two of the pieces or more surely say the same, and all of them together something else; or together they
    say the opposite of one, while another speaks of something else: in "keep away, and do not rush" nothing denies the
    first, in "close to me, I do not want" the second half does."""
    sure = [one.about for one in some if one.about and not one.unsure]
    said = {one.about for one in some if one.about and one.probability >= MENTIONED}
    if len(said) > 1 and OPPOSITE.get(together.about or "") in sure:
        return True
    return len(sure) > 1 and len(set(sure)) == 1 and together.about != sure[0]


def _together(some: Sequence[Piece]) -> Piece:
    words = tuple(word for piece in some for word in piece.words)
    first = some[0]
    return Piece(words, first.part, first.strictly, some[-1].closes, any(one.foremost for one in some), first.group)


# ---- what the pieces mean together -----------------------------------------------------------------------------------


def _decided(read: Sequence[_Read]) -> tuple[dict[int, str], dict[str, bool]]:
    """Piece -> objective wanted by it; objective -> whether it is given up, of those that are said to matter less."""
    wanted: dict[int, str] = {}
    lesser: dict[str, bool] = {}
    for group in sorted({one.piece.group for one in read}):
        members = [(k, one) for k, one in enumerate(read) if one.piece.group == group and one.about and not one.unsure]
        compared = any(one.piece.part in ("lesser", "conceded") for one in read if one.piece.group == group)
        avoided = any(one.piece.part == "lesser" and not one.towards for _, one in members)
        first = {k: one.about for k, one in members if _asks(one, compared, avoided) and one.about}
        wanted |= first
        for k, one in members:
            about = cast(str, one.about)
            if one.piece.part == "conceded":
                lesser[about] = True
            elif one.piece.part == "lesser":
                if not one.towards:
                    wanted[k] = about
                elif not first and about in OPPOSED:
                    wanted[k] = OPPOSITE[about]
                else:
                    lesser[about] = one.piece.strictly
            elif k not in first:
                lesser[about] = True
    return wanted, lesser


def _contradictions(read: Sequence[_Read], wanted: Mapping[int, str]) -> list[tuple[int, int]]:
    """Pairs of pieces that ask for opposites, neither of them first by what the sentence says: "near but far"."""
    found: list[tuple[int, int]] = []
    for first, second in combinations(sorted(wanted), 2):
        alike = all(getattr(read[first].piece, of) == getattr(read[second].piece, of) for of in ("part", "foremost"))
        taken = {number for pair in found for number in pair}
        if alike and OPPOSITE.get(wanted[first]) == wanted[second] and not taken & {first, second}:
            found.append((first, second))
    return found


def _which_of(read: Sequence[_Read], pair: tuple[int, int]) -> Question:
    """Which of the two opposites is meant; all that stands between is part of the question."""
    first, second = (read[number] for number in pair)
    offered = tuple(str(one.about) for one in (first, second))
    return Question(first.piece.words[0].start, second.piece.words[-1].end, offered)


def _asks(one: _Read, compared: bool, avoided: bool) -> bool:
    """Whether a plain or preferred piece asks for what it is about; in comparisons it may only be put up with."""
    part: Part = one.piece.part
    if part == "plain":
        return True
    if part != "preferred":
        return False
    if not one.towards and compared:
        return False
    slow_anywhere = one.label == "+slower_near_person" and not _BESIDE & set(one.piece.forms)
    return not (compared and avoided and (one.about == "closer" or slow_anywhere))


def _weighted(
    read: Sequence[_Read], wanted: Mapping[int, str], lesser: Mapping[str, bool], slight: Sequence[str]
) -> Weights:
    """Foremost first: what is said to matter most, then what a comparison prefers, then what is named first."""
    order = sorted(wanted, key=lambda k: (not read[k].piece.foremost, read[k].piece.part == "plain", k))
    weights: Weights = {}
    for k in order:
        objective = wanted[k]
        if objective in weights or OPPOSITE.get(objective) in weights:
            continue
        half = SLIGHTLY if set(slight) & set(read[k].piece.forms) else 1.0
        most = 0.8 * next(iter(weights.values())) if weights else FOREMOST_WEIGHT
        weights[objective] = round(min((FURTHER if weights else FOREMOST_WEIGHT) * half, most), 3)
    for objective, given_up in lesser.items():
        if weights and not given_up and objective not in weights and OPPOSITE.get(objective) not in weights:
            weights[objective] = LESSER
    return dict(sorted(weights.items(), key=lambda item: -item[1]))


def _is_asked(one: _Read, weights: Mapping[str, float]) -> bool:
    if one.label in OFFERED:
        return one.probability >= MENTIONED
    return bool(one.about) and one.unsure and one.probability >= MENTIONED and one.about not in weights


def _question(one: _Read) -> Question:
    offered = OFFERED.get(one.label) or one.second[:MOST_OFFERED]
    return Question(one.piece.words[0].start, one.piece.words[-1].end, tuple(offered))


def _is_missed(one: _Read) -> bool:
    """Nothing was understood of it, and it holds words that say something."""
    nothing = one.label == "none" or (one.label not in OFFERED and one.unsure and one.probability < MENTIONED)
    return nothing and any(len(form) > 2 and form not in _PASSED_OVER for form in one.piece.forms)


def _missed(one: _Read) -> tuple[int, int]:
    return one.piece.words[0].start, one.piece.words[-1].end


@lru_cache(maxsize=4)
def words_reader(language: Language) -> WordsReader:
    """The reader of the shipped model."""
    return WordsReader(load_words_model(language))
