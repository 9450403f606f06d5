"""No text from outside makes a regular expression of ours work long: a megabyte of its worst case is looked through
within 50 ms, by every pattern of `backend`, `app` and the browser's modules, found by looking into their source.

Pydantic's `Field(pattern=...)` are not looked for: its engine is linear for every pattern. `experiments` reads files of
this repository only.
"""

from __future__ import annotations

import ast
import importlib
import re
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from desirepath.grammar.source import CORE
from desirepath.learning.words.lexicon import LONGEST
from desirepath.store.scrubbing import LONGEST as KEPT_OF_A_TEXT
from desirepath.study.protocol.reading import _named

try:
    from re import _parser as sre  # type: ignore[attr-defined]
except ImportError:
    import sre_parse as sre

ROOT = Path(__file__).resolve().parent.parent
MEGABYTE = 2**20
SIZES = (2**12, 2**15, 2**18, MEGABYTE)  # what grows with the square is found in the first, not after an hour
BAR_S = 0.050  # of processor time, for a megabyte
BUSY = (
    4  # times a plain search: beside another test's compiling, linear ones took up to three; the square takes hundreds
)
FEWEST_S = 0.004  # what the clock and a cold cache may add to the small ones
A_MATCH_S = 0.5e-6  # for handing over one match, of which a megabyte may have half a million
LOOKS = {"search", "match", "fullmatch", "sub", "subn", "split", "findall", "finditer"}
MOST_REPRESENTATIVES = 6
PLAIN = re.compile(r"(?i)\b(code|token)=")  # what a megabyte costs at least, while others work on this machine as well

SENTENCE = 18 * LONGEST  # characters of a wish: refused beyond, and one may become 18 where accents are taken off
BOUNDED = {
    # file: (the most characters that its patterns ever see, who sees to that)
    "backend/desirepath/learning/words/lexicon.py": (SENTENCE, "`WordsRead` and `understand` take no longer sentence"),
    "backend/desirepath/report/planned_design.py": (
        6 * 60,
        "names of levels, of which `Slug` allows 60, and of six factors",
    ),
    "backend/desirepath/store/scrubbing.py": (
        KEPT_OF_A_TEXT,
        "`scrub` cuts every text of a log line; keys are ours",
    ),
}
MADE_THERE = {  # (file, what is looked for) -> the patterns that are put together or handed on there
    ("backend/desirepath/study/protocol/reading.py", "f\"\\\\b({'|'.join(longest)})\\\\b\""): [
        _named(["NASA-TLX", "SUS", "System Usability Scale"]).pattern
    ],
    ("backend/desirepath/report/planned_design.py", "'(.*?)' + '-(.*?)'.join(map(re.escape, first)) + '(.*)'"): [
        "(.*?)near-(.*?)slow(.*)"
    ],
    ("backend/desirepath/grammar/source.py", "f'(?:{pattern})$'"): [  # which PyYAML matches from the start on
        f"^{pattern.pattern}" for _, pattern, _ in CORE
    ],
}


@dataclass(frozen=True)
class Found:
    """A pattern, where it stands and what is done with it: `match`, `fullmatch`, or `search` for whatever goes on
    through a text."""

    file: str
    pattern: re.Pattern[Any]
    how: str = "search"


def sources() -> Iterator[Path]:
    for room in ("backend", "app"):
        yield from sorted((ROOT / room).rglob("*.py"))


def is_re(node: ast.AST, names: Iterable[str]) -> bool:
    return (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and isinstance(node.func.value, ast.Name)
        and node.func.value.id == "re"
        and node.func.attr in names
    )


def how_of(called: str) -> str:
    return called if called in ("match", "fullmatch") else "search"


def in_python() -> Iterator[Found]:
    """Whatever is given to `re`, in the namespace of its module; raises NameError for what is put together there."""
    texts = {file: file.read_text(encoding="utf-8") for file in sources()}
    looked = re.compile(rf"(\w+)\.({'|'.join(sorted(LOOKS))})\(")
    used = {found for text in texts.values() for found in looked.findall(text)}  # NAME.fullmatch(...) anywhere
    for file in (file for file, text in texts.items() if "import re\n" in text):
        nodes = list(ast.walk(ast.parse(texts[file])))
        here = str(file.relative_to(ROOT))
        named = {
            id(node.value): node.targets[0].id
            for node in nodes
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
        }
        for node in nodes:
            if not is_re(node, LOOKS | {"compile"}):
                continue
            given = node.args[0]
            if (made := MADE_THERE.get((here, ast.unparse(given)))) is not None:
                yield from (Found(here, re.compile(one), how_of(node.func.attr)) for one in made)
                continue
            flags = [one.value for one in node.keywords if one.arg == "flags"]
            flags += node.args[{"compile": 1}.get(node.func.attr, 4 if "sub" in node.func.attr else 2) :][:1]
            space = vars(importlib.import_module(".".join(file.relative_to(ROOT).with_suffix("").parts[1:])))
            value = [eval(compile(ast.Expression(one), here, "eval"), {**space}) for one in (given, *flags)]
            hows = {how for name, how in used if name == named.get(id(node), "")} or {node.func.attr}
            for how in sorted(hows):  # every process collects the same
                yield Found(here, re.compile(*value), how_of(how))


def in_the_browser() -> Iterator[Found]:
    """Literals of the modules that browsers load; what they use of the language Python reads the same way."""
    literal = re.compile(
        r"[(=,:]\s*/((?:[^/\\\n\[*]|\\.|\[[^\]\n]*\])(?:[^/\\\n\[]|\\.|\[[^\]\n]*\])*)/[dgimsuvy]*[,.;) ]"
    )
    for folder in ("frontend/static/js", "app/desirepath_stage/client"):
        for file in sorted((ROOT / folder).rglob("*.js")):
            code = file.read_text(encoding="utf-8")
            assert "RegExp(" not in code, f"{file}: write the pattern as a literal, so that it is looked at here"
            yield from (Found(str(file.relative_to(ROOT)), re.compile(one[1])) for one in literal.finditer(code))


