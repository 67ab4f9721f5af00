"""A few random arms, logs and engines of the user's own; `python -m tests.first_contact` takes any number."""

import pytest

from tests import first_contact


@pytest.mark.parametrize(("command", "seed"), [
    *first_contact.seeds(), ("judge", 3), ("inspect", 2), ("run", 6), ("advise", 4), ("convert", 1), ("history", 0)])
def test_no_command_ends_in_an_internal_error(command, seed):
    words, result = first_contact.case(command, seed, 5.0)
    assert not first_contact.wrong(result), " ".join(words)


def test_what_is_internal_is_seen():
    for text in ("crosscheck: internal error, a mistake of crosscheck: KeyError: 'x' (a.py, line 3)",
                 "own Go on arm: fails: ZeroDivisionError: float division by zero",
                 "Traceback (most recent call last):"):
        assert first_contact.wrong(first_contact.SimpleNamespace(code=1, text=text))
    assert first_contact.wrong(first_contact.SimpleNamespace(code=70, text=""))
    assert first_contact.wrong(first_contact.SimpleNamespace(code=-11, text=""))
    assert not first_contact.wrong(first_contact.SimpleNamespace(code=None, text="10 s: judging log.csv"))
    assert not first_contact.wrong(first_contact.SimpleNamespace(code=2, text="crosscheck: arm.toml: mass: 0; write"))
