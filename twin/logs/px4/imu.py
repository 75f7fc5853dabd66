"""Inertial sensors, magnetometer and barometer of a PX4 log of any release.

| release | gyroscope and accelerometer | averaging time | magnetometer, barometer |
|---|---|---|---|
| before 1.5 | sensor_combined.gyro_rad_s | not logged | in it, gauss and mbar |
| 1.5 to 1.7 | sensor_combined.gyro_rad | gyro_integral_dt, float: s | in it, gauss and a height |
| from 1.8 | the same | integer: us | vehicle_magnetometer, vehicle_air_data |
| from 1.11, without sensor_combined | vehicle_imu, increments | its dt, us | the same |

Source: PX4, msg/sensor_combined.msg and msg/vehicle_imu.msg of the releases.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..assemble import FlightBuilder
from ..columns import ACC, GYRO, MAG
from ..flight import Array
from .log import Px4Log, Topic

Times = NDArray[np.int64]

_GAUSS_T = 1e-4  # T
_MBAR_PA = 100.0  # Pa
_NO_RELATIVE_TIME = 2**31 - 1  # of a row without an acceleration
_SAME_ROW_US = 600  # between accelerometer and gyroscope that share a row
_LONGEST_WINDOW_US = 100_000  # averaging time; beyond is damage
_FARTHEST_US = 30_000  # between accelerometer and gyro of one message; sound logs: under 5 ms
_EARLIEST_US = 2**62  # before any stamp
_OVERLAP = 1.5  # intervals that an averaging time may span
_COMBINED = "sensor_combined"  # topic


def from_px4_gauss(field: Array) -> Array:
    """Magnetic field, gauss -> T."""
    return field * _GAUSS_T


def from_px4_interval(values: NDArray[np.generic]) -> Times:
    """Averaging time, us: the unit depends on the type of the field, s as float (up to PX4 1.7),
    else us."""
    with np.errstate(invalid="ignore", over="ignore"):
        if values.dtype.kind == "f":
            us = 1e6 * values.astype(np.float64)
            known = np.isfinite(us) & (np.abs(us) < _EARLIEST_US)
            return np.round(np.where(known, us, 0.0)).astype(np.int64)
        return values.astype(np.int64)


@dataclass(frozen=True, slots=True)
class _Source:
    """Samples of accelerometer and gyroscope from one topic.

    Attributes:
        topic: The topic.
        gyro: Body rates, FRD, rad/s, shape (n, 3).
        gyro_end_us: End of the averaging window of each sample, us, shape (n,).
        gyro_dt_us: Length of the averaging window, us, shape (n,); 0: not known.
        acc: Specific force, FRD, m/s^2, shape (n, 3).
        acc_end_us: End of the averaging window of each sample, us, shape (n,).
        acc_dt_us: Length of the averaging window, us, shape (n,); 0: not known.
        has_acc: Whether a row has an accelerometer sample, shape (n,).
    """

    topic: Topic
    gyro: Array
    gyro_end_us: Times
    gyro_dt_us: Times
    acc: Array
    acc_end_us: Times
    acc_dt_us: Times
    has_acc: NDArray[np.bool_]


def add_imu(log: Px4Log, flight: FlightBuilder) -> bool:
    """Accelerometer and gyro, stamped with the middle of the averaging window of each sample.

    Returns:
        Whether they are from the topics after the low-passes of the controllers.
    """
    source = _combined(log) or _increments(log)
    if source is None:
        _filtered_imu(log, flight)
        return True
    gyro_us, acc_us = (
        end - dt // 2
        for end, dt in (
            (source.gyro_end_us, source.gyro_dt_us),
            (source.acc_end_us, source.acc_dt_us),
        )
    )
    together = source.has_acc & (np.abs(acc_us - gyro_us) < _SAME_ROW_US)
    acc_us = np.where(together, gyro_us, acc_us)[source.has_acc]
    acc = source.acc[source.has_acc]
    if source.gyro_dt_us.any():
        log.note(
            "info",
            source.topic.name,
            f"samples are means over {np.median(source.gyro_dt_us) / 1e3:.1f} ms; their time is "
            f"the middle of that, {np.median(source.gyro_end_us - gyro_us) / 1e3:.1f} ms before "
            "the time stamp of the log",
        )
    for where, names, t_us, values in (
        ("gyro", GYRO, gyro_us, source.gyro),
        ("acc", ACC, acc_us, acc),
    ):
        rising = np.diff(np.maximum.accumulate(t_us), prepend=-_EARLIEST_US) > 0
        log.note("error", where, "samples dropped whose averaging times overlap", ~rising)
        flight.add(where, names, t_us[rising], values[rising])
    _gaps(log, source.topic, source.gyro_dt_us, flight.facts)
    for field in ("accelerometer_clipping", "delta_velocity_clipping"):
        clipping = source.topic.data.get(field)
        if clipping is not None:
            message = "samples in which the accelerometer was at its limit"
            log.note("warning", "acc", message, clipping != 0)
    return False


def _combined(log: Px4Log) -> _Source | None:
    """Samples of sensor_combined, None where the log has none."""
    gyro = "gyro_rad" if "gyro_rad[0]" in log.fields(_COMBINED) else "gyro_rad_s"
    fields = [f"{s}[{k}]" for s in (gyro, "accelerometer_m_s2") for k in range(3)]
    if not log.fields(_COMBINED) or (topic := log.topic(_COMBINED, 0, *fields)) is None:
        return None
    stamps = topic.data.get("accelerometer_timestamp", topic.data.get("accelerometer_timestamp[0]"))
    field = f"accelerometer_timestamp{'' if stamps is not None else '_relative'}"
    if stamps is not None:  # before PX4 1.5: own stamps, repeated until there is a new sample
        relative = stamps.astype(np.int64) - topic.data["timestamp"].astype(np.int64)
        has_acc = np.diff(stamps.astype(np.int64), prepend=-1) != 0
        none = ~has_acc
    else:
        offset = topic.data.get("accelerometer_timestamp_relative", np.zeros(len(topic.t_us)))
        relative = offset.astype(np.int64)
        none = relative == _NO_RELATIVE_TIME
        has_acc = ~none
    has_acc &= np.abs(relative) < _FARTHEST_US
    log.note("info", "acc", "rows of sensor_combined without an acceleration sample", none)
    log.note("error", "acc", f"samples left out, {field} is beyond 0.03 s", ~has_acc & ~none)
    acc_end = topic.t_us + np.where(has_acc, relative, 0)
    return _Source(
        topic,
        topic.array(gyro, 3),
        topic.t_us,
        _window(log, topic, "gyro_integral_dt"),
        topic.array("accelerometer_m_s2", 3),
        acc_end,
        _window(log, topic, "accelerometer_integral_dt"),
        has_acc,
    )


def _increments(log: Px4Log) -> _Source | None:
    """Samples of vehicle_imu: increments over their time, None where the log has no usable time."""
    there = log.fields("vehicle_imu")
    lengths = [
        next((f for f in (f"{stem}_dt", "dt") if f in there), "")
        for stem in ("delta_angle", "delta_velocity")
    ]
    fields = [f"{s}[{k}]" for s in ("delta_angle", "delta_velocity") for k in range(3)]
    if not all(lengths) or (topic := log.topic("vehicle_imu", 0, *fields)) is None:
        return None
    found = []
    for stem, length in zip(("delta_angle", "delta_velocity"), lengths, strict=True):
        dt_us = _window(log, topic, length)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            found.append((topic.array(stem, 3) / (1e-6 * dt_us[:, None]), dt_us))
    (gyro, gyro_dt), (acc, acc_dt) = found
    usable = (gyro_dt > 0) & (acc_dt > 0)
    if not usable.any():
        return None
    several = ", the first of several instances" if len(log.instances("vehicle_imu")) > 1 else ""
    log.note("info", "acc", f"from vehicle_imu{several}: no sensor_combined in the log")
    cut = Topic(
        topic.name,
        topic.t_us[usable],
        {k: v[usable] for k, v in topic.data.items()},
        topic.by_sample_time,
    )
    return _Source(
        cut,
        gyro[usable],
        cut.t_us,
        gyro_dt[usable],
        acc[usable],
        cut.t_us,
        acc_dt[usable],
        np.ones(int(usable.sum()), dtype=np.bool_),
    )


def _window(log: Px4Log, topic: Topic, field: str) -> Times:
    """Length of the averaging windows of a topic, us; 0 where it is not known."""
    if not topic.has(field):
        return np.zeros(len(topic.t_us), dtype=np.int64)
    length = from_px4_interval(topic.data[field])
    possible = (length > 0) & (length < _LONGEST_WINDOW_US)
    message = f"samples whose {field} is not within 0 to 0.1 s: their own time is taken"
    log.note("warning", topic.name, message, ~possible)
    over = possible[1:] & (length[1:] > _OVERLAP * np.diff(topic.t_us))
    message = f"samples whose {field} reaches back over the sample before: their middle is off"
    log.note("warning", topic.name, message, over)
    return np.where(possible, length, 0)


def _gaps(log: Px4Log, topic: Topic, window_us: Times, facts: dict[str, str]) -> None:
    """Count IMU samples that were taken but are not in the log."""
    steps = np.diff(topic.t_us)
    if len(steps) == 0 or not window_us.any():
        return
    gaps = np.maximum(steps - window_us[1:], 0)
    lost = int(np.round(gaps[gaps > 0.1 * window_us[1:]].sum() / window_us.mean()))
    span_s = (topic.t_us[-1] - topic.t_us[0]) * 1e-6
    facts["imu_rate"] = (
        f"{(len(steps) + lost) / span_s:.0f} Hz sampled, {len(steps) / span_s:.0f} Hz in the log"
    )
    if lost:
        share = 100 * lost / (len(steps) + lost)
        log.note(
            "warning",
            topic.name,
            f"{lost} samples missing ({share:.2g} %); the longest gap is "
            f"{steps.max() / 1e3:.1f} ms. Nothing is filled in",
        )


def _filtered_imu(log: Px4Log, flight: FlightBuilder) -> None:
    """Add the filtered signals of the controllers, the second choice."""
    for name, where, names in (
        ("vehicle_acceleration", "acc", ACC),
        ("vehicle_angular_velocity", "gyro", GYRO),
    ):
        topic = log.topic(name, 0, "xyz[0]", "xyz[1]", "xyz[2]")
        if topic is None:
            message = f"neither sensor_combined, vehicle_imu nor {name} is in the log"
            log.note("warning", where, message)
            continue
        log.note("warning", where, f"from {name}: low-pass filtered on board, bias removed")
        flight.add(where, names, topic.t_us, topic.array("xyz", 3))


def add_magnetometer(log: Px4Log, flight: FlightBuilder) -> None:
    """Add the first magnetometer, up to PX4 1.7 that of sensor_combined."""
    fields = [f"magnetometer_ga[{k}]" for k in range(3)]
    if not log.instances("vehicle_magnetometer"):
        t_us, gauss = _slower(log, "magnetometer", fields)
        flight.add("mag", MAG, t_us, from_px4_gauss(gauss))
        return
    topic = log.topic("vehicle_magnetometer", 0, *fields)
    if topic is None:
        return
    if len(log.instances("vehicle_magnetometer")) > 1:
        log.note("info", "mag", "several magnetometers in the log, the first is used")
    flight.add("mag", MAG, topic.t_us, from_px4_gauss(topic.array("magnetometer_ga", 3)))


def add_barometer(log: Px4Log, flight: FlightBuilder) -> None:
    """Add the static pressure, up to PX4 1.8 from sensor_combined where it has pressure, not
    height."""
    topic = log.topic("vehicle_air_data", 0, "baro_pressure_pa")
    if topic is not None:
        pressure = topic.columns(("baro_pressure_pa",))
        flight.add("baro", ("baro_pa",), topic.t_us, pressure)
        return
    for field, factor in (
        ("baro_pressure_pa", 1.0),
        ("baro_pres_mbar", _MBAR_PA),
        ("baro_pres_mbar[0]", _MBAR_PA),
    ):
        t_us, values = _slower(log, "baro", [field])
        if len(t_us):
            flight.add("baro", ("baro_pa",), t_us, factor * values)
            return
    if "baro_alt_meter" in log.fields(_COMBINED):
        message = "left out: this release logs a height by pressure, and not the pressure"
        log.note("info", "baro", message)


def _slower(log: Px4Log, stem: str, fields: list[str]) -> tuple[Times, Array]:
    """Times and values of a slower sensor in sensor_combined, each sample once; empty without
    it."""
    nothing = np.zeros(0, dtype=np.int64), np.zeros((0, len(fields)))
    if not set(fields) <= log.fields(_COMBINED).keys():
        return nothing
    topic = log.topic(_COMBINED, 0)
    if topic is None:
        return nothing
    stamps = topic.data.get(f"{stem}_timestamp", topic.data.get(f"{stem}_timestamp[0]"))
    if stamps is not None:
        t_us = topic.t_us + stamps.astype(np.int64) - topic.data["timestamp"].astype(np.int64)
        there = stamps != 0
    elif topic.has(f"{stem}_timestamp_relative"):
        relative = topic.data[f"{stem}_timestamp_relative"].astype(np.int64)
        t_us, there = topic.t_us + relative, relative != _NO_RELATIVE_TIME
    else:
        return nothing
    t_us, values = t_us[there], topic.columns(fields)[there]
    new = np.diff(np.maximum.accumulate(t_us), prepend=-_EARLIEST_US) > 0
    return t_us[new], values[new]
