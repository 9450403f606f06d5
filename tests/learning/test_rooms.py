"""The rooms of learning: whoever opens one file can read it without another that needs the first."""

from __future__ import annotations

import grimp
import pytest


def circles(of: dict[str, set[str]]) -> list[list[str]]:
    """Modules that lead back to themselves, each circle once (strongly connected components, Tarjan)."""
    found, index, low, stack = [], {}, {}, []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for other in of[module]:
            if other not in index:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], index[other])
        if low[module] == index[module]:
            circle = [stack.pop()]
            while circle[-1] != module:
                circle.append(stack.pop())
            if len(circle) > 1:
                found.append(sorted(circle))

    for module in of:
        if module not in index:
            visit(module)
    return found


@pytest.mark.parametrize("room", ["desirepath.learning", "desirepath.jobs"])
def test_no_circle_of_imports(room: str) -> None:
    """Imports inside functions count, too: they only hide a circle."""
    graph = grimp.build_graph("desirepath", cache_dir=None)
    modules = {module for module in graph.modules if module.startswith(f"{room}.")}
    of = {module: graph.find_modules_directly_imported_by(module) & modules for module in modules}
    assert circles(of) == []


def test_a_circle_would_be_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
