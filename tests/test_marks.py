"""The marks of tests by what they cost: what the file says, and how it is measured and written."""

import pytest

from tools import marks

EVERY = ["tests/a.py::one[x]", "tests/a.py::one[y]", "tests/a.py::one[z]", "tests/a.py::two", "tests/b.py::three[1, 2]",
         "tests/b.py::three[[3]]"]


def read(tmp_path, text):
    (tmp_path / "marks.toml").write_text(text, "utf-8")
    return marks.Marks(tmp_path / "marks.toml")


@pytest.mark.parametrize("slow", [EVERY, EVERY[:1], EVERY[:2], EVERY[3:], [EVERY[-1]], []])
def test_what_is_written_is_read(tmp_path, slow):
    found = read(tmp_path, marks.text({}, {"slow": slow, "study": set(EVERY) - set(slow)}, EVERY))
    assert [test for test in EVERY if found.has("slow", test)] == slow
    assert all(found.has("study", test) != found.has("slow", test) for test in EVERY)


def test_cases_are_listed_only_where_they_differ():
    written = marks.text({}, {"slow": EVERY[:2] + EVERY[4:]}, EVERY)
    assert written.splitlines()[-5:] == ['[slow."tests/a.py"]', 'one = {but = ["z"]}', "", '[slow."tests/b.py"]',
                                         "three = true"]


def test_a_test_that_is_gone_loses_its_marks():
    written = marks.text({"tests/gone.py::one": "nothing"}, {"slow": ["tests/gone.py::one", EVERY[3]]}, EVERY)
    assert "gone" not in written
    assert "two = true" in written


def test_a_study_is_slow_and_the_core_is_told(tmp_path):
    found = read(tmp_path, marks.text({EVERY[0]: "a sign"}, {"slow": EVERY[:1], "study": EVERY[1:2]}, EVERY))
    assert [found.of(test) for test in EVERY[:3]] == [["slow", "core"], ["slow", "study"], []]


BURNING = """
import time
import pytest

def burn(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass

@pytest.fixture(scope="module")
def shared():
    burn(0.4)

def test_alone():
    burn(0.2)

def test_one(shared):
    burn(0.1)

def test_other(shared):
    pass

FOUND = []

def test_remembers():
    if not FOUND:
        burn(0.6)
    FOUND.append(1)
"""


def test_fixtures_are_shared_and_memories_are_warm(tmp_path):
    (tmp_path / "test_burning.py").write_text(BURNING)
    found = {test.rpartition("::")[2]: cost
             for test, cost in marks.measured([str(tmp_path / "test_burning.py")], "not study").items()}
    assert found == {"test_alone": pytest.approx(0.2, abs=0.1), "test_one": pytest.approx(0.3, abs=0.1),
                     "test_other": pytest.approx(0.2, abs=0.1), "test_remembers": pytest.approx(0, abs=0.1)}


@pytest.mark.parametrize(("cost", "before", "after"), [
    (0.71, False, True), (0.69, False, False), (0.41, True, True), (0.39, True, False)])
def test_a_mark_changes_beyond_two_limits(cost, before, after):
    assert marks.slow(cost, before) == after


def test_a_quick_test_that_has_become_slow_is_reported(tmp_path, capsys):
    (tmp_path / "test_slower.py").write_text(BURNING.replace("0.6", "1.8"))
    pytest.main(["-p", "tools.marks", "-p", "no:xdist", "-p", "no:cacheprovider", str(tmp_path / "test_slower.py")])
    told = capsys.readouterr().out
    assert "1 tests that are not marked slow took over 1.75 s" in told
    assert "test_remembers" in told
    assert "test_alone" not in told


def test_what_a_process_took_before_a_test_is_not_counted_for_it(tmp_path, capsys, monkeypatch):
    """It is told only when the process ends."""
    monkeypatch.setattr(marks, "ended", iter((0.0, 100.0)).__next__)
    (tmp_path / "test_quick.py").write_text("def test_quick():\n    pass\n", "utf-8")
    pytest.main(["-p", "tools.marks", "-p", "no:xdist", "-p", "no:cacheprovider", str(tmp_path / "test_quick.py")])
    told = capsys.readouterr().out
    assert "1 passed" in told or "[100%]" in told
    assert "took over" not in told
