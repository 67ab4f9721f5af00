"""Frames on the socket between a worker and its parent: a message arrives unchanged, or the worker is ended.

A frame carries the number of its request and a checksum. They show when an engine has written to the socket, or has
forked so that two processes answer. The worker is ended then, and only its task is lost.

What a worker answers is plain data (msgpack), decoded strictly to the type that the function is annotated to return.
It is never unpickled, because an engine could then run code in the parent. Of the packages only msgspec and NumPy are
imported, because this module also runs in environments that were made for one version of an engine.
"""

from __future__ import annotations

import contextlib
import functools
import math
import os
import re
import socket
import struct
import threading
import types
import typing
import zlib
from collections.abc import Callable
from typing import Any

import msgspec

from crosscheck import errors

HEADER = struct.Struct(">4sQQI")  # mark, number of the request, bytes of the content, their checksum
_MARK = b"xchk"

MOST = 2**30
"""Most bytes of one result."""

_ROOM = 2**24
"""Bytes of a message beside the result."""

_NUMBERS = re.compile(r"[<>|][biuf][0-9]{1,2}")
"""Types of arrays that are taken, as `numpy.dtype.str`: truth values, whole and real numbers."""

_ERRORS = {kind.__name__: kind for kind in (
    errors.CrosscheckError, errors.SceneError, errors.Unsupported, errors.EngineError, errors.ArgumentError,
    ImportError, ValueError, TypeError, ArithmeticError, LookupError, OSError, RuntimeError)}
"""The errors that are raised again in the parent. Of another one the nearest base in this list is."""


class BrokenFrame(ValueError):
    """The bytes from the socket are not a frame of the current request."""


class Done(msgspec.Struct, tag="done", frozen=True):
    """The result of a task, see `encode`, and the warnings meanwhile."""

    result: bytes
    warnings: dict[str, int] = {}  # how often each came


class Crash(msgspec.Struct, tag="crash", frozen=True):
    """Why a task has no result."""

    message: str  # one line
    details: str = ""  # the traceback, or the end of what was printed
    kinds: tuple[str, ...] = ()  # names of the class of what was raised, and of its bases
    warnings: dict[str, int] = {}  # as of `Done`
    at: str = ""  # the last label that the task gave to `crosscheck.jobs.workers.child.at`
    signal: str = ""  # name of the signal that ended the process, for example "SIGKILL"; "" if a limit did

    def error(self) -> Exception | None:
        """What the task raised, with its message; None if nothing, or if the parent does not know its kind."""
        told = self.message.partition(": ")[2]
        return next((_ERRORS[name](told) for name in self.kinds if name in _ERRORS), None)


Answer = str | Done | Crash
"""What a worker sends: what its task does next, and at the end one of the others."""


class Pipe:
    """One end of the socket. `number` is that of the current request, which all its frames carry."""

    def __init__(self, end: socket.socket) -> None:
        self.number, self._end, self._lock = 0, end, threading.Lock()  # threads may report while another one answers
        self._pid, self._file = os.getpid(), os.fstat(end.fileno())

    def send(self, content: bytes) -> None:
        """Write a frame. Raises `EOFError` in a fork of the process, and `OSError` if nobody reads it."""
        if os.getpid() != self._pid:  # the engine's code forked and returned in the child, too
            raise EOFError
        if not os.path.samestat(os.fstat(self._end.fileno()), self._file):
            raise OSError("an engine has replaced the pipe to the parent by another file")
        with self._lock:
            self._end.sendall(HEADER.pack(_MARK, self.number, len(content), zlib.crc32(content)) + content)

    def receive(self, request: bool = False) -> bytes:
        """The content of the next frame; with `request` it may have another number, which becomes the current one.

        Raises `EOFError` or `OSError` if the other end is closed, `BrokenFrame` if the bytes are no such frame.
        """
        mark, number, length, checksum = HEADER.unpack(self._read(HEADER.size))
        if mark != _MARK or not (request or number == self.number) or length > MOST + _ROOM:
            raise BrokenFrame(f"no header of request {self.number}")
        content = self._read(length)
        if zlib.crc32(content) != checksum:
            raise BrokenFrame("the checksum of the content differs")
        self.number = number
        return content

    def quiet(self) -> bool:
        """Whether the other end is open and no bytes wait to be read, as it must be between two requests."""
        try:
            self._end.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except OSError as error:
            return isinstance(error, BlockingIOError)
        return False

    def close(self) -> None:
        """End the exchange; a thread that waits for the other end goes on."""
        with contextlib.suppress(OSError):  # closed by the other end
            self._end.shutdown(socket.SHUT_RDWR)

    def _read(self, count: int) -> bytes:
        content = bytearray()
        while len(content) < count:
            part = self._end.recv(min(count - len(content), 1 << 20))
            if not part:
                raise EOFError
            content += part
        return bytes(content)


def encode(result: object) -> bytes:
    """A result as plain data: dataclasses, structs, containers, numbers, texts, and arrays of numbers.

    Raises `TypeError` for anything else.
    """
    return msgspec.msgpack.encode(result, enc_hook=_plain)


def decode(content: bytes, kind: object) -> Any:
    """The result of type `kind` from its plain data; raises `ValueError` naming the field that is not of its type."""
    try:
        return msgspec.msgpack.decode(content, type=kind, dec_hook=_array)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ValueError(str(error)) from None


def answered(function: Callable[..., Any]) -> Any:
    """The type of the results of a function, from its annotation; without one, any plain data.

    A partial function whose annotation is a type variable returns what the function returns that it is given.
    """
    given: tuple[Any, ...] = ()
    while isinstance(function, functools.partial):
        given, function = (*function.args, *given), function.func
    stated = getattr(function, "__annotations__", {}).get("return", Any)
    holder = types.SimpleNamespace(__annotations__={"return": stated})  # other annotations may name what is not loaded
    kind = typing.get_type_hints(holder, getattr(function, "__globals__", {}))["return"]
    if isinstance(kind, typing.TypeVar):
        kind = answered(next(each for each in given if callable(each)))
    return Any if kind is object else kind


def _plain(value: object) -> object:
    import numpy as np

    if isinstance(value, np.generic) and value.dtype.kind in "biuf":
        return value.item()
    if isinstance(value, np.ndarray) and _NUMBERS.fullmatch(value.dtype.str):
        return value.dtype.str, value.shape, value.tobytes()
    what = f"array of {value.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
    raise TypeError(f"an answer cannot hold an object of type {what}")


def _array(kind: type, content: object) -> object:
    import numpy as np

    if kind is not np.ndarray:
        raise NotImplementedError(f"an answer of type {kind!r}")
    name, shape, data = msgspec.convert(content, tuple[str, tuple[int, ...], bytes])
    if not _NUMBERS.fullmatch(name):
        raise ValueError(f"an array of {name!r}")
    dtype = np.dtype(name)
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(data):
        raise ValueError(f"{len(data)} bytes for an array of {name} and shape {shape}")
    return np.frombuffer(bytearray(data), dtype).reshape(shape)
