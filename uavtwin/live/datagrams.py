"""MAVLink over UDP: datagrams with their time of arrival, frames, the aircraft's clock.

Datagrams have the kernel's time stamp where available, so several may be received at a time, which
is cheaper, without changing their times of arrival.

The aircraft's clock: a message with time t left at t and arrived later, so local time less t is the
offset plus the delay. The lower bound of many, a line below all of them, is the offset plus the
shortest delay. Where TIMESYNC is answered, local time of the request less t bounds the offset from
below: the offset is the middle of both lines, if the shortest delays in both directions are equal.
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
"""Largest size of a datagram: the limit of UDP."""
_STAMPED = getattr(socket, "SO_TIMESTAMPNS", 35) if sys.platform == "linux" else None
"""Option and kind of the stamp, without a name in Python before 3.14."""
_STAMP = struct.Struct("@ll")
"""Layout of the stamp: seconds and ns since 1970."""
_ANCILLARY_BYTES = socket.CMSG_SPACE(_STAMP.size) if _STAMPED is not None else 0
"""Space for the kernel's stamp."""


@dataclass(frozen=True, slots=True)
class Datagram:
    """A received datagram.

    Attributes:
        content: Bytes of the datagram.
        sender: Host and port.
        at_s: Time of arrival, on the monotonic clock.
        at_us: Time of arrival, us since 1970.
    """

    content: bytes
    sender: tuple[str, int]
    at_s: float
    at_us: int


class Arrivals:
    """Receiver of datagrams from a non-blocking socket."""

    def __init__(self, listens: socket.socket) -> None:
        """Enable time stamps of the kernel."""
        self._socket = listens
        self._empty_s = time.monotonic()
        if _STAMPED is not None:
            listens.setsockopt(socket.SOL_SOCKET, _STAMPED, 1)

    def wait(self, longest_s: float) -> bool:
        """Wait for a datagram; returns whether there is one."""
        return bool(select.select([self._socket], [], [], longest_s)[0])

    def take(self, most: int) -> Iterator[Datagram]:
        """The datagrams available, up to a number."""
        for _ in range(most):
            try:
                content, ancillary, _, sender = self._receive()
            except OSError:  # none left, or a message to a closed port was returned
                self._empty_s = time.monotonic()
                return
            now_s, now_ns = _both_clocks()
            ago_s = 1e-9 * (now_ns - _stamp_ns(ancillary, now_ns))
            # it arrived after all earlier ones were received, also if the system's clock was set
            ago_s = min(max(ago_s, 0.0), now_s - self._empty_s)
            at_us = round(1e-3 * now_ns - 1e6 * ago_s)
            yield Datagram(content, (sender[0], sender[1]), now_s - ago_s, at_us)

    def _receive(self) -> tuple[bytes, list[tuple[int, int, bytes]], int, tuple[str, int]]:
        """Replacement of `recvmsg`, which some systems lack."""
        if _STAMPED is None:
            content, sender = self._socket.recvfrom(_LONGEST)
            return content, [], 0, sender
        return self._socket.recvmsg(_LONGEST, _ANCILLARY_BYTES)


def _both_clocks() -> tuple[float, int]:
    """The monotonic clock, s, and the system's, ns, at one instant: of three readings the one with
    the shortest duration."""
    read = ((time.monotonic(), time.time_ns(), time.monotonic()) for _ in range(3))
    _, now_s, now_ns = min((after - before, before, ns) for before, ns, after in read)
    return now_s, now_ns


def _stamp_ns(ancillary: list[tuple[int, int, bytes]], otherwise: int) -> int:
    """Time stamp of the kernel, ns since 1970."""
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _STAMPED and len(data) == _STAMP.size:
            seconds, ns = _STAMP.unpack(data)
            return int(10**9 * seconds + ns)
    return otherwise


Sender = tuple[str, int]
_MOST_OTHERS = 32
"""Largest number of other senders listed by name; messages of more are counted together."""
MORE_OTHERS = "further senders"  # name for those not listed
_FEW = 10
"""Number of messages below which a silent sender is replaced by the next aircraft."""


