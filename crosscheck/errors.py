"""The errors of crosscheck, and common phrases of messages.

Two more errors are defined where they are raised: `crosscheck.TruthError`, in `crosscheck.references.base`, and
`lieeuler.IntegrationError`, which carries the trajectory so far.
"""

from __future__ import annotations

import contextlib
import contextvars
import difflib
import math
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import PurePath

LONGEST = 2000
"""Most characters of a message. Some engines put all that they have printed into theirs, and each report repeats it."""

FAILED = "✗ "
"""Prefix of the label of a task that failed; the terminal prints such a label at once and leaves it on the screen."""


def brief(text: str, most: int = LONGEST) -> str:
    """The text without control characters, which terminals obey and XML refuses, cut after `most` characters."""
    printable = "".join(letter if letter.isprintable() or letter in "\n\t\xa0" else
                    letter.encode("unicode_escape").decode() for letter in text[:most])
    return printable if len(text) <= most else f"{printable}... ({len(text) - most} more characters)"


class CrosscheckError(Exception):
    """Base of all errors of crosscheck. The message is written for the user; all messages are cut here by `brief`."""

    def __init__(self, *given: object) -> None:
        super().__init__(*(brief(each) if type(each) is str else each for each in given))


@contextlib.contextmanager
def errors_as(convert: Callable[[Exception], Exception], *passing: type[Exception]) -> Iterator[None]:
    """Code of others runs within, which may raise anything: `convert` makes an error of ours of it.

    Errors of ours and of the kinds in `passing` pass as they are.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, (CrosscheckError, *passing)):
            raise
        raise convert(error) from error


class OutOfTime(BaseException):
    """The time of `within` is over. Nothing takes it for an error of the code that it ends."""


_END: contextvars.ContextVar[tuple[Callable[[], float], float]] = contextvars.ContextVar(
    "end of the time", default=(lambda: 0.0, math.inf))


@contextlib.contextmanager
def within(seconds: float, clock: Callable[[], float] = time.process_time) -> Iterator[None]:
    """What takes long, such as runs, truth and fits, raises `OutOfTime` in here after so many seconds of a clock."""
    before = _END.set((clock, clock() + seconds))
    try:
        yield
    finally:
        _END.reset(before)


def check_time(needed: float = 0.0) -> None:
    """Raises `OutOfTime` if the time of `within` is over, or would be after what needs so many seconds."""
    clock, end = _END.get()
    if clock() + needed > end:
        raise OutOfTime


class SceneError(CrosscheckError):
    """A scene file is wrong. The message names the file, the entry and what to write instead."""


class Unsupported(CrosscheckError):
    """An engine cannot model this scene, or not in this form or with this method. The message is the reason."""


class EngineError(CrosscheckError):
    """An engine failed while it ran. The message contains the engine's own message."""


class EngineDied(EngineError):
    """The process of an engine ended, was ended, or answered what is no plain data."""

    status = "crashed"


class ArgumentError(CrosscheckError, ValueError):
    """An argument of a public function is wrong. The message names it and lists what is allowed."""


@contextlib.contextmanager
def writing(out: object) -> Iterator[None]:
    """Files are written within to where --out points; an `ArgumentError` says what the system refuses."""
    try:
        yield
    except OSError as error:
        raise ArgumentError(f"--out {out}: {error.strerror or error}; choose another folder") from None


EXTRAS = {
    "mujoco": "mujoco", "pinocchio": "pinocchio", "pin": "pinocchio", "exudyn": "exudyn", "pydrake": "drake",
    "dartpy": "dart", "heyoka": "truth", "pandas": "data", "pyarrow": "data", "xarray": "data", "jinja2": "report",
    "plotly": "report", "matplotlib": "report", "psycopg": "history",
    "distributed": "cluster", "dask": "cluster", "rerun": "rerun", "drake": "drake", "dart": "dart",
    "mcap": "mcap", "mcap_ros2": "mcap",
}
"""The extra of pyproject.toml that installs a module or an engine."""


PINNED = {"mjx": "3.17.0", "mjx-single": "3.17.0", "newton": "1.8.0", "pybullet": "3.2.7",
          "sapien": "3.0.3", "warp": "4.0.0"}
"""Versions of the engines that need an environment of their own."""


class EngineWarning(UserWarning):
    """A warning in another process, with its place, and how often it came."""

    def __init__(self, text: str, count: int) -> None:
        super().__init__(text)
        self.count = count


MOST_WARNINGS = 100
"""Most different warnings that are counted apart; texts may hold numbers."""


@contextlib.contextmanager
def counting_warnings(counts: dict[str, int]) -> Iterator[None]:
    """Count warnings by text and place, instead of printing them."""
    def count(message: Warning | str, category: type[Warning], filename: str, lineno: int,
              file: object = None, line: object = None) -> None:
        own = isinstance(message, EngineWarning)
        text = brief(str(message) if own else
                     f"{category.__name__}: {message} ({PurePath(filename).name}, line {lineno})")
        text = text if text in counts or len(counts) < MOST_WARNINGS else "others"
        counts[text] = counts.get(text, 0) + (message.count if isinstance(message, EngineWarning) else 1)

    with warnings.catch_warnings():
        for kind in (RuntimeWarning, EngineWarning):
            warnings.filterwarnings("always", category=kind, append=True)  # Python's default: once a place
        warnings.showwarning = count
        yield


def install(name: str) -> str:
    """The command that installs a module or an engine."""
    if name in PINNED:
        return f"crosscheck list --engine {name}=={PINNED[name]} makes an environment for it"
    extra = EXTRAS.get(name.partition(".")[0])
    return f"pip install 'lieeuler-crosscheck[{extra}]'" if extra else f"pip install {name}"


def missing(error: ImportError) -> str:
    """One sentence: which module is missing, and how to install it."""
    name = error.name or str(error)
    return f"{name.partition('.')[0]} is not installed; {install(name)}" if error.name else str(error)


@contextlib.contextmanager
def needing(what: str) -> Iterator[None]:
    """Packages of extras are imported within; an `ArgumentError` says which one is missing for what."""
    try:
        yield
    except ImportError as error:
        raise ArgumentError(f"{what}: {missing(error)}") from None


def unknown(what: str, given: object, allowed: Iterable[str]) -> str:
    """One sentence: which name is not known, a similar allowed name if there is one, and all allowed names."""
    allowed = list(allowed)
    lower = {name.lower(): name for name in allowed}
    near = difflib.get_close_matches(str(given).lower(), lower, n=1)
    guess = f"; did you mean {lower[near[0]]!r}?" if near else ";"
    return f"{what}: {given!r} is not known{guess} allowed: {', '.join(allowed)}"


def counted(number: int, word: str, many: str | None = None, none: str = "0") -> str:
    """A number with its word in the singular or the plural; `none` stands for the number 0."""
    return f"{number or none} {word if number == 1 else many or word + 's'}"


def named(error: BaseException) -> str:
    """The class of an error and its message."""
    return f"{type(error).__name__}: {error}"


def said(error: BaseException) -> str:
    """The message of an error in one line, or the name of its class if the message is empty."""
    return " ".join(brief(str(error)).split()) or type(error).__name__
