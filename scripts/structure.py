"""How the house is built, in figures: modules at the root, rooms, arrows, floors, circles, the longest import chain.

A room is a folder of station/ (or a file directly in it), and each of shared/, robot/ and benchmarks/. An arrow A -> B:
some module of A imports one of B, at its top or inside a function, for types only or not. A floor: a room stands above
all that it imports. `python scripts/structure.py [PACKAGE]`: with a package such as station.places its parts are the
rooms.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from functools import cache
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[1]
PACKAGES = ("shared", "robot", "station", "benchmarks")
Graph = dict[str, set[str]]


def import_graph() -> Graph:
    """Module -> modules of ours that it imports."""
    sys.path.insert(0, str(ROOT))
    graph = grimp.build_graph(*PACKAGES, cache_dir=None, include_external_packages=False)
    return {module: set(graph.find_modules_directly_imported_by(module)) for module in graph.modules}


def room_of(module: str, inside: str) -> str:
    """The room that a module lies in; empty for one that lies in none of them."""
    parts = module.split(".")
    if not inside:
        return ".".join(parts[:2]) if parts[0] == "station" and len(parts) > 1 else parts[0]
    depth = inside.count(".") + 1
    if not module.startswith(inside + "."):
        return ""
    return ".".join(parts[: depth + 1])


def arrows_between(graph: Graph, inside: str) -> Graph:
    """Room -> rooms that it imports."""
    arrows: Graph = defaultdict(set)
    for module, imported in graph.items():
        room = room_of(module, inside)
        if room and room != inside:
            arrows[room] |= {
                other for name in imported if (other := room_of(name, inside)) and other not in (room, inside)
            }
    return arrows


def circles(arrows: Graph) -> list[set[str]]:
    """Groups of rooms that reach each other."""
    reach = {room: _reached(arrows, room) for room in arrows}
    found: list[set[str]] = []
    for room in arrows:
        circle = {other for other in reach[room] if room in reach.get(other, set())} | ({room} & reach[room])
        if circle and circle not in found:
            found.append(circle)
    return found


def _reached(arrows: Graph, start: str) -> set[str]:
    seen: set[str] = set()
    waiting = list(arrows.get(start, ()))
    while waiting:
        if (room := waiting.pop()) not in seen:
            seen.add(room)
            waiting += arrows.get(room, ())
    return seen


def longest_chain(graph: Graph) -> list[str]:
    """The longest path of imports, top first. Raises RecursionError where modules import each other in a circle."""

    @cache
    def below(module: str) -> tuple[str, ...]:
        return (module, *max((below(other) for other in graph.get(module, ())), key=len, default=()))

    return list(max((below(module) for module in sorted(graph)), key=len))


def main(inside: str) -> None:
    graph = import_graph()
    arrows = arrows_between(graph, inside)
    found = circles(arrows)
    print(f"modules directly in station/: {len(list((ROOT / 'station').glob('*.py'))) - 1}")
    print(f"rooms: {len(arrows)}, arrows: {sum(map(len, arrows.values()))}, circles of rooms: {len(found)}")
    for circle in found:
        print("  circle:", ", ".join(sorted(circle)))
        for room in sorted(circle):
            ties = [
                f"{a} -> {b}"
                for a in graph
                for b in graph[a]
                if room_of(a, inside) == room and room_of(b, inside) in circle - {room}
            ]
            for tie in sorted(ties)[:12]:
                print("    ", tie)
    if not found:
        floors = longest_chain(arrows)
        print(f"floors: {len(floors)}: {' > '.join(floors)}")
    of_station = {
        m: {o for o in others if not o.startswith("benchmarks")}
        for m, others in graph.items()
        if not m.startswith("benchmarks")
    }
    module_circles = circles(of_station)
    print(f"circles of modules: {len(module_circles)}", *(", ".join(sorted(c)) for c in module_circles), sep="\n  ")
    if not module_circles:
        chain = longest_chain(of_station)
        print(f"longest import chain: {len(chain)}: {' > '.join(chain)}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "")
