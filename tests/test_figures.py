"""The guide figures are counted as they are described."""

from tests import ROOT
from tools import golden
from tools.figures import House, catches_all, figures, holds_a_way, runs_an_engine

CODE = '''
import pickle
from typing import Any


LEFT = 1e-9
"""What rounding leaves."""


class Cell:
    method: str
    step: float


class Point:
    step: float


def one(adapter, scene, spec: Any) -> Any:
    from crosscheck.errors import Unsupported
    try:
        found = adapter.run(scene, spec)[:, 7]
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
        "files outside adapters that name an engine": 1, "numbers in the judge": 3,
        "of these neither shapes nor with a reason beside": 1, "own imports inside functions": 1,
        "getattr": 1, "Any": 2, "names `found`": 2, "pickle.loads": 1, "test functions": 1}


def test_a_golden_comparison_names_each_kind_of_difference_once():
    runs = [{"engine": "e1", "outcome": "pass", "error": 1e-3, "wall_time": 0.1},
            {"engine": "e2", "outcome": "pass", "error": None, "curve": 300 * "a"}]
    before = golden.flat("verify", {"records": runs, "meta": {"seconds": 3.0}})
    assert golden.compare(before, dict(before)) == []
    assert len(before) == 7  # no time
    runs[0] |= {"outcome": "fail", "error": 1.1e-3}
    runs[1] |= {"curve": 300 * "b"}
    lines = golden.compare(before, golden.flat("verify", {"records": runs[:2]}))
    assert lines[0] == "verify/records/e1/outcome: pass -> fail"
    assert [line.split(" differ")[0].split()[-3:] for line in lines[1:]] == [["1", "of", count] for count in "122"]
    assert any("at most by 9.1e-02: verify/records/e1/error: 0.001 -> 0.0011" in line for line in lines)
    assert golden.compare(before, {}) == ["7 values only before, for one verify/records/e1/engine"]


def test_names_say_what_they_hold_and_types_what_they_are():
    """Limits are only ever lowered. Of what other packages give without types, a named alias says what it is."""
    house = House(ROOT)
    assert house.count("crosscheck/", lambda node: getattr(node, "id", "") == "found") <= 5
    assert house.count("crosscheck/", lambda node: getattr(node, "id", "") == "Any") <= 440


def test_one_type_says_a_run_and_few_places_take_every_error():
    """Limits are only ever lowered. A handler of every error has its reason in tests/running/test_attempt.py."""
    house = House(ROOT)
    assert house.count("crosscheck/", holds_a_way) <= 6
    assert house.count("crosscheck/", catches_all) <= 3
    assert house.count("crosscheck/", runs_an_engine) <= 3
