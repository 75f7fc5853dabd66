"""MAVLink over UDP: datagrams with their time of arrival, frames, the aircraft's clock.

Datagrams carry the kernel's time stamp where it sets one, so they may be taken several at a time,
which costs less, without a change of any time of arrival.

The aircraft's clock: a message that says t left at t and came later, so our time less t is the
offset and the delay. The lowest of many, a line beneath all of them, is the offset and the shortest
delay. Where TIMESYNC is answered, our time of the request less t bounds the offset from below: the
middle of both lines is the offset, as far as the shortest delays there and back are alike.
"""

import math
import select
import socket
import struct
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from twin.logs.mavlink.frames import GCS, Message, MessageParser, Sequence

_LONGEST = 65536
"""Bytes of a datagram, at most: the limit of UDP."""
_STAMPED = getattr(socket, "SO_TIMESTAMPNS", 35) if sys.platform == "linux" else None
"""Option and kind of the stamp, which Python has no name for before 3.14."""
_STAMP = struct.Struct("@ll")
"""Seconds and ns since 1970."""
_ANCILLARY_BYTES = socket.CMSG_SPACE(_STAMP.size) if _STAMPED is not None else 0
"""Space for the kernel's stamp."""


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
            except OSError:  # nothing more is there, or what was sent to a closed port came back
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


Sender = tuple[str, int]
_MOST_OTHERS = 32
"""Other senders that are listed by name; messages of more are counted together."""
MORE_OTHERS = "further senders"  # name of those not listed
_FEW = 10
"""A sender of fewer messages that is silent gives its place to the next aircraft."""


@dataclass(frozen=True, slots=True)
class Received:
    """A message of the aircraft.

    Attributes:
        message: The message.
        frame: Its bytes.
    """

    message: Message
    frame: bytes


@dataclass(slots=True)
class Receiver:
    """Takes datagrams apart and keeps to one aircraft.

    Attributes:
        system: System id of the aircraft; None: the first one that is heard.
        sender: Where its messages come from; None: nothing came yet.
        datagrams: How many came.
        octets: How many bytes.
        others: Messages of other systems, or of the same id from elsewhere, by who sent them: the
            first 32, and `MORE_OTHERS`.
        parser: Takes datagrams apart; counts what is no message.
        silent: Whether the aircraft has not been heard for a while, and may send from another port.
    """

    system: int | None = None
    sender: Sender | None = None
    datagrams: int = 0
    octets: int = 0
    others: Counter[str] = field(default_factory=Counter)
    parser: MessageParser = field(default_factory=MessageParser)
    silent: bool = False
    _wanted: int | None = field(init=False)

    def __post_init__(self) -> None:
        self._wanted = self.system

    @property
    def sequence(self) -> Sequence:
        """Counts of the aircraft's messages."""
        return Sequence() if self.system is None else self.parser.link.of(self.system)

    def messages(self, datagram: bytes, sender: Sender) -> Iterator[Received]:
        """Messages of the aircraft in a datagram, those that came before left out."""
        self.datagrams += 1
        self.octets += len(datagram)
        for message, frame in self.parser.push(
            datagram, lambda m: self._is_of_the_aircraft(m, sender)
        ):
            yield Received(message, frame)

    def _is_of_the_aircraft(self, message: Message, sender: Sender) -> bool:
        system = message.get_srcSystem()
        if message.get_type() == "HEARTBEAT" and message.type == GCS:
            return self._is_other(f"ground station, system {system}")
        if self.silent and self.sender != sender and self.sequence.received < _FEW:
            self.system, self.sender = self._wanted, None  # what was heard first was no aircraft
        if self.sender is None and self.system in (None, system) and _is_vehicle(message):
            self.system, self.sender = system, sender
        if self.sender is None:
            return False
        if system != self.system:
            return self._is_other(f"system {system} at {sender[0]}:{sender[1]}")
        if sender != self.sender and not (self.silent and sender[0] == self.sender[0]):
            return self._is_other(f"system {system} again, at {sender[0]}:{sender[1]}")
        if sender != self.sender:
            self.sender = sender  # of the same machine, after a silence
        return True

    def _is_other(self, who: str) -> bool:
        """Count a message that is not of the aircraft."""
        known = who in self.others or len(self.others) < _MOST_OTHERS
        self.others[who if known else MORE_OTHERS] += 1
        return False


