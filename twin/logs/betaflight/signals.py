"""Fields of main frames -> columns of the flight table.

Axes of Betaflight: body x forward, y left, z up (roll right, nose down and nose left are positive);
world x north, y west, z up. Half a turn about x makes them FRD and NED. The accelerometer at rest
reads +1 g along z. Source: Betaflight's mixer.c, rc.c, imu.c and sitl.c: the mixer raises the rear
motors for a positive pitch, the left ones for a positive roll; stick forward and stick right are
positive there, and yaw is taken negative of the stick.
"""

import numpy as np
from numpy.typing import NDArray

from ...vehicle import GRAVITY_M_S2
from ..assemble import Rows, add_signal
from ..attitude import unit_quaternions
from ..clock import advancing, filter_delay_us, told_dropped
from ..columns import ACC, GYRO, QUAT
from ..flight import Array
from .log import BlackboxLog

Times = NDArray[np.int64]
TURNED = np.array((1.0, -1.0, -1.0))
"""From Betaflight's axes to FRD or NED."""
_FULL_16_BITS = 32767.0
_SEA_LEVEL_PA, _SCALE_M, _EXPONENT = 101_325.0, 44_330.0, 0.190295
"""Betaflight's own height by pressure, barometer.c."""
_HIGH_RESOLUTION = 10.0
_FRESH_US = 100_000
_HUNDREDTHS_SINCE = (4, 0)


def three(stem: str) -> tuple[str, ...]:
    """Fields of three axes."""
    return tuple(f"{stem}[{k}]" for k in range(3))


def rate_scale(log: BlackboxLog) -> float:
    """From logged rates to rad/s: `gyro_scale` is degrees per second, a tenth of it with
    blackbox_high_resolution. NaN: the head does not tell."""
    scale = log.header.bits("gyro_scale")
    fine = log.header.number("blackbox_high_resolution", 0.0) > 0.0
    if scale is None or not np.isfinite(scale) or scale <= 0.0:
        return float("nan")
    return float(np.deg2rad(scale / (_HIGH_RESOLUTION if fine else 1.0)))


def gyro_field(log: BlackboxLog) -> str:
    """The rates that are read: before the filters on board where they are logged."""
    main = log.recording.main
    return next((f for f in ("gyroUnfilt", "gyroADC") if main.has(*three(f))), "")


def accel_cutoff_hz(log: BlackboxLog) -> float:
    """Low-pass before the logged acceleration, Hz; 0: none. The head has 100 times as much."""
    return max(log.header.number("acc_lpf_hz", 0.0), 0.0) / 100.0


def add(
    log: BlackboxLog, rows: Rows, where: str, names: tuple[str, ...], t_us: Times, values: Array
) -> None:
    """Add a signal whose times are those of the firmware."""
    t_us = t_us - log.start_us
    keep, *lost = advancing(t_us)
    for message, count in told_dropped("frames", *lost):
        log.note("error", where, message, count)
    add_signal(log, rows, where, names, t_us[keep], values[keep])


def add_signals(log: BlackboxLog, rows: Rows) -> dict[str, str]:
    """Everything but motors and satellites; facts."""
    facts = _add_gyro(log, rows)
    _add_acceleration(log, rows)
    facts |= _add_attitude(log, rows)
    _add_barometer(log, rows)
    _add_battery(log, rows)
    return facts


def _add_gyro(log: BlackboxLog, rows: Rows) -> dict[str, str]:
    name, scale = gyro_field(log), rate_scale(log)
    if not name:
        log.note("warning", "gyro", "no gyroADC in the log: enable the field GYRO of Blackbox")
        return {}
    if np.isnan(scale):
        told = log.header.settings.get("gyro_scale", "")[:20]
        log.note("error", "gyro", f"left out, the head says gyro_scale {told!r}, no number")
        return {}
    main = log.recording.main
    add(log, rows, "gyro", GYRO, main.t_us, main.columns(three(name)) * TURNED * scale)
    return {"gyro from": f"{name}, {'before' if name == 'gyroUnfilt' else 'after'} the filters"}


