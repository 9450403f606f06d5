"""Which rooms import which, before and now, as one picture.

`python -m desirepath_experiments.import_picture OUT.svg BEFORE` draws the checkout in the folder BEFORE (packages
`backend` and `app`) beside this one. A row is a room with its lines of Python; imports downward are arcs on its right,
upward ones in red on its left, as wide as the root of how many pairs of files they are.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import grimp

from desirepath_experiments.reachability import source

# Top to bottom, as docs/architecture.md has them; the laboratory is above the product.
ROOMS = (
    *("experiments", "public face", "cli", "commands", "web", "api", "stage", "study", "jobs", "report", "store"),
    *("recordings", "demonstrations", "perception", "explain", "learning", "analysis", "simulation", "deploy"),
    *("grammar", "other files"),
)
WHOLE = {"app": "stage", "desirepath_stage": "stage", "desirepath_experiments": "experiments"}
FACE = {"", "__main__", "notebook", "gymnasium_envs"}
NOW, BEFORE = ("desirepath", "desirepath_stage", "desirepath_experiments"), ("backend", "app")
ROW, MIDDLE, PANEL = 26, 150, 560


def room_of(module: str) -> str:
    """The row of a module: its package, where that is a room itself, or the folder below it."""
    package, _, inside = module.partition(".")
    folder = inside.partition(".")[0]
    return WHOLE.get(package) or ("public face" if folder in FACE else folder if folder in ROOMS else "other files")


def edges_and_lines(packages: tuple[str, ...]) -> tuple[Counter[tuple[str, str]], Counter[str]]:
    """({(importing room, imported room): pairs of files}, {room: lines})."""
    graph = grimp.build_graph(*packages, include_external_packages=False, cache_dir=None)
    rooms = {module: room_of(module) for module in graph.modules}
    edges: Counter[tuple[str, str]] = Counter()
    lines: Counter[str] = Counter()
    for module, room in rooms.items():
        lines[room] += source(module).read_text(encoding="utf-8").count("\n")
        for other in graph.find_modules_directly_imported_by(module):
            edges[room, rooms[other]] += rooms[other] != room
    return +edges, lines


def panel(title: str, edges: Counter[tuple[str, str]], lines: Counter[str], x: int) -> list[str]:
    """One checkout's rooms and arcs, from x on."""
    rooms = [name for name in ROOMS if lines[name]]
    height = {name: 60 + ROW * row for row, name in enumerate(rooms)}
    up = {pair: count for pair, count in edges.items() if height[pair[0]] > height[pair[1]]}
    drawn = [f'<text x="{x + MIDDLE}" y="24" font-weight="bold">{title}</text>']
    drawn += [
        f'<text x="{x + MIDDLE}" y="42">{sum(edges.values())} imports between rooms, {sum(up.values())} upward; '
        f"{sum(lines.values()):,} lines</text>"
    ]
    for (a, b), count in sorted(edges.items(), key=lambda edge: edge[0] in up):
        y, end, upward = height[a], height[b], (a, b) in up
        at, reach = (x + MIDDLE - 6, -0.5) if upward else (x + MIDDLE + 190, 0.5)
        bend = round(at + reach * abs(end - y))
        red = ' stroke="#c22"' if upward else ""
        drawn.append(
            f'<path d="M{at} {y}C{bend} {y} {bend} {end} {at} {end}"{red} stroke-width="{count**0.5 / 2:.1f}"/>'
        )
    for name in rooms:
        drawn.append(f'<text x="{x + MIDDLE}" y="{height[name] + 4}">{name} {lines[name]:,}</text>')
    return drawn


def main() -> None:
    out, before = Path(sys.argv[1]), Path(sys.argv[2]).resolve()
    now = panel("Now", *edges_and_lines(NOW), PANEL)
    sys.path.insert(0, str(before))
    drawn = panel("Before the restructuring", *edges_and_lines(BEFORE), 0) + now
    size = f'viewBox="0 0 {2 * PANEL} {90 + ROW * len(ROOMS)}" font-family="sans-serif" font-size="13"'
    arcs = "\n".join(line for line in drawn if line.startswith("<path"))
    texts = "\n".join(line for line in drawn if line.startswith("<text"))
    out.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}><rect width="100%" height="100%" fill="#fff"/>\n'
        f'<g fill="none" stroke="#579" stroke-opacity=".5">{arcs}</g>\n{texts}\n</svg>\n',
        encoding="utf-8",
    )


if __name__ == "__main__":
    main()
