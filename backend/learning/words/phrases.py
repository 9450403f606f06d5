"""The training phrases of the words model: patterns of `datasets/words` made into labelled clauses.

Templates that are filled here, by lot but always the same for a seed; test and development sentences are not read here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

Language = Literal["en", "de"]
LANGUAGES: tuple[Language, ...] = get_args(Language)
FOLDER = Path(__file__).parents[3] / "datasets" / "words"
NOTHING_SAID = ("none", "needless")
UNCLEAR = ("care", "side")
FEWEST, MOST = 8, 90  # fillings of one pattern: about one and a half per alternative, so that long ones do not drown short ones
OPPOSED = ("closer", "farther", "person_on_left", "person_on_right")  # the bare contrary of one is the other


@dataclass(frozen=True)
class Pattern:
    """label: an objective, `none`, `care` or `side`; form: do, noun, adj, ...; text with `[a|b|]`."""

    label: str
    form: str
    text: str


@dataclass(frozen=True)
class Clause:
    """label: `+objective` asks for it, `-objective` names its contrary; or `none`, `needless`, `care`, `side`."""

    text: str
    label: str


WRAPPERS: Mapping[Language, Mapping[str, tuple[str, ...]]] = {
    "en": {
        "do": (
            "{}", "{}", "please {}", "{} please", "{}, please", "could you {}", "could you please {}", "would you {}", "can you {}",
            "I want you to {}", "I'd like you to {}", "I would like it to {}", "it should {}", "the robot should {}",
            "you should {}", "you must {}", "just {}", "I'd prefer it to {}", "try to {}", "make sure to {}", "it has to {}",
            "it would be nice if you could {}", "I'd be glad if it could {}", "I wish it would {}", "always {}",
            "the important thing is to {}", "I'd feel better if it would {}", "I'd appreciate it if you could {}",
            "would you mind {ing}", "it is important to {}", "I like it when it {s}", "I like it if you {}", "I want it to {}",
            "that it {s}", "it {s}", "{ing}", "{ing} is important to me", "you {ed}", "it {ed}", "if it {s}", "see that you {}",
            "{} if you can", "{} when possible", "I need you to {}", "I would like to see it {}", "most of all {}", "above all {}",
        ),
        "noun": (
            "{}", "{}", "{} please", "I want {}", "I'd like {}", "I need {}", "I prefer {}", "what matters to me is {}",
            "{} is important to me", "{} matters", "{} is what counts", "above all {}", "I care about {}", "it's about {}",
            "most of all {}", "I like {}", "for me {} counts", "with {}", "I would like {}", "it is all about {}", "having {}",
            "{} is the most important thing", "to have {}", "I value {}", "I would love {}", "{} counts", "the main thing is {}",
        ),
        "adj": (
            "{}", "{}", "{} please", "it should be {}", "I want it {}", "I like it {}", "be {}", "drive {}", "go {}", "as {} as you can",
            "being {}", "it must be {}", "really {}", "very {}", "quite {}", "please be {}", "please drive {}", "I prefer it {}",
            "it is {}", "to be {}", "I'd like it {}", "make it {}", "more {}", "{} is best", "{} is good", "so that it is {}",
        ),
        "bad": (
            "don't {}", "do not {}", "never {}", "please don't {}", "please do not {}", "you shouldn't {}", "it must not {}",
            "stop {ing}", "I don't want it to {}", "I don't want you to {}", "I hate it when it {s}", "it shouldn't {}",
            "I don't like it when you {}", "avoid {ing}", "I'd rather you didn't {}", "no {ing}", "without {ing}", "you must not {}",
            "it should not {}", "I can't stand it if it {s}", "not {ing}", "just don't {}", "please avoid {ing}", "dont {}",
            "it should never {}", "I don't like it {ing}", "could you please not {}", "try not to {}", "I'd prefer it not to {}",
            "it bothers me when it {s}", "I dislike it if it {s}", "that it doesn't {}", "as long as it doesn't {}", "it doesn't {}",
            "the worst is when it {s}", "and don't {}", "you don't {}",
        ),
        "badnoun": (
            "no {}", "no {} please", "without {}", "avoid {}", "I don't like {}", "I hate {}", "please no {}", "less {}", "I don't want {}",
            "not so much {}", "I can't stand {}", "I dislike {}", "stop the {}", "I want no {}", "there should be no {}", "enough of the {}",
            "as little {} as possible", "I am tired of {}", "I don't need {}", "not too much {}", "{} is awful", "{} bothers me",
        ),
        "badadj": (
            "not so {}", "not too {}", "not {}", "less {}", "too {}", "it was too {}", "don't be so {}", "don't be {}", "not that {}",
            "it is too {}", "I don't want it {}", "it shouldn't be {}", "don't drive {}", "don't go {}", "I don't like it {}", "way too {}",
            "it must not be {}", "never {}", "it's too {} for me", "please not so {}", "I find it too {}", "don't drive so {}",
        ),
        "against": ("{}", "{ing}", "it {s}", "you {ed}", "to {}"),
        "needless_do": (
            "you don't need to {}", "you don't have to {}", "it doesn't have to {}", "it need not {}", "no need to {}", "you needn't {}",
            "it isn't necessary to {}", "I don't need it to {}", "you are not obliged to {}", "there is no need to {}", "nobody has to {}",
            "it is not important to {}", "I don't mind whether you {}", "it doesn't need to {}", "it makes no difference if you {}",
        ),
        "needless_noun": (
            "{} doesn't matter to me", "I don't care about {}", "{} is not important", "never mind {}", "I don't mind about {}",
            "I don't need {}", "{} is not important to me", "I am not interested in {}", "{} is of no interest", "forget about {}",
        ),
        "needless_adj": ("it doesn't have to be {}", "it need not be {}", "you don't have to be {}", "it doesn't need to be {}",
                         "it doesn't matter if it is {}", "no need to be {}", "I don't mind how {} it is", "I don't care how {} it is"),
        "needless_bad": (
            "I don't mind if it {s}", "I don't mind if you {}", "you can {} for all I care", "it's fine if you {}", "it may {}",
            "I don't care if it {s}", "it doesn't matter if it {s}", "it's okay if it {s}", "it doesn't bother me if you {}",
        ),
    },
    "de": {
        "do": (
            "{}", "{}", "bitte {}", "{} bitte", "er soll {}", "er sollte {}", "der Roboter soll {}", "du sollst {}", "du solltest {}",
            "könntest du {}", "könnten Sie bitte {}", "kannst du {}", "würden Sie bitte {}", "ich möchte, dass Sie {}", "er muss {}",
            "einfach {}", "du musst {}", "er möge {}", "versuch zu {}", "es wäre schön, wenn Sie {} könnten", "{} soll er",
            "immer {}", "ich will, dass du {} kannst", "mir ist wichtig, {}", "{} wäre schön", "{} wäre mir lieb", "vor allem {}",
            "es wäre nett, wenn er {} würde", "ich fände es gut, wenn er {} würde", "am liebsten {}", "wichtig ist mir {}", "unbedingt {}",
            "der soll {}", "ich hätte gern, dass die Roboter {}", "mir wäre wohler, wenn du {} würdest", "können Sie {}",
        ),
        "imp": ("{}", "{}", "{} bitte", "bitte {}", "{}, bitte", "dann {}", "also {}", "{} ja", "vor allem {}"),
        "sub": (
            "ich will, dass er {}", "ich möchte, dass er {}", "es wäre schön, wenn er {}", "mir ist wichtig, dass er {}", "ich mag es, wenn er {}",
            "ich hätte gern, dass er {}", "Hauptsache, er {}", "dass er {}", "mir wäre lieb, wenn er {}", "wenn er {}", "er soll so fahren, dass er {}",
            "ich fühle mich besser, wenn er {}", "am wichtigsten ist mir, dass er {}", "ob er {}", "dass du {}", "ich find gut, wenn er {}",
        ),
        "noun": (
            "{}", "{}", "{} bitte", "ich will {}", "ich möchte {}", "ich brauche {}", "ich hätte gern {}", "mir geht es um {}", "{} ist mir wichtig",
            "wichtig ist mir {}", "{} zählt", "vor allem {}", "es kommt auf {} an", "{} wäre schön", "ich mag {}", "für mich zählt {}", "mit {}",
            "{} ist das Wichtigste", "{} bedeutet mir viel", "am wichtigsten ist {}", "mir ist {} wichtig", "ich bevorzuge {}", "Hauptsache {}",
            "ein bisschen {}", "bitte {}", "{} ist mir am liebsten",
        ),
        "adj": (
            "{}", "{}", "{} bitte", "bitte {}", "er soll {} fahren", "fahr {}", "fahren Sie {}", "ich mag es {}", "es soll {} sein", "möglichst {}",
            "ich will es {}", "sehr {}", "schön {}", "{} fahren", "{} sein", "recht {}", "sei {}", "er muss {} sein", "ich hätte es gern {}",
            "{} ist gut", "{} ist mir wichtig", "so {} wie möglich", "Hauptsache {}", "{} zu sein", "{} wäre mir lieb", "ganz {}",
        ),
        "bad": (
            "nicht {}", "bitte nicht {}", "er soll nicht {}", "du sollst nicht {}", "du solltest nicht {}", "er darf nicht {}", "bloß nicht {}",
            "ich will nicht, dass Sie {}", "Sie dürfen nicht {}", "nie {}", "niemals {}", "könnten Sie bitte nicht {}", "ohne zu {}", "er sollte nicht {}",
            "ich mag es nicht, wenn die {}", "nur nicht {}", "der soll nicht {}", "du darfst nicht {}", "er soll nie {}", "auf keinen Fall {}",
            "hör auf zu {}", "er soll aufhören zu {}", "und nicht {}", "lieber nicht {}", "Hauptsache nicht {}", "keinesfalls {}", "ich hasse es, wenn Roboter {}",
            "mich stört, wenn die {}", "Hauptsache, er muss nicht {}", "mir wäre lieber, Sie würden nicht {}",
        ),
        "badimp": ("{}", "{}", "bitte {}", "{} bitte", "{}, bitte", "und {}", "nur {}"),
        "badadj": (
            "nicht so {}", "nicht zu {}", "nicht {}", "weniger {}", "zu {}", "das war zu {}", "sei nicht so {}", "bitte nicht so {}", "fahr nicht so {}",
            "es ist zu {}", "er war mir zu {}", "nicht allzu {}", "viel zu {}", "bloß nicht {}", "ich mag es nicht {}", "er soll nicht so {} sein",
            "fahren Sie nicht so {}", "bitte nicht {}", "es darf nicht {} sein", "nicht gar so {}", "er soll nicht {} fahren", "nie {}",
        ),
        "badnoun": (
            "keine {}", "kein {}", "keinen {}", "bitte kein {}", "bitte keine {}", "ohne {}", "ich mag kein {}", "ich mag keine {}", "ich hasse {}",
            "weniger {}", "ich will keine {}", "ich will kein {}", "bloß keine {}", "bloß kein {}", "nicht so viel {}", "Schluss mit {}", "genug mit dem {}",
            "es soll keine {} geben", "möglichst wenig {}", "hör auf mit dem {}", "{} stört mich", "{} nervt", "nur keinen {}", "bitte keinen {}",
        ),
        "against": ("{}", "zu {}", "er muss {}", "{} müssen"),
        "needless_do": (
            "du musst nicht {}", "er muss nicht {}", "Sie müssen nicht {}", "du brauchst nicht zu {}", "er braucht nicht {}", "es ist nicht nötig zu {}",
            "man muss nicht {}", "niemand muss {}", "nicht nötig zu {}", "ich brauche nicht, dass die {}", "Sie brauchen nicht {}", "{} muss nicht sein",
            "{} muss er nicht", "er muss nicht unbedingt {}", "es ist egal, ob die {}",
        ),
        "needless_noun": (
            "{} ist mir egal", "{} ist nicht wichtig", "{} ist mir nicht wichtig", "auf {} kommt es nicht an", "{} spielt keine Rolle", "ich brauche {} nicht",
            "{} interessiert mich nicht", "{} muss nicht sein", "vergiss {}", "{} ist mir gleich", "{} ist unwichtig", "{} braucht es nicht",
        ),
        "needless_adj": ("es muss nicht {} sein", "er muss nicht {} sein", "du musst nicht {} sein", "es braucht nicht {} zu sein", "es muss nicht {} gehen",
                         "ob er {} ist, ist mir egal", "wie {} er fährt, ist mir egal", "{} muss es nicht sein", "mir egal, wie {} es ist"),
        "needless_bad": (
            "er darf ruhig {}", "es macht nichts, wenn die {}", "es ist egal, wenn Sie {}", "mich stört nicht, wenn die {}", "von mir aus darf er {}",
            "mir macht es nichts aus, wenn Roboter {}", "er kann gern {}",
        ),
    },
}  # fmt: skip
"""Language -> form of a pattern -> what it is said in. `{ing}`, `{s}`, `{ed}`: English forms of its first verb."""

BESIDES_SHARE = 0.15
BESIDES: Mapping[Language, tuple[str, ...]] = {
    "en": ("{}, my dear", "well, {}", "{} you know", "{} if that is possible", "I think {}", "{}, thank you", "to be honest {}", "{} mate",
           "when you go by, {}", "for me {}", "{} when you can", "oh {}", "and {}", "{} though", "{} because I am old", "{} always"),
    "de": ("{}, mein Lieber", "na ja, {}", "{}, gell", "{}, wenn es geht", "ich finde, {}", "{}, danke", "ehrlich gesagt {}", "{} halt",
           "beim Vorbeifahren {}", "für mich {}", "{} wenn möglich", "ach {}", "und {}", "{} eben", "{}, weil ich alt bin", "mal {}", "{} immer"),
}  # fmt: skip
"""What people say around a wish; it changes nothing about it."""

IRREGULAR = {"go": "went", "get": "got", "keep": "kept", "come": "came", "drive": "drove", "leave": "left", "take": "took",
             "be": "were", "make": "made", "give": "gave", "hold": "held", "run": "ran", "stand": "stood", "cut": "cut"}  # fmt: skip
DOUBLED = ("get", "cut", "run", "hit", "stop", "zigzag", "spin", "put", "let", "hug", "bump into", "slam", "ram", "skip", "slip", "tip", "clip")


def conjugated(phrase: str, form: str) -> str:
    """`phrase` with its first English verb as `ing`, `s` or `ed`."""
    verb, _, rest = phrase.partition(" ")
    if form == "ing":
        stem = verb[:-1] if verb.endswith("e") and verb not in ("be", "see") else verb + verb[-1] * (verb in DOUBLED)
        verb = stem + "ing"
    elif form == "s":
        verb = "is" if verb == "be" else verb + ("es" if verb.endswith(("s", "sh", "ch", "x", "z", "o")) else "s")
        verb = verb[:-2] + "ies" if re.search(r"[^aeiou]ys$", verb) else verb
    else:
        verb = IRREGULAR.get(verb) or verb + ("d" if verb.endswith("e") else "ed")
    return f"{verb} {rest}".strip()


def patterns(language: Language) -> list[Pattern]:
    """All patterns of a language, in the files' order."""
    found = []
    lists: dict[str, str] = {}
    for name in ("train", "others"):
        label = ""
        for line in (FOLDER / f"{name}_{language}.txt").read_text(encoding="utf-8").splitlines():
            if line.startswith("## "):
                label = line[3:].strip()
            elif line and not line.startswith("#"):
                form, _, text = line.partition(": ")
                if form.startswith("@"):
                    lists[f"<{form[1:]}>"] = text.strip()
                    continue
                for named, listed in lists.items():
                    text = text.replace(named, f"[{listed}]")
                found.append(Pattern(label, form, text.strip()))
    return found


