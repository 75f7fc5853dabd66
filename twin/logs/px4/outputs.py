"""The outputs that drive the motors of a PX4 log: instance, channel, unit and range of each.

Every output driver publishes `actuator_outputs` in an instance of its own, in the order in which
the drivers start: pulse widths in us, DShot values 1..1999, CAN values 0..8191. Since PX4 1.13
DRIVER_FUNCk is the function of output k, 101 to 112 for motors 1 to 12; before, the mixer of the
main outputs had motor k on output k, and with MOT_ORDERING = 1 the order of Betaflight. Source:
PX4, lib/mixer_module, drivers/dshot, drivers/uavcan and drivers/pwm_out (module.yaml).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from ..assemble import FlightBuilder
from ..columns import motor_columns
from ..doubts import lower_voltage
from ..flight import Array
from ..motors import MotorOutput, commands_of
from .log import Px4Log, Topic

FIRST_FUNCTION, MOST_FUNCTIONS = 101, 12
"""Value of a FUNC parameter, or of esc_report.actuator_function, for motor 1, and largest number of
motors."""
_FUNCTION = re.compile(r"([A-Z0-9_]+)_FUNC([1-9][0-9]?)")  # driver and channel of a FUNC parameter
_RANGES = {
    "PWM_MAIN": (1000.0, 2000.0),
    "PWM_AUX": (1000.0, 2000.0),
    "HIL_ACT": (1000.0, 2000.0),
    "PCA9685": (1000.0, 2000.0),
    "UAVCAN_EC": (1.0, 8191.0),
    "UCAN1_ESC": (1.0, 8191.0),
    "SIM_GZ_EC": (0.0, 1000.0),
}
"""Defaults of DRIVER_MINk and _MAXk, in the order in which the drivers start."""
_UNITS = {"UAVCAN_EC": "CAN", "UCAN1_ESC": "CAN", "SIM_GZ_EC": "1/1000"}
"""Units of drivers that send no pulse widths."""
_CAN_FULL = 8191.0  # value of command 1, uavcan.equipment.esc.RawCommand
_DSHOT_FULL, _DSHOT_MIN = 1999.0, 0.055
"""Largest value of the DShot driver, and the default of DSHOT_MIN."""
_DSHOT_TIMERS = (-5.0, -4.0, -3.0)  # DRIVER_TIMn of DShot150 to 600
NO_RANGE = "no PWM range"  # source of a default range
_SHORTEST_US, _LONGEST_US = 800.0, 2200.0
"""Range of pulse widths that PX4 accepts."""
_CAN_ENABLE = 3.0
"""UAVCAN_ENABLE from which ESCs are on the bus."""
_BETAFLIGHT = (1, 2, 3, 0)
"""Channel of motors 1 to 4 with MOT_ORDERING = 1."""
_MOST_CHANNELS = 16  # of actuator_outputs
MOTORS = {2: 4, 13: 6, 14: 8, 15: 3}
"""Number of motors by MAV_TYPE."""


@dataclass(frozen=True, slots=True)
class Outputs:
    """Logged outputs of the motors.

    Attributes:
        topic: Topic with the times of the outputs.
        values: Values in the unit of each output, shape (n, motors).
        motors: Output of motor 1, 2, ...
    """

    topic: Topic
    values: Array
    motors: tuple[MotorOutput, ...]

    @property
    def cmd(self) -> Array:
        """Commands, not clipped, shape (n, motors)."""
        return commands_of(self.motors, self.values)

    @property
    def low(self) -> Array:
        """Values of command 0, shape (motors,)."""
        return np.array([m.low for m in self.motors])

    @property
    def high(self) -> Array:
        """Values of command 1, shape (motors,)."""
        return np.array([m.high for m in self.motors])


@dataclass(frozen=True, slots=True)
class _Channel:
    """An output of a driver, counted from 0, and its motor, from 1."""

    driver: str
    channel: int
    motor: int

    @property
    def function(self) -> str:
        """Parameter that assigns the motor."""
        return f"{self.driver}_FUNC{self.channel + 1}"


class _NotUsedError(Exception):
    """Reason why the outputs are not used; becomes a finding."""


def motor_count(log: Px4Log) -> int | None:
    """Number of motors by the parameters."""
    rotors = log.params.get("CA_ROTOR_COUNT", 0)
    if rotors >= 3:
        return int(rotors)
    return MOTORS.get(int(log.params.get("MAV_TYPE", 2)))


def motor_functions(params: Mapping[str, float], driver: str = "") -> dict[tuple[str, int], int]:
    """Motor, from 1, of each output (driver, channel from 0) whose FUNC parameter is a motor."""
    found = {}
    for name, value in params.items():
        match = _FUNCTION.fullmatch(name)
        motor = int(value) - FIRST_FUNCTION + 1
        if match and 1 <= motor <= MOST_FUNCTIONS and driver in ("", match[1]):
            found[match[1], int(match[2]) - 1] = motor
    return found


def logged_outputs(log: Px4Log) -> Outputs | None:
    """The outputs that drive the motors; None, with a finding, where they are not in the log."""
    topics = {k: t for k in log.instances("actuator_outputs") if (t := _topic(log, k)) is not None}
    if not topics:
        return None
    if "MAV_TYPE" not in log.params and "CA_ROTOR_COUNT" not in log.params:
        log.note("warning", "cmd", "the log does not say the number of motors; 4 taken")
    try:
        return _outputs(log, topics)
    except _NotUsedError as why:
        log.note("warning", "cmd", f"actuator_outputs not used: {why}")
        return None


def _topic(log: Px4Log, instance: int) -> Topic | None:
    return log.topic("actuator_outputs", instance, *(f"output[{k}]" for k in range(3)))


def _outputs(log: Px4Log, topics: Mapping[int, Topic]) -> Outputs:
    n = motor_count(log)
    if not any(_varies(t, c) for t in topics.values() for c in range(_MOST_CHANNELS)):
        raise _NotUsedError("they never change")
    if n is None:
        raise _NotUsedError("MAV_TYPE is no multirotor with 3, 4, 6 or 8 motors")
    if motor_functions(log.params):
        channels = _channels(log, n)
        instances = _instances_of(log, channels, topics)
        reported = True
    else:
        instance = _mixed_instance(log, n, topics)
        driver = _driver_before_functions(log, topics, instance, n)
        order = _BETAFLIGHT if n == 4 and log.params.get("MOT_ORDERING", 0.0) == 1.0 else range(n)
        channels = [_Channel(driver, c, motor + 1) for motor, c in enumerate(order)]
        instances = {driver: instance}
        reported = False
    base = topics[instances[channels[0].driver]]
    columns, motors = [], []
    for c in channels:
        instance = instances[c.driver]
        topic, name = topics[instance], f"output[{c.channel}]"
        unit, low, high, ranged = _range(log, c, topic, reported)
        if abs(high - low) < 1.0:
            raise _NotUsedError(f"the range of motor {c.motor} is {low:g} to {high:g} ({ranged})")
        said = c.function if reported else "order of PX4's mixers"
        place = f"actuator_outputs {instance} {name}"
        motors.append(MotorOutput(c.motor, place, unit, low, high, f"{said}, {ranged}"))
        columns.append(topic.at(base.t_us, name))
    found = Outputs(base, np.column_stack(columns), tuple(motors))
    _check_range(found)
    if any(m.unit == "us" and NO_RANGE in m.source for m in motors):
        log.note("info", "cmd", f"{NO_RANGE} among the parameters; 1000 to 2000 us taken")
    if len(topics) > 1:
        which = ", ".join(str(k) for k in sorted(set(instances.values())))
        log.note("info", "cmd", f"actuator_outputs instance {which} drives the motors")
    return found


def _check_range(found: Outputs) -> None:
    """Refuse values outside of the reported range."""
    cmd = found.cmd
    if np.nanmax(cmd) > 0.0 and np.nanmedian(cmd) <= 1.05:
        return
    one = found.motors[0]
    raise _NotUsedError(
        f"{np.nanmin(found.values):.0f} to {np.nanmax(found.values):.0f} does not fit the range "
        f"{one.low:.0f} to {one.high:.0f} ({one.source})"
    )


def _varies(topic: Topic, channel: int) -> bool:
    """Whether a channel exists, has values and changes; an unused one does not."""
    name = f"output[{channel}]"
    if not topic.has(name):
        return False
    values = topic.columns((name,))[:, 0]
    known = values[np.isfinite(values)]
    return len(known) > len(values) // 2 and float(np.ptp(known)) > 0.0


# -- PX4 1.13 and later: FUNC parameters ------------------------------------------------------


def _channels(log: Px4Log, n: int) -> list[_Channel]:
    """Outputs of motors 1..n, by their functions."""
    rank = {driver: k for k, driver in enumerate(_RANGES)}
    found: dict[int, _Channel] = {}
    every = [_Channel(d, c, m) for (d, c), m in motor_functions(log.params).items()]
    for each in sorted(every, key=lambda e: (rank.get(e.driver, len(rank)), e.driver, e.channel)):
        if each.motor in found:
            first = found[each.motor].function
            log.note("info", "cmd", f"motor {each.motor} is on {first} and on {each.function}")
        found.setdefault(each.motor, each)
    if lacking := [str(m) for m in range(1, n + 1) if m not in found]:
        raise _NotUsedError(
            f"no output has the function of motor {', '.join(lacking)} of {n} (101 is motor 1 in "
            "PWM_MAIN_FUNCn, PWM_AUX_FUNCn, UAVCAN_EC_FUNCn)"
        )
    return [found[m] for m in range(1, n + 1)]


def _instances_of(
    log: Px4Log, channels: Sequence[_Channel], topics: Mapping[int, Topic]
) -> dict[str, int]:
    """Instance of actuator_outputs of each driver that has motors.

    The log does not name the driver of an instance. Channels of its motors change, channels without
    function do not, and the values are in its unit; drivers start in the order of `_RANGES`.
    """
    rank = {driver: k for k, driver in enumerate(_RANGES)}
    drivers = sorted({c.driver for c in channels}, key=lambda d: (rank.get(d, len(rank)), d))
    penalties = {
        (d, k): _misfit(log, d, [c.channel for c in channels if c.driver == d], topic)
        for d in drivers
        for k, topic in topics.items()
    }
    ways = [
        (sum(penalties[pair] for pair in zip(drivers, chosen, strict=True)), order, chosen)
        for order, chosen in enumerate(permutations(sorted(topics), len(drivers)))
    ]
    least, _, chosen = min(ways, default=(np.inf, 0, ()))
    if not np.isfinite(least):
        which = ", ".join(drivers)
        raise _NotUsedError(
            f"no instance has values of the motors of {which}: dead channels, or of another unit"
        )
    found = dict(zip(drivers, chosen, strict=True))
    if sum(1 for way in ways if way[0] == least) > 1 and _differ(topics, channels, ways, least):
        log.note(
            "warning",
            "cmd",
            f"several instances of actuator_outputs may be those of {', '.join(drivers)}: the log "
            f"does not name the driver of an instance. {', '.join(map(str, chosen))} taken, in the "
            "order in which PX4 starts its drivers",
        )
    return found


def _differ(
    topics: Mapping[int, Topic],
    channels: Sequence[_Channel],
    ways: Sequence[tuple[float, int, tuple[int, ...]]],
    least: float,
) -> bool:
    """Whether instances that fit equally well have different values; two of one driver do not
    matter."""
    likely = {k for penalty, _, chosen in ways if penalty == least for k in chosen}
    names = [f"output[{c.channel}]" for c in channels]
    first, *others = (topics[k] for k in sorted(likely))
    return any(
        not np.allclose(one.at(first.t_us, n), first.data[n], equal_nan=True)
        for one in others
        for n in names
        if one.has(n) and first.has(n)
    )


def _misfit(log: Px4Log, driver: str, motors: Sequence[int], topic: Topic) -> float:
    """Misfit of an instance to a driver; inf: impossible."""
    if not all(_varies(topic, c) for c in motors):
        return np.inf
    values = topic.columns([f"output[{c}]" for c in motors])
    on = values[np.isfinite(values) & (values > 0.0)]
    can = _UNITS.get(driver) == "CAN"
    if not len(on) or on.max() > (_CAN_FULL if can else _LONGEST_US):
        return np.inf
    pulses = on.min() >= _SHORTEST_US and on.max() <= _LONGEST_US
    others = [
        c
        for c in range(_MOST_CHANNELS)
        if c not in motors and log.params.get(f"{driver}_FUNC{c + 1}", 0.0) == 0.0
    ]
    return float(can and pulses) + sum(_varies(topic, c) for c in others)


# -- before: the mixers -----------------------------------------------------------------------


def _mixed_instance(log: Px4Log, n: int, topics: Mapping[int, Topic]) -> int:
    """Instance of the main outputs: the first whose channels 1..n all change."""
    alive = [k for k, t in sorted(topics.items()) if all(_varies(t, c) for c in range(n))]
    if not alive:
        raise _NotUsedError(f"in no instance do the first {n} outputs change")
    if len(alive) > 1:
        log.note(
            "warning",
            "cmd",
            f"the outputs of actuator_outputs instances {', '.join(map(str, alive))} all change "
            f"and no parameter PWM_MAIN_FUNCn says which drive motors: instance {alive[0]} taken, "
            "the main outputs, whose mixer is that of the motors before PX4 1.13",
        )
    return alive[0]


def _driver_before_functions(
    log: Px4Log, topics: Mapping[int, Topic], instance: int, n: int
) -> str:
    """Driver of an instance, by UAVCAN_ENABLE and by the instances before it."""
    values = topics[instance].array("output", n)
    if log.params.get("UAVCAN_ENABLE", 0.0) >= _CAN_ENABLE and np.nanmax(values) > _LONGEST_US:
        return "UAVCAN_EC"
    first = instance == min(topics) or log.params.get("SYS_USE_IO", 1.0) == 0.0
    return "PWM_MAIN" if first else "PWM_AUX"


# -- ranges -----------------------------------------------------------------------------------


def _range(
    log: Px4Log, c: _Channel, topic: Topic, functions: bool
) -> tuple[str, float, float, str]:
    """Unit, values of command 0 and 1, and their source."""
    p, k = log.params, c.channel + 1
    if c.driver.startswith("PWM_") and _is_dshot(log, c, topic):
        if p.get("DSHOT_3D_ENABLE", 0.0) > 0.0:
            raise _NotUsedError("DSHOT_3D_ENABLE is 1, motors that turn both ways are not known")
        least = p.get("DSHOT_MIN", _DSHOT_MIN)
        low = float(np.clip(int(least * _DSHOT_FULL), 1.0, _DSHOT_FULL))
        return ("DShot", *_turned(log, c, low, _DSHOT_FULL), f"DSHOT_MIN {least:.3g}")
    unit = _UNITS.get(c.driver, "us")
    if unit == "CAN" and not functions:
        return unit, 0.0, _CAN_FULL, "range of UAVCAN"
    start, full = (_end(p, c.driver, end, k) for end in ("MIN", "MAX"))
    if start is not None and full is not None:
        return (unit, *_turned(log, c, start[0], full[0]), f"{start[1]}, {full[1]}")
    if c.driver not in _RANGES:
        raise _NotUsedError(
            f"the range of {c.driver} is not known: no {c.driver}_MIN{k} and _MAX{k} in the log"
        )
    usual = _RANGES[c.driver]
    ends = start[0] if start else usual[0], full[0] if full else usual[1]
    said = next((each[1] for each in (start, full) if each), NO_RANGE)
    return (unit, *_turned(log, c, *ends), f"{said}, else the defaults")


def _end(
    params: Mapping[str, float], driver: str, end: str, number: int
) -> tuple[float, str] | None:
    """Value at an end of the range, and its parameter: of the output, else of the whole driver."""
    names = [f"{driver}_{end}{number}", f"{driver}_{end}"]
    if driver == "PWM_MAIN":
        names.append(f"PWM_{end}")
    least = 1.0 if driver.startswith("PWM_") else 0.0  # pulse widths 0 and -1: as the whole driver
    found = ((params[name], name) for name in names if params.get(name, -1.0) >= least)
    return next(found, None)


def _turned(log: Px4Log, c: _Channel, low: float, high: float) -> tuple[float, float]:
    """Ends of a range; DRIVER_REV has a bit for each output that is reversed."""
    low, high = min(low, high), max(low, high)
    bits = int(log.params.get(f"{c.driver}_REV", 0.0))
    single = log.params.get(f"{c.driver}_REV{c.channel + 1}", 0.0) > 0.0
    return (high, low) if single or bits >> c.channel & 1 else (low, high)


def _is_dshot(log: Px4Log, c: _Channel, topic: Topic) -> bool:
    """Whether an output of the microcontroller uses DShot instead of pulse widths."""
    if log.params.get("DSHOT_CONFIG", 0.0) > 0.0:
        return True  # before 1.13, for all its outputs
    values = topic.columns((f"output[{c.channel}]",))[:, 0]
    on = values[np.isfinite(values) & (values > 0.0)]
    if len(on) and on.min() < _SHORTEST_US:
        return True
    timers = [
        v for k, v in log.params.items() if re.fullmatch(rf"{c.driver}_TIM[0-9]+", k) and v != 0.0
    ]
    speaks = [t in _DSHOT_TIMERS for t in timers]
    return any(speaks) and (all(speaks) or bool(np.any(values == 0.0)))


# -- rotor speeds -------------------------------------------------------------------------------
#
# Rotor speeds reported by the speed controllers (esc_status), by the motor of each slot.
#
# esc[k].actuator_function is 100 + motor since PX4 1.13. Where it is 0, a CAN controller's slot is
# its index on the bus, which is UAVCAN_EC_FUNCk; before FUNC parameters index k was motor k.
# Source: PX4, msg/EscReport.msg, drivers/dshot/DShot.cpp, drivers/uavcan/actuators/esc.cpp.

_RPM_RAD_S = 2.0 * np.pi / 60.0  # rad/s
_SLOTS = 12  # of esc_status
_CAN = 4
"""Value of esc_connectiontype for CAN."""
_CAN_DRIVERS = ("UAVCAN_EC", "UCAN1_ESC")  # drivers whose slots are bus indices


@dataclass(frozen=True, slots=True)
class _Slot:
    """Reports of one motor's controller, and the source of the assignment."""

    topic: Topic
    number: int
    source: str

    @property
    def rpm(self) -> Array:
        return self.topic.columns((f"esc[{self.number}].esc_rpm",))[:, 0]

    @property
    def volts(self) -> Array:
        """Supply voltage while the motor turns, V; empty where the slot has no such field."""
        name = f"esc[{self.number}].esc_voltage"
        if not self.topic.has(name):
            return np.zeros(0)
        volts: Array = self.topic.columns((name,))[:, 0]
        return volts[np.abs(self.rpm) > 0.0]


