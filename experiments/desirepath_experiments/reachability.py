"""Which modules of the product no page, study, job, report, command or published name reaches.

Run `python -m desirepath_experiments.reachability`. An import counts; so does a module named in a string, as
Gymnasium's registrations name them, and one that a registry finds in its package. What only
the laboratory imports belongs into the laboratory.
"""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import grimp

PRODUCT = ("desirepath", "desirepath_stage")
# What people and programs enter by; every module below one of these is used.
ENTRANCES = (
    "desirepath.__main__",
    "desirepath.cli",
    "desirepath.web",
    "desirepath.jobs",
    "desirepath.report",
    "desirepath.store.migrations",
    "desirepath.gymnasium_envs",
    "desirepath_stage",
)
NAMED_IN_A_STRING = re.compile(r'"(desirepath(?:\.\w+)+)(?::\w+)?"')
REGISTRY = re.compile(r'Registry\(\s*(?:"[\w.]+"|\w+), "(desirepath(?:\.\w+)+)", "(\w+)"')


def source(module: str) -> Path:
    """The file of a module, without importing more of it than the packages above."""
    spec = importlib.util.find_spec(module)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(module)
    return Path(spec.origin)


def unreachable() -> tuple[dict[str, int], int]:
    """({module: lines} that nothing reaches, lines of the product)."""
    graph = grimp.build_graph(*PRODUCT, include_external_packages=False, cache_dir=None)
    texts = {module: source(module).read_text(encoding="utf-8") for module in graph.modules}
    under = tuple(f"{entrance}." for entrance in ENTRANCES)
    reached = {module for module in texts if f"{module}.".startswith(under) or module == "desirepath"}
    to_do = list(reached)
    while to_do:
        module = to_do.pop()
        named = {name for name in NAMED_IN_A_STRING.findall(texts[module]) if name in texts}
        for package, attribute in REGISTRY.findall(texts[module]):  # which are found by looking
            inside = (name for name in texts if name.rpartition(".")[0] == package)
            named |= {name for name in inside if re.search(rf"^{attribute}\b", texts[name], re.MULTILINE)}
        new = (graph.find_modules_directly_imported_by(module) | named) - reached
        reached |= new
        to_do += new
    packages = {module.rpartition(".")[0] for module in reached}
    lines = {module: len(text.splitlines()) for module, text in texts.items()}
    return {module: lines[module] for module in sorted(texts.keys() - reached - packages)}, sum(lines.values())


def main() -> None:
    left, lines = unreachable()
    print(f"{sum(left.values()):,} of {lines:,} lines of the product are reached by nothing of it")
    for module, count in left.items():
        print(f"{count:6,} {module}")


if __name__ == "__main__":
    main()
