"""Messages of the live page: from the session to the queues of its viewers.

Viewers get new messages at once, and those of the last minutes when they join. A sender never waits
for a viewer: each has a queue of its own, and a slow one loses its oldest messages. Grey bands
contain 95 % of the residuals of the first seconds: later residuals are compared with the earlier
error of the twin.
"""

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from twin.frames import to_euler
from twin.logs.autopilot import LEVELS
from twin.logs.columns import ACC, EULER, GYRO, POS, QUAT, VEL
from twin.logs.mavlink.decoder import Sample, columns_of
from twin.residuals.gap import Channel
from twin.residuals.stream_residuals import ResidualBlock
from twin.why.watch import Alarm

from ...record import plain
from ..following import Following, Reading
from ..status import LiveStatus, alarm_json

HISTORY_S = 300.0
"""Length of the flight that is stored for later viewers."""
_MOST_STORED = 20_000
"""Largest number of stored messages. Made up."""
_MOST_KEYS = 500
"""Largest number of keys whose newest message is stored. Made up."""
QUEUE = 64
"""Largest number of messages in a viewer's queue, about three seconds."""
MOST_VIEWERS = 32
"""Largest number of simultaneous viewers. Made up."""
SILENT_S = 60.0
"""Silence after which a viewer may be replaced if there are too many: the page asks for the time
every 2 s, in the background once a minute."""


class Viewer:
    """One viewer.

    Attributes:
        dropped: Number of messages lost because the viewer was too slow.
        heard_s: Time of its last request, on the clock of the hub.
        ended: Whether its connection must end.
    """

    def __init__(
        self, wake: Callable[[], object], history: list[bytes], now_s: float = 0.0
    ) -> None:
        self._wake, self._history = wake, history
        self._queue: deque[bytes] = deque()
        self.dropped, self.heard_s, self.ended = 0, now_s, False

    def end(self) -> None:
        """End its connection; from any thread."""
        self.ended = True
        with contextlib.suppress(RuntimeError):
            self._wake()

    def put(self, message: bytes) -> None:
        """Add a message to its queue; from any thread."""
        if len(self._queue) >= QUEUE:
            with contextlib.suppress(IndexError):  # it was just taken
                self._queue.popleft()
                self.dropped += 1
        self._queue.append(message)
        with contextlib.suppress(RuntimeError):  # its event loop has ended
            self._wake()

    def take(self) -> bytes:
        """All waiting messages, as one JSON array; empty without any."""
        messages, self._history = self._history, []
        with contextlib.suppress(IndexError):
            while len(messages) < _MOST_STORED:
                messages.append(self._queue.popleft())
        return b"[" + b",".join(messages) + b"]" if messages else b""