def from_px4_rpm(rpm: Array) -> Array:
    """Rotor speed, rpm of either sign -> rad/s, not negative."""
    return np.abs(rpm) * _RPM_RAD_S


def add_rotors(log: Px4Log, flight: FlightBuilder, motors: int | None) -> None:
    """Add rotor speeds of all motors, at the times of the controller of motor 1; a fact states the
    slot of each motor in esc_status.

    Args:
        log: Collects the findings.
        flight: Receives the speeds.
        motors: Number of commands; None: there are none.
    """
    topics = [t for k in log.instances("esc_status") if (t := log.topic("esc_status", k))]
    if not topics:
        return
    found, alive = _slots(log, topics)
    log.findings += lower_voltage({m: s.volts for m, s in found.items()})
    count = motors or motor_count(log) or len(found)
    lacking = [str(m) for m in range(1, count + 1) if m not in found]
    if lacking or not found:
        whose = f"of motor {', '.join(lacking)} of {count}" if alive and lacking else "of any motor"
        log.note(
            "warning",
            "rotor",
            f"left out: esc_status has no speed {whose} that changes",
            len(topics[0].t_us),
        )
        return
    slots = [found[m] for m in range(1, count + 1)]
    base = slots[0].topic
    speeds = [
        s.rpm if s.topic is base else np.interp(base.t_us, s.topic.t_us, s.rpm) for s in slots
    ]
    columns = motor_columns("rotor", count)
    flight.add("rotor", columns, base.t_us, from_px4_rpm(np.column_stack(speeds)))
    where = ", ".join(f"motor {m + 1} in slot {s.number + 1}" for m, s in enumerate(slots))
    said = ", ".join(dict.fromkeys(s.source for s in slots))
    flight.facts["rotor speeds"] = f"esc_status, {where} ({said})"


