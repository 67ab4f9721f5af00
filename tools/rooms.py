"""Measure the structure of `crosscheck`: rooms, floors, imports between rooms, circles, files that name a type.

    python tools/rooms.py [FOLDER]        FOLDER: a checkout; default: the one this file is in
    python tools/rooms.py --picture FILE  writes the picture in CONTRIBUTING.md, as SVG

A room is a folder of the package, or a module beside the folders; `lieeuler` is one room. Imports inside functions and
for type checkers count like any other. The floor of a room is the longest chain of imports below it.
`tests/test_rooms.py` holds the package to `MAY_IMPORT`.
"""

from __future__ import annotations

import ast
import functools
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

BASE = {"errors", "files"}
DATA = BASE | {"jobs", "scene", "document"}
RUNS = DATA | {"references", "adapters", "running"}
JUDGED = RUNS | {"compare", "judge"}
REPORTED = JUDGED | {"verification", "report"}

MAY_IMPORT: dict[str, set[str]] = {
    "errors": set(),
    "files": set(),
    "jobs": BASE,
    "scene": BASE | {"jobs"},  # model files are read in a worker
    "document": {"errors"},
    "references": BASE | {"scene"},
    "adapters": BASE | {"scene", "jobs", "document", "lieeuler"},
    "running": DATA | {"references", "adapters"},
    "compare": {"errors", "scene", "document"},
    "judge": BASE | {"scene", "document", "references", "compare"},
    "inspection": RUNS | {"compare"},
    "jointspace": RUNS | {"inspection"},
    "diagnosis": JUDGED | {"verification"},  # accuses nothing that the verdict accepts
    "testing": JUDGED | {"verification"},
    "verification": JUDGED | {"report"},
    "recordings": REPORTED | {"diagnosis"},
    "report": BASE | {"document"},
    "studies": REPORTED,
    "history": REPORTED,
    "sweeps": REPORTED,
    "cli": REPORTED | {"inspection", "jointspace", "diagnosis", "testing", "studies", "history", "sweeps",
                       "recordings"},
    "__main__": {"cli"},
    "lieeuler": set(),
}
"""What each room may import, bottom up. The package itself (`__init__`) names public functions by text only; its stub
says the same to type checkers and is not read here."""

Edges = dict[str, set[str]]

TYPES = {
    "joint": {"spherical", "universal", "revolute", "cylindrical", "prismatic", "planar", "fixed", "distance",
              "point_on_line", "point_on_plane", "knife_edge", "rolling_disk", "rolling_sphere"},
    "force": {"linear_spring", "torsional_spring", "constant_force", "constant_torque", "joint_torque", "joint_force"}}
"""What scene files call joints and forces. A file that names one may have to change for one more."""


def modules(root: Path) -> dict[str, Path]:
    """Modules of both packages by their dotted names, the compiled one by its bindings."""
    found = {}
    for package in ("crosscheck", "lieeuler"):
        for file in sorted((root / package).rglob("*.py")):
            parts = file.relative_to(root).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found | {"lieeuler._kernel": root / "lieeuler" / "_core" / "python" / "bind.cpp"}


def imports(known: Mapping[str, Path]) -> Edges:
    """For each module the modules of both packages it imports, wherever in the file."""
    edges: Edges = {}
    for name, file in known.items():
        targets = set()
        for module, parts in _named(file.read_text(encoding="utf-8")) if file.suffix == ".py" else ():
            targets |= {f"{module}.{part}" if f"{module}.{part}" in known else module for part in parts}
        edges[name] = {target for target in targets if target in known} - {name}
    return edges


