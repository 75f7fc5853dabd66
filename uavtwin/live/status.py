"""The status of a live flight, as numbers and in words, and its alarms.

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
    """Finds what goes wrong in a flight while it goes on; a new flight has a new one."""

    @property
    def misfit(self) -> str:
        """Why the vehicle file does not fit; "": it does, or it is not known."""
        ...

    @property
    def rests(self) -> str:
        """Why nothing is looked for, or not all of it; "": all is."""
        ...

    def push(self, rows: Rows) -> None:
        """Take new rows of the flight table."""
        ...

    def evaluate(self) -> Sequence[Alarm]:
        """Alarms that are new, have changed, or are over."""
        ...


def sentence(alarm: Alarm) -> str:
    """What an alarm says to people: what has happened, how much, and how sure that is."""
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
    """A line of `alarms.jsonl`: the event as `why` has it, without the signals that show it."""
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
"""By signal the message that it is read from, and what is missing without it."""
RATES_HZ = {
    dialect.MAVLINK_MSG_ID_HIGHRES_IMU: 200.0,
    dialect.MAVLINK_MSG_ID_ODOMETRY: 50.0,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    dialect.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: 200.0,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 5.0,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
}
"""By kind of message, the requested rate, Hz, with `request_rates`."""


def missing(sources: Mapping[str, str]) -> dict[str, str]:
    """What is missing: by signal, which message to request, and what is missing without it."""
    return {
        group: f"no {message}: {what}"
        for group, (message, what) in NEEDED_BY.items()
        if group not in sources
    }


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """The link to the aircraft.

    Attributes:
        system: System id of the aircraft; None: none was heard.
        sender: Where it sends from.
        messages: How many came of it.
        lost: How many are missing by their sequence numbers.
        duplicates: How many came twice.
        reordered: How many were overtaken.
        jumps: How often the sequence number jumped.
        late: Samples that came after their row was gone.
        strays: Samples whose time is far from that of all others.
        garbage: Bytes that are no message.
        wrong: Frames whose checksum is wrong.
        version_1: Messages of MAVLink 1.
        others: Messages of others, by who sent them.
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
    """The compensator.

    Attributes:
        horizon_s: How old the newest residual is that it sees; infinite: it sees none.
        until_s: Up to where of the flight it has been evaluated, s.
        anomaly: How strange the last seconds were, the most; above 1 rarely on flights like those
            of training.
        unusual: Share of the flight so far above 1.
        inside: Share of the flight so far where training has been.
        rms: Of the residuals so far, by channel: of the twin, and with the correction.
    """

    horizon_s: float
    until_s: float = 0.0
    anomaly: float = math.nan
    unusual: float = math.nan
    inside: float = math.nan
    rms: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LiveStatus:
    """A live flight.

    Attributes:
        link: Counts.
        clock: The aircraft's clock on ours; None: nothing came.
        sources: Which message each signal is taken from.
        missing: Signals that are absent, and what is missing without them.
        waits_for: Why the twin has not started; "": it has.
        sections: How many flights there were: the clock restarted, or a stream came later.
        flight_s: Time of the newest row of the flight table.
        rms: Of residuals, by channel, up to now.
        units: Of the channels.
        busy: Share of one core that this process takes.
        published_age_p99_s: Of what the twin publishes, 99 in 100: from when the message came that
            it was made of; NaN: nothing was published.
        alarms: The latest `alarm_json` of each.
        model: The compensator; None: there is none.
        misfit: Why the vehicle file does not fit: its rotors, in which case nothing is said of the
            body, or the weight that it carries; "": it does, or it is not known.
        rests: Why no alarm is looked for, or not all of them; "": all are.
        errors: What failed while the flight was recorded, once each.
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
        """One line for a terminal."""
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
