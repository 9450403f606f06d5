"""A sentence as clauses: where one ends, and what it is to the others: compared, conceded, a condition, a reason.

What a clause wishes is `understanding.py`'s.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, takewhile
from typing import Literal

from desirepath.learning.words.lexicon import Language, Token, known_words

HEADS = known_words(
    "far near hit fast slow settle late smooth jerky short long left right gap pace turn clearance mind calm ride arc"
)
"""Senses of what may be wished."""
SIDES = ("left", "right")
Role = Literal["main", "if", "that", "while", "reason", "lesser", "conceded"]
_ROLES: dict[str, Role] = {
    "if": "if", "unless": "if", "that": "that", "because": "reason", "while": "while", "concede": "conceded",
    "provided": "main", "asif": "reason",
}  # fmt: skip
SUBJUNCTIVE = known_words(
    "kaeme kaemen kaemst wuerde wuerden wuerdest bliebe blieben fuehre fuehren hielte hielten waere"
)
THEIRS = known_words("your its robots his her their deiner deine deinem deinen seiner seine ihrer ihre ihren ihrem")
FORBIDS = known_words("shouldnt mustnt") | {"should not", "must not", "may not", "shouldnt have", "darf nicht"}
_CALLED = known_words("robot bot roboter robi robbi mate pal")
_NO_TALE = ("please", "may", "canst", "suggest", "swap", "instead", "needless", "bad")
_POINTING = known_words("that this it das dies es so")
_OWN_WILL = ("like", "love", "want", "enjoy", "hop", "wish", "will", "woll", "mag", "moecht", "lieb", "geniess")
_ATTITUDES = ("good", "bad", "not", "needless", "avoid", "suggest", "may", "care", "why")


@dataclass
class Clause:
    """Tokens of one clause. link: what ties it to the clause before: `.`, `,`, `and`, `or`, `but`, or nothing; role:
    lesser: what a comparison puts second; conceded: what is put up with. better: what a comparison puts first; asked:
    its sentence ends in a question mark.
    """

    tokens: list[Token] = field(default_factory=list)
    link: str = "."
    role: Role = "main"
    better: bool = False
    asked: bool = False

    def has(self, *senses: str) -> bool:
        return any(token.any(*senses) for token in self.tokens)

    def all_of(self, *senses: str) -> list[Token]:
        return [token for token in self.tokens if token.any(*senses)]

    @property
    def heads(self) -> list[Token]:
        return self.all_of(*HEADS)

    @property
    def is_infinitive(self) -> bool:
        """German: "zu halten", "vorbeizufahren"."""
        return self.has("inf")


def clauses_of(text: str, tokens: Sequence[Token], language: Language) -> list[Clause]:
    """The clauses of a text in order, none empty."""
    found: list[Clause] = []
    for sentence, asked in _sentences(text, tokens):
        for number, clause in enumerate(_split(sentence, language)):
            tokens = [
                _no_liking(_infinitive(one, clause.tokens[k + 1 :]), clause.tokens[max(k - 3, 0) : k])
                for k, one in enumerate(clause.tokens)
            ]
            found.append(replace(clause, tokens=tokens, asked=asked, link=clause.link if number else "."))
    return found


def _infinitive(token: Token, after: Sequence[Token]) -> Token:
    """German "zu" before a verb is not "too": "zu halten", "ohne zu rasen"; adjectives like that stand before more."""
    alone = len(after) == 1 and after[0].form.endswith(("en", "eln", "ern")) and after[0].form != "fern"
    verb = after and (after[0].any("go", "keep") or alone)
    return replace(token, senses=frozenset({"inf"})) if token.form == "zu" and verb else token


def _no_liking(token: Token, before: Sequence[Token]) -> Token:
    """ "I like", "would like"; but "it raced like mad"."""
    likes = any(one.any("mine", "person", "not") or one.form == "would" for one in before)
    likes = likes and not any("robot" in one for one in before)
    return token if likes or token.form != "like" else replace(token, senses=frozenset({"filler"}))


def _sentences(text: str, tokens: Sequence[Token]) -> Iterator[tuple[list[Token], bool]]:
    held: list[Token] = []
    for token in tokens:
        if held and token.before in (".", "?"):
            yield held, token.before == "?"
            held = []
        held.append(token)
    if held:
        yield held, "?" in text[held[-1].words[-1].end :]


def _split(sentence: list[Token], language: Language) -> list[Clause]:
    """At commas and conjunctions, and where a comparison's second part, or another "less", "more", "not" begins."""
    clauses = [Clause()]
    compared = any(token.any("rather", "swap") for token in sentence) or any(
        "more" in a and "than" in b for a, b in pairwise(sentence)
    )
    for at, token in enumerate(sentence):
        now, after = clauses[-1], sentence[at + 1 :]
        comma = token.before == "," and (bool(after) or "please" not in token)  # "the long way, please"
        new: Clause | None = None
        kept = False
        if (compared or "over" in token) and _begins_lesser(token, clauses, after, sentence):
            new = Clause(link="than", role="lesser")
            now.better = True
            if now.has("swap"):  # "it is less about speed than about distance"
                now.role, now.better, new.role, new.better = "lesser", False, "main", True
        elif ("instead" in token and _about(after)) or ("than" in token and _about(now.tokens) and _about(after)):
            new = Clause(link="than", role="lesser")
            now.better = "instead" in token
        elif role := next(
            (_ROLES[sense] for sense in _ROLES if sense in token and not _is_mere_word(token, after)), None
        ):
            new = Clause(link="," if comma else "", role=role)
            kept = token.any("provided", "limits")
        elif _joins_nothing(token, clauses, comma):
            now.tokens.append(token)
            continue
        elif _joins_nouns(token, now, after) or (token.form == "aber" and not comma and now.tokens and not now.heads):
            continue
        elif link := next((sense for sense in ("but", "or", "and") if sense in token), None):
            new, kept = Clause(link=link), "limits" in token
        elif comma or (token.any("less", "more", "not") and _splits(now.tokens, token, _until_next(after), language)):
            new, kept = Clause(link="," if comma else ""), True
        if new is None:
            now.tokens.append(token)
            continue
        if kept:
            new.tokens.append(token)
        if now.tokens:
            clauses.append(new)
        elif now.role in ("lesser", "conceded"):  # "rather this than that you ...": still what is lesser
            now.tokens += new.tokens
        else:
            if new.link in ("", ",", "."):
                new.link = now.link
            clauses[-1] = new
    return [clause for clause in clauses if clause.tokens]


