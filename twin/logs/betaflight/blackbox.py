"""Betaflight Blackbox log -> Flight.

Axes of Betaflight: body x forward, y left, z up (roll right, nose down and nose left are positive);
world x north, y west, z up. Half a turn about x converts them to FRD and NED. The accelerometer at
rest reads +1 g along z. Source: Betaflight's mixer.c, rc.c, imu.c and sitl.c: the mixer raises the
rear motors for a positive pitch, the left ones for a positive roll; stick forward and stick right
are positive there, and yaw is the negative of the stick.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...vehicle import GRAVITY_M_S2
from ...vehicle.layouts import Layout, frame
from ..airframe import Airframe, Place, SourcedValue, local_ned
from ..assemble import FlightBuilder, unit_quaternions
from ..autopilot import (
    MOST_MESSAGES,
    Autopilot,
    Filter,
    Interval,
    Message,
    Mode,
    Setpoint,
    modes_of,
    setpoint_of,
    stretches_of,
)
from ..columns import ACC, GYRO, MAX_MOTORS, MIN_MOTORS, POS, QUAT, VEL, motor_columns
from ..flight import Array, Flight, Site
from ..formats import ReadOptions
from ..stamps import monotonic_samples
from .frames import DISARM, MODES, SYNC_BEEP, BlackboxLog, open_blackbox

# -- signals ------------------------------------------------------------------------------------
#
# Fields of main frames -> columns of the flight table.

Times = NDArray[np.int64]
TURNED = np.array((1.0, -1.0, -1.0))
"""Conversion from Betaflight's axes to FRD or NED."""
_FULL_16_BITS = 32767.0  # value of 1 in imuQuaternion
_SEA_LEVEL_PA, _SCALE_M, _EXPONENT = 101_325.0, 44_330.0, 0.190295
"""Constants of Betaflight's height over pressure, barometer.c."""
_HIGH_RESOLUTION = 10.0  # factor on rates with blackbox_high_resolution
_FRESH_US = 100_000  # time after which an unchanged value counts as a new sample
_HUNDREDTHS_SINCE = (4, 0)  # release from which vbatLatest is in 0.01 V


def vector_fields(stem: str) -> tuple[str, ...]:
    """Names of the fields of three axes."""
    return tuple(f"{stem}[{k}]" for k in range(3))


def rate_scale(log: BlackboxLog) -> float:
    """Factor from logged rates to rad/s: `gyro_scale` is degrees per second, a tenth of it with
    blackbox_high_resolution. NaN: the head does not contain it."""
    scale = log.header.bits("gyro_scale")
    fine = log.header.number("blackbox_high_resolution", 0.0) > 0.0
    if scale is None or not np.isfinite(scale) or scale <= 0.0:
        return float("nan")
    return float(np.deg2rad(scale / (_HIGH_RESOLUTION if fine else 1.0)))


def gyro_field(log: BlackboxLog) -> str:
    """Field of the body rates: those before the filters on board where they are logged."""
    main = log.recording.main
    return next((f for f in ("gyroUnfilt", "gyroADC") if main.has(*vector_fields(f))), "")


def accel_cutoff_hz(log: BlackboxLog) -> float:
    """Cut-off of the low-pass before the logged acceleration, Hz; 0: none. The head has 100 times
    that."""
    return max(log.header.number("acc_lpf_hz", 0.0), 0.0) / 100.0


def add(
    log: BlackboxLog,
    flight: FlightBuilder,
    where: str,
    names: tuple[str, ...],
    t_us: Times,
    values: Array,
) -> None:
    """Add a signal with times of the firmware's clock."""
    t_us = t_us - log.start_us
    keep = monotonic_samples(log, where, t_us, "frames")
    flight.add(where, names, t_us[keep], values[keep])


def add_signals(log: BlackboxLog, flight: FlightBuilder) -> None:
    """Add all signals but motors and satellites."""
    _add_gyro(log, flight)
    _add_acceleration(log, flight)
    _add_attitude(log, flight)
    _add_barometer(log, flight)
    _add_battery(log, flight)


