"""Effects between the true motion and field and the readings of IMU, magnetometer and barometer."""

from dataclasses import replace

import casadi as ca
import numpy as np

from ..component import Enumeration
from ..component.portable import cosine, sine
from ..frames import to_body
from ..vehicle import Vehicle
from ..vehicle.vehicle import hover_level
from .definition import (
    Block,
    Displacement,
    Effect,
    Equation,
    Lines,
    NoiseFloor,
    Repeats,
    effect_of_records,
)
from .parameters import COMMON, RARE, UNMEASURED, EffectParameter, Normal, Prior
from .stages import (
    BaroReading,
    EarthField,
    Freezing,
    ImuMotion,
    ImuNoise,
    ImuReading,
    MagReading,
    Mounting,
)
from .wording import FLY_FOR_COMPASS, Wording, heading_clause, reading_clause

_AXES = (("x", "forward"), ("y", "right"), ("z", "down"))
"""Suffix of a parameter, and direction of its axis, FRD."""
IMU_CHANNELS = ("acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z")
"""Readings by the channel number of `stuck_sensor`, from 1."""
_GOLDEN = 0.6180339887498949  # golden ratio less 1: rotors start at angles spread evenly
_NO_NOISE = 1e-30
"""Lower bound that keeps the derivative of a square root finite without noise."""


def _rotor_hz(vehicle: Vehicle) -> float:
    """Revolutions of a rotor per second in hover: by the thrust map, or estimated from its size.

    The estimate is a blade tip at 60 m/s on a rotor of radius 0.6 arms: within a factor of two for
    27 g to 2 kg.
    """
    speed = hover_level(vehicle) if vehicle.rotors.from_speed else 100.0 / vehicle.arm_m
    return speed / (2 * np.pi)


def _imu_lever_arm(s: Mounting, p: Block) -> Mounting:
    return Mounting([r + p[f"{a}_m"] for (a, _), r in zip(_AXES, s.arm_b, strict=True)])


def _vibration(f: ImuMotion, p: Block) -> ImuMotion:
    force, omega = list(f.specific_force_b), list(f.omega_b)
    for n, spin in enumerate(f.spin, start=1):
        turns = p.state(f"turns_{n}", "1", f"turns of rotor {n}", n * _GOLDEN % 1.0)
        p.derivative(f"turns_{n}", spin * p["frequency_hz"])
        angle = 2 * np.pi * (turns - ca.floor(turns))
        s, c = sine(angle), cosine(angle)
        # Once per revolution in the plane of the rotor, twice per revolution at right angles: two
        # blades.
        for k, shape in enumerate((c, s, 2 * s * c)):
            force[k] += p["accel_m_s2"] * spin * spin * shape
            omega[k] += p["gyro_rad_s"] * spin * spin * shape
    return replace(f, specific_force_b=force, omega_b=omega)


def _accel_scale(r: ImuReading, p: Block) -> ImuReading:
    return replace(r, acc=[p[a] * v for (a, _), v in zip(_AXES, r.acc, strict=True)])


def _gyro_scale(r: ImuReading, p: Block) -> ImuReading:
    return replace(r, gyro=[p[a] * v for (a, _), v in zip(_AXES, r.gyro, strict=True)])


def _accel_misalignment(r: ImuReading, p: Block) -> ImuReading:
    # Half the tangent for half the angle: no trigonometry, and exactly a rotation.
    x, y, z = (p[f"{a}_rad"] / 2 for a, _ in _AXES)
    norm = ca.sqrt(1 + x * x + y * y + z * z)
    return replace(r, acc=to_body([1 / norm, x / norm, y / norm, z / norm], r.acc))


def _accel_bias(r: ImuReading, p: Block) -> ImuReading:
    return replace(r, acc=[v + p[f"{a}_m_s2"] for (a, _), v in zip(_AXES, r.acc, strict=True)])


def _gyro_bias(r: ImuReading, p: Block) -> ImuReading:
    return replace(r, gyro=[v + p[f"{a}_rad_s"] for (a, _), v in zip(_AXES, r.gyro, strict=True)])


