"""Engines of the user: the documented example, the defaults, one clear error for everything that is missing."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck import report as report_folder
from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.errors import EngineDied
from crosscheck.scene.file import load_scene
from crosscheck.verification import job
from tests import ROOT, saved

EXAMPLE = f"{ROOT / 'examples' / 'my_engine.py'}:PivotRK4"
BAD = f"{ROOT / 'tests' / 'engines' / 'faults.py'}"


@pytest.fixture(scope="module")
def verified():
    return job.verify("smoke", ["single_pendulum", "double_pendulum"], [EXAMPLE], 1)


def test_the_example_is_judged_like_a_built_in_engine(verified):
    record, elsewhere = (record for record in verified.records if record.engine == EXAMPLE)
    assert record.outcome == "pass"
    assert record.documented_order == 4
    # Four evaluations of a smooth right-hand side: the order of the classical method, to the usual margin.
    assert record.order.observed == pytest.approx(4.0, abs=0.15)
    assert elsewhere.outcome == "unsupported"
    assert elsewhere.message == "it knows one body on a ball joint with the ground"
    assert record.version.startswith("code ")


def test_it_is_in_the_report_and_in_its_files(verified, tmp_path):
    folder = report_folder.write(verified, tmp_path / "report").parent
    pages = "".join(page.read_text(encoding="utf-8") for page in folder.rglob("*.html"))
    assert f"{EXAMPLE} RK4" in pages
    assert "it knows one body on a ball joint with the ground" in pages
    for name in ("results.json", "junit.xml", "runs.csv", "summary.md"):
        if (folder / name).exists():
            assert "my_engine.py:PivotRK4" in (folder / name).read_text(encoding="utf-8")


def test_its_own_command_repeats_its_run(verified, tmp_path):
    import shlex

    record = next(record for record in verified.records if record.engine == EXAMPLE)
    words = shlex.split(record.command)
    done = subprocess.run([sys.executable, "-m", "crosscheck", *words[1:]], capture_output=True, text=True,
                          timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"{EXAMPLE} RK4: {record.steps} steps" in " ".join(done.stdout.split())
    assert (tmp_path / "run.csv").is_file()


def test_a_module_in_the_current_folder(tmp_path):
    (tmp_path / "mine.py").write_text((ROOT / "examples" / "my_engine.py").read_text(encoding="utf-8")
                                      + "\n__version__ = '0.7'\n", encoding="utf-8")
    program = Path(sys.executable).with_name("crosscheck")
    for name in ("mine:PivotRK4", "mine.py:PivotRK4"):
        done = subprocess.run([str(program), "list", "--engine", name], capture_output=True, text=True, timeout=60,
                              cwd=tmp_path, env={**os.environ, "COLUMNS": "200"})
        assert done.returncode == 0, done.stderr
        words = next(line.split() for line in done.stdout.splitlines() if name in line.split())
        assert words[1:3] == ["0.7,", "code"]
        assert words[4:] == ["RK4"]


def test_the_process_of_an_engine_ends_with_it():
    adapters.renew()
    before = set(psutil.Process().children())
    adapters.get(EXAMPLE)
    started = set(psutil.Process().children()) - before
    assert len(started) == 1
    adapters.renew()
    assert not psutil.wait_procs(started, timeout=20)[1]


def test_two_files_of_one_name_are_two_engines(tmp_path):
    for folder, method in (("a", "One"), ("b", "Two")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "same.py").write_text(
            f"class E:\n    name = 'e'\n    methods = ({method!r},)\n    def unsupported(self, scene, spec): ...\n"
            "    def run(self, scene, spec): ...\n", encoding="utf-8")
    assert adapters.methods(f"{tmp_path}/a/same.py:E") == ("One",)
    assert adapters.methods(f"{tmp_path}/b/same.py:E") == ("Two",)


def test_defaults():
    adapter = adapters.get(f"{BAD}:Resting")
    scene = crosscheck.load_scene("single_pendulum").replace(samples=6)
    spec = RunSpec("Rest", step=0.1)
    assert (adapter.documented_order(scene, spec), adapter.held_levels(scene, spec)) == (1, frozenset())
    assert (adapter.options, adapter.forms, adapter.adaptive_methods) == (frozenset(), (), ())
    raw = adapter.run(scene, spec)
    assert isinstance(raw, RawRun)
    assert (raw.steps, raw.step) == (100, 0.1)
    assert adapter.unsupported(scene, RunSpec("Rest", step=0.1, form="tree")) == (
        "form tree is not among those of this engine: it names none")
    with pytest.raises(crosscheck.ArgumentError, match=r"form: .*Resting does not have this option; it has none"):
        crosscheck.run(scene, f"{BAD}:Resting", "Rest", step=0.1, form="tree")
    with pytest.raises(crosscheck.ArgumentError, match=r"Resting Rest needs a fixed step"):
        crosscheck.run(scene, f"{BAD}:Resting", "Rest")


@pytest.mark.parametrize(("name", "words"), [
    ("no_such_module:Engine", "and there is no module of this name"),
    ("mojoco:RK4", "did you mean 'mujoco'"),
    ("no/such/file.py:Engine", "engine: there is no file no/such/file.py"),
    (f"{BAD}:Restless", "has no class 'Restless'; engines there: Resting, Killed"),
    (f"{BAD}:Nameless", "`methods` has to be a tuple of names"),
    (f"{BAD}:", "a class is given as module:Class"),
    (":Engine", "a class is given as module:Class"),
    ("json:loads", "cannot be made without arguments: TypeError"),
    ("json:JSONDecoder", "has no method unsupported(scene, spec)"),
])
def test_what_is_missing_gets_one_clear_error(name, words):
    for lookup in (adapters.get, lambda name: job.select_engines([name])):
        with pytest.raises(crosscheck.ArgumentError) as caught:
            lookup(name)
        assert words in str(caught.value)
        assert str(caught.value).startswith("engine")


def test_wrong_states_are_named(tmp_path):
    path = tmp_path / "shapes.py"
    path.write_text("""
