"""What no flight reaches: a value beyond it is damaged, or in another unit. For every format."""

import numpy as np
from numpy.typing import NDArray

from ..vehicle import GRAVITY_M_S2
from .columns import ACC, ACC_NED, GYRO, MAG, POS, VEL

Array = NDArray[np.float64]

LIMITS = {
    "acc": 2e3,
    "acc_ned": 2e3,
    "gyro": 1e2,
    "mag": 1e-2,
    "baro": 2e5,
    "pos": 1e6,
    "vel": 1e3,
    "vbat_v": 1e3,
    "ibat_a": 1e4,
    "rotor": 1e5,
}
"""By signal, of the magnitude of each of its parts, SI."""
SIGNALS: dict[str, tuple[str, ...]] = {
    "acc": ACC,
    "acc_ned": ACC_NED,
    "gyro": GYRO,
    "mag": MAG,
    "baro": ("baro_pa",),
    "pos": POS,
    "vel": VEL,
    "vbat_v": ("vbat_v",),
    "ibat_a": ("ibat_a",),
}
"""Columns that a limit is of; `rotor` has one column per motor."""

_UNITS = {
    "acc": "in mg? An accelerometer at rest reads 9.8 m/s^2",
    "gyro": "in degrees per second? 1 rad/s = 57.3",
    "mag": "in gauss? The Earth has 2.5e-5 to 6.5e-5 T (1 gauss = 1e-4 T)",
    "pos": "in mm, or in degrees times 1e7?",
    "vel": "in mm/s?",
}


def _parts(unit: str, thousandth: str) -> tuple[tuple[str, float], ...]:
    return (f"tenths of {unit}", 0.1), (f"hundredths of {unit}", 1e-2), (thousandth, 1e-3)


READINGS: dict[str, tuple[str, float, float, tuple[tuple[str, float], ...]]] = {
    "acc": (
        "m/s^2",
        5.0,
        20.0,
        (("g", GRAVITY_M_S2), ("mg", 1e-3 * GRAVITY_M_S2), ("cm/s^2", 1e-2)),
    ),
    "mag": ("T", 1.5e-5, 1e-4, (("gauss", 1e-4), ("mgauss", 1e-7), ("uT", 1e-6), ("nT", 1e-9))),
    "baro": ("Pa", 3e4, 1.1e5, (("hPa", 1e2), ("kPa", 1e3), ("tenths of a Pa", 0.1))),
    "vbat_v": ("V", 2.0, 120.0, _parts("a volt", "mV")),
    "ibat_a": ("A", 0.05, 400.0, _parts("an ampere", "mA")),
}
"""Unit of a signal, within what the median of its magnitude lies while a multirotor flies, and
other units in which it is written, with what takes them to the unit. Current and voltage are those
of a 1S whoop to a 24S lifter, by judgement, pressure up to 9 km, the field the Earth's near iron.
"""


def other_unit(signal: str, reading: float) -> str:
    """In which other units a reading would be one of the sensor: `in mV 16.4 V, ...?`.

    Args:
        signal: A key of `READINGS`, "" comes back for any other.
        reading: Median of its magnitude, in the unit of the flight table.

    Returns:
        "" where it is possible as it is, or is in none of the other units.
    """
    if signal not in READINGS:
        return ""
    unit, low, high, others = READINGS[signal]
    if low <= reading <= high:
        return ""
    fitting = [
        f"in {name} it would be {reading * factor:.4g} {unit}"
        for name, factor in others
        if low <= reading * factor <= high
    ]
    return f"{', '.join(fitting)}: another unit?" if fitting else ""


def beyond(signal: str, values: Array) -> NDArray[np.bool_]:
    """Samples of which a part is beyond the limit of the signal, shape (n,).

    Args:
        signal: A key of `LIMITS`; nothing is beyond where it is none.
        values: Shape (n, k).
    """
    return np.asarray((np.abs(values) > LIMITS.get(signal, np.inf)).any(axis=1))


def told(signal: str, values: Array) -> str:
    """The text of a finding on such samples.

    Args:
        signal: A key of `LIMITS`.
        values: The samples, shape (n, k).
    """
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.linalg.norm(values, axis=1)
    finite = size[np.isfinite(size)]
    unit = other_unit(signal, float(np.median(finite))) if len(finite) else ""
    if unit:
        unit = f"median {np.median(finite):.4g}; {unit}"
    unit = unit or f"damaged, or {_UNITS.get(signal, 'another unit?')}"
    return f"samples left out, a value is beyond {LIMITS[signal]:g} (SI): {unit}"