def _add_acceleration(log: BlackboxLog, rows: Rows) -> None:
    main = log.recording.main
    if not main.has(*three("accSmooth")):
        log.note("warning", "acc", "no accSmooth in the log: enable the accelerometer")
        return
    one_g = log.header.number("acc_1G", 0.0)
    if not one_g > 0.0:
        told = log.header.settings.get("acc_1G", "")[:20]
        log.note("error", "acc", f"left out, the head says acc_1G {told!r}")
        return
    delay_us, cutoff_hz = 0, accel_cutoff_hz(log)
    if cutoff_hz >= 1.0:
        delay_us = filter_delay_us(cutoff_hz)
        log.note(
            "info",
            "acc",
            f"low-passed at {cutoff_hz:.0f} Hz (acc_lpf_hz) before it was logged; its time is "
            f"{delay_us / 1e3:.1f} ms before the stamp of the log, the delay of that filter",
        )
    values = main.columns(three("accSmooth")) * TURNED * (GRAVITY_M_S2 / one_g)
    add(log, rows, "acc", ACC, main.t_us - delay_us, values)


def _add_attitude(log: BlackboxLog, rows: Rows) -> dict[str, str]:
    """The vector part of the quaternion; its scalar part is never negative."""
    main = log.recording.main
    if not main.has(*three("imuQuaternion")):
        return {}
    vector = main.columns(three("imuQuaternion")) / _FULL_16_BITS
    scalar = np.sqrt(np.maximum(1.0 - np.sum(vector**2, axis=1), 0.0))
    usable, q = unit_quaternions(log, np.column_stack([scalar, vector * TURNED]))
    add(log, rows, "q", QUAT, main.t_us[usable], q)
    return {"attitude from": "imuQuaternion; without a compass, north is where it took off"}


def _add_barometer(log: BlackboxLog, rows: Rows) -> None:
    """Height over the place of arming, as the pressure that Betaflight's formula has there."""
    main = log.recording.main
    if not main.has("baroAlt"):
        return
    height_m = main.columns(("baroAlt",)) / 100.0
    kept = _fresh(main.t_us, height_m)
    share = np.maximum(1.0 - height_m[kept] / _SCALE_M, 0.0)
    add(log, rows, "baro", ("baro_pa",), main.t_us[kept], _SEA_LEVEL_PA * share ** (1 / _EXPONENT))
    log.note(
        "info",
        "baro",
        "the log has height over the place of arming, not pressure: written as that of the "
        "standard atmosphere from sea level. The pressure of the day is not known",
    )


def _add_battery(log: BlackboxLog, rows: Rows) -> None:
    main = log.recording.main
    if main.has("vbatLatest"):
        volts = main.columns(("vbatLatest",)) * (0.01 if log.version >= _HUNDREDTHS_SINCE else 0.1)
        kept = _fresh(main.t_us, volts)
        add(log, rows, "vbat_v", ("vbat_v",), main.t_us[kept], volts[kept])
    if main.has("amperageLatest"):
        amperes = main.columns(("amperageLatest",)) * 0.01
        kept = _fresh(main.t_us, amperes)
        add(log, rows, "ibat_a", ("ibat_a",), main.t_us[kept], amperes[kept])


def _fresh(t_us: Times, values: Array) -> NDArray[np.int64]:
    """Of a signal that is measured seldom and logged often: where it changes, or has not been kept
    for 0.1 s."""
    changed = np.append(True, np.any(np.diff(values, axis=0) != 0.0, axis=1)).tolist()
    kept, last = [], -_FRESH_US
    for k, (t, new) in enumerate(zip((t_us - t_us[0]).tolist(), changed, strict=True)):
        if new or t - last >= _FRESH_US:
            kept.append(k)
            last = t
    return np.array(kept, dtype=np.int64)