def _is_vehicle(message: Message) -> bool:
    """Whether a message is one of an aircraft, not of what stands on the ground.

    One of an unknown kind has no checksum that could be tested: random bytes look like it.
    """
    kind = message.get_type()
    known = not kind.startswith("UNKNOWN")
    return bool(message.get_srcSystem()) and known and kind != "TIMESYNC"


Point = tuple[float, float]
MEMORY_S = 60.0
"""Older points are forgotten: clocks drift with temperature."""
_BIN_S = 0.5
"""Length of a bin of which the lowest point is stored, s. Made up."""
_LONG_ENOUGH_S = 5.0
"""A shorter time says nothing of the drift."""


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """What is known of the aircraft's clock.

    Attributes:
        aircraft_s: Newest time of the aircraft, at which the offset holds, s.
        offset_s: Our time less the aircraft's, s.
        drift_ppm: By how much the aircraft's clock is faster; NaN: not known yet.
        source: `TIMESYNC`, or `arrivals`: the offset holds the shortest delay of the link as well.
        width_s: Between the bounds from above and below; infinite without TIMESYNC.
    """

    aircraft_s: float
    offset_s: float
    drift_ppm: float
    source: str
    width_s: float


@dataclass(slots=True)
class ClockWatch:
    """Estimates offset and drift of the aircraft's clock from times of messages."""

    _above: dict[int, Point] = field(default_factory=dict)
    _below: dict[int, Point] = field(default_factory=dict)
    _now_s: float = -math.inf

    def came(self, aircraft_s: float, at_s: float) -> None:
        """A message that says a time of the aircraft came at a time of ours, s."""
        self._now_s = max(self._now_s, aircraft_s)
        _keep_lowest(self._above, aircraft_s, at_s - aircraft_s)

    def answered(self, request_s: float, aircraft_s: float, at_s: float) -> None:
        """TIMESYNC: request and answer at times of ours, what the aircraft's clock was between."""
        self.came(aircraft_s, at_s)
        _keep_lowest(self._below, aircraft_s, -(request_s - aircraft_s))

    def estimate(self) -> ClockEstimate | None:
        """What is known now; None: no message has come."""
        self._forget()
        above = _line(list(self._above.values()))
        if above is None:
            return None
        now, slope = self._now_s, above[1]
        high = _at(above, now)
        if not self._below:
            return ClockEstimate(now, high, _ppm(slope), "arrivals", math.inf)
        # Answers are few: their line has the slope of the other one.
        level = 0.0 if math.isnan(slope) else slope
        least = max(-y + level * (now - x) for x, y in self._below.values())
        return ClockEstimate(
            now, (high + least) / 2, _ppm(slope), "TIMESYNC", max(high - least, 0.0)
        )

    def _forget(self) -> None:
        oldest = math.floor((self._now_s - MEMORY_S) / _BIN_S) if math.isfinite(self._now_s) else 0
        for points in (self._above, self._below):
            for key in [k for k in points if k < oldest]:
                del points[key]


def _keep_lowest(points: dict[int, Point], x: float, y: float) -> None:
    key = math.floor(x / _BIN_S)
    if key not in points or y < points[key][1]:
        points[key] = (x, y)


def _at(line: tuple[float, float], x: float) -> float:
    return line[0] + (0.0 if math.isnan(line[1]) else line[1] * x)


def _ppm(slope: float) -> float:
    """The offset falls by as much as the aircraft's clock is faster."""
    return -1e6 * slope / (1.0 + slope)


def _line(points: list[Point]) -> tuple[float, float] | None:
    """The line beneath all points that is nearest to them: value at 0, and slope.

    It is the edge of their lower convex hull over their middle. Over a short time it is level.
    """
    if not points:
        return None
    points = sorted(points)
    if points[-1][0] - points[0][0] < _LONG_ENOUGH_S:
        return min(y for _, y in points), math.nan
    hull: list[Point] = []
    for p in points:
        while len(hull) > 1 and _turns_right(hull[-2], hull[-1], p):
            hull.pop()
        hull.append(p)
    middle = sum(x for x, _ in points) / len(points)
    k = next(i for i in range(1, len(hull)) if hull[i][0] >= middle)
    (x0, y0), (x1, y1) = hull[k - 1], hull[k]
    slope = (y1 - y0) / (x1 - x0)
    return y0 - slope * x0, slope


def _turns_right(a: Point, b: Point, c: Point) -> bool:
    """Whether b lies on or above the line from a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
