"""A sentence of plain words as preference weights, with what was understood, what was not, and what to ask back.

Clauses are taken apart in `clauses.py` and read one by one in `readings.py`; here stands what they mean together. What
is not certain, or contradicts itself, is asked back, never guessed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, Literal

from desirepath.learning.words.caution import PLACES, doubted
from desirepath.learning.words.clauses import (
    HEADS,
    Clause,
    clauses_of,
    denied_with,
    describes,
    governor_of,
    place_of,
    verdict_on,
)
from desirepath.learning.words.lexicon import LANGUAGES, LONGEST, Language, known_words, lexicon
from desirepath.learning.words.readings import (
    OPPOSITE,
    SIDES,
    TARGETS,
    ClauseReader,
    Reading,
    Stance,
    ends_of,
    stance_of,
)
from desirepath.learning.words.second_reader import Doubts, SecondReader, one_end, other_end, second_reader

Weights = dict[str, float]
FOREMOST_WEIGHT, FURTHER = 1.0, 0.6
SLIGHTLY = 0.5  # what is asked for "a bit" weighs half
MOST_OF_OWN = 0.6  # of the words; a page's own language has at least the doubt
MOST_CLEAR = 5  # words of a clause; chosen with the limits of the second reader
_THERE = known_words("da dort there")
_IT = known_words("it them her there those ihr ihm ihnen ihn sie dazu davon dort")
_WISHING = ("good", "bad", "must", "please", "not", "needless", "avoid", "suggest", "may")
_WAS = known_words("was were did war waren hat hatte")
_STILL = known_words("any noch")
_OURS = known_words("i we im ive id me us mich mir uns ich wir")
_LIKING = ("like", "love", "want", "enjoy", "mag", "moegen", "lieb", "will", "woll", "moecht")
_NO = known_words("nein nee ne no nope")
_NOBODY = known_words("nobody noone niemand")
_GOES = known_words("geht ging gehts gings")
_SUCH = known_words("all such what that this these those solch solche solches dieses diese dieser")
_SMALL_WORDS = known_words(
    "filler robot mine is keep go good may so how and or but if that while because self please prefto big more"
)


@dataclass(frozen=True)
class Mark:
    """Words from `start` to `end` that an objective was understood from. wanted: more of it, or less; waived: it was
    said not to matter, or to matter less than something else."""

    start: int
    end: int
    objective: str
    wanted: bool = True
    waived: bool = False


@dataclass(frozen=True)
class Question:
    """What is asked back of the words from `start` to `end`, and which objectives they may have meant. about: unclear;
    contradiction; slowness: in general, which no robot here can be asked for, only slowness near the person."""

    start: int
    end: int
    offered: tuple[str, ...]
    about: Literal["unclear", "contradiction", "slowness"] = "unclear"


@dataclass(frozen=True)
class Understood:
    """weights: objective -> above 0, foremost first; language: in which it was read; not_understood: stretches (start,
    end) of the text."""

    weights: Weights
    marks: tuple[Mark, ...] = ()
    questions: tuple[Question, ...] = ()
    not_understood: tuple[tuple[int, int], ...] = ()
    language: Language = "en"

    @property
    def foremost(self) -> str | None:
        return next(iter(self.weights), None)

    def as_dict(self, text: str) -> dict[str, list[dict[str, Any]]]:
        """What was understood of the text: objective, direction (`-`: less of it, or said not to matter, which no
        weight can say), weight and words; what was not, or contradicts itself, with what it may have meant."""
        said: dict[tuple[str, bool], list[str]] = {}
        for mark in self.marks:
            if mark.wanted or not mark.waived:
                said.setdefault((mark.objective, mark.wanted and not mark.waived), []).append(
                    text[mark.start : mark.end]
                )
        asked = {
            contrary: [
                {"words": text[one.start : one.end], "offered": list(one.offered)}
                for one in self.questions
                if (one.about == "contradiction") == contrary and one.about != "slowness"
            ]
            for contrary in (False, True)
        }
        return {
            "understood": [
                {
                    "objective": name,
                    "direction": "+" if wanted else "-",
                    "weight": self.weights.get(name, 0.0) if wanted else 0.0,
                    "words": " ... ".join(words),
                }
                for (name, wanted), words in said.items()
            ],
            "not_understood": asked[False]
            + [{"words": text[start:end], "offered": []} for start, end in self.not_understood],
            "contradictions": asked[True],
        }


# ---- the clauses together --------------------------------------------------------------------------------------------


class WordsReader:
    """Reads sentences of a page's language, and of the other one where they are clearly of that. second: of a language,
    who doubts what the rules read; nobody where it returns None. doubts_unsaid: whether it is heard where it finds that
    nothing was said, which it was trained to of whole sentences."""

    def __init__(
        self,
        language: Language,
        second: Callable[[Language], SecondReader | None] = second_reader,
        doubts_unsaid: bool = True,
    ) -> None:
        self.language = language
        self.second = second
        self.doubts_unsaid = doubts_unsaid

    def understand(self, text: str) -> Understood:
        """Raises ValueError for more than LONGEST characters."""
        if len(text) > LONGEST:
            raise ValueError(f"a sentence has at most {LONGEST} characters, not {len(text)}")
        language = language_of_text(text, self.language)
        tokens = lexicon(language).tokens(text)
        clauses = clauses_of(text, tokens, language)
        read: list[Reading] = []
        missed: list[tuple[int, int]] = []
        for number, clause in enumerate(clauses):
            found = _read_clause(clauses, number, language)
            read += found
            if not found and _says_something(clause) and not _serves(clauses, number):
                missed.append((clause.tokens[0].words[0].start, clause.tokens[-1].words[-1].end))
            if clause.has("correction"):  # "Not so near ... no, wait": what was said before may hold no more
                read = [replace(one, sure=False, offered=one.offered or ends_of(one.objective)) for one in read]
        read = _unanswered(doubted(clauses, _asked_once(_compared(clauses, read), clauses)))
        second = self.second(language)
        some = second is not None and any(one.sure and not one.waived for one in read)
        doubts = second.doubts(text, tokens) if second and some else None
        if doubts is not None and not self.doubts_unsaid:
            doubts = replace(doubts, unsaid=frozenset())
        return _understood(read, missed, language, doubts)


def language_of_text(text: str, expected: Language) -> Language:
    """The language that a text is in: the expected one unless clearly more of its words are the other's."""
    (other,) = [one for one in LANGUAGES if one != expected]
    own, words = lexicon(expected).known(text)
    foreign, _ = lexicon(other).known(text)
    return other if foreign > own and own <= words * MOST_OF_OWN and foreign >= words * MOST_OF_OWN else expected