def _sensor_noise_level(n: ImuNoise, p: Block) -> ImuNoise:
    def combined(base: ca.SX, further: ca.SX) -> ca.SX:
        scaled = p["scale"] * base
        return ca.sqrt(scaled * scaled + further * further + _NO_NOISE)

    return ImuNoise(combined(n.acc, p["accel_m_s2"]), combined(n.gyro, p["gyro_rad_s"]))


def _stuck_sensor(f: Freezing, p: Block) -> Freezing:
    late = f.time_s >= p["time_s"]
    return replace(
        f,
        stuck=[
            ca.logic_or(s, ca.logic_and(late, ca.fabs(p["channel"] - n) < 0.5))
            for n, s in enumerate(f.stuck, start=1)
        ],
    )


IMU_LEVER_ARM = Effect(
    "imu_lever_arm",
    "the accelerometer sits elsewhere than the model has it, and feels turns",
    "imu",
    Mounting,
    tuple(
        EffectParameter(
            f"{a}_m", "m", f"place on top of the model's, {d}", s, (-1, 1), scale=lambda v: v.arm_m
        )
        for (a, d), s in zip(_AXES, (0.3, -0.2, 0.2), strict=True)
    ),
    ("acc", "gyro"),
    "kinematics of a rigid body, as in twin/physics/sensors/imu.py",
    _imu_lever_arm,
    prior=Prior(
        UNMEASURED,
        "boards sit anywhere on the frame",
        {"": Normal(0.0, 0.25)},
        corrects="imu.position",
    ),
    change=None,
    wording=None,
    advice=None,
)

POSE_LEVER_ARM = effect_of_records(
    "pose_lever_arm",
    "the logged position is that of a point beside the origin of the model: of a set of markers, "
    "or of the IMU of an estimator",
    tuple(
        EffectParameter(
            f"{a}_m", "m", f"place of the logged position, {d}", s, (-1, 1), scale=lambda v: v.arm_m
        )
        for (a, d), s in zip(_AXES, (0.2, -0.2, 0.2), strict=True)
    ),
    ("acc", "gyro", "q", "vel"),
    "kinematics of a rigid body: the accelerometer moves about that point",
    Displacement({f"{a}_m": f"imu_lever_arm.{a}_m" for a, _ in _AXES}),
    prior=Prior(
        UNMEASURED,
        "markers are placed around the frame, and estimators report their IMU",
        {"": Normal(0.0, 0.25)},
        corrects="rotors.position",
    ),
    change=None,
    wording=None,
    advice=None,
)

VIBRATION = Effect(
    "vibration",
    "unbalanced rotors shake the IMU at their own frequency",
    "imu",
    ImuMotion,
    (
        EffectParameter(
            "frequency_hz",
            "Hz",
            "turns of a rotor per second in hover",
            1.0,
            (0.3, 3),
            neutral=None,
            scale=_rotor_hz,
        ),
        EffectParameter(
            "accel_m_s2", "m/s2", "acceleration by one rotor in hover, amplitude", 1.0, (0, 20)
        ),
        EffectParameter(
            "gyro_rad_s", "rad/s", "body rate by one rotor in hover, amplitude", 0.02, (0, 1)
        ),
    ),
    ("acc", "gyro"),
    "rotating unbalance, force m r omega^2: Den Hartog, Mechanical Vibrations, ch. 2; twice "
    "per turn from two blades",
    _vibration,
    observable_as=Lines("frequency_hz", {"acc": "accel_m_s2", "gyro": "gyro_rad_s"}),
    prior=None,
    change=None,
    wording=None,
    advice=None,
)

ACCEL_SCALE = Effect(
    "accel_scale",
    "the accelerometer reads too much or too little in proportion",
    "imu",
    ImuReading,
    tuple(
        EffectParameter(a, "1", f"reading over specific force, {d}", s, (0.8, 1.2), 1.0)
        for (a, d), s in zip(_AXES, (1.05, 0.96, 1.04), strict=True)
    ),
    ("acc",),
    "IEEE Std 1293-2018: scale factor",
    _accel_scale,
    prior=Prior(COMMON, "MEMS, data sheets 0.5 to 3 %", {"": Normal(1.0, 0.01)}),
    change=None,
    wording=None,
    advice=None,
)

