"""Units of FMU variables as exponents of the SI base units that FMI knows."""

import math
import re

BASE_UNITS: dict[str, dict[str, int]] = {
    "1": {},
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s2": {"rad": 1, "s": -2},
    "s": {"s": 1},
    "s2": {"s": 2},
    "Hz": {"s": -1},
    "1/s": {"s": -1},
    "1/s2": {"s": -2},
    "1/s3": {"s": -3},
    "1/m": {"m": -1},
    "s/m": {"s": 1, "m": -1},
    "rad.s/m": {"rad": 1, "s": 1, "m": -1},
    "kg": {"kg": 1},
    "1/rad": {"rad": -1},
    "kg/rad": {"kg": 1, "rad": -1},
    "kg.m/rad": {"kg": 1, "m": 1, "rad": -1},
    "kg.m": {"kg": 1, "m": 1},
    "kg/m3": {"kg": 1, "m": -3},
    "kg.m2": {"kg": 1, "m": 2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N/m": {"kg": 1, "s": -2},
    "N.s/m": {"kg": 1, "s": -1},
    "N.s2/m2": {"kg": 1, "m": -1},
    "N.s": {"kg": 1, "m": 1, "s": -1},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "N.m.s": {"kg": 1, "m": 2, "s": -1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "A": {"A": 1},
    "A.s": {"A": 1, "s": 1},
    "K": {"K": 1},
    "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "T": {"kg": 1, "s": -2, "A": -1},
    "T/A": {"kg": 1, "s": -2, "A": -2},
}


DISPLAY_UNITS: dict[str, tuple[str, float]] = {
    "rad": ("deg", 180 / math.pi),
    "rad/s": ("deg/s", 180 / math.pi),
    "rad/s2": ("deg/s2", 180 / math.pi),
    "T": ("uT", 1e6),
    "Pa": ("hPa", 1e-2),
}
"""How people write some of them: name, and what one of ours is in it."""
USUAL_SIZES = {"Pa": 1e5, "T": 1e-5, "V": 10.0, "m/s2": 10.0, "rad/s2": 10.0}
"""Of a quantity without a start value of its own, where it is far from 1."""


def usual_size(unit: str, start: float) -> float:
    """Nominal value: the power of ten below the start value, or what is usual of the unit."""
    if start == 0 or not math.isfinite(start):
        return USUAL_SIZES.get(unit, 1.0)
    return float(f"1e{math.floor(math.log10(abs(start)))}")


_RATE = re.compile(r"(.+)/s([0-9]?)")


def rate_unit(unit: str) -> str:
    """Unit of the time derivative: "m/s2" of "m/s"."""
    rate = _RATE.fullmatch(unit)
    return f"{unit}/s" if rate is None else f"{rate[1]}/s{int(rate[2] or 1) + 1}"


def base_exponents(unit: str) -> dict[str, int]:
    """Exponents of kg, m, s, A, K, mol, cd, rad.

    A coefficient of a polynomial of the rotor speed, "U.sK/radK", is U times s^K / rad^K.

    Raises:
        KeyError: The unit is unknown: add it to `BASE_UNITS`.
    """
    if unit in BASE_UNITS:
        return BASE_UNITS[unit]
    if (rate := _RATE.fullmatch(unit)) is not None and rate[1] in BASE_UNITS:
        base = dict(BASE_UNITS[rate[1]])
        return {**base, "s": base.get("s", 0) - int(rate[2] or 1)}
    match = re.fullmatch(r"(N|N\.m)\.s([0-9]?)/rad([0-9]?)", unit)
    if match is None or match[2] != match[3]:
        raise KeyError(f"unit {unit!r} is not in fmus/units.py")
    power = int(match[2] or 1)
    base = dict(BASE_UNITS[match[1]])
    return {**base, "s": base.get("s", 0) + power, "rad": -power}