def _says_something(clause: Clause) -> bool:
    return any(one.senses.isdisjoint(_SMALL_WORDS) for one in clause.tokens)


def _serves(clauses: Sequence[Clause], number: int) -> bool:
    """Whether a clause without a wish says how another one is meant."""
    clause = clauses[number]
    if clause.has("unknown") or len(clauses) == 1:
        return False
    return clause.has("good", "bad", "needless", "not", "may", "avoid", "suggest", "foremost") or clause.role != "main"


def _read_clause(clauses: Sequence[Clause], number: int, language: Language) -> list[Reading]:
    clause = clauses[number]
    after = clauses[number + 1] if number + 1 < len(clauses) else None
    before = clauses[number - 1] if number and clause.link != "." else None
    if (
        clause.role == "reason"
        or clause.has("choose")
        or (number and clauses[number - 1].has("choose") and clause.link != ".")
    ):
        return []
    if clause.role in ("lesser", "conceded"):
        return [replace(one, waived=True) for one in ClauseReader(clause, Stance(), language).readings() if one.sure]
    governor = governor_of(clauses, number)
    if (
        before is not None
        and before.has("fast", "slow", "pace")
        and _is_a_place(clause)
        and not clause.has("go", "keep")
    ):
        return []  # "slower | when it is beside me"
    if governor is None and clause.role in ("if", "while") and not _wishes_beside(clause):
        return _unsaid(clauses, number, language)
    if not clause.heads and after is not None and governor_of(clauses, number + 1) is clause:
        return []
    if _is_question(clause):
        outer = stance_of(governor, language) if governor is not None else Stance()
        if not outer.waived:
            return []
    if _is_about_me(clause) and governor is None:
        return []
    outer = stance_of(governor, language) if governor is not None else Stance()
    if governor is not None and governor.has("unknown"):
        outer = replace(outer, unsure=True)
    wished = before is not None and clause.link == "," and not before.heads and before.has("good", "rather")
    described = describes(clause) and not clause.has("too", "enough") and not wished  # "mir wäre lieber, | er ..."
    verdict = verdict_on(clauses, number) if described else None
    if verdict is not None:
        governor, outer = clauses[number + 1] if number + 1 < len(clauses) else clause, Stance(turned=verdict == "bad")
    denied = denied_with(clauses, number) if governor is None else None
    if denied == "too":
        outer = stance_of(clauses[number - 1], language)
    only = after is not None and all(one.any("only", "filler") for one in after.tokens)
    reason = clauses[number + 2] if only and number + 2 < len(clauses) else after  # "just | because I'm there"
    if reason is not None and reason.role == "reason" and reason.link != "." and not reason.heads and _is_of_me(reason):
        clause = replace(clause, tokens=[*clause.tokens, replace(reason.tokens[0], senses=frozenset({"forme"}))])
    beside = place_of(clauses, number)
    limited = (after is not None and after.link != "." and (after.has("limits") or _only_then(clause, after))) or (
        before is not None and (before.has("limits") or (governor is None and _may_be_denied(before, clause)))
    )
    exceptional = after is not None and clause.has("may", "good") and _is_place_of_speed(clause, after)
    told = governor is not None and clause.role == "that" and governor.has("perceive") and not governor.has(*_WISHING)
    goes_on = clause.link == "and" and before is not None and describes(before) and _has_no_wish(clause)
    described = verdict is None and (described or told or goes_on or _only_describes(clause) or _exclaims(clause))
    doubted = denied == "perhaps" or described or clause.has("limits") or limited or exceptional
    if after is not None and after.link != "." and "than" in after.tokens[0] and "robot" in clause.tokens[0]:
        doubted = doubted or not clause.has("must", "good")  # "Er kommt näher, als mir lieb ist"
    doubted = doubted or (after is not None and _may_be_meant_otherwise(clause, after))
    doubted = doubted or (clause.asked and "how" in clause.tokens[0])  # "Who wants it fast?"
    found = ClauseReader(clause, outer, language, beside, doubted).readings()
    found = [replace(one, described=described) for one in found]
    if not found and number and clause.link in ("and", "or", ",") and clause.has("person", "thing"):
        found = _same_of_another(clauses, number, language)
    if before is not None and _is_what_is_not_meant(clauses, number):
        found = [replace(one, waived=True) for one in found]
    elif before is not None and _is_place_of_speed(before, clause):
        found = [replace(one, sure=False, offered=("slower_near_person", one.objective)) for one in found]
    elif _is_of_something_before(clauses, number):
        found = [_of_that(one, clauses[:number]) if one.objective in (*TARGETS, "closer") else one for one in found]
    elif (before is not None or after is not None) and _is_only_a_place(clause):
        found = [replace(one, sure=False, offered=ends_of(one.objective)) for one in found]
    permitted = clause.has("may") and not clause.has("not", "must", "bad") and governor is None
    condition = after is not None and bool(after.heads) and (after.role == "if" or after.has("provided"))
    if permitted and condition and after is not None and not after.has("limits"):
        more = ClauseReader(after, Stance(), language).readings()
        if any(one.objective != other.objective for one in more for other in found):
            return [replace(one, waived=True) for one in found] + (more if after.role == "if" else [])
    return found