GYRO_SCALE = Effect(
    "gyro_scale",
    "the gyroscope reads too much or too little in proportion",
    "imu",
    ImuReading,
    tuple(
        EffectParameter(a, "1", f"reading over body rate, {d}", s, (0.8, 1.2), 1.0)
        for (a, d), s in zip(_AXES, (1.05, 0.96, 1.04), strict=True)
    ),
    ("gyro", "q"),
    "IEEE Std 952-1997: scale factor",
    _gyro_scale,
    prior=Prior(COMMON, "MEMS, data sheets 0.5 to 3 %", {"": Normal(1.0, 0.01)}),
    change=None,
    wording=None,
    advice=None,
)

ACCEL_MISALIGNMENT = Effect(
    "accel_misalignment",
    "the accelerometer is mounted at a small angle to the body axes",
    "imu",
    ImuReading,
    tuple(
        EffectParameter(f"{a}_rad", "rad", f"sensor turned about body {d}", s, (-0.3, 0.3))
        for (a, d), s in zip(_AXES, (0.04, -0.03, 0.03), strict=True)
    ),
    ("acc",),
    "definition: rotation by Gibbs vector angle / 2, the angles themselves to third order",
    _accel_misalignment,
    prior=Prior(COMMON, "mounting of the board", {"": Normal(0.0, 0.02)}),
    change=None,
    wording=None,
    advice=None,
)

ACCEL_BIAS = Effect(
    "accel_bias",
    "the accelerometer reads a constant too much",
    "imu",
    ImuReading,
    tuple(
        EffectParameter(f"{a}_m_s2", "m/s2", f"reading at no specific force, {d}", s, (-2, 2))
        for (a, d), s in zip(_AXES, (0.2, -0.15, 0.15), strict=True)
    ),
    ("acc",),
    "IEEE Std 1293-2018: bias",
    _accel_bias,
    prior=Prior(COMMON, "zero-g offset of 20 to 60 mg, warmth", {"": Normal(0.0, 0.15, 0.1)}),
    change=Prior(COMMON, "a sensor that was hit or warm", {"": Normal(0.0, 0.5)}),
    wording=Wording(reading_clause("accelerometer", "m/s2")),
    advice=None,
)

GYRO_BIAS = Effect(
    "gyro_bias",
    "the gyroscope reads a constant too much",
    "imu",
    ImuReading,
    tuple(
        EffectParameter(f"{a}_rad_s", "rad/s", f"reading at rest, {d}", s, (-0.3, 0.3))
        for (a, d), s in zip(_AXES, (0.02, -0.015, 0.015), strict=True)
    ),
    ("gyro", "q"),
    "IEEE Std 952-1997: bias",
    _gyro_bias,
    prior=Prior(COMMON, "1 deg/s", {"": Normal(0.0, 0.015)}),
    change=Prior(COMMON, "a sensor that was hit or warm", {"": Normal(0.0, 0.05)}),
    wording=Wording(reading_clause("gyroscope", "rad/s")),
    advice=None,
)

SENSOR_NOISE_LEVEL = Effect(
    "sensor_noise_level",
    "the IMU is noisier or quieter than the model says",
    "imu",
    ImuNoise,
    (
        EffectParameter("scale", "1", "noise over the model's", 1.0, (0.1, 10), 1.0),
        EffectParameter("accel_m_s2", "m/s2", "further noise of the accelerometer", 0.2, (0, 5)),
        EffectParameter("gyro_rad_s", "rad/s", "further noise of the gyroscope", 0.01, (0, 0.5)),
    ),
    ("acc", "gyro"),
    "definition: sqrt((scale noise)^2 + further^2), standard deviation of independent noises",
    _sensor_noise_level,
    observable_as=NoiseFloor("scale", {"acc": "accel_m_s2", "gyro": "gyro_rad_s"}),
    prior=None,
    change=None,
    wording=None,
    advice=None,
)

