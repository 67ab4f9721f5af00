"""Guide figures of the house: how much of it there is, and how often it does the same thing. Read from the code.

    python tools/figures.py [--against REVISION]

Nothing of the checkout is imported. Lines are those of the files, blank ones and comments included. With `--against`
the same figures of another revision stand beside them.
"""

from __future__ import annotations

import argparse
import ast
import io
import subprocess
import sys
import tarfile
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tools.rooms import imports, modules

JOINTS = {"spherical", "universal", "revolute", "cylindrical", "prismatic", "planar", "fixed", "distance",
          "point_on_line", "point_on_plane", "knife_edge", "rolling_disk", "rolling_sphere"}
FORCES = {"linear_spring", "torsional_spring", "constant_force", "constant_torque", "joint_torque", "joint_force"}
ENGINES = {"mujoco", "pinocchio", "exudyn", "drake", "dart", "mjx", "newton", "pybullet", "sapien", "warp"}
SMALL = {0, 1, 2, -1, 0.5, 3}
"""Numbers that need no reason: dimensions, halves, the step of a range."""
SHAPING = {"reshape", "split", "range", "zeros", "ones", "eye", "clip"}
"""Calls whose numbers count components."""
SIMPLE = (ast.Assign, ast.AnnAssign, ast.AugAssign, ast.Return, ast.Expr)