import numpy as np
from crosscheck.scene.states import States

class Shapes:
    name = "shapes"
    methods = ("flat", "late", "few", "text", "complex")

    def unsupported(self, scene, spec):
        return None

    def run(self, scene, spec):
        n = scene.samples - (spec.method == "few")
        t = scene.t[:n] * (2.0 if spec.method == "late" else 1.0)
        shape = (n, 3) if spec.method == "flat" else (n, 1, 3)
        x = [["a"]] if spec.method == "text" else np.zeros(shape, complex if spec.method == "complex" else float)
        return States(t, x, np.tile(np.eye(3), (n, 1, 1, 1)), np.zeros((n, 1, 3)), np.zeros((n, 1, 3)))
""", encoding="utf-8")
    for method, words in (("flat", "x of shape (251, 3), not (251, 1, 3)"), ("late", "other times"),
                          ("few", "250 samples, not 251"), ("text", "something else than real numbers in x"),
                          ("complex", "something else than real numbers in x")):
        with pytest.raises(crosscheck.EngineError) as caught:
            crosscheck.run("single_pendulum", f"{path}:Shapes", method, step=0.1, samples=251)
        assert words in str(caught.value)


def test_an_error_of_its_own_is_a_failed_run_and_no_lost_process(tmp_path):
    """A lost process may be the machine's fault, and is tried again; an error would only come again."""
    path = tmp_path / "unlucky.py"
    path.write_text("""
class Unlucky:
    name = "unlucky"
    methods = ("run", "die")

    def unsupported(self, scene, spec):
        return None

    def run(self, scene, spec):
        if spec.method == "die":
            __import__("os")._exit(3)
        raise RuntimeError("no luck")
""", encoding="utf-8")
    for method, kind, words in (("run", crosscheck.EngineError, "Error: no luck"), ("die", EngineDied, "code 3")):
        with pytest.raises(crosscheck.EngineError, match=words) as caught:
            crosscheck.run("single_pendulum", f"{path}:Unlucky", method, step=0.1, samples=2)
        assert type(caught.value) is kind


def test_a_module_that_crashes_on_import_is_one_error(tmp_path):
    path = saved(tmp_path / "crash.py", "import ctypes\nctypes.string_at(0)\n")
    with pytest.raises(crosscheck.EngineError, match=r"crash.py:E cannot be loaded: .*SIGSEGV"):
        job.select_engines([f"{path}:E"])


def test_it_takes_part_in_assert_agree():
    brief = crosscheck.load_scene("single_pendulum").replace(duration=1.0, samples=11)
    crosscheck.assert_agree(brief, [(EXAMPLE, "RK4", {"step": 2e-3}), "mujoco:RK4"])