STUCK_SENSOR = Effect(
    "stuck_sensor",
    "one reading of the IMU stands still from some time on",
    "imu",
    Freezing,
    (
        EffectParameter(
            "channel",
            "1",
            "which",
            3.0,
            (0, len(IMU_CHANNELS)),
            kind=Enumeration("ImuChannel", ("none", *IMU_CHANNELS)),
        ),
        EffectParameter("time_s", "s", "since when, from the start", 5.0, (0, 3600), neutral=None),
    ),
    ("acc", "gyro"),
    "definition: from the first sample instant at or after that time the last value is repeated",
    _stuck_sensor,
    observable_as=Repeats("channel", "time_s", IMU_CHANNELS),
    prior=None,
    change=None,
    wording=None,
    advice=None,
)


def _heading_offset(e: EarthField, p: Block) -> EarthField:
    north, east, down = e.field_n
    c, s = cosine(p["yaw_rad"]), sine(p["yaw_rad"])
    return EarthField([c * north + s * east, c * east - s * north, down])


def _mag_soft_iron(r: MagReading, p: Block) -> MagReading:
    rows = (("xx", "xy", "xz"), ("xy", "yy", "yz"), ("xz", "yz", "zz"))
    field = [sum((p[k] * b for k, b in zip(row, r.field_b, strict=True)), ca.SX(0)) for row in rows]
    return replace(r, field_b=field)


def _mag_hard_iron(r: MagReading, p: Block) -> MagReading:
    return replace(r, field_b=[b + p[f"{a}_t"] for (a, _), b in zip(_AXES, r.field_b, strict=True)])


def _mag_current_coupling(r: MagReading, p: Block) -> MagReading:
    field = [b + p[f"{a}_t_a"] * r.current for (a, _), b in zip(_AXES, r.field_b, strict=True)]
    return replace(r, field_b=field)


def _baro_bias(r: BaroReading, p: Block) -> BaroReading:
    return replace(r, pressure=r.pressure + p["pa"])


def _baro_dynamic_pressure(r: BaroReading, p: Block) -> BaroReading:
    return replace(r, pressure=r.pressure + p["share"] * r.dynamic)


HEADING_OFFSET = Effect(
    "heading_offset",
    "the compass shows a heading that is off by a constant angle: a wrong declination, or a "
    "magnetic anomaly of the site",
    "magnetometer",
    EarthField,
    (
        EffectParameter(
            "yaw_rad",
            "rad",
            "heading shown minus true heading",
            0.2,
            (-3.5, 3.5),
            trifle=0.03,
            modes=(-np.pi, np.pi),  # mounted backwards: no slope leads there
        ),
    ),
    ("mag", "q"),
    "definition: the field turned about the vertical",
    _heading_offset,
    # A compass with an error may have biased the estimated attitude, or not.
    observable_as=Equation(turns_pose="pose_rad"),
    of_logs=(
        EffectParameter(
            "pose_rad",
            "rad",
            "logged attitude turned about the vertical",
            0.2,
            (-3.2, 3.2),
            trifle=0.03,
        ),
    ),
    prior=Prior(
        COMMON,
        "declination, frame of the motion capture, steel in floors",
        {"yaw_rad": Normal(0.0, 0.2, 0.15), "pose_rad": Normal(0.0, 0.2, 0.1)},
    ),
    change=Prior(COMMON, "steel nearby, a compass that was moved", {"": Normal(0.0, 0.3)}),
    wording=Wording(heading_clause, largest_alone=True),
    advice={"": FLY_FOR_COMPASS},
)

MAG_SOFT_IRON = Effect(
    "mag_soft_iron",
    "iron parts of the aircraft bend the magnetic field",
    "magnetometer",
    MagReading,
    (
        *(
            EffectParameter(2 * a, "1", f"field read per field there, {d}", s, (0.6, 1.4), 1.0)
            for (a, d), s in zip(_AXES, (1.1, 0.95, 1.05), strict=True)
        ),
        *(
            EffectParameter(
                k, "1", f"field read along one axis per field along another, {k}", 0.05, (-0.4, 0.4)
            )
            for k in ("xy", "xz", "yz")
        ),
    ),
    ("mag", "q"),
    "Gebre-Egziabher et al., J. Aerospace Engineering 19 (2006), symmetric part: the rest "
    "is a rotation",
    _mag_soft_iron,
    prior=Prior(
        COMMON,
        "5 %",
        {**{2 * a: Normal(1.0, 0.05) for a in "xyz"}, "": Normal(0.0, 0.05)},
    ),
    change=None,
    wording=None,
    advice={"": FLY_FOR_COMPASS},
)

