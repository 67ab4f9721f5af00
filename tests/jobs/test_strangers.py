"""Engines of the user that change their process, or answer what runs code, reach no other engine and no judge."""

import textwrap

import msgspec
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.document import Way
from crosscheck.errors import CrosscheckError, EngineError
from crosscheck.running.attempt import Ran, attempt
from crosscheck.verification import job
from tests.killing import timeless

HOSTILE = {
    "fork": "os.fork() or os._exit(0)",
    "garbage on every pipe": "[os.write(number, b'x' * 100) for number in range(3, 9) if ok(number)]",
    "rounding mode": "ctypes.CDLL('libm.so.6').fesetround(0x400)",
    "resource limits": "resource.setrlimit(resource.RLIMIT_NOFILE, (20, 20))",
    "patched numpy": "np.abs = lambda *given, **more: 0.0 * np.asarray(given[0])",
    "patched judge": "import crosscheck.compare.errors as found; vars(found).clear()",
    "working folder": "os.chdir('/')",
    "scene altered": "object.__setattr__(scene, 'gravity', np.zeros(3)); scene.__dict__.clear()",
    "stdout closed": "sys.stdout.close(); os.close(1)",
    "recursion limit": "sys.setrecursionlimit(60)",
    "environment": "os.environ.clear(); os.environ['OMP_NUM_THREADS'] = '64'",
    "signal handlers": "signal.signal(signal.SIGTERM, signal.SIG_IGN); signal.setitimer(signal.ITIMER_REAL, 0.2, 0.2)",
    "threads left running": "threading.Thread(target=lambda: all(map(idle, iter(int, 1))), daemon=True).start()",
    "processes left running": "subprocess.Popen(['sleep', '600'], start_new_session=True)",
    "patched at its import": "",
}
"""What the run of an engine does to its process before it answers; one does it when it is imported.

Eight at a time come before a right one. Those that may end a process come first: a new one would hide what the others
did to it.
"""

SIDE_EFFECTS = "import numpy as np\nnp.linalg.solve = None\nimport crosscheck\ncrosscheck.run = None\n"

MODULE = """
import ctypes, os, pathlib, resource, signal, subprocess, sys, threading, time
import numpy as np
from crosscheck.adapters.base import RawRun
from crosscheck.scene.states import States
{side_effects}
class Bomb:
    def __reduce__(self):
        return pathlib.Path.touch, (pathlib.Path({touched!r}),)
    def __float__(self):
        return 1.0
def idle(_):
    time.sleep(1e-3)
    return True
def ok(number):
    try:
        return bool(os.fstat(number))
    except OSError:
        return False
class Hostile:
    name, methods = "hostile", ("rattle4",)
    def unsupported(self, scene, spec):
        return None
    def run(self, scene, spec):
        rest = [np.repeat(start[None], scene.samples, axis=0) for start in (scene.x0, scene.R0, scene.v0, scene.w0)]
        fields = dict(t=scene.t.copy(), x=rest[0], R=rest[1], v=rest[2], w=rest[3], a=None, alpha=None, lam=None)
        more = dict(wall_time=0.1, steps=10, step=0.01, status="ok", stats={{}}, maxima=None, form=None)
        {action}
        return RawRun(States(**fields), **more)
"""

RIGHT = "lieeuler"


def written(folder, action, side_effects=""):
    (folder / "hostile.py").write_text(MODULE.format(action=textwrap.indent(action, 8 * " ").strip(),
                                                     side_effects=side_effects, touched=str(folder / "touched")))
    return f"{folder / 'hostile.py'}:Hostile"


def records(*engines):
    """Records by engine, without times; one worker runs them in this order."""
    found = job.verify("smoke", ["single_pendulum"], engines, 1, methods=["rattle4"]).records
    return {record.engine: timeless(msgspec.to_builtins(record, str_keys=True)) for record in found}


@pytest.fixture(scope="module")
def alone():
    return records(RIGHT)[RIGHT]


@pytest.mark.parametrize("first", range(0, len(HOSTILE), 8))
def test_the_next_engine_is_judged_as_if_it_were_alone(alone, tmp_path, first):
    hostile = []
    for what in list(HOSTILE)[first:first + 8]:
        (tmp_path / what).mkdir()
        hostile.append(written(tmp_path / what, HOSTILE[what], "" if HOSTILE[what] else SIDE_EFFECTS))
    found = records(*hostile, RIGHT)
    assert found[RIGHT] == alone
    for each in hostile:
        assert found[each]["outcome"] in ("fail", "error"), each  # a pendulum at rest is wrong, whatever else it does


@pytest.mark.parametrize("ending", ["sys.exit()", "os._exit(0)", "os.kill(os.getpid(), signal.SIGSEGV)"])
def test_a_module_that_ends_its_process_is_one_error(tmp_path, ending):
    with pytest.raises(CrosscheckError, match=r"cannot be (loaded|imported)"):
        adapters.get(written(tmp_path, "", ending))


FIELDS = ["t", "x", "R", "v", "w", "a", "alpha", "lam"]
REST = ["wall_time", "steps", "step", "status", "stats", "maxima", "form"]


CHOSEN = f"""
name = {FIELDS + REST}[scene.samples - 3]
value = {{'stats': {{'given': Bomb(), 'bombs': [Bomb()]}}, 'maxima': {{'position': Bomb()}}}}.get(name, Bomb())
(fields if name in fields else more)[name] = value
"""
"""One engine for all fields, so that its process starts once: the number of samples says where to put the object."""


@pytest.fixture(scope="module")
def bombs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bombs")
    return written(folder, CHOSEN), folder / "touched"


@pytest.mark.parametrize("field", FIELDS + REST)
def test_an_object_in_any_field_runs_nothing_here(bombs, field):
    engine, touched = bombs
    samples = 3 + (FIELDS + REST).index(field)
    scene = crosscheck.load_scene("single_pendulum").replace(duration=0.05 * (samples - 1), samples=samples)
    outcome = attempt(scene, Way(engine, "rattle4", 0.05))
    if isinstance(outcome, Ran):  # a number was made of it where there was one
        msgspec.to_builtins(outcome.raw.stats)
        assert field in ("wall_time", "step")
    else:
        assert isinstance(outcome.error, EngineError)
        assert len(outcome.why.splitlines()) == 1
    assert not touched.exists()


@pytest.mark.parametrize("question", ["unsupported", "documented_order", "held_levels"])
def test_an_object_as_any_other_answer_runs_nothing_here(tmp_path, question):
    engine = written(tmp_path, "")
    with open(tmp_path / "hostile.py", "a", encoding="utf-8") as file:
        file.write(f"    def {question}(self, *given):\n        return Bomb()\n")
    found = adapters.get(engine)
    with pytest.raises(EngineError):
        getattr(found, question)(crosscheck.load_scene("single_pendulum"), RunSpec("rattle4", step=0.05))
    assert not (tmp_path / "touched").exists()


def test_an_answer_of_two_gigabytes_is_refused(tmp_path):
    engine = written(tmp_path, "more['stats'] = {'given': 'x' * 2**31}")
    with pytest.raises(EngineError, match="at most 1 GB can be sent"):
        crosscheck.run("single_pendulum", engine, "rattle4", step=0.05)
