"""Replay of a flight as a MAVLink aircraft: in real time, faster, or in lockstep with the listener.

`Faults` are those of a radio link: some datagrams are lost, all are delayed by different times.
"""

import contextlib
import heapq
import select
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from twin.errors import LogError, TwinError
from twin.logs import Flight
from twin.logs.columns import MAX_MOTORS, POS, QUAT, VEL
from twin.logs.mavlink.encode import attitude, heartbeat, landed, local_position, messages_of
from twin.logs.mavlink.frames import AUTOPILOT, BAD, Message, dialect, packed, parser
from twin.logs.rotor_lag import as_stamped

from ..sockets import Address, sending


@dataclass(frozen=True, slots=True)
class Faults:
    """Faults of a link, drawn with a seed.

    Attributes:
        loss: Share of lost datagrams, 0..1.
        jitter_s: Largest delay of a datagram, uniformly distributed, s.
        drift: Relative rate of the aircraft's clock against the listener's: 2e-5 is 20 ppm faster.
        seed: Seed of the random numbers.
    """

    loss: float = 0.0
    jitter_s: float = 0.0
    drift: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.loss < 1.0:
            raise TwinError(f"loss {self.loss:g}: a share of 0 to below 1, 0.05 for 5 %.")
        if not 0.0 <= self.jitter_s <= 10.0:
            raise TwinError(f"jitter {self.jitter_s:g} s: 0 to 10 s.")
        if not abs(self.drift) <= 1e-2:
            raise TwinError(f"drift {1e6 * self.drift:g} ppm: at most 10000 ppm.")


@dataclass(slots=True)
class FaultyLink:
    """A link with faults: datagrams in, datagrams out at their time of arrival.

    Attributes:
        faults: Faults of the link.
        lost: Number of lost datagrams.
    """

    faults: Faults
    lost: int = 0
    _rng: np.random.Generator = field(init=False)
    _on_the_way: list[tuple[float, int, bytes]] = field(default_factory=list)
    _count: int = 0

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.faults.seed)

    def send(self, at_s: float, datagram: bytes) -> None:
        """Send a datagram at a time, s."""
        self._count += 1
        if self.faults.loss and self._rng.random() < self.faults.loss:
            self.lost += 1
            return
        late_s = self._rng.random() * self.faults.jitter_s if self.faults.jitter_s else 0.0
        heapq.heappush(self._on_the_way, (at_s + late_s, self._count, datagram))

    def due(self, now_s: float) -> list[bytes]:
        """Datagrams that have arrived by now, in order of arrival."""
        found = []
        while self._on_the_way and self._on_the_way[0][0] <= now_s:
            found.append(heapq.heappop(self._on_the_way)[2])
        return found

    @property
    def next_s(self) -> float:
        """Time of the next arrival; infinite without one."""
        return self._on_the_way[0][0] if self._on_the_way else np.inf


BOOT_US = 10_000_000
"""Time on the aircraft's clock at time 0 of the flight, us."""
_SCREEN_US = 100_000
"""Interval of messages for the displays of ground stations."""
_BEAT_US = 1_000_000
"""Interval of heartbeats, us, as MAVLink recommends."""


def motors_of(flight: Flight) -> int:
    """Number of motors in a flight."""
    stems = ("cmd", "rotor")
    return max(
        (i for i in range(1, MAX_MOTORS + 1) for s in stems if flight.has(f"{s}_{i}")), default=0
    )


def played(flight: Flight) -> Iterator[tuple[int, list[Message]]]:
    """Messages in order of time, each batch with its time on the aircraft's clock, us.

    Raises:
        LogError: The flight begins before time 0.
    """
    table, motors = flight.table, motors_of(flight)
    names = [str(c) for c in table if c not in ("time", "phase")]
    t_us = BOOT_US + np.round(1e6 * flight.time_s).astype(np.int64)
    if t_us[0] < 0:
        raise LogError(f"{flight.name}: begins at {flight.time_s[0]:g} s; a boot is at -10 s.")
    values = table[names].to_numpy(dtype=np.float64)
    codes, phases = flight.phase_codes
    known = np.isfinite(values)
    beat_us = screen_us = landed_us = -_BEAT_US
    sent_code = -1
    pose: dict[str, float] = {}
    for k, t in enumerate(t_us.tolist()):
        row = {names[i]: float(values[k, i]) for i in np.flatnonzero(known[k])}
        found: list[Message] = []
        if t - beat_us >= _BEAT_US:
            found.append(heartbeat(motors or None))
            beat_us = t
        found += messages_of(t, row, motors)
        if any(phases) and (codes[k] != sent_code or t - landed_us >= _BEAT_US):
            found.append(landed(str(phases[codes[k]])))
            sent_code, landed_us = int(codes[k]), t
        pose |= {c: row[c] for c in (*POS, *VEL, *QUAT) if c in row}
        if t - screen_us >= _SCREEN_US and (screen := _screen(t, pose)):
            found += screen
            screen_us = t
        if found:
            yield t, found


