"""ArduPilot's records of a flight: arming, estimator, phases, modes, setpoints, filters."""

from dataclasses import dataclass

import numpy as np

from ...frames import from_euler
from ..autopilot import (
    MOST_EVENTS,
    MOST_MESSAGES,
    Autopilot,
    Filter,
    FilterKind,
    Interval,
    Message,
    Mode,
    Parameter,
    Reset,
    ResetOf,
    Sensor,
    Setpoint,
    Span,
    as_text,
    differing,
    ground_spans,
    modes_of,
    motion_spans,
    setpoint_of,
    stretches_of,
)
from ..columns import GYRO, POS, QUAT, VEL
from ..flight import Array
from ..samples import stretches_where
from .airframe import logged_commands
from .log import OTHERS, ArduPilotLog, Topic, firmware

# -- arming -------------------------------------------------------------------------------------
#
# The part of a log that is a flight: the stretch in which the motors run, without a pause of a
# minute.

SpanUs = tuple[int, int]
"""Start and end, us."""

_PAUSE_US = 60_000_000  # with stopped motors, which separates two flights
ARMED, DISARMED, _AUTO_ARMED = 10, 11, 15
"""Event numbers in EV."""
_STILL_ON_US = 500_000  # between the last command and the end of a truncated log
_SHOWN = 8  # events that a text lists


def armed_spans(log: ArduPilotLog) -> list[SpanUs]:
    """Spans in which the motors were armed, in time of the log.

    By the outputs of the motors, which are constant while disarmed; where the log has none, by its
    events.
    """
    commands = logged_commands(log, log.whole)
    if commands is not None and commands.running.any():
        t_us = commands.t_us.tolist()
        return [(t_us[a], t_us[b - 1]) for a, b in stretches_where(commands.running)]
    return _by_events(log)


def _by_events(log: ArduPilotLog) -> list[SpanUs]:
    """Spans by EV; armed before the first event if it disarms, and until the end after the last."""
    events = log.whole("EV")
    ends = _ends(log)
    if events is None or ends is None:
        return []
    spans: list[SpanUs] = []
    begin: int | None = None
    any_event = False
    for t, kind in zip(events.t_us.tolist(), events.raw("Id").tolist(), strict=True):
        if kind in (ARMED, _AUTO_ARMED) and begin is None:
            begin = t
        elif kind == DISARMED and (begin is not None or not any_event):
            spans.append((ends[0] if begin is None else begin, t))
            begin = None
        any_event = any_event or kind in (ARMED, _AUTO_ARMED, DISARMED)
    return [*spans, (begin, ends[1])] if begin is not None else spans


def _ends(log: ArduPilotLog) -> SpanUs | None:
    """Start and end of the logged motion."""
    found = [t for n in ("IMU", "ATT", "XKF1", "NKF1", "EKF1") if (t := log.whole(n)) is not None]
    if not found:
        return None
    return min(int(t.t_us[0]) for t in found), max(int(t.t_us[-1]) for t in found)


def cut_to_flight(log: ArduPilotLog) -> dict[str, str]:
    """Cut a log to its longest stretch of armed time without a pause of a minute.

    Returns:
        Facts on the part in use.
    """
    spans, ends = armed_spans(log), _ends(log)
    if not spans:
        log.note("info", "log", "no time in which the motors run is known: all of it is used")
        return {"clock": f"t = 0 is {log.start_us * 1e-6:.6f} s after boot, the start of the log"}
    stretches: list[list[SpanUs]] = []
    for span in spans:
        if stretches and span[0] - stretches[-1][-1][1] <= _PAUSE_US:
            stretches[-1].append(span)
        else:
            stretches.append([span])
    used = max(stretches, key=lambda s: sum(b - a for a, b in s))
    begin, end = used[0][0], used[-1][1]
    each = [f"{(b - a) * 1e-6:.1f} s from {(a - begin) * 1e-6:.1f} s" for a, b in spans[:_SHOWN]]
    text = "; ".join(each) + (f" and {len(spans) - _SHOWN} more" if len(spans) > _SHOWN else "")
    if len(stretches) > 1:
        log.note(
            "warning",
            "log",
            f"motors run in {len(stretches)} stretches over a minute apart ({text}); the one with "
            "most of it is used. Split the log to use the others",
            len(stretches),
        )
    if ends is not None and ends[1] - end < _STILL_ON_US:
        log.note("error", "log", "it ends with the motors running: cut short?")
    if ends is not None and (left := (begin - ends[0]) + (ends[1] - end)) > _STILL_ON_US:
        log.note("info", "log", f"{left * 1e-6:.1f} s with the motors stopped are not used")
    log.cut_to(begin, end)
    return {
        "motors run": text,
        "clock": f"t = 0 is {log.start_us * 1e-6:.6f} s after boot, when the motors start",
    }


