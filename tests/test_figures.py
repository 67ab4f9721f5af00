"""The guide figures are counted as they are described."""

from tools.figures import figures

CODE = '''
import pickle
from typing import Any


class Cell:
    method: str
    step: float


class Point:
    step: float


def one(adapter, scene, spec: Any) -> Any:
    from crosscheck.errors import Unsupported
    try:
        found = adapter.run(scene, spec)
        return found, "revolute", "mujoco", 0.25, getattr(adapter, "name"), pickle.loads(b"")
    except (ValueError, Exception):
        return Unsupported
    except:
        subprocess.run(["ls"], check=True)
'''


def test_every_figure_counts_what_it_says(tmp_path):
    for name, text in (("crosscheck/__init__.py", ""), ("crosscheck/errors.py", "class Unsupported: pass\n"),
                       ("crosscheck/judge/__init__.py", ""), ("crosscheck/judge/cell.py", CODE),
                       ("lieeuler/__init__.py", ""), ("lieeuler/_core/a.hpp", "int a;\n\n// one\n"),
                       ("tests/test_a.py", "def test_one(): pass\ndef two(): pass\n")):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, "utf-8")
    found = figures(tmp_path)
    assert (found.pop("lines of crosscheck"), found.pop("lines of tests")) == (1 + CODE.count("\n"), 2)
    assert found == {
        "lines of lieeuler's Python": 0, "lines of C++": 3, "files of crosscheck": 4, "modules with one importer": 1,
        "records with a method beside an engine or a step": 1, "handlers of every error": 2,
        "calls of an adapter's run": 1, "files that name a joint type": 1, "files that name a force type": 0,
        "files outside adapters that name an engine": 1, "numbers in the judge": 1, "own imports inside functions": 1,
        "getattr": 1, "Any": 2, "names `found`": 2, "pickle.loads": 1, "test functions": 1}
