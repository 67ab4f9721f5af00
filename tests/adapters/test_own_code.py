"""What the code of an engine of the user is: an edit of any of it makes another version."""

from __future__ import annotations

import pytest

from crosscheck.adapters.external import code

FILES = {
    "engine.py": "import helper\n\n\ndef run():\n    from pack import late\n",
    "helper.py": "import numpy\nimport json\n\nVALUE = 1\n",
    "pack/__init__.py": "from .inner import x\n",
    "pack/inner.py": "x = 1\n",
    "pack/late.py": "import space.deep\n",
    "space/deep.py": "y = 1\n",  # in a namespace package
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name, text in {**FILES, "unrelated.py": "z = 1\n"}.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, "utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("home", ["engine.py", "engine"])
@pytest.mark.parametrize("edited", FILES)
def test_an_edit_of_whatever_it_imports_is_another_code(folder, home, edited):
    before = code.digest(home)
    (folder / edited).write_text(FILES[edited] + "# edited\n", "utf-8")
    after = code.digest(home)
    assert after != before
    (folder / edited).write_text(FILES[edited], "utf-8")
    assert code.digest(home) == before


@pytest.mark.parametrize("home", ["engine.py", "engine"])
def test_what_it_does_not_import_does_not_count(folder, home):
    before = code.digest(home)
    (folder / "unrelated.py").write_text("z = 2\n", "utf-8")
    assert code.digest(home) == before


@pytest.mark.parametrize("place", ["site-packages", "dist-packages"])
def test_packages_of_another_environment_do_not_count(folder, monkeypatch, place):
    (folder / "elsewhere" / place).mkdir(parents=True)
    (folder / "elsewhere" / place / "installed.py").write_text("v = 1\n", "utf-8")
    (folder / "engine.py").write_text("import installed\n", "utf-8")
    monkeypatch.syspath_prepend(str(folder / "elsewhere" / place))
    before = code.digest("engine.py")
    (folder / "elsewhere" / place / "installed.py").write_text("v = 2\n", "utf-8")
    assert code.digest("engine.py") == before


def test_two_files_that_swap_their_contents_are_another_code(folder):
    (folder / "engine.py").write_text("import one\nimport two\n", "utf-8")
    digests = set()
    for first, second in (("v = 1\n", "v = 2\n"), ("v = 2\n", "v = 1\n")):
        (folder / "one.py").write_text(first, "utf-8")
        (folder / "two.py").write_text(second, "utf-8")
        digests.add(code.digest("engine.py"))
    assert len(digests) == 2


def test_an_edited_helper_is_computed_again(folder, tmp_path_factory):
    """An engine that states a version, and whose helper alone is edited: no row of the old code is taken."""
    import subprocess
    import sys

    (folder / "pivot.py").write_text("""\
import numpy as np
import helper
from crosscheck.scene.states import States
__version__ = "1.0"
class Engine:
    name, methods, orders = "still", ("Still",), {"Still": 1}
    def unsupported(self, scene, spec):
        return None
    def run(self, scene, spec):
        T = (scene.samples,)
        x = np.broadcast_to(scene.x0 + helper.VALUE, T + scene.x0.shape)
        return States(scene.t, x, *(np.broadcast_to(a, T + a.shape) for a in (scene.R0, scene.v0, scene.w0)))
""", "utf-8")
    program = """\
import crosscheck
frame = crosscheck.sweep({"scenes": ["single_pendulum"], "steps": [0.1], "samples": 3, "duration": 0.2,
                          "engines": {"pivot.py:Engine": ["Still"]}}, workers=1, out="kept")
print(frame.attrs["report"]["computed"], frame.position_error[0])
"""
    def swept():
        done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        count, error = done.stdout.split()
        return int(count), float(error)

    first = swept()
    assert first[0] == 1
    assert swept() == (0, first[1])
    (folder / "helper.py").write_text("VALUE = 2\n", "utf-8")
    second = swept()
    assert second[0] == 1
    assert second[1] > first[1] + 0.5