def _slots(log: Px4Log, topics: list[Topic]) -> tuple[dict[int, _Slot], int]:
    """Slot of each motor, from 1, and the number of slots whose speed changes."""
    found: dict[int, _Slot] = {}
    alive, guessed = 0, []
    for topic in topics:
        for k in range(_SLOTS):
            if not topic.has(f"esc[{k}].esc_rpm") or not _has_speeds(topic, f"esc[{k}].esc_rpm"):
                continue
            alive += 1
            motor, source = _motor_of(log, topic, k)
            if motor and motor not in found:
                found[motor] = _Slot(topic, k, source)
            if source == _BY_PLACE:
                guessed.append(str(k + 1))
    if guessed:
        log.note(
            "warning",
            "rotor",
            f"no field says whose speeds slot {', '.join(guessed)} of esc_status holds "
            "(esc[].actuator_function is missing or 0): slot k taken for motor k",
        )
    return found, alive


_BY_PLACE = "by place"  # source of a slot's motor


def _motor_of(log: Px4Log, topic: Topic, slot: int) -> tuple[int, str]:
    """Motor of a slot, 0 where it has none, and the source of the assignment."""
    name = f"esc[{slot}].actuator_function"
    if topic.has(name):
        values, counts = np.unique(topic.data[name][topic.data[name] > 0], return_counts=True)
        if len(values):
            motor = int(values[counts.argmax()]) - FIRST_FUNCTION + 1
            return (motor if 1 <= motor <= MOST_FUNCTIONS else 0), "esc[].actuator_function"
    kind = topic.data.get("esc_connectiontype")
    functions = motor_functions(log.params)
    if kind is not None and np.median(kind) == _CAN:
        for driver in _CAN_DRIVERS:
            if any(d == driver for d, _ in functions):
                return functions.get((driver, slot), 0), f"{driver}_FUNCn, by index on the bus"
        if not functions:
            return slot + 1, "index on the CAN bus, the number of the motor before PX4 1.13"
    return slot + 1, _BY_PLACE


def _has_speeds(topic: Topic, name: str) -> bool:
    """Whether a slot has speeds; a slot without a controller stays at 0."""
    return float(np.ptp(topic.data[name].astype(np.float64))) > 0.0