def _add_gyro(log: BlackboxLog, flight: FlightBuilder) -> None:
    name, scale = gyro_field(log), rate_scale(log)
    if not name:
        log.note("warning", "gyro", "no gyroADC in the log: enable the field GYRO of Blackbox")
        return
    if np.isnan(scale):
        value = log.header.settings.get("gyro_scale", "")[:20]
        log.note("error", "gyro", f"left out, the head says gyro_scale {value!r}, no number")
        return
    main = log.recording.main
    add(log, flight, "gyro", GYRO, main.t_us, main.columns(vector_fields(name)) * TURNED * scale)
    side = "before" if name == "gyroUnfilt" else "after"
    flight.facts["gyro from"] = f"{name}, {side} the filters"


def _add_acceleration(log: BlackboxLog, flight: FlightBuilder) -> None:
    main = log.recording.main
    if not main.has(*vector_fields("accSmooth")):
        log.note("warning", "acc", "no accSmooth in the log: enable the accelerometer")
        return
    one_g = log.header.number("acc_1G", 0.0)
    if not one_g > 0.0:
        value = log.header.settings.get("acc_1G", "")[:20]
        log.note("error", "acc", f"left out, the head says acc_1G {value!r}")
        return
    delay_us, cutoff_hz = 0, accel_cutoff_hz(log)
    if cutoff_hz >= 1.0:
        delay_us = flight.filter_delay_us("acc", cutoff_hz, "acc_lpf_hz")
    values = main.columns(vector_fields("accSmooth")) * TURNED * (GRAVITY_M_S2 / one_g)
    add(log, flight, "acc", ACC, main.t_us - delay_us, values)


def _add_attitude(log: BlackboxLog, flight: FlightBuilder) -> None:
    """Add the attitude from the vector part of a quaternion with non-negative scalar part."""
    main = log.recording.main
    if not main.has(*vector_fields("imuQuaternion")):
        return
    vector = main.columns(vector_fields("imuQuaternion")) / _FULL_16_BITS
    scalar = np.sqrt(np.maximum(1.0 - np.sum(vector**2, axis=1), 0.0))
    usable, q = unit_quaternions(log, np.column_stack([scalar, vector * TURNED]))
    add(log, flight, "q", QUAT, main.t_us[usable], q)
    source = "imuQuaternion; without a compass, north is where it took off"
    flight.facts["attitude from"] = source


def _add_barometer(log: BlackboxLog, flight: FlightBuilder) -> None:
    """Add the pressure that gives the logged height over the place of arming by Betaflight's
    formula."""
    main = log.recording.main
    if not main.has("baroAlt"):
        return
    height_m = main.columns(("baroAlt",)) / 100.0
    fresh = _fresh(main.t_us, height_m)
    share = np.maximum(1.0 - height_m[fresh] / _SCALE_M, 0.0)
    add(
        log,
        flight,
        "baro",
        ("baro_pa",),
        main.t_us[fresh],
        _SEA_LEVEL_PA * share ** (1 / _EXPONENT),
    )
    log.note(
        "info",
        "baro",
        "the log has height over the place of arming, not pressure: written as that of the "
        "standard atmosphere from sea level. The pressure of the day is not known",
    )


def _add_battery(log: BlackboxLog, flight: FlightBuilder) -> None:
    main = log.recording.main
    if main.has("vbatLatest"):
        volts = main.columns(("vbatLatest",)) * (0.01 if log.version >= _HUNDREDTHS_SINCE else 0.1)
        fresh = _fresh(main.t_us, volts)
        add(log, flight, "vbat_v", ("vbat_v",), main.t_us[fresh], volts[fresh])
    if main.has("amperageLatest"):
        amperes = main.columns(("amperageLatest",)) * 0.01
        fresh = _fresh(main.t_us, amperes)
        add(log, flight, "ibat_a", ("ibat_a",), main.t_us[fresh], amperes[fresh])


