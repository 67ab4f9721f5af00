"""References share no code with the engines that they judge, and the two formulations none with each other."""

import ast
import inspect
import pathlib
import re
import subprocess
import sys

import pytest

import crosscheck.references as references
from crosscheck.scene import mechanics

FOLDER = pathlib.Path(references.__file__).parent
OWN = {"crosscheck.scene.model", "crosscheck.scene.states", "crosscheck.errors", "crosscheck.files",  # no mechanics
       "crosscheck.scene.functions",  # data of a scene, which series evaluate by formulas of their own
       "crosscheck.scene.laws",  # the table of forces, of which each formulation reads its own column
       "crosscheck.scene.touching"}  # distances of shapes, by coal
OF_MAXIMAL = {"crosscheck.scene.mechanics", "crosscheck.scene.armature", "crosscheck.scene.coordinates",
              "crosscheck.scene.vectors"}


def imported(file):
    """Full names of everything a module imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file.name}: relative import hides what it names"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def belongs(name, modules):
    return any(name == module or name.startswith(module + ".") for module in modules)


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.py")), ids=lambda file: file.stem)
def test_imports_nothing_under_test(file):
    ours = {name for name in imported(file) if name.split(".")[0] in {"crosscheck", "lieeuler"}}
    allowed = OWN | {"crosscheck.references"} | (OF_MAXIMAL if file.stem in MAXIMAL else set())
    assert not {name for name in ours if not belongs(name, allowed)}
    assert not imported(file) & {"mujoco", "pinocchio", "exudyn", "importlib.import_module"}
    nodes = ast.walk(ast.parse(file.read_text()))
    assert not [node.lineno for node in nodes if isinstance(node, ast.Attribute) and node.attr == "kind"]  # of a joint


SERIES = {"taylor", "articulated", "joint_motion", "loops", "tree", "tree_loads", "generic", "tree_laws",
          "monitors"}
MAXIMAL = {"maximal", "defects"}


def test_the_formulations_share_no_equations():
    """Each may use data and errors of the package."""
    parts = dict.fromkeys(SERIES, MAXIMAL) | dict.fromkeys(MAXIMAL, SERIES)
    for name, others in parts.items():
        modules = {f"crosscheck.references.{other}" for other in others}
        assert not {module for module in imported(FOLDER / f"{name}.py") if belongs(module, modules)}, name
    frame = {"__init__", "base", "cache", "conditioning", "dense_output", "members", "modes", "pieces",
             "restarts"}
    assert {file.stem for file in FOLDER.glob("*.py")} == frame | set(parts)  # a new module has to be placed


def test_neither_reads_the_others_column_of_a_law():
    """The series read potential and dissipation of the table of forces, the index-1 equations the effort."""
    for name in SERIES:
        assert not re.search(r"\.effort\b", (FOLDER / f"{name}.py").read_text()), name
    for function in (mechanics.applied_forces, mechanics._add_of_force, mechanics._measured):
        assert not re.search("potential|dissipation", inspect.getsource(function)), function


def test_running_loads_no_engine():
    """Dynamic imports would escape the syntax tree; a run in a fresh interpreter shows what is really loaded."""
    code = ("import sys; from crosscheck.references import compute, maximal; "
            "from crosscheck.scene.file import load_scene; "
            "scene = load_scene('heavy_top').replace(duration=0.05, samples=2); compute(scene); "
            "maximal.Maximal(scene).run(); "
            "print(*[m for m in sys.modules if m.split('.')[0] in ('lieeuler', 'mujoco', 'pinocchio', 'exudyn') "
            "or m.startswith('crosscheck.engines.')])")
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert result.stdout.split() == []


def test_importing_the_package_is_light():
    code = ("import sys, crosscheck.references; "
            "print(*[m for m in ('heyoka', 'scipy', 'mpmath') if m in sys.modules])")
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert result.stdout.split() == []