def _until_next(after: Sequence[Token]) -> list[Token]:
    """What follows in the same clause."""
    ends = ("and", "or", "but", "than", *_ROLES)
    return list(takewhile(lambda one: one.before != "," and (not one.any(*ends) or one is after[0]), after))


def _about(tokens: Sequence[Token]) -> bool:
    return any(not HEADS.isdisjoint(token.senses) or "thing" in token for token in tokens)


def _joins_nouns(token: Token, now: Clause, after: Sequence[Token]) -> bool:
    """ "the plants and boxes": no clause begins where neither side has said anything yet."""
    noun = next((one for one in after[:3] if not one.any("filler", "mine", "prefto")), None)
    return (
        token.any("and", "or")
        and bool(now.tokens)
        and not now.heads
        and now.tokens[-1].any("thing", "person")
        and noun is not None
        and noun.any("thing", "person")
    )


def _joins_nothing(token: Token, clauses: Sequence[Clause], comma: bool) -> bool:
    """ "slower still", "noch drei Umwege": "noch" is "nor" only after "weder"."""
    now = clauses[-1]
    if token.form == "noch":
        return not any(one.form == "weder" for clause in clauses for one in clause.tokens)
    return token.form == "still" and bool(now.heads) and not comma


def _is_mere_word(token: Token, after: Sequence[Token]) -> bool:
    """ "that close", "that would be nice", "Warum bremst er denn?": no clause begins."""
    if token.form in ("who", "which") and token.before in ("", ".", "?") and token.words[0].start == 0:
        return True  # "Who needs speed?"
    if token.form == "denn":
        return token.before not in (",", ".", "?")
    if token.form != "that":
        return False
    is_pronoun = ("would", "will", "really", "way", "much", "far")
    return not after or bool(HEADS & after[0].senses) or after[0].any("is", "not") or after[0].form in is_pronoun


def _begins_lesser(token: Token, clauses: list[Clause], after: Sequence[Token], sentence: Sequence[Token]) -> bool:
    """Whether a comparison's second part begins: than, over, "prefer this to", "not so much this as"."""
    now = clauses[-1]
    preferred = any(one.has("rather") for one in clauses)  # whatever it is: "I'd rather it came than ..."
    if not (any(_about(one.tokens) for one in clauses) or ("than" in token and preferred)) or not _about(after):
        return False
    if "than" in token:
        return True
    if "over" in token:
        return len(sentence) <= 5 or now.has("rather", "keep", "good")
    if "asmuch" in token:
        return now.has("swap")
    follows = after[:2]
    to = "prefto" in token and any(one.form.startswith(("prefer", "favo")) for one in now.tokens)
    return to and any(HEADS & one.senses for one in follows)


