"""The packages keep to the rooms of `tools/rooms.py`."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import shutil

import pytest

from tests import ROOT

_spec = importlib.util.spec_from_file_location("rooms", ROOT / "tools" / "rooms.py")
rooms = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(rooms)

@pytest.fixture(scope="module")
def edges():
    return rooms.imports(rooms.modules(ROOT))


def test_no_import_against_the_rule(edges):
    assert rooms.violations(edges) == []


def test_no_circle(edges):
    assert rooms.circles(rooms.between(edges)) == []
    assert rooms.circles(edges) == []


def test_few_rooms_floors_and_arrows(edges):
    between = rooms.between(edges)
    assert len(between) <= 24
    assert sum(map(len, between.values())) <= 130  # eleven of compare; a test knows the verdict
    assert max(rooms.floors(between).values()) <= 10


@pytest.mark.parametrize("folder", ["benchmarks", "examples", "tools"])
def test_what_programs_beside_the_packages_import_is_there(folder):
    for file in (ROOT / folder).glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module.startswith(("benchmarks", "crosscheck", "lieeuler")):
                module = importlib.import_module(node.module)
                for name in node.names:
                    assert hasattr(module, name.name) or importlib.util.find_spec(f"{node.module}.{name.name}"), (
                        f"{file.name}: {node.module} has no {name.name}")


@pytest.mark.parametrize(("module", "line", "said"), [
    ("scene/model.py", "import crosscheck.cli.app", "scene may not import cli"),
    ("jobs/grid.py", "def late():\n    from crosscheck.report import exports", "jobs may not import report"),
    ("references/base.py", "if False:\n    import lieeuler", "references may not import lieeuler"),
    ("lounge/chair.py", "import crosscheck.errors", "'lounge' is not in MAY_IMPORT"),
])
def test_a_seeded_import_is_found(tmp_path, edges, module, line, said):
    for package in ("crosscheck", "lieeuler"):
        unread = shutil.ignore_patterns("_core", "__pycache__", "*.so")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=unread)
    file = tmp_path / "crosscheck" / module
    file.parent.mkdir(exist_ok=True)
    text = file.read_text("utf-8") if file.exists() else ""
    file.write_text(f"{text}\n{line}\n", "utf-8")
    new = set(rooms.violations(rooms.imports(rooms.modules(tmp_path)))) - set(rooms.violations(edges))
    assert len(new) == 1
    assert said in new.pop()


def test_tests_of_lieeuler_name_no_crosscheck():
    """`make test-lieeuler` shows it of what they import as well."""
    files = sorted((ROOT / "tests" / "lieeuler").glob("*.py"))
    assert len(files) > 30
    assert [path.name for path in files if "crosscheck" in path.read_text("utf-8")] == []


def test_files_that_name_a_type_are_counted(tmp_path):
    texts = {"one": 'TYPE = "revolute"', "two": "revolute = 'a revolute joint'  # revolute", "three": "planar: str",
             "four": 'def f(kind): return kind in ("planar", "joint_force")'}
    (tmp_path / "crosscheck").mkdir()
    for name, text in texts.items():
        (tmp_path / "crosscheck" / f"{name}.py").write_text(text, "utf-8")
    assert list(rooms.report(tmp_path))[-2:] == ["files that name a joint type 2", "files that name a force type 1"]


def test_a_seeded_circle_is_found():
    loop = {"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}
    assert rooms.circles(loop) == [["a", "b", "c"]]
    with pytest.raises(ValueError, match="circle"):
        rooms.floors(loop)
    assert rooms.floors({"a": {"b"}, "b": set(), "d": {"a"}}) == {"a": 2, "b": 1, "d": 3}


def test_the_picture_is_that_of_the_code():
    """`python tools/rooms.py --picture docs/static/house.svg` draws it anew."""
    assert (ROOT / "docs/static/house.svg").read_text("utf-8") == rooms.picture(ROOT)


def test_the_picture_leaves_out_what_is_implied():
    assert rooms.reduced({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == {"a": {"b"}, "b": {"c"}, "c": set()}


def test_the_version_of_the_formulas_covers_what_they_import(edges):
    from crosscheck.references.cache import SHARED

    reached = {target for module in edges if rooms.room(module) == "references"
               for target in rooms.reachable(edges, module) if rooms.room(target) == "scene"}
    assert {f"crosscheck.scene.{name}" for name in SHARED} >= reached - {"crosscheck.scene"}
