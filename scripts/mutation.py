"""Puts small changes into `backend/analysis` and `backend/report`, one at a time, and counts how many the tests notice.

A sample (or `--all`) of all changes that can be made: a comparison, a sign, a bound, a condition, a number. Each runs
in a process of its own, forked from one in which the libraries are loaded: first the tests that bear the file's name,
then, if these notice nothing, all tests of both rooms. What survives is listed. With `--out` a run that was stopped
goes on where it was: what the file tells of a change to the same source is not tried again.

    python scripts/mutation.py --sample 150 --seed 1 --out mutants.jsonl
"""

from __future__ import annotations

import argparse
import ast
import copy
import hashlib
import importlib.abc
import importlib.util
import json
import os
import random
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("backend/analysis", "backend/report")
LEFT_OUT = ("__init__.py", "scale_wordings.py")  # of words there is nothing to change
FIRST: dict[str, list[str]] = {  # tests that are about a file though they do not bear its name
    "study_data.py": ["report/test_findings.py"],
    "study_design.py": ["report/test_designs.py"],
    "item_tests.py": ["report/test_designs.py", "report/test_findings.py"],
    "rating_findings.py": ["report/test_findings.py", "report/test_designs.py"],
    "choice_findings.py": ["report/test_findings.py", "report/test_designs.py"],
    "analysis_plan.py": ["report/test_findings.py"],
    "report_text.py": ["report/test_findings.py", "report/test_designs.py"],
    "rating_text.py": ["report/test_designs.py", "report/test_findings.py"],
    "choice_text.py": ["report/test_own_findings.py", "report/test_findings.py"],
    "report_cells.py": ["report/test_designs.py"],
    "further_text.py": ["report/test_further_findings.py"],
    "simulated_power.py": ["report/test_planned_design.py"],
    "triads.py": ["analysis/test_choices.py", "report/test_findings.py"],
    "equivalence.py": ["analysis/test_further.py"],
    "reliability.py": ["analysis/test_further.py"],
    "bradley_terry.py": ["analysis/test_further.py"],
    "scales.py": ["analysis/test_scales.py", "report/test_findings.py"],
}
ALONE = (
    "frechet.py",
    "metrics.py",
    "scales.py",
    "mixed_models.py",
    "report_figures.py",
)  # no other test would look at these closer
SLOW = ("tests/report/test_made_up_cohorts.py",)  # counts over hundreds of studies; `--slow` runs it, too
COMPARED = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
COMPUTED = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Pow: ast.Mult,
    ast.Mod: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
UNCHANGED = -1  # number of the change that is none
NAMED: dict[str, tuple[str, str, str]] = {  # changes that once nothing noticed: file, what stands there, instead
    "flips pooled over people": (
        "backend/report/choice_findings.py",
        "per_person[pair].append(np.mean(flips, axis=0))",
        "per_person[pair].extend(flips)",
    ),
    "correction of own against others taken away": (
        "backend/report/own_findings.py",
        "corrected([declared for declared, _ in raw], plan.correction)",
        "[declared for declared, _ in raw]",
    ),
    "paused counted as completed": (
        "backend/report/findings.py",
        "person.state == FINISHED",
        'person.state in (FINISHED, "paused")',
    ),
    "probes counted as answers": (
        "backend/report/choice_findings.py",
        'regular = [one for one in own if one.role == "regular"]',
        "regular = own",
    ),
    "probes counted in agreement": (
        "backend/report/findings.py",
        'regular = [one for one in own.choices if one.role == "regular"]',
        "regular = list(own.choices)",
    ),
    "first and second swapped": (
        "backend/report/study_data.py",
        "return self.chosen == self.second",
        "return self.chosen == self.first",
    ),
    "rejected set to chosen": (
        "backend/report/study_data.py",
        "return self.first if self.second_chosen else self.second",
        "return self.chosen",
    ),
    "the own policy always wins": (
        "backend/report/own_findings.py",
        "counts[one.person][one.chosen] += 1",
        'counts[one.person]["own"] += 1',
    ),
    "preferred whichever side wins": (
        "backend/report/own_findings.py",
        "return self.test.significant(alpha) and self.test.effect > 0",
        "return self.test.significant(alpha)",
    ),
    "it is personal whichever side wins": (
        "backend/report/choice_text.py",
        "    if other.preferred(alpha):\n",
        "    if other.test.significant(alpha):\n",
    ),
}
CALLED = {"min": "max", "max": "min", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutant:
    """The `number`-th change that can be made to a file."""

    file: str
    number: int
    line: int
    change: str


class _Mutator(ast.NodeTransformer):
    """Counts the changes that can be made, and makes the one whose number is `wanted`."""

    def __init__(self, wanted: int | None = None) -> None:
        self.wanted, self.found = wanted, list[tuple[int, str]]()

    def _here(self, node: ast.AST, change: str) -> bool:
        self.found.append((getattr(node, "lineno", 0), change))
        return len(self.found) - 1 == self.wanted

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        for k, operator in enumerate(node.ops):
            new = COMPARED[type(operator)]
            if self._here(node, f"{type(operator).__name__} -> {new.__name__}"):
                node.ops[k] = new()
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        new = COMPUTED.get(type(node.op))
        words = isinstance(node.left, ast.JoinedStr) or isinstance(node.right, ast.JoinedStr)
        if new and not words and self._here(node, f"{type(node.op).__name__} -> {new.__name__}"):
            node.op = new()
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        if self._here(node, "and <-> or"):
            node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, ast.Not | ast.USub) and self._here(node, f"{type(node.op).__name__} taken away"):
            return node.operand
        return node

    def visit_If(self, node: ast.If) -> ast.AST:
        self.generic_visit(node)
        if self._here(node, "condition turned round"):
            node.test = ast.UnaryOp(ast.Not(), node.test)
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        self.generic_visit(node)
        if self._here(node, "condition turned round"):
            node.test = ast.UnaryOp(ast.Not(), node.test)
        return node

    def visit_comprehension(self, node: ast.comprehension) -> ast.AST:
        self.generic_visit(node)
        for k, _ in enumerate(node.ifs):
            if self._here(node.target, "filter taken away"):
                node.ifs[k] = ast.Constant(True)
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.func, ast.Name) and node.func.id in CALLED:
            new = CALLED[node.func.id]
            if self._here(node, f"{node.func.id} -> {new}"):
                node.func = ast.Name(new, ast.Load())
        return node

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        if isinstance(node.value, bool):
            if self._here(node, f"{node.value} -> {not node.value}"):
                return ast.copy_location(ast.Constant(not node.value), node)
        elif isinstance(node.value, int | float) and self._here(node, f"{node.value} -> {node.value + 1}"):
            return ast.copy_location(ast.Constant(node.value + 1), node)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        """Bodies and defaults; annotations and decorators are left alone."""
        node.body = [self.visit(statement) for statement in node.body]
        node.args.defaults = [self.visit(one) for one in node.args.defaults]
        node.args.kw_defaults = [self.visit(one) if one is not None else None for one in node.args.kw_defaults]
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        return node  # what an error says is words

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        node.body = [self.visit(statement) for statement in node.body]
        return node


