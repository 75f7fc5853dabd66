"""Attitude, velocity and position of a DataFlash log, as the estimator had them.

ArduPilot's quaternion turns the body into NED, Hamilton, scalar first, as that of the flight table.
"""

import numpy as np

from ...frames import from_euler
from ..assemble import Rows
from ..attitude import unit_quaternions
from ..columns import POS, QUAT, VEL
from ..flight import Array
from .estimator import Primary
from .log import ArduPilotLog
from .signals import add, si

_Q = ("Q1", "Q2", "Q3", "Q4")
_ANGLES = ("Roll", "Pitch", "Yaw")
_CONTROLLERS = (
    (("PSCN", "PN", "VN", 1.0), ("PSCE", "PE", "VE", 1.0), ("PSCD", "PD", "VD", 1.0)),
    (("PSC", "PX", "VX", 1.0), ("PSC", "PY", "VY", 1.0), ("CTUN", "Alt", "CRt", -1.0)),
    (("NTUN", "PosX", "VelX", 1.0), ("NTUN", "PosY", "VelY", 1.0), ("CTUN", "Alt", "CRt", -1.0)),
)
"""Message, place, rate and sign per axis of NED: since ArduPilot 4.1, Copter 3.6 to 4.0, up to 3.5;
CTUN counts upwards."""
_FASTER = 2.0
_RESETS = {60: "height", 62: "yaw"}
"""EV of a reset of the estimator."""
_EARTH_M = 6_371_000.0


def add_motion(log: ArduPilotLog, rows: Rows, used: Primary) -> dict[str, str]:
    """Attitude, velocity and position.

    Returns:
        Facts on where they come from.
    """
    facts = {}
    if source := _add_attitude(log, rows, used):
        facts["attitude from"] = source
    if source := _add_course(log, rows, used):
        facts["position from"] = source
    _resets(log)
    return facts


def _add_attitude(log: ArduPilotLog, rows: Rows, used: Primary) -> str:
    """Quaternions of the core in charge, or ATT where that is logged much faster."""
    topic = log.topic(f"{used.family}Q", used.core, *_Q) if used.family else None
    angles = log.topic("ATT", None, *_ANGLES)
    if angles is None and used.family:
        angles = log.topic(f"{used.family}F1", used.core, *_ANGLES)
    if topic is not None and (angles is None or angles.rate_hz < _FASTER * topic.rate_hz):
        usable, unit = unit_quaternions(log, si(log, topic, "q", _Q))
        add(log, rows, "q", QUAT, topic.t_us[usable], unit)
        return f"{topic.name}, core {used.core}, {topic.rate_hz:.0f} Hz"
    if angles is None:
        log.note("warning", "q", "no attitude in the log. Set LOG_BITMASK bit 0 or 1")
        return ""
    euler = si(log, angles, "q", _ANGLES)
    possible = np.isfinite(euler).all(axis=1) & (np.abs(euler) <= 2.0 * np.pi + 0.01).all(axis=1)
    if not possible.all():
        message = f"samples of {angles.name} left out, an angle is none"
        log.note("error", "q", message, int(np.count_nonzero(~possible)))
    q = np.asarray(from_euler(*euler[possible].T), dtype=np.float64).T
    add(log, rows, "q", QUAT, angles.t_us[possible], q)
    return f"{angles.name}, {angles.rate_hz:.0f} Hz"


def _add_course(log: ArduPilotLog, rows: Rows, used: Primary) -> str:
    """Position and velocity of the core in charge, else of the position controller, else of POS."""
    topic = log.topic(f"{used.family}F1", used.core) if used.family else None
    pos, vel = ("PN", "PE", "PD"), ("VN", "VE", "VD")
    if topic is not None and topic.has(*pos, *vel):
        add(log, rows, "pos", POS, topic.t_us, si(log, topic, "pos", pos))
        add(log, rows, "vel", VEL, topic.t_us, si(log, topic, "vel", vel))
        log.note(
            "info",
            "pos",
            "position and velocity are the estimator's, not a reference. Where the delays that it "
            "assumes differ from the true ones, they lead or lag the truth",
        )
        return f"{topic.name}, core {used.core}, {topic.rate_hz:.0f} Hz"
    return _controller_course(log, rows) or _global_course(log, rows)


def _controller_course(log: ArduPilotLog, rows: Rows) -> str:
    """What the controllers of position and height are given, where all three axes are there."""
    for axes in _CONTROLLERS:
        if any(message not in log.content.messages for message, *_ in axes):
            continue
        topics = [log.topic(message, None, place, rate) for message, place, rate, _ in axes]
        found = [t for t in topics if t is not None]
        if len(found) < len(axes):
            continue
        shortest = min(found, key=lambda t: len(t.t_us))
        for k, (where, names) in enumerate((("pos", POS), ("vel", VEL)), start=1):
            columns = []
            for (_, place, rate, sign), topic in zip(axes, found, strict=True):
                values = si(log, topic, where, ((place, rate)[k - 1],))[:, 0]
                columns.append(sign * np.interp(shortest.t_us, topic.t_us, values))
            add(log, rows, where, names, shortest.t_us, np.column_stack(columns))
        log.note(
            "info", "pos", "no XKF1: position and velocity as the position controller has them"
        )
        named = ", ".join(dict.fromkeys(t.name for t in found))
        return f"{named}, {shortest.rate_hz:.0f} Hz"
    return ""


def _global_course(log: ArduPilotLog, rows: Rows) -> str:
    """Position alone, from latitude, longitude and height over home."""
    topic = log.topic("POS", None, "Lat", "Lng", "Alt")
    if topic is None:
        log.note("warning", "pos", "no XKF1, PSCN or POS in the log: no position, no velocity")
        return ""
    places = local_ned(topic.raw("Lat"), topic.raw("Lng"), topic.raw("Alt"))
    add(log, rows, "pos", POS, topic.t_us, places)
    log.note("warning", "pos", "from latitude and longitude of POS; there is no velocity")
    return f"POS, {topic.rate_hz:.0f} Hz"


def local_ned(latitude_deg: Array, longitude_deg: Array, up_m: Array) -> Array:
    """Places on the globe, shape (n,) each -> NED from the first of them, m, shape (n, 3).

    Valid for: some kilometres.
    """
    lat, lng = np.radians(latitude_deg), np.radians(longitude_deg)
    north = _EARTH_M * (lat - lat[0])
    east = _EARTH_M * np.cos(lat[0]) * (lng - lng[0])
    return np.column_stack([north, east, up_m[0] - up_m])


def _resets(log: ArduPilotLog) -> None:
    """Steps that the estimator put into its own output."""
    events = log.topic("EV", None, "Id")
    if events is None:
        return
    kinds = events.raw("Id")
    for number, name in _RESETS.items():
        if len(times := events.t_s[kinds == number]):
            at = ", ".join(f"{t:.2f}" for t in times[:8])
            where = "q" if name == "yaw" else "pos"
            message = f"the estimator reset its {name} at {at} s: expect steps there"
            log.note("warning", where, message, len(times))