FOUND = list(dict.fromkeys([*in_python(), *in_the_browser()]))


def representatives(parsed: Iterable[Any]) -> Iterator[str]:
    """A character of every literal and class of a pattern, in its order."""
    for op, given in parsed:
        match str(op):
            case "LITERAL":
                yield chr(given)
            case "NOT_LITERAL":
                yield "x" if given != ord("x") else "y"
            case "ANY":
                yield "x"
            case "IN":
                yield from (chr(one[1]) if str(one[0]) == "LITERAL" else chr(one[1][0]) for one in given
                            if str(one[0]) in ("LITERAL", "RANGE"))  # fmt: skip
                yield from ({"CATEGORY_SPACE": " ", "CATEGORY_DIGIT": "0"}.get(str(one[1]), "x") for one in given
                            if str(one[0]) == "CATEGORY")  # fmt: skip
                yield from "x" if str(given[0][0]) == "NEGATE" else ""
            case _:
                yield from (char for inner in parts_of(given) for char in representatives(inner))


def parts_of(given: Any) -> Iterator[Any]:
    """Whatever of an operator's arguments is a pattern itself."""
    if isinstance(given, sre.SubPattern):
        yield given
    elif isinstance(given, list | tuple):
        for one in given:
            yield from parts_of(one)


def samples(parsed: Iterable[Any], more: int) -> str:
    """A text that the pattern is likely to fit, with `more` of what may be repeated."""
    made = ""
    for op, given in parsed:
        match str(op):
            case "BRANCH":
                made += samples(given[1][0], more)
            case "MAX_REPEAT" | "MIN_REPEAT" | "POSSESSIVE_REPEAT":
                made += samples(given[2], more) * min(max(given[0], more), given[1])
            case "SUBPATTERN" | "ATOMIC_GROUP":
                made += samples(given[-1] if isinstance(given, tuple) else given, more)
            case "ASSERT" | "ASSERT_NOT" | "AT" | "GROUPREF":
                pass
            case _:
                made += next(representatives([(op, given)]), "")
    return made


def worst_cases(pattern: re.Pattern[Any]) -> Iterator[tuple[str, str, str]]:
    """(begins, is repeated, ends): characters and pairs of what the pattern names, and beginnings of what fits it;
    after a beginning of what fits, and before something that does not."""
    source = pattern.pattern.decode("latin-1") if isinstance(pattern.pattern, bytes) else pattern.pattern
    parsed = sre.parse(source, pattern.flags & ~re.LOCALE if isinstance(pattern.pattern, str) else 0)
    letters = [*list(dict.fromkeys(representatives(parsed)))[:MOST_REPRESENTATIVES], "!", " "]
    fits = [samples(parsed, more) for more in (1, 8)]
    begins = {one[:k] for one in fits for k in {0, len(one) // 2, len(one) - 1, len(one)} if k >= 0}
    repeated = {*letters, *("".join(two) for two in product(letters, repeat=2)), *begins, f"{fits[0]} "} - {""}
    yield from product(begins, repeated, ("", "\0!"))


def seconds(found: Found, case: tuple[str, str, str], size: int, tries: int = 1) -> float:
    """Processor time of looking through `size` characters of a case, less what its matches cost."""
    begin, again, end = case
    text: Any = begin + again * (max(0, size - len(begin) - len(end)) // len(again)) + end
    if isinstance(found.pattern.pattern, bytes):
        text = text.encode("latin-1", "replace")
    taken = []
    for _ in range(tries):
        began, matches = time.thread_time(), 0
        if found.how == "search":
            counted = deque(enumerate(found.pattern.finditer(text), 1), maxlen=1)
            matches = counted[0][0] if counted else 0
        else:
            getattr(found.pattern, found.how)(text)
        taken.append(time.thread_time() - began - matches * A_MATCH_S)
    return min(taken)


def plainest(size: int) -> float:
    """What a search for two words takes here and now: 20 to 25 ms a megabyte on a quiet core."""
    return seconds(Found("", PLAIN), ("", "c!", ""), size, tries=3)


@pytest.mark.parametrize("found", FOUND, ids=lambda one: f"{one.file} {one.how}")
def test_a_megabyte_of_its_worst_case_is_looked_through_at_once(found: Found) -> None:
    most = BOUNDED.get(found.file, (MEGABYTE, ""))[0]
    cases = list(worst_cases(found.pattern))
    for size in [*(one for one in SIZES if one < most), most]:
        allowed = BAR_S if most < MEGABYTE else max(FEWEST_S, BAR_S * size / MEGABYTE)
        taken = sorted(((seconds(found, case, size), case) for case in cases), reverse=True)[:4]
        if taken[0][0] > allowed:
            took, case = max((seconds(found, case, size, tries=3), case) for _, case in taken)
            told = f"{found.file}: {found.pattern.pattern!r}: {took * 1000:.0f} ms for {size} characters as in {case!r}"
            assert took < max(allowed, BUSY * plainest(size)), told
        cases = [case for _, case in taken]


def test_every_bound_is_of_a_pattern_that_is_there() -> None:
    assert set(BOUNDED) <= {one.file for one in FOUND}
    assert len(FOUND) > 60, "the patterns are not where they are looked for any more"
    for file in sources():
        assert not re.search(
            r"^\s*(from re import|import re as|(import|from) regex)", file.read_text(), re.MULTILINE
        ), file
