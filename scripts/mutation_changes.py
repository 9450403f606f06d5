"""The small changes that can be put into `backend/desirepath/analysis` and `backend/desirepath/report`, and those that once nothing noticed.
Which tests run against them is `mutation_tests.py`, the run and its count `mutation.py`.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("backend/desirepath/analysis", "backend/desirepath/report")
LEFT_OUT = ("__init__.py", "scale_wordings.py")  # of words there is nothing to change
EQUIVALENT = Path(__file__).with_name("mutation_equivalent.json")
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
        "backend/desirepath/report/choice_findings.py",
        "per_person[pair].append(np.mean(flips, axis=0))",
        "per_person[pair].extend(flips)",
    ),
    "correction of own against others taken away": (
        "backend/desirepath/report/own_findings.py",
        "corrected([declared for declared, _ in raw], plan.correction)",
        "[declared for declared, _ in raw]",
    ),
    "paused counted as completed": (
        "backend/desirepath/report/findings.py",
        "person.state == FINISHED",
        'person.state in (FINISHED, "paused")',
    ),
    "probes counted as answers": (
        "backend/desirepath/report/choice_findings.py",
        'regular = [one for one in own if one.role == "regular"]',
        "regular = own",
    ),
    "probes counted in agreement": (
        "backend/desirepath/report/findings.py",
        'regular = [one for one in own.choices if one.role == "regular"]',
        "regular = list(own.choices)",
    ),
    "first and second swapped": (
        "backend/desirepath/report/study_data.py",
        "return self.chosen == self.second",
        "return self.chosen == self.first",
    ),
    "rejected set to chosen": (
        "backend/desirepath/report/study_data.py",
        "return self.first if self.second_chosen else self.second",
        "return self.chosen",
    ),
    "the own policy always wins": (
        "backend/desirepath/report/own_findings.py",
        "counts[one.person][one.chosen] += 1",
        'counts[one.person]["own"] += 1',
    ),
    "preferred whichever side wins": (
        "backend/desirepath/report/own_findings.py",
        "return self.test.significant(alpha) and self.test.effect > 0",
        "return self.test.significant(alpha)",
    ),
    "it is personal whichever side wins": (
        "backend/desirepath/report/choice_text.py",
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


def changed_code(mutant: Mutant) -> tuple[CodeType, CodeType]:
    """The module's code as it is, and with the change."""
    path = ROOT / mutant.file
    source = path.read_text(encoding="utf-8")
    instead = source
    if mutant.change in NAMED:
        _, there, put = NAMED[mutant.change]
        instead = source.replace(there, put)
    tree = ast.fix_missing_locations(_Mutator(mutant.number).visit(ast.parse(instead)))
    return compile(source, str(path), "exec"), compile(tree, str(path), "exec")


def source_hash(file: str) -> str:
    """Of the file that is changed: what was tried of an older one tells nothing."""
    return hashlib.sha256((ROOT / file).read_bytes()).hexdigest()[:12]


def statement_lines(mutant: Mutant) -> range:
    """The lines of the statement that is changed, without the body that it may have."""
    tree = ast.parse((ROOT / mutant.file).read_text(encoding="utf-8"))
    around = [
        one
        for one in ast.walk(tree)
        if isinstance(one, ast.stmt) and one.lineno <= mutant.line <= (one.end_lineno or one.lineno)
    ]
    inner = min(around, key=lambda one: (one.end_lineno or one.lineno) - one.lineno)
    body = getattr(inner, "body", None)
    last = max(inner.lineno, body[0].lineno - 1) if body else inner.end_lineno or inner.lineno
    return range(inner.lineno, last + 1)


def equivalent(mutant: Mutant) -> str:
    """Why the change is none that could count, or nothing. Named by what stands in the line, not by its number."""
    line = (ROOT / mutant.file).read_text(encoding="utf-8").splitlines()[mutant.line - 1].strip()
    for one in json.loads(EQUIVALENT.read_text(encoding="utf-8")):
        if (one["file"], one["line"], one["change"]) == (mutant.file, line, mutant.change):
            return str(one["why"])
    return ""
