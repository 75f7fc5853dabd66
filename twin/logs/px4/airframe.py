"""Facts of an aircraft from the parameters and topics of a PX4 log."""

from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from ...vehicle.layouts import CCW, CW, FRAMES, Layout, frame
from ..airframe import (
    NO_MULTIROTOR,
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
from .control import airframe_mixer, frame_of_mixer
from .log import Px4Log, Topic
from .outputs import MOTORS, Outputs, logged_outputs
from .rebuild import flown_mixer

_OTHER_ALLOCATION = {
    1: "a fixed-wing aircraft",
    **dict.fromkeys((2, 3, 4), "a VTOL aircraft, with wings"),
    **dict.fromkeys((5, 6), "a rover"),
    **dict.fromkeys((10, 11), "a helicopter"),
}
"""Vehicle by CA_AIRFRAME."""
_RANGES = {4: "x", 5: "+", 6: "hex x", 7: "hex +", 8: "octo x", 9: "octo +", 10: "wide"}
"""Frame by the thousands of SYS_AUTOSTART, PX4 airframes reference."""
_GENERIC_M = 0.15
"""Coordinate of PX4's generic quadrotor, which many users do not change: not a real size."""
_KM = 0.05
"""CA_ROTOR*_KM where the log does not have it: PX4's default, counter-clockwise."""
_LARGEST_M = 1.0
"""Coordinates from this size are proportions: PX4 needs only those."""
_TYPED_SD = 0.05
"""Standard deviation of coordinates entered by a user, over the arm; by judgement."""
_MOST_CELLS, _MOST_V = 60, 5.5  # number of cells in series, and volts of one: beyond is damage
_HIGHEST_M = 2e4  # height of a fix; beyond is damage
_FIX_3D = 3  # fix_type
_MOVED_DEG = 1e-6
"""A tenth of a metre: a larger change of the estimator's origin is a restart."""
_EARLIEST_S = 1.0e9  # 2001: receivers without a date begin in 1970 or 1980


def from_px4_airframe(log: Px4Log, filtered: bool) -> Airframe:
    """Facts of the aircraft in a PX4 log.

    Args:
        log: The log.
        filtered: Whether accelerometer and gyroscope are from the topics after the low-passes.
    """
    p = log.params
    count = _rotors(log)
    return Airframe(
        no_multirotor=_no_multirotor(log),
        rotors=count,
        layout=_layout(log, None if count is None else count.value),
        thrust=_thrust(log),
        pulse_us=_pulse(log),
        cells=_cells(log),
        imu_position_m=_imu_position(log),
        accel_cutoff_hz=positive_parameter(p, "IMU_ACCEL_CUTOFF") if filtered else None,
        gyro_cutoff_hz=positive_parameter(p, "IMU_GYRO_CUTOFF") if filtered else None,
        place=_place(log),
        filters="" if filtered else _filters(log),
        origin=_origin(log),
    )


def _no_multirotor(log: Px4Log) -> str:
    for name, kinds in (("MAV_TYPE", NO_MULTIROTOR), ("CA_AIRFRAME", _OTHER_ALLOCATION)):
        value = int(log.params.get(name, -1))
        if value in kinds:
            return f"{name} is {value}, {kinds[value]}"
    return ""


def _rotors(log: Px4Log) -> SourcedValue[int] | None:
    count = log.params.get("CA_ROTOR_COUNT", 0.0)
    if MIN_MOTORS <= count <= MAX_MOTORS:
        return SourcedValue(int(count), "CA_ROTOR_COUNT of the log")
    kind = int(log.params.get("MAV_TYPE", -1))
    known = MOTORS.get(kind)
    return None if known is None else SourcedValue(known, f"MAV_TYPE {kind} of the log")


def _layout(log: Px4Log, motors: int | None) -> Layout | None:
    """Layout from CA_ROTOR* where the log has them, else by the selected airframe; where that is
    none of PX4's, by the mixer that computes the logged outputs from the logged controls."""
    if MIN_MOTORS <= log.params.get("CA_ROTOR_COUNT", 0.0) <= MAX_MOTORS:
        return _allocated(log, int(log.params["CA_ROTOR_COUNT"]))
    autostart = int(log.params.get("SYS_AUTOSTART", 0.0))
    mixer = airframe_mixer(autostart)
    name = frame_of_mixer(mixer) if mixer else _RANGES.get(autostart // 1000)
    if name is None:
        outputs = _outputs_unsaid(log)
        flown = None if outputs is None else flown_mixer(log, outputs)
        if flown is None:
            return None
        name = frame_of_mixer(flown[0])
        how = f"by logged controls and outputs, to {flown[1]:.1f} us"
        return frame(name, f"mixer {flown[0]} {how}, frame {name}")
    if len(FRAMES[name][0]) != (motors or 4):
        return None
    return frame(name, f"SYS_AUTOSTART {autostart} of the log, frame {name}")


def _allocated(log: Px4Log, motors: int) -> Layout | None:
    p = log.params
    position = np.array([[p.get(f"CA_ROTOR{k}_P{a}", 0.0) for a in "XYZ"] for k in range(motors)])
    turn = np.array([p.get(f"CA_ROTOR{k}_KM", _KM) for k in range(motors)])
    if not np.all(turn) or not np.any(position[:, :2]):
        return None
    sizes = np.abs(position[:, :2])
    generic = bool(np.isin(np.round(sizes, 6), (0.0, _GENERIC_M)).all())
    metric = bool(sizes.max() < _LARGEST_M) and not generic
    return Layout(
        position,
        np.where(turn > 0, CCW, CW),
        metric,
        _TYPED_SD,
        f"CA_ROTOR0..{motors - 1}_PX, _PY, _PZ and the signs of _KM of the log",
        senses_known=bool(np.ptp(np.sign(turn)) > 0),  # all equal: the default, never set
        place_keys="CA_ROTOR{}_PX, _PY of the log",
        sense_keys="CA_ROTOR{}_KM of the log",
    )


def _thrust(log: Px4Log) -> SourcedValue[ThrustCurve] | None:
    """Thrust curve; None for 0, the default of PX4, which is uninformative."""
    factor = log.params.get("THR_MDL_FAC", 0.0)
    if not 0.0 < factor <= 1.0:
        return None
    return SourcedValue(ThrustCurve(factor), f"THR_MDL_FAC {factor:g} of the log")


def _outputs_unsaid(log: Px4Log) -> Outputs | None:
    """Outputs that drive the motors, without findings; None: they are not logged, or commands are
    logged as well."""
    if log.instances("actuator_motors"):
        return None
    noted = len(log.findings)
    outputs: Outputs | None = logged_outputs(log)
    del log.findings[noted:]  # the reader of the commands has reported them
    return outputs


def _pulse(log: Px4Log) -> SourcedValue[tuple[float, float]] | None:
    """Pulse range of the outputs that drive the motors, where the log has their pulse widths."""
    outputs = _outputs_unsaid(log)
    if outputs is None or any(m.unit != "us" for m in outputs.motors):
        return None
    first = outputs.motors[0]
    return SourcedValue((first.low, first.high), f"{first.source} of the log")


def _cells(log: Px4Log) -> SourcedValue[Cells] | None:
    stem = "BAT1" if "BAT1_N_CELLS" in log.params else "BAT"
    p = {name: log.params.get(f"{stem}_{name}", 0.0) for name in _BATTERY}
    count = int(p["N_CELLS"])
    if not 1 <= count <= _MOST_CELLS or not _MOST_V > p["V_CHARGED"] > p["V_EMPTY"] > 1.0:
        return None
    return SourcedValue(
        Cells(
            count,
            p["V_CHARGED"],
            p["V_EMPTY"],
            p["CAPACITY"] * 3.6 if p["CAPACITY"] > 0 else None,
            p["R_INTERNAL"] if p["R_INTERNAL"] > 0 else None,
        ),
        f"{stem}_N_CELLS {count} of the log",
    )


_BATTERY = ("N_CELLS", "V_CHARGED", "V_EMPTY", "CAPACITY", "R_INTERNAL")  # parameters BATn_*


def _imu_position(log: Px4Log) -> SourcedValue[tuple[float, float, float]] | None:
    """Position of the IMU; None for 0, 0, 0, the default of PX4, which is uninformative."""
    x, y, z = (log.params.get(f"EKF2_IMU_POS_{a}", 0.0) for a in "XYZ")
    return SourcedValue((x, y, z), "EKF2_IMU_POS_X, _Y, _Z of the log") if x or y or z else None


FILTERS = {
    "IMU_GYRO_CUTOFF": "gyroscope",
    "IMU_DGYRO_CUTOFF": "angular acceleration",
    "IMU_ACCEL_CUTOFF": "accelerometer",
    "IMU_GYRO_NF_FREQ": "notch",
    "IMU_GYRO_NF0_FRQ": "notch",
    "IMU_GYRO_NF1_FRQ": "notch",
}
"""Parameters with the frequency of a filter, Hz, and the filtered signal."""


def _filters(log: Px4Log) -> str:
    """Text on the filters of the controllers: the logged samples are taken before them."""
    p = log.params
    said = [
        f"{what} {p[name]:g} Hz ({name})" for name, what in FILTERS.items() if p.get(name, 0.0) > 0
    ]
    return ", ".join(said)


def _place(log: Px4Log) -> SourcedValue[Place] | None:
    """Median of the fixes of a GNSS receiver."""
    for name in ("vehicle_gps_position", "sensor_gps"):
        topic = log.topic(name)
        if topic is None or not topic.has("fix_type"):
            continue
        fixed = topic.data["fix_type"] >= _FIX_3D
        if np.mean(fixed) < 0.5:
            continue
        degrees = _degrees(topic)
        if degrees is None or not np.isfinite(degrees[fixed]).all():
            continue
        latitude, longitude, height = np.median(degrees[fixed], axis=0)
        possible = abs(latitude) <= 90.0 and abs(longitude) <= 360.0 and abs(height) < _HIGHEST_M
        if not possible or not (latitude or longitude):
            continue
        place = Place.of_degrees(latitude, longitude, height, _year(topic, fixed))
        return SourcedValue(place, f"{name} of the log, {int(fixed.sum())} fixes")
    return None


def _origin(log: Px4Log) -> SourcedValue[Place] | None:
    """Origin of the estimator's positions; None where it has none, or has moved it."""
    topic = log.topic("vehicle_local_position", 0)
    if topic is None or not topic.has("ref_lat", "ref_lon", "ref_alt", "xy_global"):
        return None
    there = topic.columns(("ref_lat", "ref_lon", "ref_alt"))[topic.data["xy_global"] > 0]
    there = there[np.isfinite(there).all(axis=1)]
    if not len(there) or np.any(np.ptp(there[:, :2], axis=0) > _MOVED_DEG):
        return None
    latitude, longitude, height = there[-1]
    if abs(latitude) > 90.0 or abs(longitude) > 360.0 or not (latitude or longitude):
        return None
    place = Place.of_degrees(latitude, longitude, height)
    return SourcedValue(place, "vehicle_local_position of the log")


def _degrees(topic: Topic) -> Array | None:
    """Latitude and longitude in degrees, height in m, shape (n, 3); release 1.14 renamed the
    fields."""
    if topic.has("latitude_deg", "longitude_deg", "altitude_ellipsoid_m"):
        return topic.columns(("latitude_deg", "longitude_deg", "altitude_ellipsoid_m"))
    if topic.has("lat", "lon", "alt_ellipsoid"):
        return topic.columns(("lat", "lon", "alt_ellipsoid")) * (1e-7, 1e-7, 1e-3)
    return None


def _year(topic: Topic, fixed: NDArray[np.bool_]) -> float | None:
    """Decimal year by the receiver's clock."""
    if not topic.has("time_utc_usec"):
        return None
    utc_s = float(np.median(topic.data["time_utc_usec"][fixed].astype(np.float64))) * 1e-6
    if not _EARLIEST_S < utc_s < 4.0e9:
        return None
    return round(decimal_year(datetime.fromtimestamp(utc_s, UTC)), 2)


# -- site ---------------------------------------------------------------------------------------
#
# Indoors or outdoors, by the source of the position.

_GNSS = ("vehicle_gps_position", "sensor_gps")  # topics, newest name last
_TRACKED = ("vehicle_visual_odometry", "vehicle_mocap_odometry")  # topics of an external pose
_AID_VISION = 8 | 16
"""EKF2_AID_MASK of PX4 up to 1.13: position and yaw of external vision. Its successor EKF2_EV_CTRL
enables vision by default and is uninformative."""


def from_px4_site(log: Px4Log) -> Site | None:
    """Outdoors where at least half of the samples have a satellite fix; indoors with an external
    pose from cameras or motion capture; None where the log has neither."""
    for name in _GNSS:
        kinds = log.fields(name).get("fix_type")
        if kinds is not None and np.mean(kinds >= _FIX_3D) >= 0.5:
            return Site(False, f"{name} has a fix")
    for name in _TRACKED:
        if log.fields(name):
            return Site(True, f"{name} and no fix by satellites")
    mask = int(log.params.get("EKF2_AID_MASK", 0)) & _AID_VISION
    if mask:
        return Site(True, f"EKF2_AID_MASK takes external vision ({mask}), no fix by satellites")
    return None
