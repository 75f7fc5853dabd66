"""The aircraft and the site of an ArduPilot log: frame, motor outputs, yaw trim, parameters."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal

import numpy as np
import pandas as pd

from ...vehicle.layouts import CCW, CW, Layout
from ..airframe import (
    Airframe,
    Cells,
    Place,
    SourcedValue,
    ThrustCurve,
    decimal_year,
    positive_parameter,
)
from ..columns import MAX_MOTORS, MIN_MOTORS
from ..flight import Array, Site
from ..motors import MotorCommands, MotorOutput, commands_of, describe_outputs
from .log import (
    OTHERS,
    TRICOPTER,
    ArduPilotLog,
    Frame,
    Topic,
    firmware,
    frame_of,
    motor_channels,
    motor_value,
    pulse_range_us,
)

# -- geometry -----------------------------------------------------------------------------------
#
# Positions and directions of rotation of ArduPilot's motors, by FRAME_CLASS and FRAME_TYPE.
#
# The order of the motors is that of the frame: motor i is `cmd_i` and `rotor_i` of the flight
# table. Source: ArduPilot, libraries/AP_Motors/AP_MotorsMatrix.cpp and the documentation of
# connecting motors, https://ardupilot.org/copter/docs/connect-escs-and-motors.html.

Sense = Literal["ccw", "cw"]


@dataclass(frozen=True, slots=True)
class Geometry:
    """Rotors of a frame, motor 1 first.

    Attributes:
        frame: FRAME_CLASS and FRAME_TYPE by name, such as `quad x`.
        direction: Forward and right coordinates from the centre, the farthest rotor at 1, shape (n,
            2).
        sense: Direction of rotation of each rotor, seen from above.
        below: Whether a rotor is mounted coaxially below another one.
    """

    frame: str
    direction: Array
    sense: tuple[Sense, ...]
    below: tuple[bool, ...]

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.sense)

    @property
    def turn(self) -> Array:
        """+1 for a counter-clockwise rotor, -1 for the others, shape (n,)."""
        return np.array([1.0 if s == "ccw" else -1.0 for s in self.sense])


CLASSES = {  # FRAME_CLASS
    1: "quad",
    2: "hexa",
    3: "octa",
    4: "octaquad",
    5: "y6",
    7: "tri",
    12: "dodecahexa",
    14: "deca",
}
NO_MULTIROTOR = {6: "helicopter", 8: "singlecopter", 9: "coaxcopter", 11: "dual helicopter"} | {
    13: "quad helicopter"
}
"""FRAME_CLASS whose motor functions in SERVOn_FUNCTION are swash plates and flaps."""
TYPES = {  # FRAME_TYPE
    0: "plus",
    1: "x",
    2: "v",
    3: "h",
    4: "vtail",
    5: "atail",
    6: "plusrev",
    10: "y6b",
    11: "y6f",
    12: "bf_x",
    13: "dji_x",
    14: "cw_x",
    15: "i",
    16: "nyt_plus",
    17: "nyt_x",
    18: "bf_x_rev",
}

# clockwise angle from the front, degrees, and direction: + counter-clockwise, - clockwise
_CIRCLES: dict[tuple[str, str], str] = {
    ("quad", "plus"): "90+ -90+ 0- 180-",
    ("quad", "x"): "45+ -135+ -45- 135-",
    ("quad", "v"): "45+ -135+ -45- 135-",
    ("quad", "h"): "45- -135- -45+ 135+",
    ("quad", "plusrev"): "90- -90- 0+ 180+",
    ("quad", "bf_x"): "135- 45+ -135+ -45-",
    ("quad", "bf_x_rev"): "135+ 45- -135- -45+",
    ("quad", "dji_x"): "45+ -45- -135+ 135-",
    ("quad", "cw_x"): "45+ 135- -135+ -45-",
    ("hexa", "plus"): "0- 180+ -120- 60+ -60+ 120-",
    ("hexa", "x"): "90- -90+ -30- 150+ 30+ -150-",
    ("hexa", "dji_x"): "30+ -30- -90+ -150- 150+ 90-",
    ("hexa", "cw_x"): "30+ 90- 150+ -150- -90+ -30-",
    ("octa", "plus"): "0- 180- 45+ 135+ -45+ -135+ -90- 90-",
    ("octa", "x"): "22.5- -157.5- 67.5+ 157.5+ -22.5+ -112.5+ -67.5- 112.5-",
    ("octa", "dji_x"): "22.5+ -22.5- -67.5+ -112.5- -157.5+ 157.5- 112.5+ 67.5-",
    ("octa", "cw_x"): "22.5+ 67.5- 112.5+ 157.5- -157.5+ -112.5- -67.5+ -22.5-",
    ("octaquad", "plus"): "0+ -90- 180+ 90- -90+ 0- 90+ 180-",
    ("octaquad", "x"): "45+ -45- -135+ 135- -45+ 45- 135+ -135-",
    ("octaquad", "v"): "45+ -45- -135+ 135- -45+ 45- 135+ -135-",
    ("octaquad", "h"): "45- -45+ -135- 135+ -45- 45+ 135- -135+",
    ("dodecahexa", "plus"): "0+ 0- 60- 60+ 120+ 120- 180- 180+ -120+ -120- -60- -60+",
    ("dodecahexa", "x"): "30+ 30- 90- 90+ 150+ 150- -150- -150+ -90+ -90- -30- -30+",
}
# forward and right coordinates instead, in units of the mixer, and the direction
_PLACES: dict[tuple[str, str], str] = {
    ("hexa", "h"): "0,1- 0,-1+ 1,-1- -1,1+ 1,1+ -1,-1-",
    ("octa", "v"): ".34,-.83- -.32,.67- -.32,-.67+ -1,.5+ 1,-1+ .34,.83+ 1,1- -1,-.5-",
    ("octa", "h"): "1,1- -1,-1- .333,1+ -1,1+ 1,-1+ -.333,-1+ .333,-1- -.333,1-",
    ("octa", "i"): "-1,-.333- 1,.333- -1,-1+ 1,-.333+ -1,.333+ 1,1+ -1,1- 1,-1-",
    ("y6", "y6b"): ".5,1- .5,1+ -1,0- -1,0+ .5,-1- .5,-1+",
    ("y6", "y6f"): "-1,0+ .5,1+ .5,-1+ -1,0- .5,1- .5,-1-",
    ("y6", ""): ".666,1+ .666,-1- .666,-1+ -1.333,0- .666,1- -1.333,0+",
}


def geometry(frame_class: int, frame_type: int) -> Geometry | None:
    """Rotors of a frame; None where it is unknown, or has no fixed positions or directions."""
    kind, form = CLASSES.get(frame_class, ""), TYPES.get(frame_type, "")
    if kind == "y6" and (kind, form) not in _PLACES:
        form = ""
    if rotors := _CIRCLES.get((kind, form)):
        angles = np.radians([float(t[:-1]) for t in rotors.split()])
        places = np.column_stack([np.cos(angles), np.sin(angles)])
    elif rotors := _PLACES.get((kind, form)):
        places = np.array([[float(v) for v in t[:-1].split(",")] for t in rotors.split()])
        places = places / np.linalg.norm(places, axis=1).max()
    else:
        return None
    sense: tuple[Sense, ...] = tuple("ccw" if t.endswith("+") else "cw" for t in rotors.split())
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    below = tuple(bool((apart[k, :k] < 1e-6).any()) for k in range(len(places)))
    return Geometry(f"{kind} {form}".strip(), np.round(places, 6), sense, below)


def frame_name(frame_class: int, frame_type: int) -> str:
    """FRAME_CLASS and FRAME_TYPE by name where known, else by number."""
    kind = CLASSES.get(frame_class, f"FRAME_CLASS {frame_class}")
    return f"{kind} {TYPES.get(frame_type, f'FRAME_TYPE {frame_type}')}"


# -- site ---------------------------------------------------------------------------------------
#
# Place and date of a DataFlash log, by its satellite fixes.

_FIX_3D = 3  # GPS.Status
_GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)  # origin of GPS weeks
_LEAP_S = 18  # since 2017
_MOST_WEEKS = 4000  # to the year 2056: later ones are damage


def _fixes(log: ArduPilotLog) -> tuple[Topic, "np.ndarray[tuple[int], np.dtype[np.bool_]]"] | None:
    there = log.instances("GPS")
    topic = log.topic("GPS", there[0], "Status") if there else None
    return None if topic is None else (topic, topic.raw("Status") >= _FIX_3D)


def from_ardupilot_site(log: ArduPilotLog) -> Site | None:
    """Outdoors where at least half of the samples have a satellite fix; else not known."""
    found = _fixes(log)
    if found is None or found[1].mean() < 0.5:
        return None
    return Site(False, "GPS has a fix")


def median_fix(log: ArduPilotLog) -> tuple[Place, str] | None:
    """Median of the fixes, with its source as text; None without any."""
    found = _fixes(log)
    if found is None or not found[1].any():
        return None
    topic, fixed = found
    date = ("GWk", "GMS") if topic.has("GWk") else ("Week", "TimeMS")  # the latter up to Copter 3.2
    if not topic.has("Lat", "Lng", "Alt", *date):
        return None
    where = [float(np.median(topic.raw(c)[fixed])) for c in ("Lat", "Lng", "Alt")]
    week, ms = (float(np.median(topic.raw(c)[fixed])) for c in date)
    if not np.isfinite((*where, week, ms)).all() or not 0.0 < week < _MOST_WEEKS:
        return None
    if abs(where[0]) > 90.0 or abs(where[1]) > 180.0 or not 0.0 <= ms < 7 * 86_400_000:
        return None
    then = _GPS_EPOCH + timedelta(weeks=week, milliseconds=ms, seconds=-_LEAP_S)
    north = f"{abs(where[0]):.4f} {'N' if where[0] >= 0.0 else 'S'}"
    east = f"{abs(where[1]):.4f} {'E' if where[1] >= 0.0 else 'W'}"
    text = f"{north}, {east}, {where[2]:.0f} m, {then.date().isoformat()}"
    return Place.of_degrees(where[0], where[1], where[2], decimal_year(then)), text


# -- motor outputs ------------------------------------------------------------------------------
#
# Motor commands of a DataFlash log: pulse widths of RCOU, for the outputs that drive motors.

_ENOUGH_HZ = 50.0  # rate of motor commands; below, a finding
_OUTPUT = re.compile(r"(?:C|Ch|Chan)([1-9][0-9]?)")  # column of RCOU in each release
_ONESHOT125, _SHORT_US = 2.0, 300.0
"""MOT_PWM_TYPE of OneShot125, and upper limit of its pulses of 125 to 250 us."""


def logged_commands(log: ArduPilotLog, get: Callable[[str], Topic | None]) -> MotorCommands | None:
    """Commands of all motors; None where the log does not have them all.

    Args:
        log: The log; problems are reported by `from_ardupilot_commands` only.
        get: Function that returns a topic of the log.
    """
    channels = channels_of(log)
    if not MIN_MOTORS <= len(channels) <= MAX_MOTORS:
        return None
    widths = _widths(get, channels)
    if widths is None:
        return None
    topic, pwm_us = widths
    outputs = motor_outputs(log, channels, pwm_us)
    low, high = outputs[0].low, outputs[0].high
    said = f"{topic.name}, {topic.rate_hz:.0f} Hz, outputs {', '.join(map(str, channels))}"
    facts = {"commands": f"{said}, {low:.0f} to {high:.0f} us", "motors": describe_outputs(outputs)}
    return MotorCommands(topic.t_us, commands_of(outputs, pwm_us), facts)


def motor_outputs(log: ArduPilotLog, channels: list[int], widths_us: Array) -> list[MotorOutput]:
    """Output, range and source of the range of each motor.

    Until Copter 3.5 pulses of OneShot125 were divided by 8 before logging. Source: ArduPilot,
    AP_Motors::rc_write of that time.

    Args:
        log: The log.
        channels: Output number of each motor, from 1.
        widths_us: Logged pulse widths, shape (n, motors).
    """
    low, high = pulse_range_us(log.params)
    source = "MOT_PWM_MIN, MOT_PWM_MAX, MOT_PWM_TYPE"
    longest = float(np.nanmax(widths_us, initial=0.0))
    if motor_value(log.params, "MOT_PWM_TYPE", 0.0) == _ONESHOT125 and longest <= _SHORT_US:
        low, high, source = low / 8.0, high / 8.0, f"{source} 2: OneShot125, an eighth"
    named = {f"SERVO{c}_FUNCTION" for c in channels} <= log.params.keys()
    said = "SERVOn_FUNCTION" if named else "order of the frame"
    return [
        MotorOutput(motor, f"output {channel}", "us", low, high, f"{said}, {source}")
        for motor, channel in enumerate(channels, 1)
    ]


def channels_of(log: ArduPilotLog) -> list[int]:
    """Output numbers of the motors: by their functions, else the first ones, as many as the frame
    has; [] for a vehicle that is no multirotor."""
    frame = frame_of(log)
    if frame.kind in NO_MULTIROTOR:
        return []
    if has_functions(log.params):
        return motor_channels(log.params)
    if CLASSES.get(frame.kind) == "tri":
        return list(TRICOPTER)
    rotors = geometry(frame.kind, frame.form)
    return list(range(1, rotors.count + 1)) if rotors else []


def has_functions(params: Mapping[str, float]) -> bool:
    """Whether a log has SERVOn_FUNCTION parameters (since Copter 3.5)."""
    return any(name.startswith("SERVO") and name.endswith("_FUNCTION") for name in params)


def _widths(get: Callable[[str], Topic | None], channels: list[int]) -> tuple[Topic, Array] | None:
    """Pulse widths of the outputs, at the times of the message with the first output."""
    where: dict[int, tuple[Topic, str]] = {}
    for name in ("RCOU", "RCO2", "RCO3"):
        topic = get(name)
        for column in topic.source.data if topic is not None else ():
            if topic is not None and (match := _OUTPUT.fullmatch(column)) and topic.has(column):
                where.setdefault(int(match.group(1)), (topic, column))
    if any(c not in where for c in channels):
        return None
    base = where[channels[0]][0]
    columns = []
    for channel in channels:
        topic, column = where[channel]
        held = np.searchsorted(topic.t_us, base.t_us, side="right") - 1
        columns.append(topic.raw(column)[np.maximum(held, 0)])
    return base, np.column_stack(columns)


def from_ardupilot_commands(log: ArduPilotLog) -> MotorCommands | None:
    """Commands of a flight, clipped; findings report missing and clipped ones."""
    commands = logged_commands(log, log.topic)
    if commands is None:
        channels = channels_of(log)
        outputs = [n for n in ("RCOU", "RCO2", "RCO3") if n in log.content.messages]
        why = f"{', '.join(outputs) or 'no RCOU'} and {len(channels)} motors by SERVOn_FUNCTION"
        if not has_functions(log.params):
            why = f"{', '.join(outputs) or 'no RCOU'} and names no frame of known motors"
        log.note("warning", "cmd", f"no motor commands: the log has {why}. Set LOG_BITMASK bit 10")
        return None
    commands.note_slow(log, _ENOUGH_HZ)
    if not commands.running.any():
        log.note("warning", "cmd", "the motors never run")
    return commands.clipped(log, "RCOU")


# -- yaw trim -----------------------------------------------------------------------------------
#
# The yaw trim of a flight: difference of command between rotors of the two directions.

_FLYING = ("hover", "forward", "tour")  # phases in which the heading is controlled
_FEWEST = 20  # samples for a mean


@dataclass(frozen=True, slots=True)
class YawTrim:
    """Difference of command between rotors of the two directions that holds the heading.

    Attributes:
        command: Mean command of the clockwise rotors less that of the others.
        share: The difference as a share of the mean command of all.
        n: Number of samples.
    """

    command: float
    share: float
    n: int

    def __str__(self) -> str:
        more = "more" if self.command >= 0.0 else "less"
        return (
            f"clockwise rotors get {abs(self.command):.3f} {more} than the others, "
            f"{abs(self.share):.1%} of the mean command"
        )


def yaw_trim(table: pd.DataFrame, rotors: Geometry) -> YawTrim | None:
    """Yaw trim of a flight, from its commands in hover and forward flight.

    Args:
        table: Flight table, its commands in the order of the rotors.
        rotors: Directions of rotation of the rotors.

    Returns:
        None where the flight has too few commands in the air.
    """
    names = [f"cmd_{k + 1}" for k in range(rotors.count)]
    if any(c not in table for c in names) or f"cmd_{rotors.count + 1}" in table:
        return None
    phase = table["phase"].replace("", np.nan).ffill()
    rows = table.loc[phase.isin(_FLYING), names].dropna().to_numpy(dtype=np.float64)
    if len(rows) < _FEWEST or len(set(rotors.sense)) < 2:
        return None
    clockwise = rotors.turn < 0.0
    apart = float(rows[:, clockwise].mean() - rows[:, ~clockwise].mean())
    return YawTrim(apart, apart / float(rows.mean()), len(rows))


# -- airframe -----------------------------------------------------------------------------------
#
# Facts of an aircraft from the parameters and the head of an ArduPilot log.

_FRAME_SD = 0.05
"""Standard deviation of rotor positions about those of the named frame, over the arm; by judgement,
as for PX4."""
_FULL_CELL_V = 4.2  # voltage of a full lithium polymer cell
_IMU = tuple(f"INS_POS1_{a}" for a in "XYZ")  # position of the first IMU, m
_SPIN_MIN, _SPIN_MAX = 0.15, 0.95  # ArduPilot's defaults
_EKF_ORIGIN = 0  # ORGN.Type
_COUNTED = {"XKF1", "NKF1", "EKF1", "PSCN"}
"""Messages whose positions are relative to the origin of the EKF."""
_OTHERS = {  # firmware by the first word of its name
    "Plane": "a fixed-wing aircraft",
    "Rover": "a rover",
    "Sub": "a submarine",
    "AntennaTracker": "an antenna tracker",
    "Blimp": "an airship",
}


def from_ardupilot_airframe(log: ArduPilotLog) -> Airframe:
    """Facts of the aircraft in an ArduPilot log; the place is that of the flight."""
    params, count, place = log.params, len(channels_of(log)), median_fix(log)
    return Airframe(
        no_multirotor=_no_multirotor(log),
        rotors=SourcedValue(count, _motors_from(log)) if count else None,
        layout=_layout(frame_of(log), count),
        thrust=_thrust(params),
        pulse_us=SourcedValue(pulse_range_us(params), "MOT_PWM_* and MOT_PWM_TYPE of the log"),
        cells=_cells(params),
        imu_position_m=_imu_position(params),
        accel_cutoff_hz=positive_parameter(params, "INS_ACCEL_FILTER"),
        gyro_cutoff_hz=positive_parameter(params, "INS_GYRO_FILTER"),
        place=None if place is None else SourcedValue(place[0], "GPS of the log"),
        origin=_origin(log),
    )


def _motors_from(log: ArduPilotLog) -> str:
    """Source of the number of motors."""
    if has_functions(log.params):
        return "outputs by SERVOn_FUNCTION of the log"
    return frame_of(log).source


def _no_multirotor(log: ArduPilotLog) -> str:
    frame = frame_of(log)
    if name := NO_MULTIROTOR.get(frame.kind):
        return f"FRAME_CLASS is {frame.kind}, a {name}"
    other = OTHERS.match(firmware(log))
    if other and log.params.get("Q_ENABLE", 0.0) < 1.0:
        return f"its firmware is {other.group()}, of {_OTHERS[other.group(1) or other.group()]}"
    return ""


def _layout(frame: Frame, motors: int) -> Layout | None:
    """Rotor positions on a circle: ArduPilot has no parameter for the size."""
    rotors = geometry(frame.kind, frame.form)
    if rotors is None or rotors.count != (motors or rotors.count):
        return None
    return Layout(
        np.column_stack([rotors.direction, np.zeros(rotors.count)]),
        np.where(rotors.turn > 0.0, CCW, CW),
        metric=False,
        sd=_FRAME_SD,
        source=f"{frame.source}, {rotors.frame}",
    )


def _thrust(params: Mapping[str, float]) -> SourcedValue[ThrustCurve] | None:
    """Thrust curve of a log with at least the exponent; ArduPilot, Motor Thrust Scaling."""
    expo = motor_value(params, "MOT_THST_EXPO", -1.0)
    if not 0.0 <= expo <= 1.0:
        return None
    high = motor_value(params, "MOT_SPIN_MAX", _SPIN_MAX)
    if "THR_MIN" in params and "MOT_SPIN_MIN" not in params:  # up to Copter 3.3
        low = 1e-3 * params["THR_MIN"]
        high = low + (1.0 - low) * high
        least = f"THR_MIN {params['THR_MIN']:g}, MOT_THST_MAX"
    else:
        low = motor_value(params, "MOT_SPIN_MIN", _SPIN_MIN)
        least = f"MOT_SPIN_MIN {low:g}, MOT_SPIN_MAX"
    if not 0.0 <= low < high <= 1.0:
        low, high = _SPIN_MIN, _SPIN_MAX
    source = f"MOT_THST_EXPO {expo:g}, {least} {high:g} of the log"
    return SourcedValue(ThrustCurve(expo, low, high), source)


def _cells(params: Mapping[str, float]) -> SourcedValue[Cells] | None:
    """Battery by the voltages between which thrust is scaled."""
    low, high = (motor_value(params, f"MOT_BAT_VOLT_{k}", 0.0) for k in ("MIN", "MAX"))
    if not 0.0 < low < high:
        return None
    count = max(round(high / _FULL_CELL_V), 1)
    capacity = params.get("BATT_CAPACITY", 0.0)
    cells = Cells(count, high / count, low / count, 3.6 * capacity if capacity > 0.0 else None)
    return SourcedValue(
        cells, f"MOT_BAT_VOLT_MIN {low:g} and _MAX {high:g} (or MOT_THST_BAT_*) of the log"
    )


def _imu_position(params: Mapping[str, float]) -> SourcedValue[tuple[float, float, float]] | None:
    x, y, z = (params.get(name, 0.0) for name in _IMU)
    return SourcedValue((x, y, z), f"{_IMU[0]} to _Z of the log") if any((x, y, z)) else None


def _origin(log: ArduPilotLog) -> SourcedValue[Place] | None:
    """Origin of the estimator's positions; those of POS alone start at its first sample."""
    topic = log.whole("ORGN")  # logged once, mostly before the flight
    if topic is None or not topic.has("Type", "Lat", "Lng", "Alt"):
        return None
    if not _COUNTED & log.content.messages.keys():
        return None
    columns = np.column_stack([topic.raw(c) for c in ("Lat", "Lng", "Alt")])
    there = columns[topic.raw("Type") == _EKF_ORIGIN]
    if not len(there) or not np.isfinite(there).all() or np.any(np.ptp(there, axis=0) > 0.0):
        return None
    latitude, longitude, height = there[-1].tolist()
    if abs(latitude) > 90.0 or abs(longitude) > 180.0:
        return None
    return SourcedValue(Place.of_degrees(latitude, longitude, height), "ORGN of the log")