def _may_be_meant_otherwise(clause: Clause, after: Clause) -> bool:
    """ "Closer? Never!", "Any slower and I'd fall asleep", "The closer it gets, the more nervous I am"."""
    if clause.asked and after.link == "." and "not" in after.tokens[0] and not after.heads:
        return True
    first = clause.tokens[0].form
    if first in ("any", "noch") and after.link in ("and", "or"):
        return after.tokens[0].any("mine", "self", "person") and not after.heads
    return first in ("the", "je") and after.link == "," and after.has("bad") and not after.heads


def _unsaid(clauses: Sequence[Clause], number: int, language: Language) -> list[Reading]:
    """A circumstance is no wish by itself; alone it is asked back what follows from it."""
    clause = clauses[number]
    own = clause.has("good", "bad", "needless")
    others = [one for one in clauses if one is not clause and one.heads]
    return [] if others and not own else ClauseReader(clause, Stance(), language, doubted=not own).readings()


def _is_place_of_speed(before: Clause, clause: Clause) -> bool:
    """ "you may be fast | but not near me" says where not to be fast, rather than not to be near."""
    bare = clause.has("not") and clause.has("near", "beside", "pass")
    bare = bare and not clause.has("go", "keep", "fast", "slow", "so", "too")
    return bare and before.has("fast", "slow", "pace") and clause.link in ("but", "and", ",")