@functools.cache
def _named(text: str) -> list[tuple[str, list[str]]]:
    """What a file imports: modules, each with what is imported from it."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found += [(alias.name, [""]) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.append((node.module, [alias.name for alias in node.names]))
    return found


def room(module: str) -> str:
    """The room of a module; the package `crosscheck` itself is "__init__"."""
    package, _, rest = module.partition(".")
    return "lieeuler" if package == "lieeuler" else rest.partition(".")[0] or "__init__"


def between(edges: Edges) -> Edges:
    """Imports between rooms."""
    rooms: Edges = {}
    for module, targets in edges.items():
        rooms.setdefault(room(module), set()).update({room(target) for target in targets} - {room(module)})
    return rooms


def circles(edges: Edges) -> list[list[str]]:
    """Sets of nodes that import each other, each sorted (strongly connected components of more than one node)."""
    below = {node: reachable(edges, node) for node in edges}
    groups = {frozenset({node, *(other for other in below[node] if node in below.get(other, ()))}) for node in edges}
    return sorted(sorted(group) for group in groups if len(group) > 1)


def reachable(edges: Edges, start: str) -> set[str]:
    """All that `start` imports, directly or not."""
    seen: set[str] = set()
    ready = [start]
    while ready:
        new = edges.get(ready.pop(), set()) - seen
        seen |= new
        ready += new
    return seen


def floors(edges: Edges) -> dict[str, int]:
    """The floor of each room, from 1; rooms of a circle share none, so a circle raises ValueError."""
    if circles(edges):
        raise ValueError("rooms in a circle have no floor")
    known: dict[str, int] = {}

    def floor(node: str) -> int:
        if node not in known:
            known[node] = 1 + max((floor(target) for target in edges.get(node, ())), default=0)
        return known[node]

    return {node: floor(node) for node in edges}


def violations(edges: Edges) -> list[str]:
    """Imports that `MAY_IMPORT` does not allow, and rooms it does not know."""
    found = []
    for module, targets in sorted(edges.items()):
        for target in sorted(targets):
            here, there = room(module), room(target)
            if here == there or here == "__init__":
                continue
            if here not in MAY_IMPORT:
                found.append(f"{module}: the room {here!r} is not in MAY_IMPORT")
            elif there not in MAY_IMPORT[here] and there != "__init__":
                found.append(f"{module} imports {target}: {here} may not import {there}")
    return found


def naming(known: Mapping[str, Path], words: set[str]) -> list[str]:
    """The modules of crosscheck with a text constant that is one of these words."""
    return [name for name, file in known.items() if name.startswith("crosscheck.") and any(
        isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in words
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))))]


def report(root: Path) -> Iterable[str]:
    """Lines of the summary."""
    known = modules(root)
    edges = imports(known)
    rooms = between(edges)
    loops = circles(rooms)
    yield f"rooms {len(rooms)}"
    yield f"floors {'none: circles' if loops else max(floors(rooms).values())}"
    yield f"imports between rooms {sum(map(len, rooms.values()))}"
    for loop in loops:
        yield f"circle between rooms: {', '.join(loop)}"
    inside = circles(edges)
    for loop in inside:
        yield f"circle between modules: {', '.join(loop)}"
    yield f"circles between rooms {len(loops)}, between modules {len(inside)}"
    broken = violations(edges)
    yield from broken
    yield f"imports against the rule {len(broken)}"
    for kind, words in TYPES.items():
        yield f"files that name a {kind} type {len(naming(known, words))}"


WIDTH, HEIGHT, ACROSS, UP = 118, 28, 132, 64
"""Size of a room in the picture, and the distances of neighbours in a floor and of floors, px."""


def reduced(edges: Edges) -> Edges:
    """The edges that no longer path implies: A to C is left out where A leads to B and B to C."""
    return {node: {target for target in targets
                   if not any(target in reachable(edges, other) for other in targets - {target})}
            for node, targets in edges.items()}


def picture(root: Path) -> str:
    """The rooms by floors as SVG, with the imports that no other import implies."""
    outside = ("__init__", "__main__")
    rooms = {name: targets for name, targets in between(imports(modules(root))).items() if name not in outside}
    storeys: dict[int, list[str]] = {}
    for name, floor in floors(rooms).items():
        storeys.setdefault(floor, []).append(name)
    across = max(map(len, storeys.values()))
    place = {}
    for floor, names in storeys.items():
        for k, name in enumerate(sorted(names)):
            place[name] = (ACROSS * (k + 0.5 + (across - len(names)) / 2), UP * (max(storeys) - floor) + HEIGHT)
    body = [f'<path d="M{place[name][0]:g} {place[name][1] + HEIGHT / 2:g}L{place[target][0]:g} '
            f'{place[target][1] - HEIGHT / 2 - 4:g}" class="a" marker-end="url(#m)"/>'
            for name, targets in sorted(reduced(rooms).items()) for target in sorted(targets)]
    for name, (x, y) in sorted(place.items()):
        body.append(f'<rect x="{x - WIDTH / 2:g}" y="{y - HEIGHT / 2:g}" width="{WIDTH}" height="{HEIGHT}" rx="5"/>'
                    f'<text x="{x:g}" y="{y + 4:g}">{name}</text>')
    size = f"{across * ACROSS} {UP * (max(storeys) - 1) + 2 * HEIGHT}"
    return "\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" role="img" font-family="sans-serif">',
        "<title>The rooms of the packages. An arrow leads from a room to one that it imports.</title>",
        "<style>rect{fill:#fff;stroke:#456}text{text-anchor:middle;font-size:13px}.a{stroke:#9ab;fill:none}</style>",
        '<defs><marker id="m" markerWidth="7" markerHeight="7" refX="5" refY="3" orient="auto">'
        '<path d="M0 0L6 3L0 6z" fill="#9ab"/></marker></defs>',
        '<rect width="100%" height="100%" style="stroke:none"/>', *body, "</svg>", ""])


if __name__ == "__main__":
    here = Path(__file__).parents[1]
    if sys.argv[1:2] == ["--picture"]:
        Path(sys.argv[2]).write_text(picture(here), encoding="utf-8")
    else:
        print(*report(Path(sys.argv[1]) if len(sys.argv) > 1 else here), sep="\n")
