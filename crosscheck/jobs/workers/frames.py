"""Frames on the pipes between a worker and its parent: a message arrives unchanged, or the worker is ended.

A frame carries the number of its request and a checksum. They show when an engine has written to the pipe, or has
forked so that two processes answer. The worker is ended then, and only its task is lost.

What a worker answers is plain data (msgpack), decoded strictly to the type that the function is annotated to return.
It is never unpickled, because an engine could then run code in the parent. Of the packages only msgspec and NumPy are
imported, because this module also runs in environments that were made for one version of an engine.
"""

from __future__ import annotations

import functools
import math
import re
import struct
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


class BrokenFrame(Exception):
    """The bytes from the pipe are not a frame of the current request."""


class At(msgspec.Struct, tag="at", frozen=True):
    """What the task does next."""

    label: str


class Done(msgspec.Struct, tag="done", frozen=True):
    """The result of a task, see `encode`, and the warnings meanwhile."""

    result: bytes
    warnings: dict[str, int] = {}  # how often each came


class Raised(msgspec.Struct, tag="raised", frozen=True):
    """The error that ended a task."""

    words: str  # one line, with the name of its class
    where: str  # the traceback
    kinds: tuple[str, ...]  # names of its class and of the bases
    message: str
    warnings: dict[str, int] = {}  # how often each came

    def error(self) -> Exception | None:
        """The error with its message; None if it is of no kind that the parent knows."""
        kind = next((_ERRORS[name] for name in self.kinds if name in _ERRORS), None)
        return None if kind is None else kind(self.message)


Answer = At | Done | Raised


def framed(number: int, content: bytes) -> bytes:
    """The frame that carries `content`."""
    return HEADER.pack(_MARK, number, len(content), zlib.crc32(content)) + content


def number_of(header: bytes) -> int:
    """Number of the request that a frame belongs to."""
    return int(HEADER.unpack(header)[1])


def size(header: bytes, number: int) -> tuple[int, int]:
    """(length in bytes, checksum) of the content. Raises `BrokenFrame` if the header is not of request `number`."""
    mark, own, length, checksum = HEADER.unpack(header)
    if mark != _MARK or own != number or length > MOST + _ROOM:
        raise BrokenFrame(f"{header!r} is no header of request {number}")
    return length, checksum


def check(content: bytes, checksum: int) -> None:
    """Raise `BrokenFrame` if the content is not what was sent."""
    if zlib.crc32(content) != checksum:
        raise BrokenFrame("the checksum of the content differs")


def packed(answer: Answer) -> bytes:
    """The content of a frame."""
    return msgspec.msgpack.encode(answer)


def unpacked(content: bytes) -> Answer:
    """The answer in a frame; raises `BrokenFrame` if it is none."""
    try:
        answer: Answer = msgspec.msgpack.decode(content, type=Answer)
        return answer
    except (msgspec.MsgspecError, RecursionError) as error:
        raise BrokenFrame(str(error)) from None


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
