"""Frames on the pipes between a worker and its parent: a message arrives unchanged, or the worker is ended.

A frame carries the number of its request and a checksum. They show when an engine has written to the pipe, or has
forked so that two processes answer. The worker is ended then, and only its task is lost. Only the standard library is
imported, because this module also runs in environments that were made for one version of an engine.
"""

from __future__ import annotations

import struct
import zlib

HEADER = struct.Struct(">4sQQI")  # mark, number of the request, bytes of the content, their checksum
_MARK = b"xchk"


class BrokenFrame(Exception):
    """The bytes from the pipe are not a frame of the current request."""


def framed(number: int, content: bytes) -> bytes:
    """The frame that carries `content`."""
    return HEADER.pack(_MARK, number, len(content), zlib.crc32(content)) + content


def number_of(header: bytes) -> int:
    """Number of the request that a frame belongs to."""
    return int(HEADER.unpack(header)[1])


def size(header: bytes, number: int) -> tuple[int, int]:
    """(length in bytes, checksum) of the content. Raises `BrokenFrame` if the header is not of request `number`."""
    mark, own, length, checksum = HEADER.unpack(header)
    if mark != _MARK or own != number:
        raise BrokenFrame(f"{header!r} is no header of request {number}")
    return length, checksum


def check(content: bytes, checksum: int) -> None:
    """Raise `BrokenFrame` if the content is not what was sent."""
    if zlib.crc32(content) != checksum:
        raise BrokenFrame("the checksum of the content differs")
