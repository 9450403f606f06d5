"""One clause of plain words: which scales it speaks of (far and near, fast and slow, ...), and which end is wished.

A wish is turned round as often as something in its clause denies: "don't", "hate", "less", "too". What is not certain
is left unsure, to be asked back: an unknown word beside a wish, two denials, a side that is nobody's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

from desirepath.learning.preferences.objectives import NAMES, OPPOSITES
from desirepath.learning.words.clauses import FORBIDS, SUBJUNCTIVE, THEIRS, Clause
from desirepath.learning.words.lexicon import Language, Token, known_words

CARE = ("farther", "slower_near_person", "smoother")
SIDES = ("person_on_left", "person_on_right")
TARGETS = ("farther", "clearance")
CALM = ("smoother", "slower_near_person")
OPPOSITE = {NAMES[a]: NAMES[b] for a, b in OPPOSITES} | {NAMES[b]: NAMES[a] for a, b in OPPOSITES}
MOST_DENIALS = 2  # more in one clause than anybody can be sure of
_SCALES: Mapping[str, tuple[str, int]] = {
    "far": ("distance", +1), "gap": ("distance", +1), "near": ("distance", -1), "hit": ("distance", -1),
    "clearance": ("distance", +1), "mind": ("distance", +1),
    "fast": ("speed", +1), "pace": ("speed", +1), "slow": ("speed", -1), "settle": ("speed", -1), "late": ("speed", -1),
    "smooth": ("smooth", +1), "jerky": ("smooth", -1), "turn": ("smooth", -1),
    "short": ("path", +1), "long": ("path", -1),
    "left": ("side", +1), "right": ("side", -1),
}  # fmt: skip
"""Sense -> what it is about, and which end of that."""
_OTHER_HEADS = ("far", "near", "hit", "fast", "slow", "short", "long", "arc")
_ARTICLES = known_words("the this that these those your its das dieses diese die dein sein")
_TURNING = ("not", "undo", "less", "bad", "needless", "avoid", "why", "enough")
_NARROW = ("close", "closer", "nah", "naeher", "nahe", "eng", "enger", "dicht", "dichter", "knapp")  # of a gap: small
_OF_SPEED = ("more", "less", "big", "not", "bad", "too", "good", "needless", "why", "avoid", "rather")
_ASKS_FOR = ("good", "rather", "may", "keep", "go", "please", "big", "more", "must", "canst")
_SOONER = known_words("rather sooner better lieber eher besser")
_CAN = known_words("can could cant cannot couldnt kann kannst koennen")
_ADJECTIVES = known_words("close near fast far quick jerky sharp bumpy")
_THEM = ("them", "those", "these", "that", "this", "davon", "denen")
_AFTER_RIGHT = known_words(
    "along past by up next through at into away behind beside there here in now between across over off ahead after to"
)
"""Words before which "right" is no side."""
_MINE = frozenset(["my", "our", "meiner", "meine", "meinen", "unserer"])


@dataclass(frozen=True)
class Reading:
    """objective: what is meant; wanted: more of it, or less; tokens: that it was read from, of all of the clause. sure:
    false where it must be asked back; waived: it is said not to matter, or to matter less than something else;
    described: it says how the robot was.
    """

    objective: str
    wanted: bool
    tokens: tuple[Token, ...]
    clause: tuple[Token, ...]
    sure: bool = True
    waived: bool = False
    slight: bool = False
    foremost: bool = False
    offered: tuple[str, ...] = ()
    described: bool = False

    @property
    def start(self) -> int:
        return self.clause[0].words[0].start

    @property
    def end(self) -> int:
        return self.clause[-1].words[-1].end


@dataclass(frozen=True)
class Stance:
    """How a clause stands to what it, or the clause that hangs on it, speaks of. waived: it is said not to matter."""

    turned: bool = False
    waived: bool = False
    unsure: bool = False


def stance_of(clause: Clause, language: Language) -> Stance:
    """Denials and dislikes turn a wish round, two of them back again; a denied dislike says that it does not matter."""
    place = clause.tokens.index
    denials = clause.all_of("not", "undo") + [one for one in clause.all_of("avoid") if _denies(one, clause)]
    denials += clause.all_of("why") if not clause.has("suggest") else []
    disliked, needless = clause.all_of("bad"), clause.all_of("needless")
    if needless:
        further = [one for one in denials if place(one) > place(needless[0])]
        if clause.has("so", "too", "big") and clause.heads:  # "you need not drive so fast" asks for less of it
            sure = clause.has("fast", "pace") or (clause.has("so", "too") and not clause.has("long"))
            return Stance(turned=True, unsure=bool(further or disliked) or not sure)
        return Stance(waived=True, unsure=bool(further or disliked))
    if disliked and denials and (language == "de" or any(place(one) < place(disliked[0]) for one in denials)):
        return Stance(waived=True, unsure=len(denials) > 1)
    turns = len(denials) + bool(disliked)
    plain = [one for one in denials if "not" in one]
    unsure = turns > MOST_DENIALS or len(plain) >= MOST_DENIALS
    unsure = unsure or (clause.asked and not clause.has("why") and _asks_back(clause, bool(plain)))
    unsure = unsure or _is_mistyped_too(clause.tokens)
    unsure = unsure or bool(plain and clause.has("too") and _CAN & {one.form for one in clause.tokens})
    if language == "en" and clause.heads and plain and not disliked and place(plain[-1]) > place(clause.heads[-1]):
        unsure = unsure or not any("good" in one for one in clause.tokens[place(plain[-1]) :])
    return Stance(turned=turns % 2 == 1, unsure=unsure)


def _denies(token: Token, clause: Clause) -> bool:
    """ "avoid rushing" denies; "avoid me" keeps away."""
    return any(one is not token for one in clause.heads) or not clause.has("person", "thing")


def _compares(tokens: Sequence[Token]) -> bool:
    return any("than" in one or one.form.startswith(("than ", "als ")) for one in tokens)


def _is_mistyped_too(tokens: Sequence[Token]) -> bool:
    """ "to close", "2 fast"."""
    return any(a.form in ("to", "2") and b.form in _ADJECTIVES for a, b in pairwise(tokens))


def _asks_back(clause: Clause, denied: bool) -> bool:
    """ "Must you drive so fast?" wants the contrary, and in "Couldn't it go faster?" a denial is none; "not so close?"
    and "don't rush, okay?" are what they seem."""
    if clause.heads and clause.has("so", "too", "enough"):
        return not denied
    return denied and not clause.tokens[0].any("not", "please")


Scaled = tuple[Token, str, int]
"""A head, the scale that it is on, and which end of that it stands for."""


class ClauseReader:
    """Reads one clause. outer: how the clause that it hangs on stands to it; beside: it is known to be about driving
    beside the person; doubted: whatever it says is asked back."""

    def __init__(self, clause: Clause, outer: Stance, language: Language, beside: bool = False, doubted: bool = False):
        self.clause, self.tokens, self.language, self.beside = clause, clause.tokens, language, beside
        own = stance_of(clause, language)
        self.waived = own.waived or outer.waived
        self.turned = own.turned != outer.turned
        self.denied = clause.has("not", "undo", "bad", "avoid", "why", "needless") or outer.turned
        self.sure = not (own.unsure or outer.unsure or doubted or clause.has("unknown", "half"))

    def readings(self) -> list[Reading]:
        heads = self._heads()
        if not heads:
            return self._without_heads()
        heads, sure = self._without_places(heads)
        scales = list(dict.fromkeys(scale for _, scale, _ in heads))
        if len(scales) > 1 and (self.denied or self.clause.has("too", "less")):
            sure = False  # which of them it is that is denied, or too much?
        if {"speed", "distance"} <= set(scales) and self.clause.has("may"):
            sure = False  # "it can be quick far away" says where
        return [
            reading for scale in scales for reading in self._of(scale, [one for one in heads if one[1] == scale], sure)
        ]

    # ---- what it is about --------------------------------------------------------------------------------------------

    def _heads(self) -> list[Scaled]:
        """Heads with their scales; a noun is none where an adjective beside it says what is wished of it."""
        has = self.clause.has
        found: list[Scaled] = []
        for at, token in enumerate(self.tokens):
            sense = self._sense(token, at)
            if (
                sense is None
                or (sense == "turn" and has("smooth", "jerky", "calm"))
                or (sense == "pace" and has("fast", "slow", "settle"))
                or (sense in ("fast", "slow") and at + 1 < len(self.tokens) and self.tokens[at + 1].any("turn", "arc"))
                or (sense in ("short", "long") and has("gap", "clearance") and not has("way"))
                or (sense == "near" and has("gap") and token.form in _NARROW)
            ):
                continue
            scale, end = _SCALES[sense]
            found.append((token, scale, -end if sense == "pace" and has("calm", "smooth") else end))
        if has("calm") and has("ride", "turn") and not has("smooth", "jerky"):
            found.append((self.clause.all_of("calm")[0], "smooth", +1))
        if has("arc") and not any(scale == "distance" for _, scale, _ in found):
            around = has("person", "thing", "beside")
            found = [one for one in found if one[1] != "path"] if around else found
            if around or not found:
                found.append((self.clause.all_of("arc")[0], *(("distance", +1) if around else ("path", -1))))
        return found

    def _sense(self, token: Token, at: int) -> str | None:
        senses = [sense for sense in _SCALES if sense in token]
        if "avoid" in token and not _denies(token, self.clause):
            return "far"
        after = self.tokens[at + 1 : at + 2]
        if token.form == "right" and after and not after[0].before and after[0].words[0].form in _AFTER_RIGHT:
            return None  # "right along the wall"
        if "settle" in token and self._is_of_person(at):
            return None  # "I can't calm down"
        if "smooth" in senses and "arc" in token and (token.words[0].capital or not after):
            return None  # German "eine Runde", and "runde Kurven"
        if "smooth" in senses and after and "pace" in after[0]:
            return None  # "a gentler pace"
        if not senses or (senses == ["mind"] and not self.clause.has("thing", "any")):
            return None
        if "far" in senses and "way" in token:  # German "Weg" and "weg"
            takes = any(one.form.startswith(("nimm", "nehm")) for one in self.tokens)  # "nimmt uns die Arbeit weg"
            adjective = takes or (at > 0 and self.tokens[at - 1].any("short", "long"))
            return None if adjective or token.words[0].capital else "far"
        if "long" in senses and token.form == "lang" and self.clause.has("thing"):
            return "near"  # German "an der Wand lang"
        return senses[0]

    def _is_of_person(self, at: int) -> bool:
        doers = [one for one in self.tokens[:at] if one.any("mine", "person", "robot")]
        return bool(doers) and "robot" not in doers[-1]

    def _without_places(self, heads: list[Scaled]) -> tuple[list[Scaled], bool]:
        """Without nearness that only says where to be slow or quick: "slow when close to me"; whether that is certain:
        "come close quickly" may say two things."""
        nears = [token for token, scale, _ in heads if scale == "distance" and "near" in token]
        speeds = [token for token, scale, _ in heads if scale == "speed"]
        if not nears or not speeds:
            return heads, True
        place = self.tokens.index
        behind = all(place(near) > place(speeds[0]) for near in nears)
        comes = any(one.form.startswith(("come", "get", "komm", "rueck")) for one in self.clause.all_of("go"))
        wish = any(near.form in ("closer", "nearer", "naeher", "dichter") for near in nears)
        wish = wish or (comes and self.clause.role == "main" and not self.denied)
        rest = [one for one in heads if one[0] not in nears]
        self.beside = True
        clear = (behind or self.clause.has("person", "beside", "pass")) and not wish
        return rest, clear and not any(scale == "distance" for _, scale, _ in rest)

    # ---- which end of it is wished -----------------------------------------------------------------------------------

    def _of(self, scale: str, heads: list[Scaled], sure: bool) -> list[Reading]:
        if scale == "side":
            return [one for token, _, end in heads for one in self._side(token, end)]
        ends = {self._made_less(token, end, heads) for token, _, end in heads}
        if len(ends) > 1:  # "near but far" in one breath: each by itself, so that the contradiction shows
            return [one for head in heads for one in self._of(scale, [head], sure and not self.denied)]
        tokens = [token for token, _, _ in heads]
        end, certain = self._wished(ends.pop(), tokens)
        sure = sure and certain
        if scale == "distance":
            return self._distance(tokens, end, sure)
        if all("pace" in token for token in tokens) and self.clause.has("care", "mind"):
            end, sure = -1, False  # "watch your speed"
        elif (
            all("pace" in token for token in tokens)
            and self.clause.has("keep", "go")
            and not self.clause.better
            and not self.clause.has(*_OF_SPEED)
        ):
            sure = False  # "keep your speed" says neither more nor less
        elif all("pace" in token for token in tokens) and self.clause.has("half", "smooth"):
            sure = False
        if scale == "speed" and (self.beside or self.clause.has("beside", "pass")):
            return [self._reading("slower_near_person", end < 0, tokens, sure and not self._beside_things())]
        if end < 0 and self.clause.role == "main" and any(token.any("jerky", "turn") for token in tokens):
            sure = (
                sure and any("jerky" in one for one in tokens) and self._asks_for_jerks(tokens)
            )  # otherwise a denial was more probably not found
        if end < 0 and self.clause.role == "main" and not self.clause.better and any("late" in one for one in tokens):
            sure = sure and self.clause.has("may")  # "it takes forever"
        few = self.clause.role == "main" and not self.clause.has(*_ASKS_FOR) and not self.waived
        if scale == "path" and end < 0 and few:
            sure = False  # nor for detours in so few words
        if scale == "speed" and end > 0 and self._because_of_me(tokens):
            return [self._reading("slower_near_person", False, tokens, sure)]
        name = {"speed": "faster", "smooth": "smoother", "path": "shorter"}[scale]
        return [self._reading(name, end > 0, tokens, sure)]

    def _asks_for_jerks(self, heads: Sequence[Token]) -> bool:
        """ "it should zigzag", "more jerks please"; not "the jerking should get better", "please those jerks"."""
        if self.denied or self.clause.has("care", "calm", "mind", "smooth", *_OTHER_HEADS):
            return False
        first = self.tokens.index(heads[0])
        named = first > 0 and self.tokens[first - 1].form in _ARTICLES
        improved = any(one.form in ("better", "besser", "gut", "good") for one in self.tokens)
        return self.clause.has("must", "please", "good", "more") and not named and not improved

    def _because_of_me(self, tokens: Sequence[Token]) -> bool:
        """ "don't brake for me" speaks of driving beside the person."""
        return self.clause.has("forme") and self.turned and all("slow" in token for token in tokens)

    def _beside_things(self) -> bool:
        return self.clause.has("thing") and not self.clause.has("person", "beside")

    def _made_less(self, head: Token, end: int, heads: list[Scaled]) -> int:
        """The end that a head stands for with what makes it less: "less speed", "the gap was small"."""
        if self.clause.has("less"):
            at = self.tokens.index(head)
            others = [self.tokens.index(token) for token, _, _ in self._heads() if token is not head]
            for less in self.clause.all_of("less"):
                k = self.tokens.index(less)
                if less.form == "down" and head.any("slow", "settle"):
                    continue  # "slow the thing down"
                if k < at and not any(k < other < at for other in others):
                    return -end
                if k > at and not any(at < other for other in others):
                    return -end
        small = any(one.form in _NARROW for one in self.tokens) or (
            self.clause.has("short") and not self.clause.has("way")
        )
        return -end if small and head.any("gap", "clearance") else end

    def _wished(self, end: int, heads: Sequence[Token]) -> tuple[int, bool]:
        """The end that is wished, and whether that is certain."""
        clause = self.clause
        noun = any(token.any("gap", "clearance", "pace", "turn") for token in heads)
        certain = self.turned or clause.role != "main" or not any("hit" in token for token in heads)
        if clause.has("enough"):
            if clause.has("not", "why"):
                return end, certain  # "not fast enough" wants more of it
            certain = certain and (noun or clause.has("keep"))
        if self.waived:
            return end, certain
        if clause.role == "main" and self._describes() and not clause.has("may", "please"):
            # "it comes closer than I like", "it is never too fast"
            certain = certain and not _compares(self.tokens) and not (self.denied and clause.has("too"))
        if self._too_much(heads) and not self.denied:
            if any(one.form in _SOONER for one in self.tokens) and clause.better:  # "better too far than too near"
                return end, certain and not clause.has("is")
            return -end, certain and not clause.has("may")
        if clause.has("so") and not self.denied and not clause.has("canst"):
            certain = certain and not self._describes()
        return (-end if self.turned else end), certain

    def _too_much(self, heads: Sequence[Token]) -> bool:
        """Whether there is too much, or too little, of it: "too" stands before it, or before how large it is."""
        for at, token in enumerate(self.tokens):
            if "too" not in token:
                continue
            rest = self.tokens[at + 1 :]
            while rest and rest[0].any("big", "less") and not rest[0].any(*_SCALES):
                if len(rest) == 1 or self.tokens.index(heads[0]) < at:
                    return True
                rest = rest[1:]
            if rest and (rest[0] in heads or rest[0].any(*_SCALES)):
                return True
            if token.form in ("zu sehr", "zu viel", "zuviel", "uebertrieben"):
                return True
        return self.language == "en" and bool(self.tokens) and self._ends_with_too_much()

    def _ends_with_too_much(self) -> bool:
        """ "it wobbles too much"."""
        forms = [token.form for token in self.tokens]
        return any(forms[k : k + 2] in (["too", "much"], ["too", "often"], ["too", "hard"]) for k in range(len(forms)))

    def _describes(self) -> bool:
        """Whether it says how the robot is, rather than how it should be."""
        than = next((k for k, one in enumerate(self.tokens) if _compares([one])), len(self.tokens))
        wished = any(one.any("good", "must") or one.form in SUBJUNCTIVE | FORBIDS for one in self.tokens[:than])
        return "robot" in self.tokens[0] and not wished

    # ---- of whom, of what, on whose side -----------------------------------------------------------------------------

    def _distance(self, heads: list[Token], end: int, sure: bool) -> list[Reading]:
        """Of the person, or of things; of neither where it cannot be told."""
        last = max(self.tokens.index(token) for token in heads)
        around = ("person", "thing", "any", "goal", "beside")
        named = [one for one in [*self.tokens[last:], *reversed(self.tokens[:last])] if one.any(*around)]
        hit = any("hit" in token for token in heads)
        if hit and {"mir", "me"} & {one.form for one in named} and any("thing" in one for one in named):
            named = [one for one in named if "thing" in one]  # "stoß mir die Vase nicht um"
        things = all(token.any("mind", "clearance") for token in heads)
        target = named[0] if named else None
        if any(one.form in _THEM for one in self.tokens[last:]):  # "the walls are new, keep off them"
            return [self._reading("farther", end > 0, heads, False, offered=TARGETS)]
        if end < 0 and self.turned and any(token.form.endswith("around") for token in heads):
            sure = False  # "without going around" may speak of the way
        if target is None and not things and not hit:
            return [self._from_person(end, heads, sure)]
        if things and self.turned:  # "don't worry about the furniture"
            return [replace(self._reading("clearance", True, heads, sure), waived=True)]
        if (target is not None and "thing" in target) or (target is not None and "any" in target and (hit or things)):
            return [self._reading("clearance", end > 0, heads, sure)]
        if target is not None and target.any("person", "beside") and not things:
            return [self._from_person(end, heads, sure)]
        return [self._reading("farther", end > 0, heads, False, offered=TARGETS)]

    def _from_person(self, end: int, heads: Sequence[Token], sure: bool) -> Reading:
        return self._reading("farther" if end > 0 else "closer", True, heads, sure)

    def _side(self, token: Token, end: int) -> list[Reading]:
        """Whose left it is decides; nobody's, or the person's own, is asked back."""
        at = self.tokens.index(token)
        owner = self._owner(at)
        name = SIDES[0] if (end > 0) != self.turned else SIDES[1]
        if owner == "robot":
            return [self._reading(name, True, [token], sure=True)]
        if owner == "person" or self._is_a_side(at):
            return [self._reading(name, True, [token], sure=False, offered=SIDES)]
        return []

    def _owner(self, at: int) -> Literal["robot", "person"] | None:
        if self.clause.has("robotview"):  # "seen from the robot I want to be on the right"
            return "robot"
        for one in reversed(self.tokens[max(0, at - 2) : at]):
            if one.form in THEIRS or one.form in _MINE:
                return "robot" if one.form in THEIRS else "person"
        for one in self.tokens[at + 1 : at + 6]:
            if "robot" in one and one.form not in ("der", "das"):
                return "robot"
            if one.any("person", "beside", "mine"):
                return "person"
            if one.any("left", "right") or not one.any("filler", "prefto", "near", "robot"):
                return None
        return None

    def _is_a_side(self, at: int) -> bool:
        """Whether "right" is a side here, and not only a word."""
        led = at > 0 and self.tokens[at - 1].form in ("the", "on", "to", "keep", "stay", "pass")
        return self.language == "de" or led or len(self.tokens[at].words) > 1 or len(self.tokens) <= 4

    def _without_heads(self) -> list[Reading]:
        """ "be careful", "two metres away", "calmly": care and calm are asked back, care of things is clearance."""
        has, all_of = self.clause.has, self.clause.all_of
        if has("care") and has("thing"):
            return [self._reading("clearance", not self.turned, all_of("care"), sure=not self.denied)]
        if has("bad") and has("thing") and not self.waived:
            return [self._reading("clearance", True, all_of("bad"), sure=False)]
        if has("span") and has("keep", "atleast", "within", "go"):
            near = has("within") != self.turned
            return self._distance(all_of("span"), -1 if near else +1, sure=self.turned or not has("within"))
        if has("span") and has("good", "please"):
            return [self._reading("farther", True, all_of("span"), sure=False)]
        if has("calm"):
            return [self._reading("smoother", True, all_of("calm"), sure=False, offered=CALM)]
        scared = all_of("bad") if has("not") and not has("may", "self") else []
        vague = all_of("care", "mind") or scared
        return [Reading("farther", True, tuple(vague), tuple(self.tokens), False, offered=CARE)] if vague else []

    def _reading(
        self, objective: str, wanted: bool, heads: Sequence[Token], sure: bool, offered: tuple[str, ...] = ()
    ) -> Reading:
        sure = sure and self.sure
        telling = tuple(one for one in self.tokens if one in heads or one.any(*_TURNING))
        offered = offered or (() if sure else ends_of(objective))
        slight, foremost = self.clause.has("slight"), self.clause.has("foremost")
        return Reading(objective, wanted, telling, tuple(self.tokens), sure, self.waived, slight, foremost, offered)


def ends_of(objective: str) -> tuple[str, ...]:
    """An objective, and what can be had of its contrary."""
    other = OPPOSITE.get(objective) or {"faster": "slower_near_person"}.get(objective)
    return (objective, other) if other else (objective,)
