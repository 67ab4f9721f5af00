"""Frames on the pipes between a worker and its parent: what is received is what was sent, or the pipe is given up.

A frame carries the number of the request that it belongs to and a checksum. An engine that writes to descriptors it
does not own, or that forks and answers twice, is noticed at the next frame and costs its worker, no other engine's run.
Only the standard library is imported: the worker's side also runs in environments made for one version of an engine.
"""

from __future__ import annotations

import struct
import zlib

HEADER = struct.Struct(">4sQQI")  # mark, number of the request, bytes of the content, their checksum
_MARK = b"xchk"


class BrokenFrame(Exception):
    """What came through the pipe is no frame of the request that is being answered."""


def framed(number: int, content: bytes) -> bytes:
    """The frame that carries `content`."""
    return HEADER.pack(_MARK, number, len(content), zlib.crc32(content)) + content


def number_of(header: bytes) -> int:
    """The request that a frame belongs to."""
    return int(HEADER.unpack(header)[1])


def size(header: bytes, number: int) -> tuple[int, int]:
    """(bytes of the content, checksum) that a header announces; `BrokenFrame` where it does not answer `number`."""
    mark, own, length, checksum = HEADER.unpack(header)
    if mark != _MARK or own != number:
        raise BrokenFrame(f"{header!r} is no header of request {number}")
    return length, checksum


def check(content: bytes, checksum: int) -> None:
    """Raise `BrokenFrame` where the content is not what was sent."""
    if zlib.crc32(content) != checksum:
        raise BrokenFrame("the checksum of the content differs")
