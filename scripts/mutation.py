"""Puts small changes into `backend/desirepath/analysis` and `backend/desirepath/report`, one at a time, and counts how many the tests notice.

A sample (or `--all`) of all changes that can be made: a comparison, a sign, a bound, a condition, a number. Each is
tried against all tests of both rooms that reach it, those first that take least. What survives is listed; a survivor
that `mutation_equivalent.json` names changes nothing that counts, for the reason given there, and is counted apart.
With `--out` a run that was stopped goes on where it was: what the file tells of a change to the same source is not
tried again.

    python scripts/mutation.py --sample 150 --seed 1 --out mutants.jsonl
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from mutation_changes import NAMED, ROOT, UNCHANGED, Mutant, equivalent, mutants, source_hash
from mutation_tests import NOT_DONE, Outcome, tried_imported, tried_warm


def already_tried(out: Path | None, *, survivors_again: bool) -> dict[tuple[str, int, str], bool]:
    """(source hash, number, change) -> whether it survived, from the lines of an earlier run; later lines win."""
    if out is None or not out.is_file():
        return {}
    lines = [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]
    tried = {(line["source"], line["number"], line["change"]): line["survives"] for line in lines if "source" in line}
    return {key: lives for key, lives in tried.items() if not (lives and survivors_again)}


def libraries() -> None:
    """Loads what takes seconds, once for all forks."""
    import matplotlib as mpl
    import numba
    import pandas
    import scipy.integrate
    import scipy.optimize
    import scipy.stats
    import sqlalchemy
    import statsmodels.formula.api
    import torch

    import desirepath.learning.policies.evaluate
    import desirepath.store.models

    mpl.use("agg")
    torch.set_num_threads(1)
    del numba, pandas, scipy, sqlalchemy, statsmodels, backend


def outcomes(todo: list[Mutant], *, slow: bool, limit_s: float, minutes: float) -> Iterator[Outcome]:
    """Of one change after the other, until the time is up: in forks of a process that has collected the tests, and
    those that are no change of a function with all imported anew."""
    begun = time.monotonic()
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read)

        def told(one: Outcome) -> bool:
            line = [todo.index(one.mutant), one.survives, one.by, one.seconds]
            os.write(write, (json.dumps(line) + "\n").encode())
            return time.monotonic() - begun < 60 * minutes

        try:
            tried_warm(todo, slow=slow, limit_s=limit_s, told=told)
            os._exit(0)
        finally:
            os._exit(1)
    os.close(write)
    elsewhere = list[Mutant]()
    with os.fdopen(read) as pipe:
        for line in pipe:
            k, survives, by, seconds = json.loads(line)
            if by == NOT_DONE:
                elsewhere.append(todo[k])
            else:
                yield Outcome(todo[k], survives, by, seconds)
    if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0:
        sys.exit("the tests fail as they are, or cannot be collected: nothing can be learned from changes")
    for one in elsewhere:
        if time.monotonic() - begun < 60 * minutes:
            yield tried_imported(one, slow=slow, limit_s=limit_s)


def chosen_of(asked: argparse.Namespace, every: list[Mutant]) -> list[Mutant]:
    """The changes that are asked for."""
    if not asked.named:
        return every if asked.all else random.Random(asked.seed).sample(every, min(asked.sample, len(every)))
    chosen = []
    for name, (file, there, _) in NAMED.items():
        before, *after = (ROOT / file).read_text(encoding="utf-8").split(there)
        if len(after) != 1:
            sys.exit(f"{name}: {there!r} does not stand in {file} once; say what the change is now")
        chosen.append(Mutant(file, UNCHANGED, before.count("\n") + 1, name))
    return chosen


def main() -> None:
    told = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    told.add_argument("--sample", type=int, default=150, help="how many changes, drawn by lot")
    told.add_argument("--all", action="store_true", help="every change; takes an hour or two")
    told.add_argument("--named", action="store_true", help="the changes that once nothing noticed, no others")
    told.add_argument("--seed", type=int, default=0)
    told.add_argument("--file", default="", help="only files whose path holds this")
    told.add_argument("--slow", action="store_true", help="with the tests that count over hundreds of studies")
    told.add_argument(
        "--limit-s", type=float, default=240.0, help="for the tests of one change, beside 20 times theirs"
    )
    told.add_argument("--minutes", type=float, default=1e9, help="stop after so long; what was tried counts")
    told.add_argument("--out", type=Path, help="a line of JSON for each change; what is there is not tried again")
    told.add_argument("--survivors-again", action="store_true", help="but what survived is: after new tests")
    told.add_argument("--json", type=Path, help="writes the count, its interval and what survived to this file")
    asked = told.parse_args()
    summary = asked.json.resolve() if asked.json else None
    out = asked.out.resolve() if asked.out else None
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    libraries()
    every = [one for one in mutants() if asked.file in one.file]
    chosen = chosen_of(asked, every)
    known = already_tried(out, survivors_again=asked.survivors_again)
    before = {one: known.get((source_hash(one.file), one.number, one.change)) for one in chosen}
    alive = [one for one, lives in before.items() if lives]
    tried = sum(lives is not None for lives in before.values())
    todo = [one for one, lives in before.items() if lives is None]
    for found in outcomes(todo, slow=asked.slow, limit_s=asked.limit_s, minutes=asked.minutes) if todo else ():
        one = found.mutant
        tried += 1
        alive += [one] * found.survives
        line = {"file": one.file, "line": one.line, "change": one.change, "number": one.number}
        line |= {"survives": found.survives, "source": source_hash(one.file), "by": found.by}
        if out:
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line | {"seconds": round(found.seconds, 1)}) + "\n")
        if asked.named and not found.survives:
            print(f"noticed: {one.file}: {one.change}: {found.by}", flush=True)
    same = {one: why for one in alive if (why := equivalent(one))}
    texts = {
        one: (ROOT / one.file).read_text(encoding="utf-8").splitlines()[max(0, one.line - 1)].strip() for one in alive
    }
    for one, text in texts.items():
        why = f"\n    changes nothing that counts: {same[one]}" if one in same else ""
        print(f"survives: {one.file}:{one.line}: {one.change}: {text}{why}")
    killed = tried - len(alive)
    print(f"seed {asked.seed}, commit {commit()}: ", end="")
    print(f"{killed} of {tried} noticed ({in_words(killed, tried)})", end="")
    if same:
        print(f"; without {len(same)} that change nothing that counts {in_words(killed, tried - len(same))}", end="")
    print(f"; {len(chosen) - tried} of those chosen are left; {len(every)} can be made")
    if summary:
        low, high = _wilson(killed, tried)
        survivors = [
            {"file": one.file, "line": text, "change": one.change, "changes_nothing_that_counts": same.get(one)}
            for one, text in texts.items()
        ]
        found = {"command": " ".join(["python", "scripts/mutation.py", *sys.argv[1:]]), "seed": asked.seed}
        found |= {"commit": commit(), "can_be_made": len(every), "tried": tried, "noticed": killed}
        found |= {"share": killed / max(1, tried), "low": low, "high": high, "survivors": survivors}
        summary.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def commit() -> str:
    """Of the working tree; `+` where it holds more than that."""
    git = ["git", "-C", str(ROOT)]
    head = subprocess.run([*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    changed = subprocess.run([*git, "status", "--porcelain"], capture_output=True, text=True, check=False)
    return head.stdout.strip() + "+" * bool(changed.stdout.strip())


def in_words(hits: int, n: int) -> str:
    """A share with Wilson's interval."""
    low, high = _wilson(hits, n)
    return f"{hits / max(1, n):.1%}, {low:.1%} to {high:.1%}"


def _wilson(hits: int, n: int) -> tuple[float, float]:
    if not n:
        return 0.0, 1.0
    z, share = 1.959964, hits / n
    centre, half = share + z * z / (2 * n), z * (share * (1 - share) / n + z * z / (4 * n * n)) ** 0.5
    return (centre - half) / (1 + z * z / n), (centre + half) / (1 + z * z / n)


if __name__ == "__main__":
    main()
