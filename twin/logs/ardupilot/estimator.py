"""The estimator that flies the aircraft: which core, which of the sensors it uses."""

from dataclasses import dataclass

import numpy as np

from .log import ArduPilotLog, Topic

_EKF2 = 2
_MOST_SENSORS = 16


@dataclass(frozen=True, slots=True)
class Primary:
    """The core of the EKF that is in charge for most of the flight.

    Attributes:
        family: `XK` of EKF3, `NK` of EKF2, "" without either.
        core: Its number.
        gyro: Instance of IMU whose gyroscope it uses.
        accelerometer: The same of its accelerometer.
        compass: Instance of MAG.
        barometer: Instance of BARO.
        gps: Instance of GPS.
    """

    family: str
    core: int = 0
    gyro: int = 0
    accelerometer: int = 0
    compass: int = 0
    barometer: int = 0
    gps: int = 0


def primary(log: ArduPilotLog) -> Primary:
    """What flies the aircraft; a change of core is noted."""
    found = {f: sorted({*log.instances(f"{f}F1"), *log.instances(f"{f}Q")}) for f in ("XK", "NK")}
    there = [f for f, cores in found.items() if cores]
    if not there:
        return Primary("")
    wanted = "NK" if int(log.params.get("AHRS_EKF_TYPE", 3.0)) == _EKF2 else "XK"
    family = wanted if wanted in there else there[0]
    cores = found[family]
    core = _most(log, log.topic(f"{family}F4", _first(log, f"{family}F4"), "PI"), "PI", cores)
    if core not in cores:
        core = cores[0]
    sensors = log.topic("XKFS", core) if family == "XK" and log.instances("XKFS") else None

    def used(column: str) -> int:
        """Instance of a sensor, the one used for most of the time."""
        if sensors is None or not sensors.has(column):
            return 0
        values = sensors.raw(column)
        values = values[(values >= 0) & (values < _MOST_SENSORS)]
        return int(np.bincount(values.astype(np.int64)).argmax()) if len(values) else 0

    return Primary(family, core, used("GI"), used("AI"), used("MI"), used("BI"), used("SI"))


def _first(log: ArduPilotLog, name: str) -> int | None:
    found = log.instances(name)
    return found[0] if found else None


def _most(log: ArduPilotLog, topic: Topic | None, column: str, cores: list[int]) -> int:
    """The core in charge for most of the time; -1 where nothing says so."""
    if topic is None:
        return -1
    values = topic.raw(column).astype(np.int64)
    known = np.isin(values, cores)
    if not known.any():
        return -1
    changes = np.flatnonzero(np.diff(values[known])) + 1
    most = int(np.bincount(values[known]).argmax())
    if len(changes):
        at = ", ".join(f"{t:.1f}" for t in topic.t_s[known][changes][:8])
        message = f"the core of the EKF in charge changes at {at} s; core {most} is used throughout"
        log.note("warning", "q", message, len(changes))
    return most
