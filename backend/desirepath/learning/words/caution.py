"""Where a sentence as a whole makes a reading doubtful that its clause alone does not: it is asked back instead.

Kinds, not phrases: questions that are none, descriptions of some robot, what was all right, speed beside the person,
both ends of a scale without a comparison that says which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from desirepath.learning.words.clauses import Clause
from desirepath.learning.words.lexicon import known_words
from desirepath.learning.words.readings import TARGETS, Reading, ends_of

SPEEDS = ("slower_near_person", "faster")
_NEGATED_VERBS = known_words(
    "wouldnt isnt doesnt didnt wasnt arent shouldnt couldnt cant wont havent hasnt werent aint "
    "waere ist war sollte soll koennte kann muesste muss wuerde hat haette faehrt geht"
)
_ROBOTS = known_words(
    "robot robots machine machines bot bots thing things one ones roboter robotern maschine maschinen"
)
_PASSED = known_words("was were war waren ging fuhr felt seemed fand fuehlte lief hat passte")
_APPROVED = known_words(
    "fine ok okay good great perfect right alright nice pleasant comfortable lovely ideal enough gut passt passte "
    "richtig ordnung super prima perfekt angenehm toll klasse optimal"
)
_ALIKE = known_words("so auch ebenso too also")
_AT_IT = known_words("dran daran davon")
_ALONG = known_words("along follow entlang folg folge folgen")
_STRAIGHT = known_words("straight geradeaus gerade geradlinig")
PLACES = ("next to", "right next to", "directly next to", "beside", "right beside", "neben", "bei mir", "bei uns")
_ENDS = (("fast", "slow"), ("short", "long"), ("smooth", "jerky"), ("near", "far"))
_OF: dict[str, tuple[int, int]] = {
    "faster": (0, 1), "slower_near_person": (0, -1), "shorter": (1, 1), "smoother": (2, 1), "closer": (3, 1),
    "farther": (3, -1),
}  # fmt: skip
"""Objective -> its scale of `_ENDS`, and which end more of it is."""


def doubted(clauses: Sequence[Clause], read: Sequence[Reading]) -> list[Reading]:
    """The readings, those unsure that the sentence as a whole makes doubtful, without those of what was all right."""
    homes = [_home(one, clauses) for one in read]
    kept = [
        (one, home) for one, home in zip(read, homes, strict=True) if home is None or not _was_all_right(clauses, home)
    ]
    found: list[Reading] = []
    for one, home in kept:
        if home is None or one.waived or not one.sure:
            found.append(one)
            continue
        clause = clauses[home]
        agreed = any(
            _way(other) == _way(one) and at is not None and not clauses[at].asked and other.sure and not other.waived
            for other, at in kept
        )
        if one.objective == "faster" and _is_beside(clauses, home):
            found.append(replace(one, sure=False, offered=SPEEDS))
        elif one.objective in ("farther", "closer") and _AT_IT & set(_words(clause)):
            found.append(replace(one, sure=False, offered=TARGETS))  # "the drips stand about, not so close to that"
        elif (
            (_is_no_question(clause) and not agreed)
            or _describes_some_robot(clauses, home, one)
            or _says_how_it_was(clause)
            or _only_permits(clauses, home, one)
            or _is_bare_place(clauses, home, one)
            or _is_taken_back(clauses, home, one)
        ):
            found.append(replace(one, sure=False, offered=ends_of(one.objective)))
        else:
            found.append(one)
    return _both_ends(clauses, found)


def _home(one: Reading, clauses: Sequence[Clause]) -> int | None:
    return next((k for k, clause in enumerate(clauses) if any(token in clause.tokens for token in one.tokens)), None)


def _way(one: Reading) -> tuple[int, int] | None:
    """The scale of a reading and the end that it wishes."""
    scale = _OF.get(one.objective)
    return (scale[0], scale[1] if one.wanted else -scale[1]) if scale else None


def _words(clause: Clause) -> list[str]:
    return [word.form for token in clause.tokens for word in token.words]


def _was_all_right(clauses: Sequence[Clause], at: int) -> bool:
    """ "The speed was fine", "der Abstand passt", and the first of "distance | and speed were fine"."""
    clause, after = clauses[at], clauses[at + 1] if at + 1 < len(clauses) else None
    nouns = bool(clause.heads) and all(one.any("gap", "pace", "turn", "ride", "clearance") for one in clause.heads)
    if not nouns or clause.has("more", "less", "too", "not", "must", "rather", "needless", "bad", "avoid"):
        return False
    words = set(_words(clause))
    if words & _APPROVED and (words & _PASSED or "passt" in words or clause.has("is")):
        return not clause.has("keep", "go", "please") or bool(words & _PASSED)
    bare = not clause.has("keep", "go", "good", "please")
    before = set(_words(clauses[at - 1])) if at and clause.link == "and" else set()
    if bare and words & _ALIKE and before & _APPROVED and before & _PASSED:
        return True  # "the distance was fine | and so was the speed"
    return bare and after is not None and after.link in ("and", ",") and _was_all_right(clauses, at + 1)


def _is_no_question(clause: Clause) -> bool:
    """ "Wouldn't a detour be nicer?", "Why does it always slow down?": what follows from it is not said."""
    if not clause.asked or clause.has("suggest"):
        return False
    first = clause.tokens[0].words[0].form
    negated = first.endswith("nt") or any(word in ("not", "nicht", "kein", "keine") for word in _words(clause))
    return clause.has("why") or (first in _NEGATED_VERBS and negated)


def _describes_some_robot(clauses: Sequence[Clause], at: int, one: Reading) -> bool:
    """ "a fast robot at my side makes me wobble": which of that is disliked?"""
    clause = clauses[at]
    if not any(a in one.tokens and not a.any("more") and b.form in _ROBOTS for a, b in pairwise(clause.tokens)):
        return False
    scale = _way(one)
    others = [other for other in clauses if other is not clause and scale and other.has(*_ENDS[scale[0]])]
    return bool(others) or clause.has("near", "beside", "pass") or not clause.has("good", "bad", "needless", "please")


def _says_how_it_was(clause: Clause) -> bool:
    """ "It was not exactly fast" is irony as likely as praise."""
    was = bool(_PASSED & set(_words(clause))) and clause.has("is") and clause.has("not")
    return was and clause.role == "main" and not clause.has("enough", "so", "too", "must", "good", "bad", "rather")


def _only_permits(clauses: Sequence[Clause], at: int, one: Reading) -> bool:
    """ "Fine to go fast elsewhere, | but next to me it should crawl"."""
    clause, after = clauses[at], clauses[at + 1] if at + 1 < len(clauses) else None
    permits = clause.has("may") and not clause.has("not", "must", "please", "good", "rather")
    return (
        permits
        and one.objective == "faster"
        and after is not None
        and after.link == "but"
        and after.has("slow", "late")
    )


def _is_bare_place(clauses: Sequence[Clause], at: int, one: Reading) -> bool:
    """ "Near me: | slowly"."""
    clause = clauses[at]
    bare = all(token.any("near", "person", "filler", "so", "prefto", "beside") for token in clause.tokens)
    wish = any(token.form.endswith(("closer", "nearer", "naeher", "dichter", "ran")) for token in clause.heads)
    return one.objective == "closer" and bare and not wish and any(other.has("fast", "slow") for other in clauses)


def _is_taken_back(clauses: Sequence[Clause], at: int, one: Reading) -> bool:
    """ "With my pram next to me | more clearance", "off the walls | and along them", "fewer turns, | straight on":
    what another clause says makes it a place, the contrary, or the same again."""
    others = [other for k, other in enumerate(clauses) if k != at]
    if one.objective == "closer":
        place = all(head.form in PLACES for head in clauses[at].all_of("near"))
        return place and any(other.has("far", "gap", "clearance") for other in others)
    if one.objective == "clearance" and one.wanted:
        return any(
            not other.has("far", "near", "gap", "clearance") and _ALONG & set(_words(other)) and not other.has("not")
            for other in others
        )
    straight = all(token.form in _STRAIGHT for token in one.tokens if token.any("short", "long"))
    return one.objective == "shorter" and straight and any(other.has("turn", "jerky", "smooth") for other in others)


def _is_beside(clauses: Sequence[Clause], at: int) -> bool:
    """Whether speed is spoken of where the person is: "full speed right past me", "keep it up | even beside me"."""
    clause = clauses[at]
    if clause.has("general"):
        return False
    mine = any("mine" in a and b.any("thing", "person") for a, b in pairwise(clause.tokens))
    if clause.has("pass", "beside") or mine:
        return True
    near = [clauses[k] for k in (at - 1, at + 1) if 0 <= k < len(clauses) and clauses[max(k, at)].link != "."]
    return any(
        (one.role in ("if", "while", "conceded") or (not one.heads and not one.has("go", "keep")))
        and one.has("near", "pass", "beside")
        and not one.has("far", "gap", "fast", "slow", "thing")
        for one in near
    )


def _both_ends(clauses: Sequence[Clause], read: Sequence[Reading]) -> list[Reading]:
    """Unsure where both ends of a scale are named, and no comparison says which is wished."""
    found = list(read)
    compared = any(one.role in ("lesser", "conceded") or one.better for one in clauses)
    questions = [k for k, one in enumerate(clauses) if one.has("how") and one.heads]
    for k, one in enumerate(read):
        way = _way(one)
        nested = (
            compared and len(questions) > 1 and _home(one, clauses) in questions
        )  # "less about how ... than how ..."
        if nested:
            found[k] = replace(one, sure=False, waived=False, offered=ends_of(one.objective))
        if not one.sure or one.waived or nested:
            continue
        if way is not None and not compared and _is_torn(clauses, read, one, way):
            found[k] = replace(one, sure=False, offered=ends_of(one.objective))
    for k, (a, b) in enumerate(pairwise(read), 1):  # "no braking beside me. Full speed!"
        same = a.objective == "slower_near_person" and b.objective == "faster" and a.wanted != b.wanted
        home = _home(b, clauses)
        if same and found[k].sure and not b.waived and home is not None and not clauses[home].has("general"):
            found[k] = replace(b, sure=False, offered=SPEEDS)
    return found


def _is_torn(clauses: Sequence[Clause], read: Sequence[Reading], one: Reading, way: tuple[int, int]) -> bool:
    """Whether the other end is named where no reading of this scale explains it, or fast beside the person and slow
    elsewhere is read without a word that says so."""
    scale, end = way
    ends = _ENDS[scale]
    others = [other for other in read if other is not one and (there := _way(other)) is not None and there[0] == scale]
    if scale == 0 and not any(clause.has("general") for clause in clauses):
        pairs = {(other.objective, other.wanted) for other in (one, *others) if not other.waived}
        if {("slower_near_person", False), ("faster", False)} <= pairs:
            return True
    if scale == 3:
        return False  # a place beside something is no wish, and what clashes is found as a contradiction
    explained = {token for other in (one, *others) for token in other.clause}
    other_end = ends[1 if end > 0 else 0]
    return any(other_end in token and token not in explained for clause in clauses for token in clause.tokens)