def _of_that(one: Reading, before: Sequence[Clause]) -> Reading:
    """Distance to what was named before: to things, if nobody was."""
    if any(clause.has("person", "self", "beside") for clause in before) or not before[-1].has("thing"):
        return replace(one, sure=False, offered=TARGETS)
    denials = [token for token in one.clause if token.any("not", "undo", "bad", "needless", "avoid", "why")]
    plain = len(denials) <= 1 and not any(token.any("unknown", "half", "limits") for token in one.clause)
    certain = one.sure or (one.offered == TARGETS and plain and not one.described)
    wanted = (one.objective != "closer") == one.wanted
    return replace(one, objective="clearance", wanted=wanted, sure=certain, offered=() if certain else TARGETS)


def _is_of_something_before(clauses: Sequence[Clause], number: int) -> bool:
    """ "the vase is old, | give it plenty of room"."""
    clause = clauses[number]
    stands_for = any(one.form.split()[-1] in _IT for one in clause.tokens[1:]) or clause.tokens[0].form in _THERE
    if clause.has("person", "thing", "beside"):
        return False
    if stands_for and any(one.has("thing", "mind") for one in clauses[:number]):
        return True
    before = clauses[number - 1] if number and clause.link != "." else None  # "not so far from the sofa, go nearer"
    return before is not None and clause.has("near") and before.has("thing") and not before.has("person", "beside")


def _is_only_a_place(clause: Clause) -> bool:
    """ "next to my chair" beside another clause says where, and not what is wished."""
    heads = clause.heads
    wishes = ("go", "keep", "good", "please", "not", "bad", "more", "less", "too", "rather", "must", "may", "canst")
    return bool(heads) and all(one.form in PLACES for one in heads) and not clause.has(*wishes)


def _is_of_me(clause: Clause) -> bool:
    """ "because I'm standing there", "because of me"."""
    return clause.has("person", "self", "mine") and len(clause.tokens) <= 6


def _is_what_is_not_meant(clauses: Sequence[Clause], number: int) -> bool:
    """ "Distance, | not speed, | is what counts"."""
    clause = clauses[number]
    nouns = bool(clause.heads) and all(one.any("gap", "pace", "clearance") for one in clause.heads)
    only = all(one.any("not", "gap", "pace", "clearance", "filler", "mine") for one in clause.tokens)
    earlier = [one for before in clauses[:number] for one in before.heads]
    other = bool(earlier) and all(one.senses != earlier[-1].senses for one in clause.heads)
    return nouns and only and other and clause.tokens[0].form in ("not", "nicht") and clause.link == ","


