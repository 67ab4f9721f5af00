"""What an engine does to its worker ends with the worker: pipes, helpers, forks."""

import socket
import time
from pathlib import Path

import numpy as np
import pytest

from crosscheck.jobs import drive
from crosscheck.jobs.workers import frames
from crosscheck.jobs.workers.process import Limits
from tests.engines import faults as tasks
from tests.jobs.test_isolation import await_true

GUARD = Limits(time=60.0)


def after(*task, limits=GUARD):
    """The result of a task, and that of the next one in the same worker, if the worker still exists."""
    found, *rest = drive.run_tasks(tasks.call, [task, (tasks.square_or_die, 2), (tasks.square_or_die, 3)], 1,
                                  limits=limits)
    assert rest == [4, 9]
    return found


def running(told):
    """Whether the process whose number a file holds does anything."""
    try:
        return Path(f"/proc/{int(told.read_text())}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.parametrize("session", [False, True], ids=["its group", "a session of its own"])
def test_a_helper_that_holds_the_pipes_ends_with_its_worker(tmp_path, session):
    began = time.monotonic()
    found = after(tasks.helper_then_death, tmp_path / "pid", session)
    assert "SIGKILL" in found.message
    assert time.monotonic() - began < GUARD.time  # the helper sleeps ten times as long
    await_true(lambda: not running(tmp_path / "pid"))


@pytest.mark.parametrize("task", [tasks.helper_left, tasks.daemon_left])
def test_a_helper_ends_with_the_last_task(tmp_path, task):
    drive.run_tasks(task, [tmp_path / "pid"], 1)
    await_true(lambda: not running(tmp_path / "pid"))


def framed(number, content):
    """The bytes of a frame."""
    own, other = socket.socketpair()
    with own, other:
        pipe = frames.Pipe(own)
        pipe.number = number
        pipe.send(content)
        return other.recv(1000)


@pytest.mark.parametrize("content", [b"g", b"garbage 123\n", bytes(300), framed(1, b"no pickle"), framed(7, b"")],
                         ids=["a letter", "text", "zeros", "a frame", "a late one"])
def test_bytes_in_a_pipe_cost_their_own_task(content):
    found = after(tasks.scribble, content)
    assert isinstance(found, drive.Crash)


def test_closed_pipes_cost_their_own_task():
    assert "closed the pipe" in after(tasks.close_pipes, 600.0).message


def test_replaced_pipes_cost_their_own_task(tmp_path):
    assert "replaced the pipe" in after(tasks.replace_pipes, tmp_path / "file").message


def test_a_fork_answers_nothing():
    assert after(tasks.return_twice, 5) == 5


def test_a_task_that_may_runs_again_after_a_kill_from_outside(tmp_path):
    assert "SIGKILL" in drive.run_tasks(tasks.die_once, [tmp_path / "first"], 1)[0].message
    assert drive.run_tasks(tasks.die_once, [tmp_path / "second", tmp_path / "third.term"], 1, retry=True) == [1, 1]
    assert "SIGKILL" in drive.run_tasks(tasks.square_or_die, [-1], 1, retry=True)[0].message


def test_large_tasks_and_results_arrive_whole():
    content = bytes(range(256)) * 40_000
    assert drive.run_tasks(tasks.call, [(bytes.upper, content)], 1) == [content.upper()]


def received(content):
    """The content of a frame of request 3."""
    own, other = socket.socketpair()
    with own, other:
        own.sendall(content)
        own.shutdown(socket.SHUT_WR)
        pipe = frames.Pipe(other)
        pipe.number = 3
        return pipe.receive()


@pytest.mark.parametrize("spoil", [lambda frame: frame[1:] + b"?", lambda frame: b"?" + frame,
                                   lambda frame: frame[:-1] + b"?", lambda frame: framed(4, b"content")])
def test_a_broken_frame_is_seen(spoil):
    with pytest.raises(frames.BrokenFrame):
        received(spoil(framed(3, b"content")))


def test_a_cut_frame_is_an_end():
    with pytest.raises(EOFError):
        received(framed(3, b"content")[:-1])


def test_a_whole_frame_is_taken():
    assert received(framed(3, b"content")) == b"content"


def test_an_object_of_an_engine_runs_nothing_in_the_parent(tmp_path):
    path = tmp_path / "unpickled"
    assert "cannot hold an object of type Bomb" in after(tasks.returned, path).message
    found = after(tasks.raised, path)
    assert found.message == "BombError: an error of the engine's own kind"
    assert type(found.error()) is ValueError
    assert not path.exists()


def arrays(shape: tuple) -> dict[str, np.ndarray]:
    """Arrays of every kind that is taken."""
    values = np.arange(np.prod(shape)).reshape(shape)
    return {kind: values.astype(kind) for kind in ("?", "i1", "u4", "i8", "f4", "f8")} | {"turned": values.T * 0.1}


def test_a_result_of_another_type_is_a_failure():
    found, right = drive.run_tasks(tasks.mistyped, [1], 1)[0], drive.run_tasks(arrays, [(2, 3, 4)], 1)[0]
    assert "not of the type that was asked for: Expected `int`, got `str`" in found.message
    for kind, values in arrays((2, 3, 4)).items():
        np.testing.assert_array_equal(right[kind], values, strict=True)


@pytest.mark.parametrize("content", [("|O", (1,), bytes(8)), ("<f8", (2,), bytes(8)), ("<f8", (-1, -1), bytes(8)),
                                     ("|V8", (1,), bytes(8)), ("<f8", (1.5,), bytes(8)), "text", ("<f8", (1,))])
def test_an_array_that_is_none_is_refused(content):
    with pytest.raises(ValueError, match=r"array|Expected"):
        frames.decode(frames.encode(content), np.ndarray)


def test_a_frame_of_two_gigabytes_is_refused_by_its_header():
    with pytest.raises(frames.BrokenFrame):
        received(frames.HEADER.pack(b"xchk", 3, 2**31, 0))