def filled(pattern: str, random: np.random.Generator) -> str:
    """One filling of `[a|b|]`."""
    return " ".join(re.sub(r"\[([^\]]*)\]", lambda m: str(random.choice(m[1].split("|"))), pattern).split())


def _labelled(pattern: Pattern, language: Language) -> Iterator[tuple[str, str, int]]:
    """(which wrappers, label, how many times as often) that a pattern is used with."""
    label = pattern.label
    want = label if label in (*NOTHING_SAID, *UNCLEAR) else f"+{label}"
    known = WRAPPERS[language]
    if pattern.form == "say":
        yield "", want, 3 if label == "none" else 1
    elif pattern.form == "badsay":
        yield "", f"-{label}", 2
    else:
        yield pattern.form, want, 2
        if want == f"+{label}":
            if pattern.form in ("do", "noun", "adj"):
                yield f"needless_{pattern.form}", "needless", 0
            elif pattern.form in ("bad", "badnoun", "badadj") and label not in OPPOSED:
                yield ("against" if pattern.form == "bad" else ""), f"-{label}", 1
                if pattern.form == "bad" and f"needless_{pattern.form}" in known:
                    yield "needless_bad", "needless", 0


def training_clauses(language: Language, seed: int = 0) -> list[Clause]:
    """Every pattern filled and said in many ways, the same for a seed; no clause twice with the same label."""
    random = np.random.default_rng([seed, LANGUAGES.index(language)])
    found: dict[Clause, None] = {}
    for pattern in patterns(language):
        for wrappers, label, often in _labelled(pattern, language):
            ways = WRAPPERS[language].get(wrappers, ("{}",))
            many = min(max(FEWEST, 3 * (1 + pattern.text.count("|")) // 2), MOST)
            for _ in range(many * often or many // 3):
                phrase = filled(pattern.text, random)
                way = str(random.choice(ways))
                if label not in NOTHING_SAID and random.random() < BESIDES_SHARE:
                    way = str(random.choice(BESIDES[language])).replace("{}", way)
                for form in ("ing", "s", "ed"):
                    if "{" + form + "}" in way:
                        way = way.replace("{" + form + "}", conjugated(phrase, form))
                found[Clause(way.replace("{}", phrase), label)] = None
    return list(found)