class House:
    """The files of a checkout, parsed."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.texts = {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8")
                      for folder in ("crosscheck", "lieeuler", "tests")
                      for path in sorted((root / folder).rglob("*.py"))}
        self.parsed = {name: ast.parse(text) for name, text in self.texts.items()}

    def nodes(self, under: str) -> Iterator[tuple[str, ast.AST]]:
        """(file, node) of all that is below a folder."""
        for name, tree in self.parsed.items():
            if name.startswith(under):
                for node in ast.walk(tree):
                    yield name, node

    def lines(self, under: str, *endings: str) -> int:
        """Lines of the files with these endings below a folder."""
        return sum(len(path.read_bytes().splitlines()) for path in (self.root / under).rglob("*")
                   if path.suffix in endings)

    def count(self, under: str, counts: Callable[[ast.AST], bool]) -> int:
        """Number of nodes for which `counts` is true."""
        return sum(counts(node) for _, node in self.nodes(under))

    def naming(self, words: set[str], without: str = " ") -> int:
        """Number of files of crosscheck with a text constant that is one of these words."""
        return len({name for name, node in self.nodes("crosscheck/") if isinstance(node, ast.Constant)
                    and isinstance(node.value, str) and node.value in words and not name.startswith(without)})


def catches_all(node: ast.AST) -> bool:
    """Whether it is a handler of every error."""
    if not isinstance(node, ast.ExceptHandler):
        return False
    kinds = node.type.elts if isinstance(node.type, ast.Tuple) else [node.type]
    return any(kind is None or getattr(kind, "id", "") in ("Exception", "BaseException") for kind in kinds)


def runs_an_engine(node: ast.AST) -> bool:
    """Whether it calls `run` of an adapter: a method with a scene and a request."""
    return (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "run"
            and len(node.args) == 2 and "spec" in ast.unparse(node.args[1]).lower())


def holds_a_way(node: ast.AST) -> bool:
    """Whether it is a record with a method beside an engine or a step."""
    if not isinstance(node, ast.ClassDef):
        return False
    fields = {each.target.id for each in node.body if isinstance(each, ast.AnnAssign)
              and isinstance(each.target, ast.Name)}
    return "method" in fields and bool(fields & {"engine", "step"})


def is_a_number(node: ast.AST) -> bool:
    """Whether it is a number that needs a reason."""
    return (isinstance(node, ast.Constant) and isinstance(node.value, int | float)
            and not isinstance(node.value, bool) and node.value not in SMALL)


def reasoned(text: str, tree: ast.Module) -> Iterator[ast.AST]:
    """What has its reason beside it: the string below an assignment, the comment above a statement or in its line."""
    lines = text.splitlines()
    for each, following in zip(tree.body, tree.body[1:], strict=False):
        told = isinstance(following, ast.Expr) and isinstance(getattr(following.value, "value", None), str)
        if isinstance(each, ast.Assign | ast.AnnAssign) and told:
            yield from ast.walk(each)
    for node in ast.walk(tree):
        if isinstance(node, SIMPLE) and lines[node.lineno - 2].lstrip().startswith("#"):
            yield from ast.walk(node)
        elif isinstance(node, ast.Constant) and "  # " in lines[node.lineno - 1]:
            yield node


def says_a_shape(node: ast.AST) -> Iterator[ast.AST]:
    """Numbers of this node that count components, places or hundredths, or are a power of ten or two."""
    if isinstance(node, ast.Subscript):
        yield from ast.walk(node.slice)
    elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in SHAPING:
        yield from (inner for each in node.args for inner in ast.walk(each))
    elif isinstance(node, ast.Compare) and ".shape" in ast.unparse(node.left):
        yield from ast.walk(node)
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        yield from (node.left, *ast.walk(node.right))
    elif isinstance(node, ast.FormattedValue):
        yield from ast.walk(node)


def unreasoned(house: House) -> int:
    """Numbers of the judge that are neither shapes nor named with their reason beside."""
    count = 0
    for name, tree in house.parsed.items():
        if name.startswith("crosscheck/judge/"):
            known = {id(each) for each in reasoned(house.texts[name], tree)} | {
                id(each) for node in ast.walk(tree) for each in says_a_shape(node)}
            count += sum(is_a_number(node) and id(node) not in known for node in ast.walk(tree))
    return count


def inner_imports(house: House) -> int:
    """Imports of own modules inside functions, each once."""
    found = set()
    for name, node in house.nodes("crosscheck/"):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            found |= {(name, each.lineno) for each in ast.walk(node) if isinstance(each, ast.ImportFrom)
                      and (each.module or "").partition(".")[0] in ("crosscheck", "lieeuler")}
    return len(found)


def figures(root: Path) -> dict[str, int]:
    """All figures of a checkout."""
    house, edges = House(root), imports(modules(root))
    importers = Counter(target for targets in edges.values() for target in targets)
    own = [name for name in edges if name.startswith("crosscheck.")]
    crosscheck = "crosscheck/"
    return {
        "lines of crosscheck": house.lines("crosscheck", ".py"),
        "lines of lieeuler's Python": house.lines("lieeuler", ".py"),
        "lines of C++": house.lines("lieeuler", ".hpp", ".cpp", ".h"),
        "lines of tests": house.lines("tests", ".py", ".cpp"),
        "files of crosscheck": sum(name.startswith(crosscheck) for name in house.parsed),
        "modules with one importer": sum(importers[name] == 1 for name in own),
        "records with a method beside an engine or a step": house.count(crosscheck, holds_a_way),
        "handlers of every error": house.count(crosscheck, catches_all),
        "calls of an adapter's run": house.count(crosscheck, runs_an_engine),
        "files that name a joint type": house.naming(JOINTS),
        "files that name a force type": house.naming(FORCES),
        "files outside adapters that name an engine": house.naming(ENGINES, "crosscheck/adapters/"),
        "numbers in the judge": house.count("crosscheck/judge/", is_a_number),
        "of these neither shapes nor with a reason beside": unreasoned(house),
        "own imports inside functions": inner_imports(house),
        "getattr": house.count(crosscheck, lambda node: isinstance(node, ast.Call) and getattr(
            node.func, "id", "") == "getattr"),
        "Any": house.count(crosscheck, lambda node: isinstance(node, ast.Name) and node.id == "Any"),
        "names `found`": house.count(crosscheck, lambda node: isinstance(node, ast.Name) and node.id == "found"),
        "pickle.loads": house.count(crosscheck, lambda node: isinstance(node, ast.Attribute) and ast.unparse(
            node) == "pickle.loads"),
        "test functions": house.count("tests/", lambda node: isinstance(node, ast.FunctionDef)
                                      and node.name.startswith("test_")),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", help="a revision, such as a commit")
    options = parser.parse_args()
    root = Path(__file__).resolve().parents[1]
    columns = [figures(root)]
    if options.against:
        packed = subprocess.run(["git", "-C", str(root), "archive", options.against], capture_output=True, check=True)
        with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(packed.stdout)) as archive:
            archive.extractall(folder, filter="data")
            columns.insert(0, figures(Path(folder)))
    for name in columns[0]:
        print(f"{name:50}" + "".join(f"{column[name]:>10,}" for column in columns))
    return 0


if __name__ == "__main__":
    sys.exit(main())