def _splits(before: Sequence[Token], token: Token, after: Sequence[Token], language: Language) -> bool:
    """Whether another wish begins here: "less speed | more distance", "fast | not slow"."""
    if (
        not after
        or not _about(before)
        or not _about(after)
        or "than" in after[0]
        or any(one.any("is") for one in before)
    ):
        return False
    if "not" not in token:
        if not any(one.any(*HEADS) for one in before):  # "leave the furniture more space" is one wish
            return False
        return not any(one.any("not", "needless", "avoid", "bad", "why", "too") for one in before)
    if token.form not in ("without", "ohne") and not _same_scale(before, after):
        return False
    if language == "de" and token.form != "ohne":
        next_to = after[0].any("too", "so") or not HEADS.isdisjoint(after[0].senses)
        return next_to and not any(one.any("go", "keep") for one in before)
    return token.form in ("without", "ohne") or not any(one.any("good") for one in before)


def _is_bare(clause: Clause) -> bool:
    """Only what it is about, with no verb: the verb is in the next clause."""
    return bool(clause.heads) and not clause.has(*_ATTITUDES, "keep", "go", "too", "more", "less", "please")


def _same_scale(before: Sequence[Token], after: Sequence[Token]) -> bool:
    return any(
        any(one.any(*scale) for one in before) and any(one.any(*scale) for one in after)
        for scale in (("far", "near", "gap"), ("fast", "slow", "pace"), ("smooth", "jerky"), ("short", "long"), SIDES)
    )


# ---- what clauses are to each other ----------------------------------------------------------------------------------


def governor_of(clauses: Sequence[Clause], number: int) -> Clause | None:
    """The clause that says how this one is meant: "I hate it | when you rush", "If you kept away, | I'd be glad"."""
    clause = clauses[number]
    before = clauses[number - 1] if number and clause.link != "." else None
    after = clauses[number + 1] if number + 1 < len(clauses) and clauses[number + 1].link != "." else None
    if clause.role in ("if", "that", "while") or (clause.link == "," and clause.is_infinitive):
        content = clause.role == "that" or clause.is_infinitive
        leads = before is not None and before.role in ("main", "that") and not before.heads
        if before is not None and leads and (content or before.has(*_ATTITUDES)):
            if (
                clause.role == "if"
                and not before.has("good", "bad", "needless")
                and after is not None
                and after.role == "main"
                and not after.heads
                and after.has("good", "bad")
            ):
                return after  # "I am old, the more room | the better"
            return before
        follows = clause.role in ("if", "that") and after is not None and after.role == "main" and not after.heads
        follows = follows and not (before is not None and before.heads and describes(before))
        if after is not None and follows and after.has("good", "bad", "needless", "not"):
            return after
        return Clause() if content else None
    own = (*_ATTITUDES, "too", "keep", "slight", "must", "canst", "rather", "please")
    if after is not None and after.link == "," and _only_says_how(after) and not clause.has(*own):
        return after
    return None


def _only_says_how(clause: Clause) -> bool:
    """ "close to me, | I don't want"."""
    small = ("not", "bad", "good", "needless", "robot", "mine", "filler", "person", "that", "keep", "go", "is")
    return clause.has("good", "bad", "needless") and all(token.any(*small) for token in clause.tokens)


def place_of(clauses: Sequence[Clause], number: int) -> bool:
    """Whether a circumstance puts this clause beside the person: the one that follows it, or one that begins the
    sentence, which holds for all that is joined by "and"."""
    if number + 1 < len(clauses) and clauses[number + 1].link != "." and _is_beside(clauses[number + 1]):
        return True
    for at in range(number, 0, -1):
        before = clauses[at - 1]
        if clauses[at].link == ".":
            return False
        if before.role in ("if", "while"):
            return _is_beside(before) and (before.link in (".", "but", "and") or not clauses[at - 2].heads)
        if clauses[at].link != "and":
            return False
    return False