# -- estimator ----------------------------------------------------------------------------------
#
# The estimator in control of the aircraft: its core and the sensors it uses.

_FAMILIES = {3: "XK", 2: "NK", 1: "EK"}
"""Prefix of the messages, by AHRS_EKF_TYPE."""
_HIGHEST = 16  # largest number of a core or sensor; beyond is damage


@dataclass(frozen=True, slots=True)
class ActiveEstimator:
    """The EKF core that is active for most of the flight.

    Attributes:
        family: `XK` for EKF3, `NK` for EKF2, `EK` for the first EKF, "" without any.
        core: Number of the core.
        imu: Instance of IMU that the core uses.
        compass: Instance of MAG that the core uses.
        barometer: Instance of BARO that the core uses.
        gps: Instance of GPS that the core uses.
    """

    family: str
    core: int = 0
    imu: int = 0
    compass: int = 0
    barometer: int = 0
    gps: int = 0


def active_estimator(log: ArduPilotLog) -> ActiveEstimator:
    """The estimator in control of the aircraft; findings report changes of core or sensors.

    Source: ArduPilot, LogStructure.h of AP_NavEKF3 (XKF4.PI, XKFS) and EK3_IMU_MASK, from which
    core k takes the k-th sensor.
    """
    found = {
        f: sorted({*log.instances(f"{f}F1"), *log.instances(f"{f}Q")}) for f in _FAMILIES.values()
    }
    there = [f for f, cores in found.items() if cores]
    if not there:
        return ActiveEstimator("")
    wanted = _FAMILIES.get(int(log.params.get("AHRS_EKF_TYPE", 3.0)), "XK")
    family = wanted if wanted in there else there[0]
    cores = found[family]
    states = log.topic(f"{family}F4", _first(log, f"{family}F4"))
    core = _most(log, states, "PI", "q", "EKF core in charge")
    core = core if core in cores else cores[0]
    sensors = log.topic("XKFS", core) if family == "XK" and log.instances("XKFS") else None
    return ActiveEstimator(
        family,
        core,
        _imu(int(log.params.get(f"EK{3 if family == 'XK' else 2}_IMU_MASK", 0.0)), core),
        max(_most(log, sensors, "MI", "mag", "compass that the EKF uses"), 0),
        max(_most(log, sensors, "BI", "baro", "barometer of the EKF"), 0),
        max(_most(log, sensors, "GI", "pos", "GPS of the EKF"), 0),
    )


def _imu(mask: int, core: int) -> int:
    """The IMU of a core: the sensor in the mask at the position of the core's number."""
    sensors = [k for k in range(_HIGHEST) if mask >> k & 1]
    return sensors[core] if core < len(sensors) else core


def _first(log: ArduPilotLog, name: str) -> int | None:
    found = log.instances(name)
    return found[0] if found else None


def _most(log: ArduPilotLog, topic: Topic | None, column: str, where: str, what: str) -> int:
    """Number of the core or sensor that is active for most of the time; -1 where it is not
    logged."""
    if topic is None or not topic.has(column):
        return -1
    values = topic.raw(column)
    known = (values >= 0) & (values < _HIGHEST)
    if not known.any():
        return -1
    numbers = values[known].astype(np.int64)
    most = int(np.bincount(numbers).argmax())
    changes = np.flatnonzero(np.diff(numbers)) + 1
    if len(changes):
        at = ", ".join(f"{t:.1f}" for t in topic.t_s[known][changes][:_SHOWN])
        message = f"the {what} changes at {at} s; here number {most} is used throughout"
        log.note("warning", where, message, len(changes))
    return most


