"""Measure the reader of plain words on a labelled CSV: `python -m tests.learning.words.measure FILE.csv --language en`.

For whoever labels sentences without knowing the code. A CSV has the columns `sentence,expected`; quote sentences with
commas. `expected` is `ask`, `none`, or what the person wants, several things separated by `;`:

- `farther:+`: the robot keeps more distance to me / to people. `closer:+`: it comes nearer to me.
- `person_on_left:+`: I am on the ROBOT's left side as it passes ("keep me on your left"); `person_on_right:+`: on its
  right. A side that is not said to be the robot's ("pass on the left", "on my left") is `ask`.
- `clearance:+`: it stays away from walls, furniture, things. `clearance:-`: it goes close to them.
- `shorter:+`: a short, direct way without detours. `shorter:-`: a longer way is wanted.
- `smoother:+`: gentle curves, no jerks, few turns. `smoother:-`: jerky, zigzag driving is wanted.
- `faster:+`: it hurries, arrives soon. `faster:-`: it is slow in general, takes its time, does not hurry. "You need not
  hurry" is `faster:-`, too (`none` where you find that it says nothing).
- `slower_near_person:+`: it slows down near me, when it passes me. `slower_near_person:-`: fast even there.

Of a comparison ("rather slow than close", "distance is more important than speed") label what is preferred only. What
is given up by it ("even if it takes longer") is not labelled. `ask`: it cannot be told without asking back: too vague
("be careful"), or it contradicts itself ("near but far"). `none`: nothing is said about how the robot drives, or
everything is all right.

Right: everything expected was understood and nothing else (`ask`: something is asked back). Asked: not all of it was,
but what was is right, and something is asked back. Missed: the same, and nothing is asked. Wrong direction: the
opposite of something expected was understood. Wrong otherwise: something that was not said was understood.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from desirepath.analysis.estimates import wilson
from desirepath.learning.words.lexicon import LANGUAGES, Language
from desirepath.learning.words.understanding import words_reader
from desirepath_experiments.benchmarks.labelled_wishes import KINDS, Case, judge, read_cases


def measure(cases: list[Case], language: Language) -> dict[str, list[Case]]:
    """Kind of outcome -> its sentences."""
    reader = words_reader(language)
    found: dict[str, list[Case]] = {kind: [] for kind in KINDS}
    for case in cases:
        found[judge(case, reader.understand(case.sentence))].append(case)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--language", choices=LANGUAGES, required=True)
    parser.add_argument("--all", action="store_true", help="also list what was asked back or missed")
    arguments = parser.parse_args()
    found = measure(read_cases(arguments.file), arguments.language)
    n = sum(map(len, found.values()))
    for kind, cases in found.items():
        interval = wilson(len(cases), n)
        print(f"{kind:16} {len(cases):4} of {n}  {interval.value:6.1%}  ({interval.low:.1%} to {interval.high:.1%})")
    for kind in KINDS[1 if arguments.all else 3 :]:
        for case in found[kind]:
            got = words_reader(arguments.language).understand(case.sentence)
            read = [_label(mark.objective, mark.wanted) + " waived" * mark.waived for mark in got.marks]
            expected = "ask" if case.wanted is None else "; ".join(_label(*one) for one in sorted(case.wanted))
            print(f"{kind}: {case.sentence!r} expected {expected or 'none'}, read as {', '.join(read) or 'nothing'}")


def _label(objective: str, wanted: bool) -> str:
    return f"{objective}:{'+' if wanted else '-'}"


if __name__ == "__main__":
    main()
