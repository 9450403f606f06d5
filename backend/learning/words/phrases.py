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
FEWEST, MOST = (
    8,
    90,
)  # fillings of one pattern: about one and a half per alternative, so that long ones do not drown short ones
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


BESIDES_SHARE = 0.15  # of the clauses have something said around them that changes nothing
IRREGULAR = {
    "go": "went",
    "get": "got",
    "keep": "kept",
    "come": "came",
    "drive": "drove",
    "leave": "left",
    "take": "took",
    "be": "were",
    "make": "made",
    "give": "gave",
    "hold": "held",
    "run": "ran",
    "stand": "stood",
    "cut": "cut",
}
DOUBLED = (
    *("get", "cut", "run", "hit", "stop", "zigzag", "spin", "put", "let", "hug", "bump into", "slam", "ram", "skip"),
    *("slip", "tip", "clip"),
)


def ways(language: Language) -> dict[str, list[str]]:
    """Form of a pattern -> what it is said in, `{}` being the phrase; `besides`: what people say around a wish."""
    found: dict[str, list[str]] = {}
    for line in (FOLDER / f"ways_{language}.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            found[line[3:]] = []
        elif line and not line.startswith("# "):
            list(found.values())[-1].append(line)
    return found


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


def _labelled(pattern: Pattern, known: Mapping[str, list[str]]) -> Iterator[tuple[str, str, int]]:
    """(which wrappers, label, how many times as often) that a pattern is used with."""
    label = pattern.label
    wished = label if label in (*NOTHING_SAID, *UNCLEAR) else f"+{label}"
    if pattern.form == "say":
        yield "", wished, 3 if label == "none" else 1
    elif pattern.form == "badsay":
        yield "", f"-{label}", 2
    else:
        yield pattern.form, wished, 2
        if wished == f"+{label}":
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
    known = ways(language)
    for pattern in patterns(language):
        for form_of_ways, label, often in _labelled(pattern, known):
            said_in = known.get(form_of_ways, ["{}"])
            many = min(max(FEWEST, 3 * (1 + pattern.text.count("|")) // 2), MOST)
            for _ in range(many * often or many // 3):
                phrase = filled(pattern.text, random)
                way = str(random.choice(said_in))
                if label not in NOTHING_SAID and random.random() < BESIDES_SHARE:
                    way = str(random.choice(known["besides"])).replace("{}", way)
                for form in ("ing", "s", "ed"):
                    if "{" + form + "}" in way:
                        way = way.replace("{" + form + "}", conjugated(phrase, form))
                found[Clause(way.replace("{}", phrase), label)] = None
    return list(found)