def _is_a_place(clause: Clause) -> bool:
    near = any(one.form in PLACES for one in clause.heads)
    return clause.role in ("if", "while") and near and not clause.has("not", "good", "bad", "must", "far", "gap")


def _only_then(clause: Clause, after: Clause) -> bool:
    """ "Drive fast only when nobody is here"."""
    return after.role == "if" and clause.has("only") and clause.has("fast", "slow", "pace")


def _may_be_denied(before: Clause, clause: Clause) -> bool:
    """ "don't act | as if you had all the time in the world": what a clause denies may be the next."""
    denies = before.has("not", "avoid", "undo", "bad", "unknown") and not before.heads and len(before.tokens) > 1
    both = before.role == clause.role == "main" and clause.link == ","
    return denies and both and "go" not in clause.tokens[0] and not clause.has("keep", "must", "please", "not", "good")


def _same_of_another(clauses: Sequence[Clause], number: int, language: Language) -> list[Reading]:
    """ "Keep away from the table | and me": the second hangs on the first's wish."""
    clause, before = clauses[number], clauses[number - 1]
    named = ("person", "thing", "filler", "robot", "mine", "prefto", "beside", "please", "too")
    distance = before.has("far", "near", "gap", "hit", "mind", "clearance")
    if (
        not distance
        or (clause.link == "," and len(clause.tokens) < 2)
        or any(not one.any(*named) for one in clause.tokens)
    ):
        return []
    rest = [one for one in before.tokens if not one.any("person", "thing", "beside")]
    whole = replace(before, tokens=[*rest, *clause.tokens])
    return [
        replace(one, clause=tuple(clause.tokens))
        for one in _read_clause([*clauses[: number - 1], whole], number - 1, language)
    ]


def _wishes_beside(clause: Clause) -> bool:
    """ "keep away while passing as close as you can": what looks like a circumstance is a wish."""
    return clause.has("canst") or (clause.role == "while" and clause.has("far", "gap", "smooth", "short", "fast"))


def _is_question(clause: Clause) -> bool:
    first = clause.tokens[0]
    return "how" in first and clause.role == "main" and clause.link in (".", ",") and not clause.has("good")


def _is_about_me(clause: Clause) -> bool:
    """ "I walk slowly" is about the person, and no wish."""
    return clause.has("self") and not clause.has("good", "bad", "mind", "left", "right", "needless", "not", "must")


def _has_no_wish(clause: Clause) -> bool:
    """ "it came close | and raced"."""
    return not clause.has(*_WISHING, "too", "enough", "canst", "keep", "rather", "more", "less")


def _exclaims(clause: Clause) -> bool:
    """ "All that rushing!", "Dieses Gerase!", "Could it be any slower?", "Langsamer geht es wohl nicht": mockery, and
    of what, or not?"""
    forms = [word.form for one in clause.tokens for word in one.words]
    wishes = clause.has("must", "please", "good", "bad", "too", "canst", "needless", "avoid", "keep", "suggest")
    if clause.asked and not clause.has("suggest", "please") and (forms[0] in _WAS or _STILL & set(forms)):
        return True
    others = clause.tokens[0].any("person", "self") and forms[0] not in _OURS
    if (forms[0] in _NOBODY and not wishes) or (others and any(form.startswith(_LIKING) for form in forms[1:])):
        return True  # "niemand hetzt dich", "my husband likes it fast"
    if len(forms) > 1 and (forms[-1] in _NO or (len(forms) == 2 and forms[0] in ("the", "das", "der", "die"))):
        return True  # "Abstand ja, Tempo nein", "The speed!"
    if _GOES & set(forms) and clause.has("not") and clause.tokens[0].any(*HEADS):
        return True
    such = forms[0] in _SUCH or " ".join(forms[:2]) in ("so much", "so many", "so ein", "so viel", "so viele")
    return such and not wishes and not clause.has("go", "not", "less")


