"""Effects between what is there and what magnetometer and barometer read."""

from dataclasses import replace

import casadi as ca

from ..component.portable import cosine, sine
from .definition import Block, Effect, EffectParameter
from .observability import Equation
from .sensor_stages import BaroReading, EarthField, MagReading

_AXES = (("x", "forward"), ("y", "right"), ("z", "down"))


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
    (EffectParameter("yaw_rad", "rad", "heading shown minus true heading", 0.2, (-1.6, 1.6)),),
    ("mag", "q"),
    "definition: the field turned about the vertical",
    _heading_offset,
    # A compass that is off may have misled the estimate of the attitude, or not.
    observable_as=Equation(turns_pose="pose_rad"),
    of_logs=(
        EffectParameter(
            "pose_rad", "rad", "logged attitude turned about the vertical", 0.2, (-1.6, 1.6)
        ),
    ),
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
)

EFFECTS = (
    HEADING_OFFSET,
    MAG_SOFT_IRON,
    MAG_HARD_IRON,
    MAG_CURRENT_COUPLING,
    BARO_BIAS,
    BARO_DYNAMIC_PRESSURE,
)
