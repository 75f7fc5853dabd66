"""Datagrams of a socket, and when they came: by the kernel's stamp where it sets one.

So they may be taken several at a time, which costs less, and nobody's clock notices.
"""

import select
import socket
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

_LONGEST = 65536
_STAMPED = getattr(socket, "SO_TIMESTAMPNS", 35) if sys.platform == "linux" else None
"""Option and kind of the stamp, which Python has no name for before 3.14."""
_STAMP = struct.Struct("@ll")
"""Seconds and ns since 1970."""
_ANCILLARY_BYTES = socket.CMSG_SPACE(_STAMP.size) if _STAMPED is not None else 0


@dataclass(frozen=True, slots=True)
class Datagram:
    """What came.

    Attributes:
        content: Its bytes.
        sender: Host and port.
        at_s: When, on the monotonic clock.
        at_us: When, us since 1970.
    """

    content: bytes
    sender: tuple[str, int]
    at_s: float
    at_us: int


class Arrivals:
    """Takes datagrams from a socket that does not wait."""

    def __init__(self, listens: socket.socket) -> None:
        """Ask the kernel for stamps."""
        self._socket = listens
        self._empty_s = time.monotonic()
        if _STAMPED is not None:
            listens.setsockopt(socket.SOL_SOCKET, _STAMPED, 1)

    def wait(self, longest_s: float) -> bool:
        """Wait for something; returns whether there is any."""
        return bool(select.select([self._socket], [], [], longest_s)[0])

    def take(self, most: int) -> Iterator[Datagram]:
        """Those that are there, at most so many."""
        for _ in range(most):
            try:
                content, ancillary, _, sender = self._receive()
            except OSError:  # nothing more is there, or what was sent to nobody came back
                self._empty_s = time.monotonic()
                return
            now_s, now_ns = _both_clocks()
            ago_s = 1e-9 * (now_ns - _stamp_ns(ancillary, now_ns))
            # it came after all before it had been taken, whatever was done to the system's clock
            ago_s = min(max(ago_s, 0.0), now_s - self._empty_s)
            at_us = round(1e-3 * now_ns - 1e6 * ago_s)
            yield Datagram(content, (sender[0], sender[1]), now_s - ago_s, at_us)

    def _receive(self) -> tuple[bytes, list[tuple[int, int, bytes]], int, tuple[str, int]]:
        """As `recvmsg`, which not every system has."""
        if _STAMPED is None:
            content, sender = self._socket.recvfrom(_LONGEST)
            return content, [], 0, sender
        return self._socket.recvmsg(_LONGEST, _ANCILLARY_BYTES)


def _both_clocks() -> tuple[float, int]:
    """The monotonic clock, s, and the system's, ns, at one instant: of three readings that between
    whose two least came."""
    read = ((time.monotonic(), time.time_ns(), time.monotonic()) for _ in range(3))
    _, now_s, now_ns = min((after - before, before, ns) for before, ns, after in read)
    return now_s, now_ns


def _stamp_ns(ancillary: list[tuple[int, int, bytes]], otherwise: int) -> int:
    """The kernel's stamp, ns since 1970."""
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _STAMPED and len(data) == _STAMP.size:
            seconds, ns = _STAMP.unpack(data)
            return int(10**9 * seconds + ns)
    return otherwise