def mutants() -> Iterator[Mutant]:
    """Every change that can be made to both rooms."""
    for room in ROOMS:
        for path in sorted((ROOT / room).glob("*.py")):
            if path.name in LEFT_OUT:
                continue
            mutator = _Mutator()
            mutator.visit(ast.parse(path.read_text(encoding="utf-8")))
            name = path.relative_to(ROOT).as_posix()
            yield from (Mutant(name, k, line, change) for k, (line, change) in enumerate(mutator.found))


class _Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports the mutated module in place of the one on disk."""

    def __init__(self, mutant: Mutant) -> None:
        self.name = mutant.file.removesuffix(".py").replace("/", ".")
        self.path = ROOT / mutant.file
        source = self.path.read_text(encoding="utf-8")
        if mutant.change in NAMED:
            _, there, instead = NAMED[mutant.change]
            source = source.replace(there, instead)
        tree = copy.deepcopy(ast.parse(source))
        changed = ast.fix_missing_locations(_Mutator(mutant.number).visit(tree))
        self.code = compile(changed, str(self.path), "exec")

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> object:
        if fullname != self.name:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=str(self.path))

    def create_module(self, spec: object) -> None:
        return None

    def exec_module(self, module: object) -> None:
        module.__file__ = str(self.path)  # type: ignore[attr-defined]
        exec(self.code, module.__dict__)  # noqa: S102


def tests_for(mutant: Mutant, *, slow: bool) -> list[list[str]]:
    """The tests to run one after the other: those of the file, then all of both rooms."""
    name = Path(mutant.file).name
    room = mutant.file.split("/")[1]
    own = [f"tests/{room}/test_{name}", *(f"tests/{one}" for one in FIRST.get(name, []))]
    nearest = [one for one in own if (ROOT / one).is_file()]
    every = sorted(
        p.relative_to(ROOT).as_posix() for r in ("analysis", "report") for p in (ROOT / "tests" / r).glob("test_*.py")
    )
    rest = [one for one in every if one not in nearest and (slow or one not in SLOW)]
    if room == "report":  # no test of analysis imports a report
        rest = sorted((one for one in rest if one.startswith("tests/report")), key=lambda one: "known" not in one)
    if name in ALONE:
        return [nearest]
    return [nearest, rest] if nearest else [rest]


def survives(mutant: Mutant, *, slow: bool, limit_s: float) -> bool:
    """Whether no test notices the change. Tests that take longer than the limit have noticed."""
    for files in tests_for(mutant, slow=slow):
        child = os.fork()
        if child == 0:
            _run(mutant, files)
        begun = time.monotonic()
        while True:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                break
            if time.monotonic() - begun > limit_s:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
                return False
            time.sleep(0.05)
        if os.waitstatus_to_exitcode(status) != 0:
            return False
    return True


def _run(mutant: Mutant, files: list[str]) -> None:
    """In the child: tests with the change; never returns."""
    import numba
    import pytest

    numba.config.DISABLE_JIT = True  # of what is imported from now on: compiled code lies in a cache, unchanged
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    code = 1
    try:
        for name in [
            n for n in sys.modules if n.startswith(("backend.analysis", "backend.report", "backend.experiments"))
        ]:
            del sys.modules[name]
        sys.meta_path.insert(0, _Changed(mutant))
        code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-p", "no:timeout", "-W", "ignore", *files]))
    finally:
        os._exit(code)


def source_hash(file: str) -> str:
    """Of the file that is changed: what was tried of an older one tells nothing."""
    return hashlib.sha256((ROOT / file).read_bytes()).hexdigest()[:12]


def already_tried(out: Path | None, *, survivors_again: bool) -> dict[tuple[str, int, str], bool]:
    """(source hash, number, change) -> whether it survived, from the lines of an earlier run; later lines win."""
    if out is None or not out.is_file():
        return {}
    lines = [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]
    tried = {(line["source"], line["number"], line["change"]): line["survives"] for line in lines if "source" in line}
    return {key: lives for key, lives in tried.items() if not (lives and survivors_again)}


def main() -> None:
    told = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    told.add_argument("--sample", type=int, default=150, help="how many changes, drawn by lot")
    told.add_argument("--all", action="store_true", help="every change; takes hours")
    told.add_argument("--named", action="store_true", help="the changes that once nothing noticed, no others")
    told.add_argument("--seed", type=int, default=0)
    told.add_argument("--file", default="", help="only files whose path holds this")
    told.add_argument("--slow", action="store_true", help="with the tests that count over hundreds of studies")
    told.add_argument("--limit-s", type=float, default=240.0, help="for the tests of one change")
    told.add_argument("--minutes", type=float, default=1e9, help="stop after so long; what was tried counts")
    told.add_argument("--out", type=Path, help="a line of JSON for each change; what is there is not tried again")
    told.add_argument("--survivors-again", action="store_true", help="but what survived is: after new tests")
    asked = told.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    import matplotlib as mpl
    import numba
    import pandas
    import scipy.integrate
    import scipy.optimize
    import scipy.stats
    import sqlalchemy
    import statsmodels.formula.api
    import torch

    import backend.learning.policies.evaluate
    import backend.store.models

    mpl.use("agg")
    torch.set_num_threads(1)
    del numba, pandas, scipy, sqlalchemy, statsmodels, backend
    every = [one for one in mutants() if asked.file in one.file]
    chosen = every if asked.all else random.Random(asked.seed).sample(every, min(asked.sample, len(every)))
    for file in (
        sorted({one.file for one in chosen})
        if asked.file
        else ("backend/analysis/tested.py", "backend/report/findings.py")
    ):
        if not survives(Mutant(file, UNCHANGED, 0, "none"), slow=asked.slow, limit_s=asked.limit_s):
            sys.exit(f"the tests fail with {file} as it is: nothing can be learned from changes")
    if asked.named:
        chosen = [Mutant(file, UNCHANGED, 0, name) for name, (file, _, _) in NAMED.items()]
        for name, (file, there, _) in NAMED.items():
            if (ROOT / file).read_text(encoding="utf-8").count(there) != 1:
                sys.exit(f"{name}: {there!r} does not stand in {file} once; say what the change is now")
    begun, tried, alive = time.monotonic(), 0, list[Mutant]()
    known = already_tried(asked.out, survivors_again=asked.survivors_again)
    for one in chosen:
        source = source_hash(one.file)
        lives = known.get((source, one.number, one.change))
        if lives is None and time.monotonic() - begun > 60 * asked.minutes:
            continue
        before = lives is not None
        if lives is None:
            lives = survives(one, slow=asked.slow, limit_s=asked.limit_s)
        tried += 1
        alive += [one] * lives
        line = {"file": one.file, "line": one.line, "change": one.change, "number": one.number, "survives": lives}
        line["source"] = source
        if asked.out and not before:
            with asked.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        if lives or asked.named:
            print(f"{'survives' if lives else 'noticed'}: {one.file}:{one.line}: {one.change}", flush=True)
    killed = tried - len(alive)
    low, high = _wilson(killed, tried)
    print(f"{killed} of {tried} noticed ({killed / max(1, tried):.1%}, {low:.1%} to {high:.1%})", end="")
    print(f"; {len(chosen) - tried} of those chosen are left; {len(every)} can be made")


def _wilson(hits: int, n: int) -> tuple[float, float]:
    if not n:
        return 0.0, 1.0
    z, share = 1.959964, hits / n
    centre, half = share + z * z / (2 * n), z * (share * (1 - share) / n + z * z / (4 * n * n)) ** 0.5
    return (centre - half) / (1 + z * z / n), (centre + half) / (1 + z * z / n)


if __name__ == "__main__":
    main()
