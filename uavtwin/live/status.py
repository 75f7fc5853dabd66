"""Status of a live flight, as numbers and in words, and its alarms.

`FlightWatch` is the interface of `twin.why.watch.Watch`; a flight without one has no alarms.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from msgspec import structs, to_builtins

from twin.formatting import certainty
from twin.logs.mavlink.frames import dialect
from twin.physics.sensors.table import SENSORS
from twin.residuals.stream import Rows
from twin.why.watch import Alarm

from ..diagnosis import cause_in_words, size_in_words
from .datagrams import ClockEstimate


class FlightWatch(Protocol):
    """Diagnosis during a flight; each flight has a new one."""

    @property
    def misfit(self) -> str:
        """Reason why the vehicle file does not fit; "": it does, or it is not known."""
        ...

    @property
    def rests(self) -> str:
        """Reason why the search for faults is off or partial; "": it is on."""
        ...

    def push(self, rows: Rows) -> None:
        """Append rows of the flight table."""
        ...

    def evaluate(self) -> Sequence[Alarm]:
        """Alarms that are new, have changed, or have ended."""
        ...


def sentence(alarm: Alarm) -> str:
    """Sentence on an alarm: event, size, and probability."""
    event = alarm.event
    details = [d for d in (size_in_words(event), certainty(event.probability)) if d]
    text = f"{event.text} ({', '.join(details)})"
    if event.alternatives:
        known = (f"{cause_in_words(c)} ({certainty(c.probability)})" for c in event.alternatives)
        text += f"; or {' or '.join(known)}"
    if alarm.closed_s is not None:
        text += f"; over since {alarm.closed_s:.1f} s"
    return text


def alarm_json(alarm: Alarm, section: int) -> dict[str, Any]:
    """A line of `alarms.jsonl`: the event as in `why`, without the signals that show it."""
    event = to_builtins(structs.replace(alarm.event, evidence=()))
    times = {n: getattr(alarm, n) for n in ("raised_s", "known_s", "closed_s")}
    times["delay_s"] = alarm.raised_s - alarm.known_s
    return {"section": section, **event, **times, "text": sentence(alarm)}


NEEDED_BY: dict[str, tuple[str, str]] = {
    **{s.signal: (s.messages[0], s.without) for s in SENSORS if s.without},
    "q": ("ODOMETRY or ATTITUDE_QUATERNION", "the twin has no state: no residuals"),
    "vel": (
        "ODOMETRY or LOCAL_POSITION_NED",
        "no residuals over a short horizon, nothing on drag and wind",
    ),
    "pos": (
        "ODOMETRY or LOCAL_POSITION_NED",
        "nothing on ground effect; take-off is recognised by thrust alone",
    ),
    "cmd": (
        "ACTUATOR_OUTPUT_STATUS or SERVO_OUTPUT_RAW",
        "the twin has no commands: no residuals",
    ),
    "vbat_v": ("BATTERY_STATUS", "nothing on battery sag"),
    "landed": ("EXTENDED_SYS_STATE", "flight phases are unknown"),
}
"""Source message of each signal, and the consequence where it is missing."""
RATES_HZ = {
    dialect.MAVLINK_MSG_ID_HIGHRES_IMU: 200.0,
    dialect.MAVLINK_MSG_ID_ODOMETRY: 50.0,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    dialect.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: 200.0,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 5.0,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
}
"""Requested rate, Hz, by kind of message, with `request_rates`."""


def missing(sources: Mapping[str, str]) -> dict[str, str]:
    """Missing signals: the message to request, and the consequence, by signal."""
    return {
        group: f"no {message}: {what}"
        for group, (message, what) in NEEDED_BY.items()
        if group not in sources
    }


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """State of the link to the aircraft.

    Attributes:
        system: System id of the aircraft; None: none received.
        sender: Sender of its messages.
        messages: Number of its messages.
        lost: Number of missing messages, by their sequence numbers.
        duplicates: Number of duplicate messages.
        reordered: Number of reordered messages.
        jumps: Number of jumps of the sequence number.
        late: Number of samples that arrived too late for their row.
        strays: Number of samples whose time is far from that of all others.
        garbage: Number of bytes that belong to no message.
        wrong: Number of frames with a wrong checksum.
        version_1: Number of messages of MAVLink 1.
        others: Number of messages of other senders, by sender.
    """

    system: int | None
    sender: str
    messages: int
    lost: int
    duplicates: int
    reordered: int
    jumps: int
    late: int
    strays: int
    garbage: int
    wrong: int
    version_1: int
    others: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class ModelStatus:
    """State of the compensator.

    Attributes:
        horizon_s: Age of the newest residual among its inputs; infinite: none.
        until_s: Time of the flight up to which it was evaluated, s.
        anomaly: Largest anomaly score of the last seconds; rarely above 1 on flights similar to
            those of training; NaN: it has none.
        unusual: Share of the flight so far with a score above 1; NaN: it has none.
        inside: Share of the flight so far within the range of training.
        rms: Rms of the residuals so far, by channel: of the twin, and with the correction.
    """

    horizon_s: float
    until_s: float = 0.0
    anomaly: float = math.nan
    unusual: float = math.nan
    inside: float = math.nan
    rms: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LiveStatus:
    """Status of a live flight.

    Attributes:
        link: State of the link.
        clock: The aircraft's clock relative to the local one; None: no message so far.
        sources: Source message of each signal.
        missing: Missing signals, and the consequence of each.
        waits_for: Reason why the twin has not started; "": it has.
        sections: Number of flights: after a restart of the clock, or with a later stream.
        flight_s: Time of the newest row of the flight table.
        rms: Rms of residuals, by channel, so far.
        units: Units of the channels.
        busy: CPU use of this process as a share of one core.
        published_age_p99_s: 99th percentile of the age of the twin's published data, from the
            arrival of the causing message; NaN: nothing was published.
        alarms: The latest `alarm_json` of each alarm.
        model: State of the compensator; None: there is none.
        misfit: Reason why the vehicle file does not fit: its rotors, in which case there are no
            events of the body, or the weight that it carries; "": it does, or it is not known.
        rests: Reason why the search for alarms is off or partial; "": it is on.
        errors: Errors during the flight, without repetitions.
    """

    link: LinkStatus
    clock: ClockEstimate | None
    sources: Mapping[str, str]
    missing: Mapping[str, str]
    waits_for: str
    sections: int
    flight_s: float
    rms: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    busy: float = 0.0
    published_age_p99_s: float = math.nan
    alarms: tuple[Mapping[str, Any], ...] = ()
    model: ModelStatus | None = None
    misfit: str = ""
    rests: str = ""
    errors: tuple[str, ...] = ()

    def line(self) -> str:
        """The status in one line for a terminal."""
        link = self.link
        if link.system is None:
            return "nothing heard yet"
        parts = [f"{self.flight_s:.1f} s", f"{link.messages} messages, {link.lost} lost"]
        if self.clock is not None:
            parts.append(f"clock {self.clock.offset_s:+.4f} s")
        parts += [
            f"{n} {v:.3g} {self.units[n]}" for n, v in self.rms.items() if n.startswith("acc")
        ]
        if self.model is not None and math.isfinite(self.model.anomaly):
            parts.append(f"anomaly {self.model.anomaly:.2f}")
        if self.waits_for:
            parts.append(f"the twin waits for {self.waits_for}")
        if self.rests:
            parts.append(self.rests)
        return "; ".join(parts)