# -- phases -------------------------------------------------------------------------------------
#
# Phases, flight modes and failures of a DataFlash log.

MODES = {
    **dict(
        enumerate(("Stabilize", "Acro", "AltHold", "Auto", "Guided", "Loiter", "RTL", "Circle"))
    ),
    **{9: "Land", 11: "Drift", 13: "Sport", 14: "Flip", 15: "AutoTune", 16: "PosHold"},
    **{17: "Brake", 18: "Throw", 19: "Avoid_ADSB", 20: "Guided_NoGPS", 21: "Smart_RTL"},
    **{22: "FlowHold", 23: "Follow", 24: "ZigZag", 25: "SystemID", 26: "Heli_Autorotate"},
    **{27: "Auto_RTL", 28: "Turtle"},
}
"""Flight modes of ArduCopter by number."""
SUBSYSTEMS = {
    **{2: "radio", 3: "compass", 5: "radio failsafe", 6: "battery failsafe", 8: "GCS failsafe"},
    **{9: "fence", 10: "flight mode", 11: "GPS", 12: "crash check", 15: "parachute"},
    **{16: "EKF check", 17: "EKF failsafe", 18: "barometer", 19: "CPU", 21: "terrain"},
    **{22: "navigation", 23: "terrain failsafe", 24: "EKF primary", 25: "thrust loss"},
    **{26: "sensor failsafe", 27: "leak failsafe", 29: "vibration failsafe"},
}
"""Subsystems of ERR by number."""
_NOT_LANDED, _LANDED = 28, 18  # EV by number
_MOST = 2.0**53  # counters beyond are inexact as float64


def from_ardupilot_phases(log: ArduPilotLog, used: ActiveEstimator) -> list[Span]:
    """Phases from land-detector events in EV, speed and climb rate."""
    ground = _ground(log)
    topic = log.topic(f"{used.family}F1", used.core) if used.family else None
    if topic is None or not topic.has("VN", "VE", "VD"):
        return ground
    spans = motion_spans(topic.t_s, topic.si(("VN", "VE", "VD")), ground)
    if spans:
        log.note("info", "phase", "from landed state, speed and climb rate")
    return spans


def _ground(log: ArduPilotLog) -> list[Span]:
    """Spans on the ground, including the time before the first take-off."""
    events = log.topic("EV", None, "Id")
    if events is None:
        return []
    kinds = events.raw("Id")
    known = np.isin(kinds, (_NOT_LANDED, _LANDED))
    if not known.any():
        return []
    t_s, landed = events.t_s[known], kinds[known] == _LANDED
    if not landed[0]:  # it stood until it took off
        t_s, landed = np.append(-np.inf, t_s), np.append(True, landed)
    return ground_spans(t_s, landed)


def modes(log: ArduPilotLog) -> str:
    """Flight modes with their start times, "" where there are none."""
    topic = log.whole("MODE")
    if topic is None or not (names := mode_names(log, topic)):
        return ""
    parts: list[str] = []
    in_time = np.flatnonzero(topic.t_s <= (log.length_us or np.inf) * 1e-6)
    before = np.flatnonzero(topic.t_s[in_time] <= 0.0)
    for k in in_time[max(len(before) - 1, 0) :]:
        parts.append(f"{names[k]} from {max(topic.t_s[k], 0.0):.1f} s")
    more = f" and {len(parts) - _SHOWN} more" if len(parts) > _SHOWN else ""
    return ", ".join(parts[:_SHOWN]) + more


def mode_names(log: ArduPilotLog, topic: Topic) -> list[str]:
    """Name of the mode in each MODE: from ModeNum, up to Copter 3.1 from Mode (text logs: a name);
    [] where they have neither."""
    for column in ("ModeNum", "Mode"):
        if column in topic.source.data:
            values = topic.source.data[column][topic.rows].tolist()
            return [_named(log, value) for value in values]
    return []


def _named(log: ArduPilotLog, value: object) -> str:
    """Name of a mode that is logged as a number or as a name."""
    if isinstance(value, int | float):
        return mode_name(log, value)
    text = as_text(value.decode("utf-8", "replace") if isinstance(value, bytes) else value)
    return mode_name(log, float(text)) if text.isdecimal() and len(text) < 4 else text


