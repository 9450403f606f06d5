"""Numba's cache on disk: a compiled function is compiled anew only when its own file changes, so it may use nothing of
another file of ours. Read from the source of every file, imported or not.
"""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
OURS = {"desirepath", "desirepath_stage"}
GEOMETRY = """
import numba
REACH = 2
compiled = numba.njit(cache=True)

@compiled
def twice(x):
    return 2 * x
"""


def our_modules(root: Path) -> dict[str, ast.Module]:
    """Those that import Numba, and those that name one of them."""
    texts = {
        file: file.read_text() for folder in ("backend", "app", "experiments") for file in (root / folder).rglob("*.py")
    }
    numba = {file for file, text in texts.items() if re.search(r"^\s*(import|from) numba\b", text, re.MULTILINE)}
    named = {file.parent.name if file.stem == "__init__" else file.stem for file in numba}
    found = {}
    for file, text in texts.items():
        if file in numba or any(name in text for name in named):
            parts = file.relative_to(root).with_suffix("").parts[1:]
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = ast.parse(text)
    return found


def imported_names(module: str, tree: ast.Module) -> dict[str, str]:
    """Names of one file -> what they stand for in another: `desirepath.a.b` or `desirepath.a.b.name`."""
    names = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.asname or "." not in alias.name:
                    names[alias.asname or alias.name] = alias.name
        elif isinstance(node, ast.ImportFrom):
            package = module.rsplit(".", node.level)[0] + "." if node.level else ""
            for alias in node.names:
                names[alias.asname or alias.name] = f"{package}{node.module or ''}.{alias.name}".replace("..", ".")
    return names


def spelled(node: ast.expr) -> str:
    """`numba.njit` of numba.njit, numba.njit(...), partial(numba.njit, ...): the name that decorates or calls."""
    return ast.unparse(node.func if isinstance(node, ast.Call) else node)


def is_numba(name: str, names: dict[str, str]) -> bool:
    first, _, rest = name.partition(".")
    whole = f"{names.get(first, first)}.{rest}".rstrip(".")
    return whole.startswith("numba.") and whole.split(".")[-1] in {"njit", "jit", "vectorize", "guvectorize"}


def compilers(modules: dict[str, ast.Module]) -> set[str]:
    """Our own functions and names that compile: whatever mentions numba.njit and is not itself compiled by it."""
    found = set()
    for module, tree in modules.items():
        names = imported_names(module, tree)
        if not any(name.split(".")[0] == "numba" for name in names.values()):
            continue
        for node in tree.body:
            body = node.body if isinstance(node, ast.FunctionDef) else [node]
            mentions = any(
                is_numba(ast.unparse(part), names)
                for statement in body
                for part in ast.walk(statement)
                if isinstance(part, ast.Attribute | ast.Name)
            )
            if mentions and isinstance(node, ast.FunctionDef) and not node.decorator_list:
                found.add(f"{module}.{node.name}")
            elif mentions and isinstance(node, ast.Assign):
                found.update(f"{module}.{target.id}" for target in node.targets if isinstance(target, ast.Name))
    return found


def compiled_functions(modules: dict[str, ast.Module]) -> list[tuple[str, ast.FunctionDef]]:
    ours = compilers(modules)
    found = []
    for module, tree in modules.items():
        names = imported_names(module, tree)
        for node in ast.walk(tree):
            if not isinstance(node, ast.FunctionDef):
                continue
            for decorator in node.decorator_list:
                name = spelled(decorator)
                first, _, rest = name.partition(".")
                known = {f"{names.get(first, f'{module}.{first}')}.{rest}".rstrip(".")}
                if is_numba(name, names) or known & ours:
                    found.append((module, node))
    return found


def used_from_elsewhere(modules: dict[str, ast.Module]) -> list[str]:
    """Everything of another of our files that a compiled function calls or reads; constants are frozen in likewise."""
    found = []
    for module, function in compiled_functions(modules):
        names = imported_names(module, modules[module])
        for statement in function.body:
            for node in ast.walk(statement):
                if isinstance(node, ast.Name) and names.get(node.id, "").split(".")[0] in OURS:
                    found.append(f"{module}.{function.name} uses {names[node.id]} (line {node.lineno})")
    return found


def test_no_compiled_function_uses_anything_of_another_file():
    modules = our_modules(ROOT)
    assert len(compiled_functions(modules)) > 40, "the search finds no compiled functions any more"
    assert used_from_elsewhere(modules) == []


@pytest.mark.parametrize(
    ("imports", "decorator", "body"),
    [
        ("import numba\nfrom desirepath import geometry as g", "@numba.njit(cache=True)", "return g.twice(x)"),
        ("from numba import njit\nfrom desirepath.geometry import twice", "@njit(cache=True)", "return twice(x)"),
        ("from desirepath import geometry as g", "@g.compiled", "return g.twice(x)"),
        ("from desirepath.geometry import compiled, twice as double", "@compiled", "return double(x)"),
        ("from desirepath import geometry as g", "@g.compiled", "return x + g.REACH"),
    ],
)
def test_the_search_finds_every_way_to_write_it(tmp_path, imports, decorator, body):
    package = tmp_path / "backend" / "desirepath"
    package.mkdir(parents=True)
    (package / "geometry.py").write_text(GEOMETRY)
    (package / "caller.py").write_text(f"{imports}\n\n{decorator}\ndef caller(x):\n    {body}\n")
    assert len(used_from_elsewhere(our_modules(tmp_path))) == 1


def test_a_cached_caller_of_another_file_keeps_the_old_code(tmp_path):
    """Why all this: it fails when Numba learns to look at the files of what is called, and the rule may go."""
    callee = "import numba\n\n@numba.njit(cache=True)\ndef number(x):\n    return {}\n"
    caller = (
        "import numba, callee\n\n@numba.njit(cache=True)\ndef ask(x):\n    return callee.number(x)\n\nprint(ask(1))\n"
    )
    (tmp_path / "caller.py").write_text(caller)
    said = []
    for answer in ("1", "22222"):  # of another length: the file's size is part of what Numba looks at
        (tmp_path / "callee.py").write_text(callee.format(answer))
        ran = subprocess.run(
            [sys.executable, "-c", "import caller"], cwd=tmp_path, capture_output=True, text=True, check=True
        )
        said.append(ran.stdout.strip())
    assert said == ["1", "1"]
