"""Play a flight as a MAVLink aircraft, in real time, faster, or in step with who listens."""

import contextlib
import select
import time
from collections.abc import Callable
from dataclasses import dataclass

from twin.errors import TwinError
from twin.logs import Flight
from twin.logs.mavlink.frames import AUTOPILOT, BAD, Message, dialect, parser

from .address import Address, sending
from .faults import Faults, Link
from .played import BOOT_US, played

MAX_SPEED = float("inf")
"""As fast as the listener takes it."""
_STEP_US = 100_000
"""Of the flight, between two times at which an answer is waited for."""
_ANSWER_S = 10.0
_ASK_AGAIN_S = 0.5


@dataclass(frozen=True, slots=True)
class Played:
    """What was sent.

    Attributes:
        messages: How many.
        lost: How many of them were lost on purpose.
        seconds: Of the flight.
        wall_s: That it took.
    """

    messages: int
    lost: int
    seconds: float
    wall_s: float


class Replay:
    """One aircraft that sends a flight."""

    def __init__(
        self, to: Address, speed: float = 1.0, faults: Faults | None = None, system: int = 1
    ) -> None:
        """Open the way there.

        Args:
            to: Who listens.
            speed: Times real time; `MAX_SPEED`: in step with the listener, who has to answer
                TIMESYNC; loss and jitter then have no place.
            faults: Of the link; None: none.
            system: System id.

        Raises:
            TwinError: The numbers make no sense, or there is no such host.
        """
        self._faults = faults or Faults()
        if not speed > 0:
            raise TwinError(f"--speed {speed:g}: more than 0, or max.")
        if speed == MAX_SPEED and (self._faults.loss or self._faults.jitter_s):
            raise TwinError("--speed max: sends in step with the listener, without loss or jitter.")
        if not 1 <= system <= 255:
            raise TwinError(f"--system {system}: 1 to 255.")
        self._to, self._speed = to, speed
        self._socket = sending(to)
        self._packer, self._reader = parser(system, AUTOPILOT), parser()
        self._link = Link(self._faults)
        self._messages = 0
        self._answered = -1
        self._began_s = 0.0

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()

    def play(self, flight: Flight, progress: Callable[[float], None] = lambda _: None) -> Played:
        """Send a flight from its begin to its end.

        Raises:
            TwinError: The listener that has to answer does not.
        """
        began = self._began_s = time.monotonic()
        first_us, last_us = (BOOT_US + round(1e6 * float(flight.time_s[k])) for k in (0, -1))
        self._first_us, step_us, t_us = first_us, first_us + _STEP_US, first_us
        for t_us, messages in played(flight):
            if self._speed == MAX_SPEED:
                if t_us >= step_us:
                    self._await_listener(t_us)
                    step_us = t_us + _STEP_US
            else:
                self._wait_until(self._due_s(t_us))
            # as late as it is due, not as late as a busy machine gets to it
            at_s = None if self._speed == MAX_SPEED else self._due_s(t_us)
            for message in messages:
                self._send(message, at_s)
            self._deliver()
            progress((t_us - first_us) / max(last_us - first_us, 1))
        if self._speed == MAX_SPEED:
            self._await_listener(t_us + 1)
        else:
            self._wait_until(time.monotonic() + self._faults.jitter_s)
            self._deliver()
        seconds = (t_us - first_us) * 1e-6
        return Played(self._messages, self._link.lost, seconds, time.monotonic() - began)

    def listener_time_s(self, aircraft_s: float) -> float:
        """This machine's monotonic clock when the aircraft's clock says a time, s."""
        return self._due_s(round(1e6 * aircraft_s))

    @property
    def _pace(self) -> float:
        """Seconds of the aircraft's clock per second of ours."""
        return self._speed * (1.0 + self._faults.drift)

    def _due_s(self, t_us: int) -> float:
        return self._began_s + (t_us - self._first_us) * 1e-6 / self._pace

    def _send(self, message: Message, at_s: float | None = None) -> None:
        frame = message.pack(self._packer)
        self._packer.seq = (self._packer.seq + 1) % 256
        self._messages += 1
        self._link.send(time.monotonic() if at_s is None else at_s, bytes(frame))

    def _deliver(self) -> None:
        now = time.monotonic() if self._faults.jitter_s else float("inf")
        for datagram in self._link.due(now):
            with contextlib.suppress(OSError):  # nobody listens there, as yet
                select.select([], [self._socket], [], 1.0)
                self._socket.sendto(datagram, self._to.pair)

    def _wait_until(self, due_s: float) -> None:
        """Deliver and answer until then."""
        while (left := due_s - time.monotonic()) > 0:
            wait = max(min(left, self._link.next_s - time.monotonic()), 0.0)
            self._answer(wait)
            self._deliver()

    def _await_listener(self, token: int) -> None:
        """Ask, and wait until all that was sent before has been taken."""
        self._deliver()
        until, again = time.monotonic() + _ANSWER_S, 0.0
        while self._answered < token:
            now = time.monotonic()
            if now > until:
                raise TwinError(
                    f"{self._to}: nobody there answers TIMESYNC, which --speed max goes by. Start "
                    f"uavtwin live first, or give a speed."
                )
            if now > again:
                self._send(dialect.MAVLink_timesync_message(0, token))
                self._deliver()
                again = now + _ASK_AGAIN_S
            self._answer(0.05)

    def _answer(self, wait_s: float) -> None:
        """Take what comes in within a time: questions for the time, and answers."""
        if not select.select([self._socket], [], [], wait_s)[0]:
            return
        while True:
            try:
                datagram = self._socket.recv(65536)
            except OSError:
                return
            for m in self._reader.parse_buffer(datagram) or ():
                if m.get_type() == BAD or m.get_type() != "TIMESYNC":
                    continue
                if m.tc1:
                    self._answered = max(self._answered, m.ts1)
                elif self._speed != MAX_SPEED:
                    elapsed = (time.monotonic() - self._began_s) * self._pace
                    clock_ns = 1000 * self._first_us + round(1e9 * elapsed)
                    self._send(dialect.MAVLink_timesync_message(clock_ns, m.ts1))