def _fresh(t_us: Times, values: Array) -> NDArray[np.int64]:
    """Indices of new samples of a slow signal that is logged often: where it changes, or 0.1 s
    after the last one."""
    changed = np.append(True, np.any(np.diff(values, axis=0) != 0.0, axis=1)).tolist()
    fresh, last = [], -_FRESH_US
    for k, (t, new) in enumerate(zip((t_us - t_us[0]).tolist(), changed, strict=True)):
        if new or t - last >= _FRESH_US:
            fresh.append(k)
            last = t
    return np.array(fresh, dtype=np.int64)


# -- satellites ---------------------------------------------------------------------------------
#
# Satellite fixes of a Blackbox log: place, velocity, time of day.

_DEGREES = 1e-7  # unit of GPS_coord
_FEWEST_SATELLITES = 4  # of a fix in three dimensions
_DECIMETRES_SINCE = (4, 0)  # release from which on GPS_altitude is in 0.1 m
_COORDINATES = ("GPS_coord[0]", "GPS_coord[1]")  # latitude, longitude
_DATE = re.compile(r"(20\d\d)-(\d\d)-(\d\d)T")
"""0000-01-01 where the firmware does not know the time."""


def add_satellites(log: BlackboxLog, flight: FlightBuilder) -> SourcedValue[Place] | None:
    """Add positions and velocities of the fixes; returns the origin of the positions."""
    gps = log.recording.gps
    if not gps.has(*_COORDINATES, "GPS_numSat", "GPS_altitude"):
        return None
    degrees = gps.columns(_COORDINATES) * _DEGREES
    up_m = gps.columns(("GPS_altitude",))[:, 0]
    if log.version >= _DECIMETRES_SINCE:
        up_m = 0.1 * up_m
    enough = gps.columns(("GPS_numSat",))[:, 0] >= _FEWEST_SATELLITES
    somewhere = (np.abs(degrees) <= (90.0, 180.0)).all(axis=1) & degrees.any(axis=1)
    good = enough & somewhere
    message = f"fixes left out, of fewer than {_FEWEST_SATELLITES} satellites or nowhere"
    log.note("warning", "pos", message, ~good)
    if not good.any():
        return None
    t_us = gps.t_us[good]
    add(log, flight, "pos", POS, t_us, local_ned(degrees[good, 0], degrees[good, 1], up_m[good]))
    if gps.has(*vector_fields("GPS_velned")):
        add(log, flight, "vel", VEL, t_us, 0.01 * gps.columns(vector_fields("GPS_velned"))[good])
    else:
        log.note("info", "vel", "Betaflight before 4.6 does not log the velocity north, east, down")
    log.note("info", "pos", "fixes of the satellites as they came, no estimate of the autopilot")
    latitude, longitude = degrees[good][0].tolist()
    first = Place.of_degrees(latitude, longitude, up_m[good][0], _year(log))
    return SourcedValue(first, "GPS of the log")


def _year(log: BlackboxLog) -> float | None:
    """Decimal year by the clock of the flight controller, None where the clock is not set."""
    found = _DATE.match(log.header.settings.get("Log start datetime", ""))
    if found is None:
        return None
    year, month, day = (int(part) for part in found.groups())
    if not 1 <= month <= 12 or not 1 <= day <= 31:
        return None
    return year + (month - 1) / 12.0 + (day - 1) / 365.25


def site_of(origin: SourcedValue[Place] | None) -> Site | None:
    """Outdoors where there were fixes; else not known."""
    return None if origin is None else Site(False, "GPS has a fix")


# -- motors -------------------------------------------------------------------------------------
#
# Motor outputs and rotor speeds of a Blackbox log, and the mixer inferred from them.
#
# Motors of Betaflight's QUADX: 1 rear right, 2 front right, 3 rear left, 4 front left; 1 and 4 turn
# clockwise unless yaw_motors_reversed. Source: mixer.c and motor.h of Betaflight, and its manual.

