"""What no flight reaches: a value beyond it is damaged, or in another unit. For every format."""

import numpy as np
from numpy.typing import NDArray

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
    "vbat_v": "in mV?",
    "ibat_a": "in mA?",
}


def beyond(signal: str, values: Array) -> NDArray[np.bool_]:
    """Samples of which a part is beyond the limit of the signal, shape (n,).

    Args:
        signal: A key of `LIMITS`; nothing is beyond where it is none.
        values: Shape (n, k).
    """
    return np.asarray((np.abs(values) > LIMITS.get(signal, np.inf)).any(axis=1))


def told(signal: str) -> str:
    """The text of a finding on such samples."""
    unit = _UNITS.get(signal, "another unit?")
    return f"samples left out, a value is beyond {LIMITS[signal]:g} (SI): damaged, or {unit}"