def _is_beside(clause: Clause) -> bool:
    there = clause.tokens[-1].form in ("da sind", "da ist", "sind") and clause.tokens[0].form not in ("ich", "wir")
    somebody = clause.has("person") and not clause.has("unknown", "late") and not there  # "wenn Kinder da sind"
    near = clause.has("near", "pass", "beside") or somebody
    return clause.role in ("if", "while") and near and not clause.has("far", "gap", "not", "thing")


def denied_with(clauses: Sequence[Clause], number: int) -> Literal["too", "perhaps"] | None:
    """Whether the denial of the clause before is this one's, too: "don't rush or swerve"; "don't rush and come close"
    may be either."""
    clause, before = clauses[number], clauses[number - 1] if number else None
    after = clauses[number + 1] if number + 1 < len(clauses) else None
    if after is not None and after.link in ("and", "or") and after.heads and _is_bare(clause):
        last = after.tokens.index(after.heads[-1])
        if any(one.any("bad", "needless", "not") for one in after.tokens[last:]):
            return "perhaps"  # "fast and close driving scares me"
    own = ("not", "bad", "avoid", "undo", "needless", "more", "less", "too", "why", "keep", "rather", "suggest", "may")
    if before is None or clause.link not in ("or", "and", ",") or not before.heads or not clause.heads:
        return None
    if clause.has(*own, "foremost", "canst") or not before.has("not", "bad", "avoid", "needless", "undo", "why"):
        return None
    if clause.link == "or":
        return "too"
    fresh = clause.tokens[0].any("robot", "mine", "person") or clause.has("good", "must", "please")
    nouns_only = all(
        one.form.split()[-1].startswith(("kein", "no", "without", "ohne")) and one.form != "not"
        for one in before.all_of("not")
    )
    if fresh or (nouns_only and clause.link == "," and not before.has("bad", "avoid")):
        return None
    return "perhaps"


# ---- what is told of the robot ---------------------------------------------------------------------------------------


def describes(clause: Clause) -> bool:
    """Whether it says how the robot drives or drove, and not how it should: "it rushes by", "gestern ist er gerast"."""
    start = next((k + 1 for k, one in enumerate(clause.tokens) if "perceive" in one), 0)
    told = [one for one in clause.tokens[start:] if "filler" not in one]
    if clause.role != "main" or not told or clause.has(*_NO_TALE):
        return False
    if told[0].form in THEIRS or any(word.form == "bitte" for one in told for word in one.words):
        return False  # "on its right side"
    subject = 0 if "robot" in told[0] else 1
    if subject and not (
        told[0].form.endswith(("t", "te", "kam", "fuhr")) and len(told) > 1 and told[1].form in ("er", "es")
    ):
        return False
    verb = told[subject + 1] if subject + 1 < len(told) and not subject else told[0]
    if told[subject].form in _CALLED and not verb.form.endswith(("s", "ed", "t")):
        return False  # "robot, come near"
    wishes = clause.all_of("must", "rather") + [one for one in clause.tokens if one.form in SUBJUNCTIVE | FORBIDS]
    wishes += [
        one
        for one in clause.all_of("good")
        if one.form != "everything" and (one is not verb or not one.form.startswith(_OWN_WILL))
    ]
    return not wishes


def verdict_on(clauses: Sequence[Clause], number: int) -> Literal["good", "bad"] | None:
    """What is thought of what a clause describes, if that can be told: "it raced past, | I didn't like that"."""
    clause = clauses[number]
    after = next((one for one in clauses[number + 1 :] if one.role not in ("if", "while", "reason")), None)
    judges = (
        after is not None
        and after.role in ("main", "that")
        and after.link != "but"
        and not after.heads
        and not after.asked
    )
    if judges and after is not None and not clause.has("avoid") and not after.has("unknown", "may", "thing"):
        denied = after.has("not", "avoid", "needless")
        if after.has("bad"):
            return None if denied else "bad"
        points = any(one.form.split()[-1] in _POINTING for one in after.tokens)
        if denied and points and (after.has("good", "needless") or (after.has("must") and not clause.has("not"))):
            return "bad"
        if (
            after.has("good")
            and not denied
            and not clause.has("not")
            and not after.has("must", "more", "less", "keep", "go")
        ):
            return "good"
    forms = [word.form for token in clause.tokens for word in token.words]
    kept = any(a in ("kept", "keeps") and b.endswith("ing") for a, b in pairwise(forms))
    complained = clause.has("hit") or (kept and bool(clause.heads))
    return "bad" if complained and not any(one.has("good") for one in clauses) else None