def mode_name(log: ArduPilotLog, number: float) -> str:
    """Name of a flight mode; its number only where the firmware is not Copter."""
    known = {} if OTHERS.match(firmware(log)) else MODES
    whole = int(number) if np.isfinite(number) else -1
    return known.get(whole, f"mode {whole}")


def subsystem(number: float) -> str:
    """Name of a subsystem of ERR."""
    return SUBSYSTEMS.get(int(number), f"subsystem {number:.0f}")


def note_failures(log: ArduPilotLog) -> None:
    """Findings on failsafes and errors, clipping, messages that were not logged, failed motors."""
    errors = log.topic("ERR", None, "Subsys", "ECode")
    if errors is not None:
        codes = errors.raw("ECode")
        for t, system, code in zip(errors.t_s, errors.raw("Subsys"), codes, strict=True):
            if np.isfinite((system, code)).all() and code:
                message = f"{subsystem(system)} error, code {code:.0f}, at {t:.2f} s"
                log.note("warning", "log", message)
    message = "messages that could not be logged; use a faster card or log less"
    log.note("warning", "log", message, _grown(log, "DSF", None, "Dp"))
    for instance in log.instances("VIBE"):
        message = f"samples in which the accelerometer of IMU {instance} was at its limit"
        log.note("warning", "acc", message, _grown(log, "VIBE", instance, "Clip"))
    motors = log.topic("MOTB", None)
    if motors is not None and motors.has("FailFlags"):
        flags = motors.raw("FailFlags")
        failed = np.isfinite(flags) & (flags % 2 == 1)
        if failed.any():
            at = motors.t_s[failed][0]
            message = f"ArduPilot takes a motor for failed (thrust boost) from {at:.2f} s"
            log.note("warning", "cmd", message, failed)


def _grown(log: ArduPilotLog, name: str, instance: int | None, field: str) -> int:
    """Increase of a counter during the flight, 0 where the log does not have it."""
    topic = log.topic(name, instance)
    if topic is None or not topic.has(field):
        return 0
    counts = topic.raw(field)
    counts = counts[np.isfinite(counts) & (np.abs(counts) < _MOST)]
    return int(np.ptp(counts)) if len(counts) else 0


# -- setpoints ----------------------------------------------------------------------------------
#
# Setpoints of ArduPilot's controllers, in the units of the flight table.

_AXES = "NED"  # PSCN, PSCE, PSCD
_TOGETHER_S = 0.2
"""Largest difference of time between messages of three axes for one controller step; valid logs:
under 1 ms."""
_ANGLES = ("DesRoll", "DesPitch", "DesYaw")  # of ATT
_RATES = ("RDes", "PDes", "YDes")  # of RATE


def setpoints(log: ArduPilotLog, end_s: float) -> tuple[Setpoint, ...]:
    """Setpoints of position, velocity, attitude and rates, as far as the log has them.

    Args:
        log: The log, cut to the flight.
        end_s: End of the record, s.
    """
    found = [
        _course(log, POS, ("TP",), end_s),
        _course(log, VEL, ("DV", "TV"), end_s),
        _attitude(log, end_s),
        _rates(log, end_s),
    ]
    return tuple(s for s in found if s is not None)


def _course(
    log: ArduPilotLog, columns: tuple[str, ...], letters: tuple[str, ...], end_s: float
) -> Setpoint | None:
    """Targets of PSCN, PSCE and PSCD (ArduPilot 4.1 and later), at the times of the last, from the
    first of several columns that a message has: DV is the velocity demanded by mission or pilot, TV
    includes the output of the position controller.

    The horizontal controller is inactive where the pilot sets a lean angle: there is no setpoint
    then.
    """
    axes = [log.whole(f"PSC{a}") for a in _AXES]
    down = axes[-1]
    if down is None:
        return None
    down, times = _until(down, end_s)
    values = np.full((len(times), len(_AXES)), np.nan)
    for k, (axis, topic) in enumerate(zip(_AXES, axes, strict=True)):
        name = next((f"{k}{axis}" for k in letters if topic and topic.has(f"{k}{axis}")), None)
        if topic is not None and name is not None:
            values[:, k] = _nearest(topic, topic.si((name,))[:, 0], times)
    return setpoint_of(columns, times, values)


