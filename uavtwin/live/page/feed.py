"""What a live session hands over -> messages for the page."""

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from twin.explain.running.alarms import Alarm
from twin.frames import AXES, to_euler
from twin.logs.columns import ACC, EULER, GYRO, POS, VEL, motor_columns
from twin.logs.mavlink.decoder import Sample
from twin.residuals.running.residuals import ResidualBlock

from ..alarms import alarm_json
from ..following import Following
from ..status import LiveStatus
from .band import ExpectedBands
from .hub import Hub

EVERY_S = 0.05
"""Between two states of aircraft and twin."""
_STORED_EVERY = 4
"""Of so many states one is kept for viewers that come later."""
_LONGEST_TEXT = 200
_VECTORS: Mapping[str, Sequence[str]] = {"acc": ACC, "gyro": GYRO, "vel": VEL, "pos": POS}
_SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")


class TwinReading(Protocol):
    """What the twin reads now; SI, NED, FRD."""

    @property
    def acc_b(self) -> Sequence[float]:
        """Specific force, m/s^2."""
        ...

    @property
    def gyro_b(self) -> Sequence[float]:
        """Body rates as the gyroscope shows them, rad/s."""
        ...

    @property
    def position_n(self) -> Sequence[float]:
        """North, east, down, m."""
        ...

    @property
    def velocity_n(self) -> Sequence[float]:
        """North, east, down, m/s."""
        ...

    @property
    def q_nb(self) -> Sequence[float]:
        """Attitude, body to NED, w first."""
        ...


class PageFeed:
    """Turns what is known into messages; a method each for the thread that knows it.

    Messages: `about`, `now` (columns of the flight table, those of the twin behind `twin.`, their
    differences behind `gap.`), `residuals`, `alarm`, `said`, `health`. Each `at` is a time in ms
    of the system's clock.
    """

    def __init__(self, hub: Hub, vehicle: str, following: Following) -> None:
        """Nothing is known yet.

        Args:
            hub: Where messages go to.
            vehicle: Name of the twin.
            following: How the twin is kept with the aircraft.
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
        """Whether the state is to be told now, on the monotonic clock."""
        return at_s >= self._next_s

    def state(self, t_s: float, reading: TwinReading | None, at_s: float) -> None:
        """Tell the state of aircraft and twin.

        Args:
            t_s: Of the flight.
            reading: Of the twin, of the same time; None: it does not fly yet.
            at_s: When the newest sample came, on the monotonic clock.
        """
        self._next_s, self._count = at_s + EVERY_S, self._count + 1
        told: dict[str, Any] = {"t": round(t_s, 4), "at": _ms(at_s)}
        measured = self._named()
        told |= {n: _short(v) for n, v in measured.items()}
        if reading is not None:
            twin = _twin_named(reading)
            told |= {f"twin.{n}": _short(v) for n, v in twin.items()}
            told |= {
                f"gap.{n}": _short(_difference(n, measured[n], v))
                for n, v in twin.items()
                if n in measured
            }
        self._hub.send("now", told, keep=self._count % _STORED_EVERY == 1)

    def said(self, severity: int, text: str) -> None:
        """What the aircraft says of itself (STATUSTEXT)."""
        known = 0 <= severity < len(_SEVERITIES)
        name = _SEVERITIES[severity] if known else "unknown"
        text = text.encode("utf-8", "replace").decode()
        self._hub.send("said", {"at": _ms(), "severity": name, "text": text[:_LONGEST_TEXT]})

    def known(self, told: LiveStatus) -> None:
        """Health of the streams and of this program."""
        content = {**told.json(), "at": _ms(), "viewers": self._hub.viewers}
        self._hub.send("health", content, key="health")

    # -- of the thread of the twin ------------------------------------------------------------

    def block(self, block: ResidualBlock) -> None:
        """New residuals, as `gap` defines them."""
        channels = (*block.channels, *block.short)
        if block.end_s < self._until_s:  # a new flight: nothing is expected of it yet
            self._bands = ExpectedBands()
        self._until_s = block.end_s
        self._bands.add(channels)
        told = [
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
        content = {"at": _ms(), "until": block.end_s, "channels": told}
        self._hub.send("residuals", content)

    def alarm(self, alarm: Alarm, section: int) -> None:
        """An alarm that was raised, or has ended."""
        key = f"alarm {section} {alarm.effect} {alarm.raised_s:.3f}"
        content = {**alarm_json(alarm, section), "at": _ms(), "id": key}
        self._hub.send("alarm", content, key=key)

    # -- columns ------------------------------------------------------------------------------

    def _named(self) -> dict[str, float]:
        """Newest readings by column; the attitude as angles in degrees."""
        found: dict[str, float] = {}
        for group, values in list(self._measured.items()):
            if group == "q":
                found |= _attitude(values)
            elif group in _VECTORS:
                found |= dict(zip(_VECTORS[group], values, strict=True))
            elif group in ("vbat_v", "ibat_a"):
                found[group] = values[0]
            elif group in ("cmd", "rotor"):
                found |= dict(zip(motor_columns(group, len(values)), values, strict=True))
        return found


ANGLES = tuple(name.removesuffix("_rad") for name in EULER)
"""Roll, pitch, yaw as the page has them, in degrees."""
QUATERNION = tuple(f"q_{a}" for a in ("w", *AXES))


def _attitude(q_nb: Sequence[float]) -> dict[str, float]:
    angles = np.degrees(to_euler(np.array(q_nb, dtype=np.float64)))
    told = dict(zip(ANGLES, angles.tolist(), strict=True))
    return told | dict(zip(QUATERNION, q_nb, strict=True))


def _twin_named(reading: TwinReading) -> dict[str, float]:
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