def _screen(t_us: int, pose: dict[str, float]) -> list[Message]:
    """Messages for the display of a ground station: the last known pose."""
    found = []
    if set(QUAT) <= set(pose):
        found.append(attitude(t_us, [pose[c] for c in QUAT], (0.0, 0.0, 0.0)))
    if {*POS, *VEL} <= set(pose):
        found.append(local_position(t_us, [pose[c] for c in POS], [pose[c] for c in VEL]))
    return found


MAX_SPEED = float("inf")
"""Speed that means: as fast as the listener receives."""
_STEP_US = 100_000
"""Interval of flight time at which an answer is awaited."""
_ANSWER_S = 10.0
"""Longest time for an answer to TIMESYNC, s. Made up."""
_ASK_AGAIN_S = 0.5
"""Interval of TIMESYNC requests, s. Made up."""


@dataclass(frozen=True, slots=True)
class Played:
    """Summary of the messages sent.

    Attributes:
        messages: Number of messages.
        lost: Number of messages lost by simulated faults.
        seconds: Duration of the flight.
        wall_s: Duration of the replay.
    """

    messages: int
    lost: int
    seconds: float
    wall_s: float


class Replay:
    """An aircraft that sends a flight."""

    def __init__(
        self, to: Address, speed: float = 1.0, faults: Faults | None = None, system: int = 1
    ) -> None:
        """Open the connection.

        Args:
            to: Address of the listener.
            speed: Multiple of real time; `MAX_SPEED`: in lockstep with the listener, who must
                answer TIMESYNC; loss and jitter are then not possible.
            faults: Faults of the link; None: none.
            system: System id of the aircraft.

        Raises:
            TwinError: The numbers are invalid, or there is no such host.
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
        self._link = FaultyLink(self._faults)
        self._messages = 0
        self._answered = -1
        self._began_s = 0.0

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def play(self, flight: Flight, progress: Callable[[float], None] = lambda _: None) -> Played:
        """Send a flight from its start to its end, with the time stamps of its log.

        Raises:
            TwinError: The listener does not answer.
        """
        flight = as_stamped(flight)
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
            # at its scheduled time, not at that of a busy machine
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

    @property
    def _pace(self) -> float:
        """Seconds of the aircraft's clock per local second."""
        return self._speed * (1.0 + self._faults.drift)

    def _due_s(self, t_us: int) -> float:
        return self._began_s + (t_us - self._first_us) * 1e-6 / self._pace

    def _send(self, message: Message, at_s: float | None = None) -> None:
        frame = packed(message, self._packer)
        self._messages += 1
        self._link.send(time.monotonic() if at_s is None else at_s, frame)

    def _deliver(self) -> None:
        now = time.monotonic() if self._faults.jitter_s else float("inf")
        for datagram in self._link.due(now):
            with contextlib.suppress(OSError):  # no listener there yet
                select.select([], [self._socket], [], 1.0)
                self._socket.sendto(datagram, self._to.pair)

    def _wait_until(self, due_s: float) -> None:
        """Deliver and answer until a time."""
        while (left := due_s - time.monotonic()) > 0:
            wait = max(min(left, self._link.next_s - time.monotonic()), 0.0)
            self._answer(wait)
            self._deliver()

    def _await_listener(self, token: int) -> None:
        """Send a request, and wait until all earlier messages were received."""
        self._deliver()
        until, again = time.monotonic() + _ANSWER_S, 0.0
        while self._answered < token:
            now = time.monotonic()
            if now > until:
                raise TwinError(
                    f"{self._to}: no answer to TIMESYNC, which --speed max needs. Start "
                    f"uavtwin live first, or give a speed."
                )
            if now > again:
                self._send(dialect.MAVLink_timesync_message(0, token))
                self._deliver()
                again = now + _ASK_AGAIN_S
            self._answer(0.05)

    def _answer(self, wait_s: float) -> None:
        """Receive messages within a time: requests for the time, and answers."""
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
