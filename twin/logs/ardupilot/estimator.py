"""The estimator that flies the aircraft: which core, which of the sensors it uses."""

from dataclasses import dataclass

import numpy as np

from .log import ArduPilotLog, Topic

_FAMILIES = {3: "XK", 2: "NK", 1: "EK"}
"""By AHRS_EKF_TYPE."""
_MOST = 16
_SHOWN = 8


@dataclass(frozen=True, slots=True)
class Primary:
    """The core of the EKF that is in charge for most of the flight.

    Attributes:
        family: `XK` of EKF3, `NK` of EKF2, `EK` of the first EKF, "" without any.
        core: Its number.
        imu: Instance of IMU that it uses.
        compass: Instance of MAG.
        barometer: Instance of BARO.
        gps: Instance of GPS.
    """

    family: str
    core: int = 0
    imu: int = 0
    compass: int = 0
    barometer: int = 0
    gps: int = 0


def primary(log: ArduPilotLog) -> Primary:
    """What flies the aircraft; a change of core, or of what it uses, is noted.

    Source: ArduPilot, LogStructure.h of AP_NavEKF3 (XKF4.PI, XKFS) and EK3_IMU_MASK, of whose
    sensors each core takes one in turn.
    """
    found = {
        f: sorted({*log.instances(f"{f}F1"), *log.instances(f"{f}Q")}) for f in _FAMILIES.values()
    }
    there = [f for f, cores in found.items() if cores]
    if not there:
        return Primary("")
    wanted = _FAMILIES.get(int(log.params.get("AHRS_EKF_TYPE", 3.0)), "XK")
    family = wanted if wanted in there else there[0]
    cores = found[family]
    states = log.topic(f"{family}F4", _first(log, f"{family}F4"))
    core = _most(log, states, "PI", "q", "EKF core in charge")
    core = core if core in cores else cores[0]
    sensors = log.topic("XKFS", core) if family == "XK" and log.instances("XKFS") else None
    return Primary(
        family,
        core,
        _imu(int(log.params.get(f"EK{3 if family == 'XK' else 2}_IMU_MASK", 0.0)), core),
        max(_most(log, sensors, "MI", "mag", "compass that the EKF uses"), 0),
        max(_most(log, sensors, "BI", "baro", "barometer of the EKF"), 0),
        max(_most(log, sensors, "GI", "pos", "GPS of the EKF"), 0),
    )


def _imu(mask: int, core: int) -> int:
    """The sensor that a core takes: of those in the mask, the one of its own number."""
    sensors = [k for k in range(_MOST) if mask >> k & 1]
    return sensors[core] if core < len(sensors) else core


def _first(log: ArduPilotLog, name: str) -> int | None:
    found = log.instances(name)
    return found[0] if found else None


def _most(log: ArduPilotLog, topic: Topic | None, column: str, where: str, what: str) -> int:
    """The number of a core or sensor that holds for most of the time; -1 where nothing says so."""
    if topic is None or not topic.has(column):
        return -1
    values = topic.raw(column)
    known = (values >= 0) & (values < _MOST)
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