_DIGITAL = (5, 6, 7, 8)
"""DSHOT150, 300, 600 and PROSHOT1000 in motor_pwm_protocol."""
_DSHOT_STOP, _DSHOT_FULL = 48.0, 2047.0  # DSHOT values of command 0 and 1
_PULSE_STOP, _PULSE_FULL = 1000.0, 2000.0  # us, defaults of mincommand and maxthrottle
_FEATURE_3D = 1 << 12  # bit of features
_PER_ERPM = 100.0 * 2.0 * np.pi / 60.0  # rad/s of a hundred revolutions per minute
_TURNING = 0.05  # command from which a rotor must report a speed
_MOST_SILENT = 0.2  # share of frames without a report
_SURE = 0.5  # correlation from which the mixer is confirmed
_QUAD = {
    "roll": np.array((-1.0, -1.0, 1.0, 1.0)),
    "pitch": np.array((1.0, -1.0, 1.0, -1.0)),
    "yaw": np.array((1.0, -1.0, -1.0, 1.0)),
}
"""Sign of each motor's output in QUADX for a positive output of a controller."""
_CONFIRMED = "QUADX, as the motors follow the controllers"  # source of a layout
_DOUBT = "four motors, taken for QUADX"  # source of a layout


@dataclass(frozen=True, slots=True)
class Motors:
    """Outputs of the motors.

    Attributes:
        count: Number of motors.
        commands: Commands 0..1, shape (n, count); None: omitted.
        pulse_us: Pulse widths of commands 0 and 1; None: digital.
    """

    count: int
    commands: Array | None
    pulse_us: tuple[float, float] | None


def add_motors(log: BlackboxLog, flight: FlightBuilder) -> Motors:
    """Add commands and rotor speeds to the table."""
    main = log.recording.main
    count = next((k for k in range(MAX_MOTORS) if f"motor[{k}]" not in main.names), MAX_MOTORS)
    if count < MIN_MOTORS:
        message = f"{count} motor outputs in the log, a multirotor has {MIN_MOTORS} at least"
        log.note("warning", "cmd", f"{message}; enable the field MOTOR of Blackbox")
        return Motors(count, None, None)
    raw = main.columns([f"motor[{k}]" for k in range(count)])
    if log.header.whole("features", 0) & _FEATURE_3D:
        log.note("error", "cmd", "left out: motors that turn both ways (feature 3D) are not known")
        return Motors(count, None, None)
    low, high, digital = _range(log)
    if not high > low:
        log.note("error", "cmd", f"left out, the head has motors from {low:g} to {high:g}")
        return Motors(count, None, None)
    commands = np.clip((raw - low) / (high - low), 0.0, None)
    add(log, flight, "cmd", motor_columns("cmd", count), main.t_us, commands)
    _add_speeds(log, flight, commands)
    return Motors(count, commands, None if digital else (low, high))


def _range(log: BlackboxLog) -> tuple[float, float, bool]:
    """Outputs for a stopped motor and for full power, and whether they are digital."""
    header = log.header
    outputs = header.numbers("motorOutput")
    protocol = header.whole("motor_pwm_protocol", -1)
    digital = protocol in _DIGITAL if protocol >= 0 else len(outputs) > 1 and outputs[0] < 1000.0
    if digital:
        return _DSHOT_STOP, _DSHOT_FULL, True
    low = header.number("mincommand", _PULSE_STOP)
    return low, header.number("maxthrottle", _PULSE_FULL), False


def _add_speeds(log: BlackboxLog, flight: FlightBuilder, commands: Array) -> None:
    """Add rotor speeds of bidirectional DSHOT: hundreds of electrical revolutions per minute."""
    main, count = log.recording.main, commands.shape[1]
    fields = next(
        (
            f
            for stem in ("eRPM", "eRPM(/100)")
            if main.has(*(f := tuple(f"{stem}[{k}]" for k in range(count))))
        ),
        (),
    )
    if not fields:
        return
    poles = log.header.number("motor_poles", 0.0)
    if not poles >= 2.0:
        value = log.header.settings.get("motor_poles", "")[:20]
        log.note("error", "rotor", f"left out, the head says motor_poles {value!r}")
        return
    raw = main.columns(fields)
    silent = ((raw <= 0.0) & (commands > _TURNING)).any(axis=1)
    if silent.mean() > _MOST_SILENT:
        share = 100.0 * silent.mean()
        message = f"left out, a motor with a command reports no speed in {share:.0f} %"
        log.note("warning", "rotor", f"{message} of the frames")
        return
    log.note("warning", "rotor", "frames left out, a motor with a command reports no speed", silent)
    speeds = raw[~silent] * (_PER_ERPM / (poles / 2.0))
    add(log, flight, "rotor", motor_columns("rotor", count), main.t_us[~silent], speeds)