def _nearest(topic: Topic, values: Array, t_s: Array) -> Array:
    """Values at the nearest of a topic's times; NaN where there is none near."""
    after = np.clip(np.searchsorted(topic.t_s, t_s), 0, len(values) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(topic.t_s[before] - t_s) < np.abs(topic.t_s[after] - t_s)
    index = np.where(nearer, before, after)
    return np.where(np.abs(topic.t_s[index] - t_s) < _TOGETHER_S, values[index], np.nan)


def _attitude(log: ArduPilotLog, end_s: float) -> Setpoint | None:
    topic = log.whole("ATT")
    if topic is None or not topic.has(*_ANGLES):
        return None
    topic, times = _until(topic, end_s)
    roll, pitch, yaw = topic.si(_ANGLES).T
    q = np.asarray(from_euler(roll, pitch, yaw), dtype=np.float64).T
    return setpoint_of(QUAT, times, q)


def _rates(log: ArduPilotLog, end_s: float) -> Setpoint | None:
    topic = log.whole("RATE")
    if topic is None or not topic.has(*_RATES):
        return None
    topic, times = _until(topic, end_s)
    return setpoint_of(GYRO, times, topic.si(_RATES))


def _until(topic: Topic, end_s: float) -> tuple[Topic, Array]:
    """A topic within the record, and its times, s."""
    inside = (topic.t_us >= 0) & (topic.t_s <= end_s)
    cut = Topic(topic.name, topic.t_us[inside], topic.source, topic.rows[inside])
    return cut, cut.t_s


# -- the record ---------------------------------------------------------------------------------
#
# Modes, arming, failsafes, messages, parameters and filters of a DataFlash log.

_LASTING = (2, 3, 5, 6, 8, 9, 11, 16, 17, 18, 23, 26, 27, 29)
"""Subsystems of ERR whose code 0 marks the end of the error; errors of the others are
instantaneous."""
_RESETS: dict[int, ResetOf] = {60: "height", 62: "yaw"}
"""Event number in EV of a reset of the estimator. Source: ArduPilot,
libraries/AP_Logger/AP_Logger.h."""
_LONGEST_S = 365 * 86_400.0  # a year: times beyond are damage
_LEAST_HZ = 1.0  # cut-off of an enabled filter
_LOW_PASSES: tuple[tuple[str, Sensor], ...] = (  # parameter and sensor
    ("INS_GYRO_FILTER", "gyro"),
    ("INS_ACCEL_FILTER", "acc"),
)
_HARMONIC_NOTCHES = ("INS_HNTCH", "INS_HNTC2")  # stems of parameters since 4.2
_NOTCH = "INS_NOTCH"
"""Stem of the notch parameters before ArduPilot 4.2."""
_MOST_HARMONICS = 16  # bits of INS_HNTCH_HMNCS


def from_ardupilot_autopilot(log: ArduPilotLog, end_s: float) -> Autopilot:
    """ArduPilot's records of a flight; none of them is a finding.

    Args:
        log: The log, cut to the flight.
        end_s: End of the record, s.
    """
    failsafes, failures = _errors(log, end_s)
    said = sorted([*_messages(log), *failures], key=lambda m: m.t_s)
    return Autopilot(
        _modes(log, end_s),
        _armed(log, end_s),
        failsafes,
        tuple(said[:MOST_MESSAGES]),
        setpoints(log, end_s),
        _parameters(log),
        _filters(log.params),
        _resets(log, end_s),
    )


def _resets(log: ArduPilotLog, end_s: float) -> tuple[Reset, ...]:
    """Steps that the estimator made in its own output."""
    events = log.whole("EV")
    if events is None or not events.has("Id"):
        return ()
    kinds = events.raw("Id")
    each = (Reset(of, t) for k, of in _RESETS.items() for t in events.t_s[kinds == k].tolist())
    return tuple(r for r in each if 0.0 <= r.t_s <= end_s)


def _modes(log: ArduPilotLog, end_s: float) -> tuple[Mode, ...]:
    topic = log.whole("MODE")
    names = [] if topic is None else mode_names(log, topic)
    return modes_of(topic.t_s, names, end_s) if topic is not None and names else ()


def _armed(log: ArduPilotLog, end_s: float) -> tuple[Interval, ...]:
    """Armed intervals by the arming events; a log whose first event disarms began armed. Without
    events, by the outputs of the motors."""
    events = log.whole("EV")
    if events is not None and events.has("Id"):
        kinds = events.raw("Id")
        known = np.isin(kinds, (ARMED, DISARMED))
        if known.any():
            t_s, on = events.t_s[known], kinds[known] == ARMED
            t_s, on = np.append(min(0.0, t_s[0] - 1.0), t_s), np.append(not on[0], on)
            return stretches_of(t_s, on, "armed", end_s)
    spans = [(max(a * 1e-6, 0.0), min(b * 1e-6, end_s)) for a, b in armed_spans(log)]
    return tuple(Interval("armed", a, b) for a, b in spans if b > a)[:MOST_EVENTS]


def _errors(log: ArduPilotLog, end_s: float) -> tuple[tuple[Interval, ...], list[Message]]:
    """Failures with a duration, and instantaneous ones as messages."""
    topic = log.whole("ERR")
    if topic is None or not topic.has("Subsys", "ECode"):
        return (), []
    systems, codes = topic.raw("Subsys"), topic.raw("ECode")
    lasting: list[Interval] = []
    for number in _LASTING:
        of = systems == number
        if of.any():
            lasting += stretches_of(topic.t_s[of], codes[of] > 0, SUBSYSTEMS[number], end_s)
    instants = [
        Message(t, "error", f"{subsystem(number)}, code {code:.0f}")
        for t, number, code in zip(
            topic.t_s.tolist(), systems.tolist(), codes.tolist(), strict=True
        )
        if np.isfinite((number, code)).all() and number not in _LASTING and abs(t) < _LONGEST_S
    ]
    lasting.sort(key=lambda s: s.start_s)
    return tuple(lasting[:MOST_EVENTS]), instants


def _messages(log: ArduPilotLog) -> list[Message]:
    """Texts of MSG, which has no severity levels."""
    topic = log.whole("MSG")
    if topic is None or "Message" not in topic.source.data or topic.has("Message"):
        return []
    texts = topic.source.texts("Message")
    return [
        Message(t, "", text)
        for t, row in zip(topic.t_s.tolist(), topic.rows.tolist(), strict=True)
        if abs(t) < _LONGEST_S and (text := as_text(texts[row]))
    ]


def _parameters(log: ArduPilotLog) -> tuple[Parameter, ...]:
    """Parameters that differ from the defaults in PARM (since ArduPilot 4.3)."""
    messages = log.content.messages.get("PARM")
    if messages is None or not {"Name", "Default"} <= set(messages.data):
        return ()
    values = messages.data["Default"].astype(np.float64).tolist()
    defaults = {
        name: float(f"{value:.7g}")  # logged as float32
        for name, value in zip(messages.texts("Name"), values, strict=True)
        if np.isfinite(value)
    }
    return differing(log.params, defaults)


def _filters(params: dict[str, float]) -> tuple[Filter, ...]:
    """Low-passes and notches that are enabled.

    Source: ArduPilot, AP_InertialSensor and HarmonicNotchFilter; bit k of HMNCS is harmonic k + 1.
    """
    found = [
        Filter(sensor, "low-pass", params[name], name)
        for name, sensor in _LOW_PASSES
        if params.get(name, 0.0) >= _LEAST_HZ
    ]
    for stem in (*_HARMONIC_NOTCHES, _NOTCH):
        name = f"{stem}_FREQ"
        base_hz = params.get(name, 0.0)
        if params.get(f"{stem}_ENABLE", 0.0) < 1.0 or base_hz < _LEAST_HZ:
            continue
        bits = int(params.get(f"{stem}_HMNCS", 1.0)) or 1
        tracks = params.get(f"{stem}_MODE", 0.0) >= 1.0
        kind: FilterKind = "tracking notch" if tracks else "notch"
        found += [
            Filter("gyro", kind, base_hz * (k + 1), name)
            for k in range(_MOST_HARMONICS)
            if bits >> k & 1
        ]
    return tuple(sorted(found, key=lambda f: f.frequency_hz))
