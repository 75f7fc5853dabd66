"""Signals of a DataFlash log put into the flight table, in SI: inertial sensors, compass,
barometer, battery. ArduPilot's axes are those of the table: FRD, NED."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..assemble import Rows, add_signal
from ..clock import filter_delay_us
from ..columns import ACC, GYRO, MAG
from ..flight import Array
from .estimator import Primary
from .log import ArduPilotLog, Topic
from .outputs import MotorCommands
from .parameters import motor_value

_ACC = ("AccX", "AccY", "AccZ")
_GYRO = ("GyrX", "GyrY", "GyrZ")
_RATES = ("R", "P", "Y")
_MAG = ("MagX", "MagY", "MagZ")
_FILTERS = {"gyro": "INS_GYRO_FILTER", "acc": "INS_ACCEL_FILTER"}
_IN_SENSOR = "INS_MPU6K_FILTER"
"""Low-pass of the sensor up to Copter 3.2; the firmware had none of its own."""
_LEAST_HZ = 1.0
_LEAST_V = 1.0
_IDLE, _WORKING = 0.05, 0.2


add = partial(add_signal, begin="the motors ran")
"""As `assemble.add_signal`."""


def si(
    log: ArduPilotLog,
    topic: Topic,
    where: str,
    fields: tuple[str, ...],
) -> Array:
    """Fields of a topic in SI; a unit that contradicts the documented one is a finding."""
    if wrong := topic.contradicted(fields):
        label, unit = topic.source.units.labels[wrong[0]], topic.documented(wrong[0])[0]
        message = f"the log says that {topic.name}.{wrong[0]} is in {label}; taken as {unit}"
        log.note("error", where, message, len(wrong))
    return topic.si(fields)


def add_imu(log: ArduPilotLog, rows: Rows, used: Primary) -> dict[str, str]:
    """Accelerometer and gyroscope that the estimator uses.

    Returns:
        Facts on rates and filters.
    """
    facts: dict[str, str] = {}
    for where, fields, names in (("gyro", _GYRO, GYRO), ("acc", _ACC, ACC)):
        there = log.instances("IMU")
        if not there:
            log.note("warning", where, "no IMU in the log. Set LOG_BITMASK bit 7 or 18")
            facts |= _rates(log, rows) if where == "gyro" else {}
            continue
        instance = used.imu if used.imu in there else there[0]
        topic = log.topic("IMU", instance, *fields)
        if topic is None:
            continue
        delay_us = _filter_delay_us(log, where)
        values = si(log, topic, where, fields)
        add(log, rows, where, names, topic.t_us - delay_us, values)
        raw = topic.raw("GHz") if topic.has("GHz") else np.zeros(1)
        sampled = f", {np.median(raw):.0f} Hz sampled" if np.median(raw) > 0.0 else ""
        facts[f"{where} from"] = (
            f"IMU {instance} of {len(there)}, {topic.rate_hz:.0f} Hz in the log{sampled}"
        )
    return facts


def _rates(log: ArduPilotLog, rows: Rows) -> dict[str, str]:
    """Body rates as the rate controller has them, for logs without IMU."""
    topic = log.topic("RATE", None, *_RATES)
    if topic is None:
        return {}
    delay_us = _filter_delay_us(log, "gyro")
    rates = si(log, topic, "gyro", _RATES)
    add(log, rows, "gyro", GYRO, topic.t_us - delay_us, rates)
    return {"gyro from": f"RATE, {topic.rate_hz:.0f} Hz"}


def _filter_delay_us(log: ArduPilotLog, where: str) -> int:
    """Delay of the low-pass that a sensor went through before it was logged, us.

    Source: ArduPilot, LowPassFilter2p, as AP_InertialSensor applies it.
    """
    name = _FILTERS[where]
    cutoff_hz = log.params.get(name, 0.0)
    if cutoff_hz < _LEAST_HZ:
        if name not in log.params and _IN_SENSOR in log.params:
            hz = log.params[_IN_SENSOR]
            told = f"{hz:g} Hz" if hz > 0.0 else "the default of the firmware"
            message = f"low-passed within the sensor at {told} ({_IN_SENSOR}), delay not taken off"
            log.note("info", where, message)
        return 0
    delay_us = filter_delay_us(cutoff_hz)
    log.note(
        "info",
        where,
        f"calibrated and low-passed at {cutoff_hz:.0f} Hz ({name}) before it was logged; its time "
        f"is {delay_us / 1e3:.1f} ms before the time stamp of the log, the delay of that filter",
    )
    return delay_us


def add_compass(log: ArduPilotLog, rows: Rows, used: Primary) -> None:
    """Compass that the estimator uses."""
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
    add(log, rows, "mag", MAG, topic.t_us, si(log, topic, "mag", _MAG))


def add_barometer(log: ArduPilotLog, rows: Rows, used: Primary) -> None:
    """Static pressure of the barometer that the estimator uses."""
    there = log.instances("BARO")
    if not there:
        return
    topic = log.topic("BARO", used.barometer if used.barometer in there else there[0], "Press")
    if topic is not None:
        pressure = si(log, topic, "baro", ("Press",))
        add(log, rows, "baro", ("baro_pa",), topic.t_us, pressure)


def add_battery(log: ArduPilotLog, rows: Rows, commands: MotorCommands | None) -> None:
    """Voltage of the first battery that has one, and its current where it is worth anything."""
    for topic in _batteries(log):
        volts = si(log, topic, "vbat_v", ("Volt",))
        if np.nanmax(volts, initial=0.0) < _LEAST_V:
            continue
        add(log, rows, "vbat_v", ("vbat_v",), topic.t_us, volts)
        if topic.has("Curr"):
            _add_current(log, rows, topic, commands)
        return
    log.note("warning", "vbat_v", f"no battery in the log exceeds {_LEAST_V:g} V")


def _batteries(log: ArduPilotLog) -> list[Topic]:
    """Batteries by instance, else CURR of ArduPilot before 3.6: first the one by which thrust is
    scaled (MOT_BAT_IDX), last those whose monitor is switched off (BATTn_MONITOR 0)."""
    index = motor_value(log.params, "MOT_BAT_IDX", -1.0)

    def rank(instance: int) -> tuple[bool, bool, int]:
        name = f"BATT{instance + 1 if instance else ''}_MONITOR"
        return log.params.get(name, 1.0) == 0.0, float(instance) != index, instance

    found = [
        log.topic(n, k, "Volt") for n in ("BAT", "CURR") for k in sorted(log.instances(n), key=rank)
    ]
    return [t for t in found if t is not None]


def _add_current(
    log: ArduPilotLog, rows: Rows, topic: Topic, commands: MotorCommands | None
) -> None:
    amps = si(log, topic, "ibat_a", ("Curr",))
    unknown = np.isnan(amps[:, 0])
    if (doubt := _current_doubt(topic.t_us[~unknown], amps[~unknown, 0], commands)) is not None:
        log.note("warning", "ibat_a", f"left out: {doubt}", len(amps))
        return
    if unknown.any():
        log.note("warning", "ibat_a", "samples hold no current", int(unknown.sum()))
    add(log, rows, "ibat_a", ("ibat_a",), topic.t_us[~unknown], amps[~unknown])


def _current_doubt(
    t_us: NDArray[np.int64], amps: Array, commands: MotorCommands | None
) -> str | None:
    """Why the logged current cannot be that of the motors."""
    if len(amps) == 0:
        return "BAT has no current"
    with np.errstate(invalid="ignore", over="ignore"):
        if amps.max() <= 0.0:
            return f"the current is never positive ({amps.min():.2f} A): no current sensor"
        if np.ptp(amps) < 1e-4:
            return f"the current is {amps[0]:.2f} A throughout: no current sensor"
    if commands is None:
        return None
    mean = commands.mean_at(t_us)
    idle, working = amps[mean < _IDLE], amps[mean > _WORKING]
    if len(idle) and len(working) and np.median(working) < 1.5 * np.median(idle):
        return (
            f"{np.median(working):.2f} A in flight and {np.median(idle):.2f} A with the motors "
            "idle: this is not the current of the motors"
        )
    return None