def mixer_correlation(log: BlackboxLog, motors: Motors) -> dict[str, float]:
    """Correlation of each controller's output with that of QUADX computed from the motors, by axis;
    {} where the log does not have both."""
    main = log.recording.main
    if motors.count != 4 or motors.commands is None:
        return {}
    found = {}
    for k, (axis, pattern) in enumerate(_QUAD.items()):
        parts = [f"axis{p}[{k}]" for p in "PIDFS" if f"axis{p}[{k}]" in main.names]
        if not parts:
            continue
        wanted = main.columns(parts).sum(axis=1)
        given = motors.commands @ pattern
        if wanted.std() > 0.0 and given.std() > 0.0:
            found[axis] = float(np.corrcoef(wanted, given)[0, 1])
    return found


def layout_of(log: BlackboxLog, motors: Motors, facts: dict[str, str]) -> Layout | None:
    """Positions and directions of the rotors, None where they are not known; adds to the facts."""
    if motors.count != 4:
        return None
    correlation = mixer_correlation(log, motors)
    if correlation:
        text = ", ".join(f"{axis} {r:+.2f}" for axis, r in correlation.items())
        facts["mixer"] = f"QUADX; controllers against motors by axis: {text}"
    wrong = [axis for axis in ("roll", "pitch") if correlation.get(axis, 1.0) < -_SURE]
    if wrong:
        message = f"motors do not follow the controllers as in QUADX ({', '.join(wrong)})"
        log.note("warning", "cmd", f"{message}: another mixer, or motors remapped")
        return None
    sure = min(correlation.get(axis, 0.0) for axis in ("roll", "pitch")) > _SURE
    layout = frame("betaflight x", _CONFIRMED if sure else _DOUBT)
    if not sure:
        log.note("info", "cmd", f"the log does not name the mixer: {_DOUBT}")
        layout = replace(layout, places_known=False)
    yaw = correlation.get("yaw", 0.0)
    if abs(yaw) < _SURE:
        message = "the log does not give yaw_motors_reversed: motors 1 and 4 taken for clockwise"
        log.note("info", "cmd", message)
        return replace(layout, senses_known=False)
    if yaw < 0.0:
        facts["propellers"] = "reversed, as the motors follow the yaw controller"
        turned: NDArray[np.float64] = -layout.direction
        source = layout.source.replace("not reversed", "reversed")
        return replace(layout, direction=turned, source=source)
    facts["propellers"] = "not reversed, as the motors follow the yaw controller"
    return layout


# -- the autopilot ------------------------------------------------------------------------------
#
# Betaflight's own records of a flight and of its filters.

_ARMED, _ANGLE, _HORIZON = 1, 2, 4
"""Bits of the flight modes; higher ones have other meanings in other versions."""
_REASONS = {  # for disarming, core.h
    0: "arming disabled",
    1: "failsafe",
    2: "throttle timeout",
    3: "sticks",
    4: "switch",
    5: "crash protection",
    6: "runaway take-off",
    7: "GPS rescue",
    8: "serial command",
    9: "landing",
    10: "crash flip",
    255: "system",
}
_ALARMING = (1, 5, 6)  # reasons for disarming that are warnings
_FAILSAFES = {1: "signal of the receiver lost", 2: "failsafe landing", 3: "failsafe landed"}
"""Text by FailsafePhase."""
_LEAST_HZ = 1.0  # cut-off of an enabled filter