def _only_describes(clause: Clause) -> bool:
    """ "it is slow" says neither that it should be nor that it should not."""
    hedge = next((k for k, one in enumerate(clause.tokens) if one.form in ("rather", "eher")), 0)
    if any("is" in one for one in clause.tokens[:hedge]):  # "it was rather fast"
        return clause.role == "main" and not clause.better
    more = known_words("too good must bad not needless rather canst why more less enough may suggest please swap")
    says_more = clause.has(*more)
    says = clause.tokens[1:2]
    does = "robot" in clause.tokens[0] and bool(says) and says[0].any("fast", "slow", "jerky", "hit")  # "it rushes by"
    described = does or (clause.has("is") and (not clause.better or "robot" in clause.tokens[0]))
    return clause.role == "main" and described and not says_more


def _compared(clauses: Sequence[Clause], read: list[Reading]) -> list[Reading]:
    """ "Better late than too close": where what is given up is itself something that nobody wishes, its contrary is
    wished, and what comes first only put up with."""
    lesser = [one for one in clauses if one.role == "lesser"]
    if not lesser or not any(one.has("rather") for one in clauses):
        return read
    later = {id(token): clause for clause in lesser for token in clause.tokens}
    found = list(read)
    for k, one in enumerate(read):
        clause = later.get(id(one.tokens[0]))
        first = [n for n in range(k) if any(token.any("late", "long", "jerky") for token in read[n].tokens)]
        if clause is None or not one.waived or not first:
            continue
        if clause.has("too"):
            found[k] = replace(one, waived=False)
        elif one.objective == "closer":
            found[k] = replace(one, objective="farther", waived=False)
        elif not one.wanted:
            found[k] = replace(one, wanted=True, waived=False)
        else:
            continue
        found[first[-1]] = replace(read[first[-1]], waived=True)
    return found


def _asked_once(read: list[Reading], clauses: Sequence[Clause]) -> list[Reading]:
    """Readings with speed in general left unsure where the sentence had spoken of speed beside the person just before,
    and does not say that it now means something else: "slow near me, but don't go slower"."""
    found = list(read)
    for k, (one, other) in enumerate(pairwise(read), 1):
        if one.objective != "slower_near_person" or other.objective != "faster" or one.waived or other.waived:
            continue
        clause = next((some for some in clauses if any(token in some.tokens for token in other.tokens)), None)
        if clause is None:
            continue
        denied = clause.has("not", "bad", "avoid", "needless") and all(not token.any("fast") for token in other.tokens)
        same = clause.link == "," and one.wanted != other.wanted  # "quick near me, I don't like it lingering"
        if not clause.has("general") and ((denied and clause.link != ".") or same):
            found[k] = replace(other, sure=False, offered=("slower_near_person", "faster"))
    return found


def _unanswered(read: Sequence[Reading]) -> list[Reading]:
    """The readings, without those of how it was where the same person says what they want of that: "it crept, | faster
    please"."""
    said = {_matter(one) for one in read if one.sure and not one.waived}
    return [one for one in read if one.sure or not one.described or _matter(one) not in said]


def _matter(one: Reading) -> str:
    same = {"slower_near_person": "faster", "closer": "farther", "clearance": "farther"}
    return same.get(one.objective, one.objective)


