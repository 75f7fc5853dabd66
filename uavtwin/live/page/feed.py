"""The messages of the live page: from the session to the queues of its viewers.

Viewers get new messages at once, and the last minutes when they join. A sender never waits for a
viewer: each has a queue of its own, and a slow one loses the oldest messages in it. Grey bands show
where 95 % of the residuals of the first seconds were: what begins in flight is compared with the
error of the twin before.
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
"""So much of the flight is there for a viewer that comes later."""
_MOST_STORED = 20_000
"""Messages that are stored at most. Made up."""
_MOST_KEYS = 500
"""Keys of which the newest message is stored, at most. Made up."""
QUEUE = 64
"""Messages that wait for one viewer, about three seconds."""
MOST_VIEWERS = 32
"""Viewers at once, at most. Made up."""
SILENT_S = 60.0
"""The page asks for the time every 2 s, in the background once a minute: where there are too many
viewers, one that has requested nothing for longer gives its place to a new one."""


class Viewer:
    """One viewer.

    Attributes:
        dropped: Messages that it lost, because it did not keep up.
        heard_s: Time of its last request, on the clock of the hub.
        ended: Whether it has to go.
    """

    def __init__(
        self, wake: Callable[[], object], history: list[bytes], now_s: float = 0.0
    ) -> None:
        self._wake, self._history = wake, history
        self._queue: deque[bytes] = deque()
        self.dropped, self.heard_s, self.ended = 0, now_s, False

    def end(self) -> None:
        """Make it go; from any thread."""
        self.ended = True
        with contextlib.suppress(RuntimeError):
            self._wake()

    def put(self, message: bytes) -> None:
        """A message for it; from any thread."""
        if len(self._queue) >= QUEUE:
            with contextlib.suppress(IndexError):  # it was taken in this moment
                self._queue.popleft()
                self.dropped += 1
        self._queue.append(message)
        with contextlib.suppress(RuntimeError):  # its loop has ended
            self._wake()

    def take(self) -> bytes:
        """All that waits, as one JSON array; empty where nothing does."""
        messages, self._history = self._history, []
        with contextlib.suppress(IndexError):
            while len(messages) < _MOST_STORED:
                messages.append(self._queue.popleft())
        return b"[" + b",".join(messages) + b"]" if messages else b""


class Hub:
    """Takes messages from any thread and gives them to all viewers."""

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
        """A message to all.

        Args:
            kind: What it is.
            content: What it says; what is no finite number becomes null.
            key: Of those of one key only the newest is stored for later viewers.
            keep: Whether it is stored for them.
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
            wake: Called from any thread when something waits for it.
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
        """The viewer has left."""
        with self._lock, contextlib.suppress(ValueError):
            self._viewers.remove(viewer)


LEARNT_S = 20.0
"""Of samples in the air, from which the band is learnt; it stays then."""
COVERED = 0.95
"""Share of the residuals within a band."""
_FEWEST = 20
"""Samples of which a band is computed, at least. Made up."""
Key = tuple[str, float]


@dataclass(slots=True)
class ExpectedBands:
    """Bands of the channels of one flight, by name and horizon."""

    bands: dict[Key, tuple[float, float]] = field(default_factory=dict)
    _parts: dict[Key, list[NDArray[np.float64]]] = field(default_factory=dict)
    _first_s: dict[Key, float] = field(default_factory=dict)

    def add(self, channels: Sequence[Channel]) -> None:
        """Take new residuals, until enough is known."""
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
"""Between two states of aircraft and twin."""
_STORED_EVERY = 4
"""Of so many states one is stored for viewers that come later."""
_LONGEST_TEXT = 200
"""Characters of a text of the aircraft that are shown. Made up."""
_SHOWN = {"acc", "gyro", "vel", "pos", "vbat_v", "ibat_a", "cmd", "rotor"}
"""Signals that are shown as they are read."""


class PageFeed:
    """Turns what is known into messages; a method for each thread.

    Messages: `about`, `now` (columns of the flight table, those of the twin behind `twin.`, their
    differences behind `gap.`), `residuals`, `alarm`, `said`, `health`. Each `at` is a time in ms
    of the system's clock.
    """

    def __init__(self, hub: Hub, vehicle: str, following: Following) -> None:
        """Nothing is known yet.

        Args:
            hub: Where messages go to.
            vehicle: Name of the twin.
            following: How the state of the twin is corrected.
        """
        self._hub = hub
        self._measured: dict[str, tuple[float, ...]] = {}
        self._next_s, self._count = 0.0, 0
        self._bands, self._until_s = ExpectedBands(), -math.inf
        hub.send("about", {"vehicle": vehicle, "following": str(following)}, key="about")

    # -- of the thread that receives ----------------------------------------------------------

    def sample(self, sample: Sample) -> None:
        """A reading of the aircraft, the newest of its kind."""
        self._measured[sample.group] = sample.values

    def is_due(self, at_s: float) -> bool:
        """Whether the state is to be sent now, on the monotonic clock."""
        return at_s >= self._next_s

    def state(self, t_s: float, reading: Reading | None, at_s: float) -> None:
        """Send the state of aircraft and twin.

        Args:
            t_s: Of the flight.
            reading: Of the twin, of the same time; None: it does not fly yet.
            at_s: When the newest sample came, on the monotonic clock.
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
        """What the aircraft says of itself (STATUSTEXT)."""
        name = (LEVELS[severity] if 0 <= severity < len(LEVELS) else "") or "unknown"
        text = text.encode("utf-8", "replace").decode()
        self._hub.send("said", {"at": _ms(), "severity": name, "text": text[:_LONGEST_TEXT]})

    def known(self, status: LiveStatus) -> None:
        """Health of the streams and of this program."""
        content = {**plain(status), "at": _ms(), "viewers": self._hub.viewers}
        self._hub.send("health", content, key="health")

    # -- of the thread of the twin ------------------------------------------------------------

    def block(self, block: ResidualBlock) -> None:
        """New residuals, as `gap` defines them."""
        channels = (*block.channels, *block.short)
        if block.end_s < self._until_s:  # a new flight: nothing is expected of it yet
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
        """An alarm that was raised, or has ended."""
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
"""Roll, pitch, yaw as the page has them, in degrees."""


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
    """Measured less simulated; angles the short way round."""
    difference = measured - twin
    return (difference + 180) % 360 - 180 if name in ANGLES else difference


def _short(value: float) -> float | None:
    """A number as a page holds it."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


def _ms(at_s: float | None = None) -> float:
    """A time of the monotonic clock, or now, on the system's clock, ms."""
    ago_s = 0.0 if at_s is None else time.monotonic() - at_s
    return round(1e3 * (time.time() - ago_s), 1)