def from_betaflight(log: BlackboxLog, end_s: float) -> Autopilot:
    """Modes, arming, failsafes, events, setpoint of the rates and filters.

    Args:
        log: The log.
        end_s: End of the record, s.
    """
    t_s, flags = _flags(log)
    setpoint = _rates(log)
    return Autopilot(
        modes=_modes(t_s, flags, end_s),
        armed=stretches_of(t_s, (flags & _ARMED) > 0, "armed", end_s) if len(t_s) else (),
        failsafes=_failsafes(log, end_s),
        messages=_messages(log, end_s),
        setpoints=(setpoint,) if setpoint is not None else (),
        filters=filters_of(log),
    )


def _seconds(log: BlackboxLog, t_us: Times) -> Array:
    return np.asarray((t_us - log.start_us) * 1e-6, dtype=np.float64)


def _flags(log: BlackboxLog) -> tuple[Array, NDArray[np.int64]]:
    """Mode flags and the times at which they were reported, s: from S frames and events."""
    slow = log.recording.slow
    reports: list[tuple[int, int]] = []
    if slow.has("flightModeFlags"):
        at = slow.names.index("flightModeFlags")
        reports += zip(slow.t_us.tolist(), slow.values[:, at].tolist(), strict=True)
    reports += [(e.t_us, e.values[0]) for e in log.recording.events if e.kind == MODES]
    reports.sort(key=lambda each: each[0])
    t_us = np.array([t for t, _ in reports], dtype=np.int64)
    return _seconds(log, t_us), np.array([f for _, f in reports], dtype=np.int64)


def _modes(t_s: Array, flags: NDArray[np.int64], end_s: float) -> tuple[Mode, ...]:
    names = [
        "ANGLE" if bits & _ANGLE else "HORIZON" if bits & _HORIZON else "ACRO"
        for bits in flags.tolist()
    ]
    return modes_of(t_s, names, end_s)


def _failsafes(log: BlackboxLog, end_s: float) -> tuple[Interval, ...]:
    slow = log.recording.slow
    if not slow.has("failsafePhase"):
        return ()
    phase = slow.columns(("failsafePhase",))[:, 0]
    t_s = _seconds(log, slow.t_us)
    found: list[Interval] = []
    for number, name in _FAILSAFES.items():
        found += stretches_of(t_s, phase == number, name, end_s)
    return tuple(sorted(found, key=lambda s: s.start_s))


def _messages(log: BlackboxLog, end_s: float) -> tuple[Message, ...]:
    """Reason for disarming, and time of the beep on arming."""
    found = []
    for event in log.recording.events:
        t_s = min(max((event.t_us - log.start_us) * 1e-6, 0.0), end_s)
        if event.kind == DISARM:
            reason = event.values[0]
            text = f"disarmed: {_REASONS.get(reason, f'reason {reason}')}"
            found.append(Message(t_s, "warning" if reason in _ALARMING else "info", text))
        elif event.kind == SYNC_BEEP:
            found.append(Message(t_s, "info", "beep of arming"))
    return tuple(sorted(found, key=lambda m: m.t_s)[:MOST_MESSAGES])


def _rates(log: BlackboxLog) -> Setpoint | None:
    """Rate setpoints of the pilot or of the angle controller, in the same unit as the gyro."""
    main, scale = log.recording.main, rate_scale(log)
    if not main.has(*vector_fields("setpoint")) or np.isnan(scale):
        return None
    order = np.argsort(main.t_us, kind="stable")
    t_us, first = np.unique(main.t_us[order], return_index=True)
    values = main.columns(vector_fields("setpoint"))[order][first] * TURNED * scale
    return setpoint_of(GYRO, _seconds(log, t_us), values)


