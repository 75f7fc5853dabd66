"""Reader of ArduPilot DataFlash logs.

ArduPilot's axes are those of the table, FRD and NED; its quaternion rotates body into NED,
Hamilton, scalar first.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...frames import from_euler
from ..airframe import local_ned
from ..assemble import FlightBuilder
from ..columns import ACC, GYRO, MAG, POS, QUAT, VEL, motor_columns
from ..doubts import lower_voltage
from ..flight import Array, Flight
from ..formats import ReadOptions
from ..motors import MotorCommands, doubt_current
from .airframe import (
    NO_MULTIROTOR,
    channels_of,
    frame_name,
    from_ardupilot_airframe,
    from_ardupilot_commands,
    from_ardupilot_site,
    geometry,
    median_fix,
    yaw_trim,
)
from .autopilot import (
    ActiveEstimator,
    active_estimator,
    cut_to_flight,
    from_ardupilot_autopilot,
    from_ardupilot_phases,
    modes,
    note_failures,
)
from .log import OTHERS, ArduPilotLog, Topic, board, firmware, frame_of, motor_value, open_ardupilot

# -- sensors ------------------------------------------------------------------------------------
#
# Signals in SI: inertial sensors, compass, barometer, battery.

_ACC = ("AccX", "AccY", "AccZ")  # of IMU
_GYRO = ("GyrX", "GyrY", "GyrZ")  # of IMU
_RATES = ("R", "P", "Y")  # of RATE
_MAG = ("MagX", "MagY", "MagZ")  # of MAG
_FILTERS = {"gyro": "INS_GYRO_FILTER", "acc": "INS_ACCEL_FILTER"}
"""Parameter with the low-pass cut-off of each sensor."""
_IN_SENSOR = "INS_MPU6K_FILTER"
"""Low-pass in the sensor up to Copter 3.2, before the firmware had one."""
_LEAST_HZ = 1.0  # cut-off of an enabled filter
_LEAST_V = 1.0  # voltage of a connected battery


def si(log: ArduPilotLog, topic: Topic, where: str, fields: tuple[str, ...]) -> Array:
    """Fields of a topic in SI; a unit that contradicts the documented one is a finding."""
    if wrong := topic.contradicted(fields):
        label, unit = topic.source.units.labels[wrong[0]], topic.documented(wrong[0])[0]
        message = f"the log says that {topic.name}.{wrong[0]} is in {label}; taken as {unit}"
        log.note("error", where, message, len(wrong))
    return topic.si(fields)


def add_imu(log: ArduPilotLog, flight: FlightBuilder, used: ActiveEstimator) -> None:
    """Add the accelerometer and gyroscope that the estimator uses; facts on rates and filters."""
    for where, fields, names in (("gyro", _GYRO, GYRO), ("acc", _ACC, ACC)):
        there = log.instances("IMU")
        if not there:
            log.note("warning", where, "no IMU in the log. Set LOG_BITMASK bit 7 or 18")
            if where == "gyro":
                _add_rates(log, flight)
            continue
        instance = used.imu if used.imu in there else there[0]
        topic = log.topic("IMU", instance, *fields)
        if topic is None:
            continue
        delay_us = _filter_delay_us(log, flight, where)
        values = si(log, topic, where, fields)
        flight.add(where, names, topic.t_us - delay_us, values)
        raw = topic.raw("GHz") if topic.has("GHz") else np.zeros(1)
        sampled = f", {np.median(raw):.0f} Hz sampled" if np.median(raw) > 0.0 else ""
        flight.facts[f"{where} from"] = (
            f"IMU {instance} of {len(there)}, {topic.rate_hz:.0f} Hz in the log{sampled}"
        )


def _add_rates(log: ArduPilotLog, flight: FlightBuilder) -> None:
    """Add body rates from the rate controller, for logs without IMU."""
    topic = log.topic("RATE", None, *_RATES)
    if topic is None:
        return
    delay_us = _filter_delay_us(log, flight, "gyro")
    rates = si(log, topic, "gyro", _RATES)
    flight.add("gyro", GYRO, topic.t_us - delay_us, rates)
    flight.facts["gyro from"] = f"RATE, {topic.rate_hz:.0f} Hz"


def _filter_delay_us(log: ArduPilotLog, flight: FlightBuilder, where: str) -> int:
    """Delay of the low-pass applied to a sensor before logging, us.

    Source: ArduPilot, LowPassFilter2p, as applied by AP_InertialSensor.
    """
    name = _FILTERS[where]
    cutoff_hz = log.params.get(name, 0.0)
    if cutoff_hz < _LEAST_HZ:
        if name not in log.params and _IN_SENSOR in log.params:
            hz = log.params[_IN_SENSOR]
            cutoff = f"{hz:g} Hz" if hz > 0.0 else "the default of the firmware"
            message = (
                f"low-passed within the sensor at {cutoff} ({_IN_SENSOR}), delay not taken off"
            )
            log.note("info", where, message)
        return 0
    return flight.filter_delay_us(where, cutoff_hz, name)


def add_compass(log: ArduPilotLog, flight: FlightBuilder, used: ActiveEstimator) -> None:
    """Add the compass that the estimator uses."""
    there = log.instances("MAG")
    if not there:
        return
    instance = used.compass if used.compass in there else there[0]
    topic = log.topic("MAG", instance, *_MAG)
    if topic is None:
        return
    if len(there) > 1:
        message = f"{len(there)} compasses in the log, the estimator uses number {instance}"
        log.note("info", "mag", message)
    flight.add("mag", MAG, topic.t_us, si(log, topic, "mag", _MAG))


def add_barometer(log: ArduPilotLog, flight: FlightBuilder, used: ActiveEstimator) -> None:
    """Add the static pressure of the barometer that the estimator uses."""
    there = log.instances("BARO")
    if not there:
        return
    topic = log.topic("BARO", used.barometer if used.barometer in there else there[0], "Press")
    if topic is not None:
        pressure = si(log, topic, "baro", ("Press",))
        flight.add("baro", ("baro_pa",), topic.t_us, pressure)


def add_battery(log: ArduPilotLog, flight: FlightBuilder, commands: MotorCommands | None) -> None:
    """Add the voltage of the first battery that has one, and its current where it is valid."""
    for topic in _batteries(log):
        volts = si(log, topic, "vbat_v", ("Volt",))
        if np.nanmax(volts, initial=0.0) < _LEAST_V:
            continue
        flight.add("vbat_v", ("vbat_v",), topic.t_us, volts)
        if topic.has("Curr"):
            _add_current(log, flight, topic, commands)
        return
    log.note("warning", "vbat_v", f"no battery in the log exceeds {_LEAST_V:g} V")


def _batteries(log: ArduPilotLog) -> list[Topic]:
    """Batteries by instance, else CURR of ArduPilot before 3.6: first the one that scales thrust
    (MOT_BAT_IDX), last those with a disabled monitor (BATTn_MONITOR 0)."""
    index = motor_value(log.params, "MOT_BAT_IDX", -1.0)

    def rank(instance: int) -> tuple[bool, bool, int]:
        name = f"BATT{instance + 1 if instance else ''}_MONITOR"
        return log.params.get(name, 1.0) == 0.0, float(instance) != index, instance

    found = [
        log.topic(n, k, "Volt") for n in ("BAT", "CURR") for k in sorted(log.instances(n), key=rank)
    ]
    return [t for t in found if t is not None]


def _add_current(
    log: ArduPilotLog, flight: FlightBuilder, topic: Topic, commands: MotorCommands | None
) -> None:
    amps = si(log, topic, "ibat_a", ("Curr",))
    if reason := doubt_current(topic.t_us, amps[:, 0], commands, "BAT"):
        log.note("warning", "ibat_a", f"left out: {reason}", len(amps))
        return
    unknown = np.isnan(amps[:, 0])
    log.note("warning", "ibat_a", "samples hold no current", unknown)
    flight.add("ibat_a", ("ibat_a",), topic.t_us[~unknown], amps[~unknown])


# -- motion -------------------------------------------------------------------------------------
#
# Attitude, velocity and position of a DataFlash log, as estimated on board.

_Q = ("Q1", "Q2", "Q3", "Q4")  # of XKQ and NKQ
_ANGLES = ("Roll", "Pitch", "Yaw")  # of ATT and XKF1
_CONTROLLERS = (
    (("PSCN", "PN", "VN", 1.0), ("PSCE", "PE", "VE", 1.0), ("PSCD", "PD", "VD", 1.0)),
    (("PSC", "PX", "VX", 1.0), ("PSC", "PY", "VY", 1.0), ("CTUN", "Alt", "CRt", -1.0)),
    (("NTUN", "PosX", "VelX", 1.0), ("NTUN", "PosY", "VelY", 1.0), ("CTUN", "Alt", "CRt", -1.0)),
)
"""Message, position, velocity and sign for each NED axis: since ArduPilot 4.1, Copter 3.6 to 4.0,
up to 3.5; CTUN is positive upward."""
_FASTER = 2.0  # ratio of rates from which ATT is used instead of quaternions


def add_motion(log: ArduPilotLog, flight: FlightBuilder, used: ActiveEstimator) -> None:
    """Add attitude, velocity and position; facts on their sources."""
    if source := _add_attitude(log, flight, used):
        flight.facts["attitude from"] = source
    if source := _add_course(log, flight, used):
        flight.facts["position from"] = source


def _add_attitude(log: ArduPilotLog, flight: FlightBuilder, used: ActiveEstimator) -> str:
    """Add the quaternion of the active core, or ATT where it is logged much faster."""
    topic = log.topic(f"{used.family}Q", used.core, *_Q) if used.family else None
    angles = log.topic("ATT", None, *_ANGLES)
    if angles is None and used.family:
        angles = log.topic(f"{used.family}F1", used.core, *_ANGLES)
    if topic is not None and (angles is None or angles.rate_hz < _FASTER * topic.rate_hz):
        flight.add_attitude(topic.t_us, si(log, topic, "q", _Q))
        return f"{topic.name}, core {used.core}, {topic.rate_hz:.0f} Hz"
    if angles is None:
        log.note("warning", "q", "no attitude in the log. Set LOG_BITMASK bit 0 or 1")
        return ""
    euler = si(log, angles, "q", _ANGLES)
    possible = np.isfinite(euler).all(axis=1) & (np.abs(euler) <= 2.0 * np.pi + 0.01).all(axis=1)
    log.note("error", "q", f"samples of {angles.name} left out, an angle is none", ~possible)
    q = np.asarray(from_euler(*euler[possible].T), dtype=np.float64).T
    flight.add("q", QUAT, angles.t_us[possible], q)
    return f"{angles.name}, {angles.rate_hz:.0f} Hz"


def _add_course(log: ArduPilotLog, flight: FlightBuilder, used: ActiveEstimator) -> str:
    """Add position and velocity of the active core, else of the position controller, else of
    POS."""
    topic = log.topic(f"{used.family}F1", used.core) if used.family else None
    pos, vel = ("PN", "PE", "PD"), ("VN", "VE", "VD")
    if topic is not None and topic.has(*pos, *vel):
        flight.add("pos", POS, topic.t_us, si(log, topic, "pos", pos))
        flight.add("vel", VEL, topic.t_us, si(log, topic, "vel", vel))
        log.note(
            "info",
            "pos",
            "position and velocity are the estimator's, not a reference. Where the delays that it "
            "assumes differ from the true ones, they lead or lag the truth",
        )
        return f"{topic.name}, core {used.core}, {topic.rate_hz:.0f} Hz"
    return _controller_course(log, flight) or _global_course(log, flight)


def _controller_course(log: ArduPilotLog, flight: FlightBuilder) -> str:
    """Add the measured position and velocity of the controllers, where all three axes are
    logged."""
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
            flight.add(where, names, shortest.t_us, np.column_stack(columns))
        log.note(
            "info", "pos", "no XKF1: position and velocity as the position controller has them"
        )
        named = ", ".join(dict.fromkeys(t.name for t in found))
        return f"{named}, {shortest.rate_hz:.0f} Hz"
    return ""


def _global_course(log: ArduPilotLog, flight: FlightBuilder) -> str:
    """Add position alone, from latitude, longitude and height over home."""
    topic = log.topic("POS", None, "Lat", "Lng", "Alt")
    if topic is None:
        log.note("warning", "pos", "no XKF1, PSCN or POS in the log: no position, no velocity")
        return ""
    places = local_ned(topic.raw("Lat"), topic.raw("Lng"), topic.raw("Alt"))
    flight.add("pos", POS, topic.t_us, places)
    log.note("warning", "pos", "from latitude and longitude of POS; there is no velocity")
    return f"POS, {topic.rate_hz:.0f} Hz"


# -- rotor speeds -------------------------------------------------------------------------------
#
# Rotor speeds reported by the speed controllers (ESC), resampled to common times where they are
# good.

_TURNING = 0.1  # command from which a rotor must report a speed
_LONGEST_S = 0.25  # longest interval that is interpolated
_LEAST_GOOD = 0.8  # share of working time in which a rotor must report
_FEWEST = 20  # fewest reports of a controller in use


def add_rotors(log: ArduPilotLog, flight: FlightBuilder, commands: MotorCommands | None) -> None:
    """Add rotor speeds of all motors, from the instances of ESC that belong to their outputs.

    Each controller reports at its own times. Speeds are interpolated linearly to the times of the
    one with the fewest reports, between reports at most 0.25 s apart. A fact names the instances.
    """
    there = log.instances("ESC")
    if not there or commands is None:
        return
    channels = channels_of(log)
    wanted = instances_of(tuple(channels), there)
    if not wanted:
        log.note(
            "warning",
            "rotor",
            f"left out: ESC has instances {', '.join(map(str, there))}, the motors are outputs "
            f"{', '.join(map(str, channels))}",
        )
        return
    topics = [log.topic("ESC", k, "RPM") for k in wanted]
    found = [t for t in topics if t is not None and len(t.t_us) >= _FEWEST]
    if len(found) < len(wanted):
        message = f"left out: ESC reports speeds of {len(found)} of {len(wanted)} motors"
        log.note("warning", "rotor", message)
        return
    speeds = [np.abs(si(log, t, "rotor", ("RPM",))[:, 0]) for t in found]
    log.findings += lower_voltage(
        {
            m: si(log, t, "vbat_v", ("Volt",))[s > 0.0, 0]
            for m, (t, s) in enumerate(zip(found, speeds, strict=True), start=1)
            if t.has("Volt")
        }
    )
    if why := _doubt(found, speeds, commands):
        log.note("warning", "rotor", f"left out: {why}", sum(map(len, speeds)))
        return
    least = min(range(len(found)), key=lambda k: len(found[k].t_us))
    slowest = found[least]
    columns = [_at(slowest.t_us, t.t_us, s) for t, s in zip(found, speeds, strict=True)]
    together = np.column_stack(columns)
    bridged = np.isfinite(together).all(axis=1)
    message = f"samples left out: a motor reports nothing for over {_LONGEST_S:g} s"
    log.note("warning", "rotor", message, ~bridged)
    n = len(found)
    flight.add("rotor", motor_columns("rotor", n), slowest.t_us[bridged], together[bridged])
    log.note(
        "info",
        "rotor",
        "the speed controllers report at different times; all are interpolated to those of number "
        f"{wanted[least]}",
    )
    rates = ", ".join(f"{t.rate_hz:.0f}" for t in found)
    poles = log.params.get("SERVO_BLH_POLES", 0.0)
    counted = f"; SERVO_BLH_POLES {poles:.0f}, which scales what DShot reports" if poles else ""
    flight.facts["rotor speeds"] = f"ESC {', '.join(map(str, wanted))} at {rates} Hz{counted}"


def instances_of(channels: tuple[int, ...], there: list[int]) -> list[int]:
    """ESC instances of the motors, [] where the assignment is ambiguous.

    An instance is an output counted from 0 or, where the controllers are counted from the first one
    that is a motor, its index among the outputs of motors.
    """
    by_output = [c - 1 for c in channels]
    if set(by_output) <= set(there):
        return by_output
    if len(there) == len(channels):
        places = sorted(channels)
        return [there[places.index(c)] for c in channels]
    return []


def _at(t_us: NDArray[np.int64], own_us: NDArray[np.int64], values: Array) -> Array:
    """Speeds of a controller at other times, NaN where its reports are too far apart."""
    after = np.clip(np.searchsorted(own_us, t_us), 1, len(own_us) - 1)
    near = (own_us[after] - own_us[after - 1]) <= _LONGEST_S * 1e6
    near |= np.isin(t_us, own_us)
    inside = (t_us >= own_us[0]) & (t_us <= own_us[-1])
    return np.where(near & inside, np.interp(t_us, own_us, values), np.nan)


def _doubt(topics: list[Topic], speeds: list[Array], commands: MotorCommands) -> str:
    """Why the speeds cannot be those of the motors, "" where they can."""
    cmd = commands.cmd
    for motor, (topic, speed) in enumerate(zip(topics, speeds, strict=True)):
        own = np.interp(topic.t_us, commands.t_us, cmd[:, motor])
        working = own > _TURNING
        if working.sum() < _FEWEST:
            return f"motor {motor + 1} works in {int(working.sum())} reports"
        steps_s = np.diff(topic.t_us[working]) * 1e-6
        covered = float(steps_s[steps_s <= _LONGEST_S].sum() / steps_s.sum())
        if covered < _LEAST_GOOD:
            return f"motor {motor + 1} is reported in {covered:.0%} of the time that it works"
        turning = np.isfinite(speed) & (speed > 0.0)
        if turning[working].mean() < _LEAST_GOOD:
            return f"motor {motor + 1} has a speed in {turning[working].mean():.0%} of the reports"
        if np.ptp(speed[working & turning]) == 0.0:
            return f"motor {motor + 1} never changes its speed"
    return ""


# -- the flight ---------------------------------------------------------------------------------


def read_dataflash(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a DataFlash log, binary or text; arguments and errors as in `formats.Reader`."""
    log = open_ardupilot(path, blob)
    flight = FlightBuilder(log, path, _facts(log) | cut_to_flight(log), "the motors ran")
    facts, used = flight.facts, active_estimator(log)
    add_imu(log, flight, used)
    add_compass(log, flight, used)
    add_barometer(log, flight, used)
    add_motion(log, flight, used)
    commands = from_ardupilot_commands(log)
    add_battery(log, flight, commands)
    add_rotors(log, flight, commands)
    flight.add_commands(commands)
    note_failures(log)
    table = flight.lay_out("Log the default messages (LOG_BITMASK) and fly again.")
    phases = from_ardupilot_phases(log, used)
    if flown_modes := modes(log):
        facts["modes"] = flown_modes
    if place := median_fix(log):
        facts["place"] = place[1]
    found = flight.flight(
        table,
        phases,
        site=from_ardupilot_site(log),
        airframe=from_ardupilot_airframe(log),
        autopilot=from_ardupilot_autopilot(log, float(table["time"].iloc[-1])),
    )
    frame = frame_of(log)
    rotors = geometry(frame.kind, frame.form)
    if rotors is not None and (trim := yaw_trim(found.table, rotors)):
        found.facts["yaw trim"] = str(trim)
    return found


def _facts(log: ArduPilotLog) -> dict[str, str]:
    """Facts of the log about the vehicle."""
    version = firmware(log)
    facts = {"firmware": version or "ArduPilot"}
    if other := OTHERS.match(version):
        message = f"a log of {other.group()}: this is no multirotor, unless it is a quadplane"
        log.note("error" if log.params.get("Q_ENABLE", 0.0) < 1.0 else "info", "log", message)
    if hardware := board(log):
        facts["hardware"] = hardware
    frame = frame_of(log)
    if name := NO_MULTIROTOR.get(frame.kind):
        log.note("error", "log", f"FRAME_CLASS {frame.kind}, a {name}: this is no multirotor")
    if frame.kind:
        facts["airframe"] = frame_name(frame.kind, frame.form)
    return facts