class Hub:
    """Distributor of messages from any thread to all viewers."""

    def __init__(
        self, history_s: float = HISTORY_S, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._history_s, self._clock = history_s, clock
        self._lock = threading.Lock()
        self._past: deque[tuple[float, bytes]] = deque(maxlen=_MOST_STORED)
        self._newest: dict[str, bytes] = {}
        self._viewers: list[Viewer] = []

    @property
    def viewers(self) -> int:
        """Number of viewers."""
        return len(self._viewers)

    def send(self, kind: str, content: Mapping[str, Any], key: str = "", keep: bool = True) -> None:
        """Send a message to all viewers.

        Args:
            kind: Kind of the message.
            content: Content; numbers that are not finite become null.
            key: Key; of messages with the same key only the newest is stored for later viewers.
            keep: Whether it is stored for later viewers.
        """
        message = msgspec.json.encode({"kind": kind, **content})
        with self._lock:
            now = self._clock()
            if keep and key:
                self._newest.pop(key, None)
                self._newest[key] = message
                if len(self._newest) > _MOST_KEYS:
                    del self._newest[next(iter(self._newest))]
            elif keep:
                self._past.append((now, message))
            while self._past and self._past[0][0] < now - self._history_s:
                self._past.popleft()
            for viewer in self._viewers:
                viewer.put(message)

    def join(self, wake: Callable[[], object]) -> Viewer | None:
        """A new viewer; None: there are too many.

        Args:
            wake: Called from any thread when there is a message for it.
        """
        with self._lock:
            now = self._clock()
            if len(self._viewers) >= MOST_VIEWERS:
                quietest = min(self._viewers, key=lambda v: v.heard_s)
                if now - quietest.heard_s <= SILENT_S:
                    return None
                self._viewers.remove(quietest)
                quietest.end()
            history = [*self._newest.values(), *(m for _, m in self._past)]
            viewer = Viewer(wake, history, now)
            self._viewers.append(viewer)
            return viewer

    def leave(self, viewer: Viewer) -> None:
        """Remove a viewer."""
        with self._lock, contextlib.suppress(ValueError):
            self._viewers.remove(viewer)


LEARNT_S = 20.0
"""Length of flight in the air from which the band is computed; it is constant afterwards."""
COVERED = 0.95
"""Share of the residuals within a band."""
_FEWEST = 20
"""Fewest samples for a band. Made up."""
Key = tuple[str, float]


@dataclass(slots=True)
class ExpectedBands:
    """Expected bands of the channels of one flight, by name and horizon."""

    bands: dict[Key, tuple[float, float]] = field(default_factory=dict)
    _parts: dict[Key, list[NDArray[np.float64]]] = field(default_factory=dict)
    _first_s: dict[Key, float] = field(default_factory=dict)

    def add(self, channels: Sequence[Channel]) -> None:
        """Add new residuals, until the bands are fixed."""
        for channel in channels:
            key = channel.name, channel.horizon_s
            if key in self.bands or not len(channel.t_s):
                continue
            residual = channel.residual
            parts = self._parts.setdefault(key, [])
            parts.append(residual[np.isfinite(residual)])
            began_s = self._first_s.setdefault(key, float(channel.t_s[0]))
            if channel.t_s[-1] - began_s < LEARNT_S or sum(map(len, parts)) < _FEWEST:
                continue
            tail = 50 * (1 - COVERED)
            low, high = np.percentile(np.concatenate(parts), [tail, 100 - tail])
            if math.isfinite(low):
                self.bands[key] = float(low), float(high)
            del self._parts[key]


EVERY_S = 0.05
"""Interval between two states of aircraft and twin."""
_STORED_EVERY = 4
"""Decimation of states that are stored for later viewers."""
_LONGEST_TEXT = 200
"""Largest number of characters of a displayed text from the aircraft. Made up."""
_SHOWN = {"acc", "gyro", "vel", "pos", "vbat_v", "ibat_a", "cmd", "rotor"}
"""Signals that are displayed as received."""


class PageFeed:
    """Conversion of live data into messages; each thread has its own method.

    Messages: `about`, `now` (columns of the flight table, those of the twin with prefix `twin.`,
    their differences with prefix `gap.`), `residuals`, `alarm`, `said`, `health`. Each `at` is a
    time in ms of the system's clock.
    """

    def __init__(self, hub: Hub, vehicle: str, following: Following) -> None:
        """Set up without data.

        Args:
            hub: Hub that receives the messages.
            vehicle: Name of the twin's vehicle.
            following: Correction of the twin's state.
        """
        self._hub = hub
        self._measured: dict[str, tuple[float, ...]] = {}
        self._next_s, self._count = 0.0, 0
        self._bands, self._until_s = ExpectedBands(), -math.inf
        hub.send("about", {"vehicle": vehicle, "following": str(following)}, key="about")

    # -- of the thread that receives ----------------------------------------------------------

    def sample(self, sample: Sample) -> None:
        """Add a reading of the aircraft, the newest of its kind."""
        self._measured[sample.group] = sample.values

    def is_due(self, at_s: float) -> bool:
        """Whether the state must be sent now, on the monotonic clock."""
        return at_s >= self._next_s

    def state(self, t_s: float, reading: Reading | None, at_s: float) -> None:
        """Send the state of aircraft and twin.

        Args:
            t_s: Time of the flight.
            reading: Readings of the twin at that time; None: it has not started.
            at_s: Arrival of the newest sample, on the monotonic clock.
        """
        self._next_s, self._count = at_s + EVERY_S, self._count + 1
        columns: dict[str, Any] = {"t": round(t_s, 4), "at": _ms(at_s)}
        measured = self._named()
        columns |= {n: _short(v) for n, v in measured.items()}
        if reading is not None:
            twin = _twin_named(reading)
            columns |= {f"twin.{n}": _short(v) for n, v in twin.items()}
            columns |= {
                f"gap.{n}": _short(_difference(n, measured[n], v))
                for n, v in twin.items()
                if n in measured
            }
        self._hub.send("now", columns, keep=self._count % _STORED_EVERY == 1)

    def said(self, severity: int, text: str) -> None:
        """Send a text of the aircraft (STATUSTEXT)."""
        name = (LEVELS[severity] if 0 <= severity < len(LEVELS) else "") or "unknown"
        text = text.encode("utf-8", "replace").decode()
        self._hub.send("said", {"at": _ms(), "severity": name, "text": text[:_LONGEST_TEXT]})

    def known(self, status: LiveStatus) -> None:
        """Send the health of the streams and of this program."""
        content = {**plain(status), "at": _ms(), "viewers": self._hub.viewers}
        self._hub.send("health", content, key="health")

    # -- of the thread of the twin ------------------------------------------------------------

    def block(self, block: ResidualBlock) -> None:
        """Send new residuals, as defined by `gap`."""
        channels = (*block.channels, *block.short)
        if block.end_s < self._until_s:  # a new flight has no expected band yet
            self._bands = ExpectedBands()
        self._until_s = block.end_s
        self._bands.add(channels)
        described = [
            {
                "name": c.name,
                "unit": c.unit,
                "horizon_s": c.horizon_s,
                "t": np.round(c.t_s, 4).tolist(),
                "residual": [_short(r) for r in c.residual.tolist()],
                "band": self._bands.bands.get((c.name, c.horizon_s)),
            }
            for c in channels
        ]
        content = {"at": _ms(), "until": block.end_s, "channels": described}
        self._hub.send("residuals", content)

    def alarm(self, alarm: Alarm, section: int) -> None:
        """Send an alarm that was raised, or has ended."""
        key = f"alarm {section} {alarm.event.cause} {alarm.raised_s:.3f}"
        content = {**alarm_json(alarm, section), "at": _ms(), "id": key}
        self._hub.send("alarm", content, key=key)

    # -- columns ------------------------------------------------------------------------------

    def _named(self) -> dict[str, float]:
        """Newest readings by column; the attitude as angles in degrees."""
        found: dict[str, float] = {}
        for group, values in list(self._measured.items()):
            if group == "q":
                found |= _attitude(values)
            elif group in _SHOWN:
                found |= dict(zip(columns_of(group, len(values)), values, strict=True))
        return found


ANGLES = tuple(name.removesuffix("_rad") for name in EULER)
"""Names of roll, pitch, yaw on the page, in degrees."""


def _attitude(q_nb: Sequence[float]) -> dict[str, float]:
    angles = np.degrees(to_euler(np.array(q_nb, dtype=np.float64)))
    named = dict(zip(ANGLES, angles.tolist(), strict=True))
    return named | dict(zip(QUAT, q_nb, strict=True))


def _twin_named(reading: Reading) -> dict[str, float]:
    vectors = {
        ACC: reading.acc_b,
        GYRO: reading.gyro_b,
        VEL: reading.velocity_n,
        POS: reading.position_n,
    }
    found = _attitude(reading.q_nb)
    for names, values in vectors.items():
        found |= dict(zip(names, values, strict=True))
    return found


def _difference(name: str, measured: float, twin: float) -> float:
    """Measured less simulated; angles wrapped."""
    difference = measured - twin
    return (difference + 180) % 360 - 180 if name in ANGLES else difference


def _short(value: float) -> float | None:
    """A number rounded for the page."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


def _ms(at_s: float | None = None) -> float:
    """A time of the monotonic clock, or the present, on the system's clock, ms."""
    ago_s = 0.0 if at_s is None else time.monotonic() - at_s
    return round(1e3 * (time.time() - ago_s), 1)