def filters_of(log: BlackboxLog) -> tuple[Filter, ...]:
    """Low-passes and notches that are enabled, by frequency.

    A dynamic low-pass follows the throttle upwards from the first of two frequencies; the notches
    of the rotors have harmonics at integer multiples.
    """
    header = log.header
    found = []
    for name in (
        "gyro_lpf1_static_hz",
        "gyro_lpf2_static_hz",
        "gyro_lowpass_hz",
        "gyro_lowpass2_hz",
        "gyro_lpf1_dyn_hz",
        "gyro_lowpass_dyn_hz",
    ):
        hz = header.number(name, 0.0)
        if _LEAST_HZ <= hz < np.inf:
            found.append(Filter("gyro", "low-pass", hz, name))
    found += [
        Filter("gyro", "notch", hz, "gyro_notch_hz")
        for hz in header.numbers("gyro_notch_hz")
        if _LEAST_HZ <= hz < np.inf
    ]
    lowest = header.number("rpm_filter_min_hz", 0.0)
    if header.number("rpm_filter_harmonics", 0.0) >= 1.0 and _LEAST_HZ <= lowest < np.inf:
        found.append(Filter("gyro", "tracking notch", lowest, "rpm_filter_min_hz"))
    if _LEAST_HZ <= accel_cutoff_hz(log) < np.inf:
        found.append(Filter("acc", "low-pass", accel_cutoff_hz(log), "acc_lpf_hz"))
    return tuple(sorted(found, key=lambda f: f.frequency_hz))


# -- the flight ---------------------------------------------------------------------------------

_ADVICE = "Enable the fields GYRO, ACC and MOTOR of Blackbox (blackbox_disable_*) and fly again."
"""Advice where no signal of the motion is logged."""
_SHOWN = 60  # characters of a text in the head


def read_blackbox(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a Blackbox log of Betaflight, of several flights in a file the longest; arguments and
    errors as in `formats.Reader`."""
    log, which = open_blackbox(path, blob)
    flight = FlightBuilder(log, path, {"firmware": log.firmware[:_SHOWN] or "Betaflight"})
    facts = flight.facts
    facts |= _facts(log)
    if which:
        facts["flight in the file"] = which
    add_signals(log, flight)
    motors = add_motors(log, flight)
    origin = add_satellites(log, flight)
    table = flight.lay_out(_ADVICE)
    airframe = _airframe(log, motors, origin, layout_of(log, motors, facts))
    autopilot = from_betaflight(log, float(table["time"].iloc[-1]))
    if autopilot.modes:
        facts["modes"] = ", ".join(f"{m.name} from {m.start_s:.1f} s" for m in autopilot.modes[:8])
    return flight.flight(table, site=site_of(origin), airframe=airframe, autopilot=autopilot)


def _facts(log: BlackboxLog) -> dict[str, str]:
    named = {
        "hardware": "Board information",
        "vehicle": "Craft name",
        "begun": "Log start datetime",
    }
    said = {fact: log.header.settings.get(name, "")[:_SHOWN] for fact, name in named.items()}
    return {fact: text for fact, text in said.items() if text and not text.startswith("0000")}


def _airframe(
    log: BlackboxLog, motors: Motors, origin: SourcedValue[Place] | None, layout: Layout | None
) -> Airframe:
    """Facts of the aircraft in the log."""
    cutoff_hz, pulse = accel_cutoff_hz(log), motors.pulse_us
    on_gyro = [f for f in filters_of(log) if f.sensor == "gyro"]
    words = ", ".join(f"{f.kind} {f.frequency_hz:g} Hz ({f.source})" for f in on_gyro)
    low = [f for f in on_gyro if f.kind == "low-pass"]
    filtered = gyro_field(log) == "gyroADC"
    return Airframe(
        rotors=SourcedValue(motors.count, "motor outputs of the log")
        if motors.count >= MIN_MOTORS
        else None,
        layout=layout,
        pulse_us=SourcedValue(pulse, "mincommand and maxthrottle of the log") if pulse else None,
        accel_cutoff_hz=SourcedValue(cutoff_hz, "acc_lpf_hz of the log")
        if cutoff_hz >= 1.0
        else None,
        gyro_cutoff_hz=SourcedValue(low[0].frequency_hz, f"{low[0].source} of the log")
        if filtered and low
        else None,
        place=origin,
        origin=origin,
        filters="" if filtered else words,
    )