def _understood(
    read: Sequence[Reading], missed: list[tuple[int, int]], language: Language, doubts: Doubts | None
) -> Understood:
    clashing = _contradictions(_wishes(read)) + _contradictions([one for one in read if one.offered == SIDES])
    contrary = [one for pair in clashing for one in pair]
    if doubts is not None:
        read = _unless_doubted(read, contrary, doubts)
    weights = _weighted([one for one in _wishes(read) if one not in contrary])
    questions = [
        Question(min(a.start, b.start), max(a.end, b.end), _offered(a, b), "contradiction") for a, b in clashing
    ]
    for one in read:
        within = any(question.start <= one.start and one.end <= question.end for question in questions)
        if one.waived or one in contrary or (within and not one.sure):
            continue
        if one.sure and one.objective == "faster" and not one.wanted and "slower_near_person" not in weights:
            questions.append(Question(one.start, one.end, ("slower_near_person",), "slowness"))
        elif not one.sure:
            questions.append(Question(one.start, one.end, one.offered))
    marks = [
        Mark(start, end, one.objective, one.wanted, one.waived)
        for one in read
        if one.sure and one not in contrary
        for start, end in _stretches(one)
    ]
    return Understood(
        weights,
        tuple(sorted(marks, key=lambda mark: mark.start)),
        tuple(sorted(questions, key=lambda question: question.start)),
        tuple(missed),
        language,
    )


def _wishes(read: Sequence[Reading]) -> list[Reading]:
    return [one for one in read if one.sure and not one.waived]


def _unless_doubted(read: Sequence[Reading], contrary: Sequence[Reading], doubts: Doubts) -> list[Reading]:
    """The readings, those unsure that the second reader doubts. It knows one end at most of a scale, so it is not heard
    where the sentence names both and says which comes first; and it may have seen few of the words of a clear, short
    clause, so there only the other end counts against it."""
    found = list(read)
    ends = {one_end(one.objective, one.wanted) for one in _wishes(read)}
    for k, one in enumerate(read):
        if not one.sure or one.waived or one in contrary:
            continue
        wish = one_end(one.objective, one.wanted)
        clear = sum(len(token.words) for token in one.clause) <= MOST_CLEAR
        clear = clear and not any("unknown" in token for token in one.clause)
        turned = wish in doubts.turned and other_end(wish) not in ends
        if turned or (wish in doubts.unsaid and not clear):
            found[k] = replace(one, sure=False, offered=one.offered or ends_of(one.objective))
    return found


def _contradictions(wishes: Sequence[Reading]) -> list[tuple[Reading, Reading]]:
    """Pairs that ask for opposites, neither of them first by what the sentence says: "near but far"."""
    found: list[tuple[Reading, Reading]] = []
    for number, first in enumerate(wishes):
        for second in wishes[number + 1 :]:
            against = OPPOSITE.get(first.objective) == second.objective or (
                first.objective == second.objective and first.wanted != second.wanted
            )
            taken = any(one in pair for pair in found for one in (first, second))
            if against and first.foremost == second.foremost and not taken:
                found.append((first, second))
    return found


def _offered(a: Reading, b: Reading) -> tuple[str, ...]:
    return (a.objective, b.objective) if a.objective != b.objective else ends_of(a.objective)


def _weighted(wishes: Sequence[Reading]) -> Weights:
    """Foremost first: what is said to matter most, then in the order of the words."""
    weights: Weights = {}
    for one in sorted(wishes, key=lambda one: not one.foremost):
        if not one.wanted or one.objective in weights or OPPOSITE.get(one.objective) in weights:
            continue
        share = SLIGHTLY if one.slight else 1.0
        most = 0.8 * next(iter(weights.values())) if weights else FOREMOST_WEIGHT
        weights[one.objective] = round(min((FURTHER if weights else FOREMOST_WEIGHT) * share, most), 3)
    return dict(sorted(weights.items(), key=lambda item: -item[1]))


def _stretches(one: Reading) -> list[tuple[int, int]]:
    """The words of a reading; those beside each other, or with one between, as one stretch."""
    found: list[tuple[int, int]] = []
    last = -3
    for at, token in enumerate(one.clause):
        if token not in one.tokens:
            continue
        start, end = token.words[0].start, token.words[-1].end
        if at - last <= 2:
            found[-1] = (found[-1][0], end)
        else:
            found.append((start, end))
        last = at
    return found or [(one.start, one.end)]


@lru_cache(maxsize=2)
def words_reader(language: Language) -> WordsReader:
    """The reader of a page's language."""
    return WordsReader(language)