def test_the_example_is_as_short_as_promised():
    body = (ROOT / "examples" / "my_engine.py").read_text(encoding="utf-8").partition("class PivotRK4")[2]
    assert len([line for line in body.splitlines() if line.strip()]) <= 40


def test_states_as_lists_become_arrays():
    from crosscheck.adapters.external import own

    adapter = own.load(EXAMPLE, ())
    scene = crosscheck.load_scene("single_pendulum").replace(duration=0.1, samples=3)
    listed = adapter._engine.run(scene, RunSpec("RK4", step=0.05))
    adapter_like = type("Lists", (), {"name": "lists", "methods": ("RK4",), "unsupported": lambda *_: None,
                                      "run": lambda *_: type(listed)(*(np.asarray(getattr(listed, each)).tolist()
                                                                       for each in ("t", "x", "R", "v", "w")))})
    raw = own.completed(adapter_like(), "lists", "1").run(scene, RunSpec("RK4", step=0.05))
    assert raw.states.R.shape == (3, 1, 3, 3)


def test_the_documented_adapter_works():
    path = ROOT / "examples" / "scipy_engine.py"
    brief = crosscheck.load_scene("double_pendulum").replace(duration=1.0, samples=11)
    crosscheck.assert_agree(brief, [(f"{path}:SciPy", "DOP853", {"rtol": 1e-8})])
    with pytest.raises(crosscheck.Unsupported, match="DOP853 is adaptive here"):
        crosscheck.run(brief, f"{path}:SciPy", "DOP853", step=1e-3)


@pytest.mark.parametrize("method", ["SymplecticEuler", "RKMK4", "RKMK8"])
def test_compiled_pinocchio_takes_the_steps_of_its_adapter(method):
    compiled, plain = (crosscheck.run("double_pendulum", engine, method, step=0.01, samples=11)
                       for engine in ("examples/pinocchio_compiled.py:Compiled", "pinocchio"))

    for quantity in ("x", "R", "v", "w", "a"):
        ours, theirs = getattr(compiled, quantity), getattr(plain, quantity)
        assert np.abs(ours - theirs).max() <= 1e-9 * np.abs(theirs).max()


def test_an_engine_of_the_user_may_derive_from_the_base_class(tmp_path):
    file = tmp_path / "derived.py"
    file.write_text("from crosscheck.adapters.base import Engine\n"
                    "class Derived(Engine):\n"
                    "    name, methods, forms, eps, orders = 'derived', ('A', 'B'), ('tree',), 1e-3, {'A': 3}\n"
                    "    adaptive_methods = ['B']\n"
                    "    def unsupported(self, scene, spec): return None\n"
                    "    def run(self, scene, spec): raise ArithmeticError\n")
    adapter, scene = adapters.get(f"{file}:Derived"), crosscheck.load_scene("single_pendulum")
    assert adapter.version().startswith("code ")
    assert (adapter.options, adapter.fixed_step_methods) == (frozenset({"form"}), ("A",))
    assert [adapter.documented_order(scene, RunSpec(method)) for method in adapter.methods] == [3, None]
    assert (adapter.held_levels(scene, RunSpec("A")), adapter.checks_sizes) == (frozenset(), False)
    assert adapter.eps == 2.0**-23  # an engine cannot claim coarser numbers


BURN = """import time
class Burn:
    name, methods, orders = "burn", ("A",), {"A": 1}
    def unsupported(self, scene, spec):
        if scene.duration < 1:
            time.sleep(.5)
            return None
        while time.process_time() < 1.0: pass
    def run(self, scene, spec): raise NotImplementedError
"""


def test_the_clock_of_an_engine_in_a_process_of_its_own_counts_what_that_works_and_not_what_it_waits(tmp_path):
    """On a busy machine `explain` ended after 60 s of the clock, in which its engine had worked for a few."""
    (tmp_path / "burn.py").write_text(BURN)
    name = f"{tmp_path / 'burn.py'}:Burn"
    engine, scene = adapters.get(name), load_scene("single_pendulum")
    used = adapters.clock(name)
    before = used()
    engine.unsupported(scene.replace(duration=0.1), RunSpec("A", step=1e-3))
    waited = used()
    engine.unsupported(scene.replace(duration=1.0), RunSpec("A", step=1e-3))
    assert waited - before < 0.4
    assert used() - waited > 0.4
    assert adapters.clock("mujoco") is time.process_time