MAG_HARD_IRON = Effect(
    "mag_hard_iron",
    "magnetised parts of the aircraft add a constant field",
    "magnetometer",
    MagReading,
    tuple(
        EffectParameter(
            f"{a}_t", "T", f"field of the aircraft, {d}", s, (-2.5e-4, 2.5e-4), trifle=1.6e-6
        )
        for (a, d), s in zip(_AXES, (6e-6, -4e-6, 4e-6), strict=True)
    ),
    ("mag", "q"),
    "Gebre-Egziabher et al., J. Aerospace Engineering 19 (2006); range: five times the earth's "
    "field, beside motors, batteries and steel in floors",
    _mag_hard_iron,
    prior=Prior(
        UNMEASURED,
        "up to the field itself where nobody calibrated; batteries and the place, and flights "
        "between which it was calibrated",
        {"": Normal(0.0, 4e-5, 1e-6)},
    ),
    change=None,
    wording=None,
    advice={"": FLY_FOR_COMPASS},
)

MAG_CURRENT_COUPLING = Effect(
    "mag_current_coupling",
    "the current from the battery adds a field that grows with it",
    "magnetometer",
    MagReading,
    tuple(
        EffectParameter(f"{a}_t_a", "T/A", f"field per current, {d}", s, (-5e-6, 5e-6))
        for (a, d), s in zip(_AXES, (3e-7, 2e-7, -3e-7), strict=True)
    ),
    ("mag", "q", "ibat"),
    "field of a conductor, proportional to its current; ArduPilot compensates it in the same form "
    "(COMPASS_MOT_X, _Y, _Z)",
    _mag_current_coupling,
    prior=Prior(RARE, "ArduPilot's compassmot", {"": Normal(0.0, 3e-7)}),
    change=None,
    wording=None,
    advice=None,
)

BARO_BIAS = Effect(
    "baro_bias",
    "the barometer reads too high or too low by a constant pressure",
    "barometer",
    BaroReading,
    (EffectParameter("pa", "Pa", "reading minus pressure", 60.0, (-6000, 6000), trifle=20.0),),
    ("baro", "pos"),
    "definition; 870 to 1084 hPa at sea level on record (WMO archive of extremes), and a file that "
    "knows no reference pressure of the day shows their distance from its own",
    _baro_bias,
    prior=Prior(
        UNMEASURED,
        "weather 10 hPa, altitude of the place",
        {"": Normal(0.0, 1500.0, 20.0)},
    ),
    change=None,
    wording=None,
    advice=None,
)

BARO_DYNAMIC_PRESSURE = Effect(
    "baro_dynamic_pressure",
    "the barometer feels a share of the dynamic pressure of the air streaming past",
    "barometer",
    BaroReading,
    (EffectParameter("share", "1", "dynamic pressure read over that there", -0.4, (-1.5, 1.5)),),
    ("baro", "pos", "vel"),
    "static pressure error of a port, p + k rho v^2 / 2; PX4 corrects it in the same form "
    "(EKF2_PCOEF_XP and others)",
    _baro_dynamic_pressure,
    prior=Prior(RARE, "static port", {"": Normal(0.0, 0.3)}),
    change=None,
    wording=None,
    advice=None,
)

EFFECTS = (
    IMU_LEVER_ARM,
    POSE_LEVER_ARM,
    VIBRATION,
    ACCEL_SCALE,
    GYRO_SCALE,
    ACCEL_MISALIGNMENT,
    ACCEL_BIAS,
    GYRO_BIAS,
    SENSOR_NOISE_LEVEL,
    STUCK_SENSOR,
    HEADING_OFFSET,
    MAG_SOFT_IRON,
    MAG_HARD_IRON,
    MAG_CURRENT_COUPLING,
    BARO_BIAS,
    BARO_DYNAMIC_PRESSURE,
)