@dataclass(frozen=True, slots=True)
class Received:
    """A message from the aircraft.

    Attributes:
        message: The message.
        frame: Bytes of its frame.
    """

    message: Message
    frame: bytes


@dataclass(slots=True)
class Receiver:
    """Parser of datagrams that selects one aircraft.

    Attributes:
        system: System id of the aircraft; None: the first one received.
        sender: Sender of its messages; None: none so far.
        datagrams: Number of datagrams received.
        octets: Number of bytes received.
        others: Messages of other systems, or of the same id from another sender, by sender: the
            first 32, and `MORE_OTHERS`.
        parser: Parser of the datagrams, with counts of invalid messages.
        silent: Whether the aircraft has been silent for some time, and may send from another port.
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
        """Counts of the aircraft's messages by sequence number."""
        return Sequence() if self.system is None else self.parser.link.of(self.system)

    def messages(self, datagram: bytes, sender: Sender) -> Iterator[Received]:
        """Messages of the aircraft in a datagram, without duplicates."""
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
            self.system, self.sender = self._wanted, None  # the first sender was no aircraft
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
        """Whether a message is not of the aircraft; such messages are counted."""
        known = who in self.others or len(self.others) < _MOST_OTHERS
        self.others[who if known else MORE_OTHERS] += 1
        return False


def _is_vehicle(message: Message) -> bool:
    """Whether a message is from an aircraft, not from a ground station.

    Messages of unknown kind have no verifiable checksum: random bytes may look like one.
    """
    kind = message.get_type()
    known = not kind.startswith("UNKNOWN")
    return bool(message.get_srcSystem()) and known and kind != "TIMESYNC"


Point = tuple[float, float]
MEMORY_S = 60.0
"""Age of points that are dropped: clocks drift with temperature."""
_BIN_S = 0.5
"""Length of a bin whose lowest point is stored, s. Made up."""
_LONG_ENOUGH_S = 5.0
"""Shortest time from which a drift is estimated."""


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """Estimated relation of the aircraft's clock to the local one.

    Attributes:
        aircraft_s: Newest time of the aircraft, for which the offset is valid, s.
        offset_s: Local time less the aircraft's, s.
        drift_ppm: Relative rate of the aircraft's clock, positive if faster; NaN: not known yet.
        source: Source: `TIMESYNC`, or `arrivals`, where the offset includes the shortest delay of
            the link.
        width_s: Distance of the upper and lower bounds; infinite without TIMESYNC.
    """

    aircraft_s: float
    offset_s: float
    drift_ppm: float
    source: str
    width_s: float


@dataclass(slots=True)
class ClockWatch:
    """Estimator for offset and drift of the aircraft's clock from times of messages."""

    _above: dict[int, Point] = field(default_factory=dict)
    _below: dict[int, Point] = field(default_factory=dict)
    _now_s: float = -math.inf

    def came(self, aircraft_s: float, at_s: float) -> None:
        """Add a message with a time of the aircraft that arrived at a local time, s."""
        self._now_s = max(self._now_s, aircraft_s)
        _keep_lowest(self._above, aircraft_s, at_s - aircraft_s)

    def answered(self, request_s: float, aircraft_s: float, at_s: float) -> None:
        """Add a TIMESYNC exchange: local times of request and answer, and the aircraft's time in
        between."""
        self.came(aircraft_s, at_s)
        _keep_lowest(self._below, aircraft_s, -(request_s - aircraft_s))

    def estimate(self) -> ClockEstimate | None:
        """Present estimate; None: no message so far."""
        self._forget()
        above = _line(list(self._above.values()))
        if above is None:
            return None
        now, slope = self._now_s, above[1]
        high = _at(above, now)
        if not self._below:
            return ClockEstimate(now, high, _ppm(slope), "arrivals", math.inf)
        # Answers are rare: their line is given the slope of the other one.
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
    """Relative clock rate from the slope of the offset, which falls for a faster clock."""
    return -1e6 * slope / (1.0 + slope)


def _line(points: list[Point]) -> tuple[float, float] | None:
    """The nearest line below all points: value at 0, and slope.

    It is the edge of their lower convex hull at their middle. Over a short time it is level.
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
    """Whether b is on or above the line from a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
