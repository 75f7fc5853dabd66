"""Checks of names, texts and units from a file before they enter C or XML.

An FMU is code that other tools load. Descriptions in a file are untrusted data: a name that is no
short identifier is refused when it is read, and again when it is written.

Units are exponents of the SI base units of FMI.
"""

import math
import re

from twin.component import Variable
from twin.errors import FmuError

LONGEST_NAME = 64
"""Largest length of a name from a file."""
LONGEST_VARIABLE = 256
"""Largest length of an FMU variable's name, with the name of its part."""
LONGEST_TEXT = 1000
"""Largest length of a description."""
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.]*")  # in a file
IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
"""Identifier of C: a letter or _, then letters, digits and _, all of ASCII."""


def check_name(where: str, name: object, longest: int = LONGEST_NAME) -> str:
    """The name, if it is valid: a letter or _, then letters, digits, _ and dots, all of ASCII.

    Args:
        where: File and quantity, for the message.
        name: Value to check.
        longest: Largest number of characters.

    Raises:
        FmuError: It is no valid name.
    """
    return _checked(where, name, _NAME, "letters, digits, _ and dots", longest)


def check_variable(where: str, name: object) -> str:
    """The name of an FMU variable; that of a derivative is `der(...)`, as in FMI 2.2.9.

    Raises:
        FmuError: It is no valid name.
    """
    if isinstance(name, str) and name.startswith("der(") and name.endswith(")"):
        return f"der({check_name(where, name[4:-1], LONGEST_VARIABLE)})"
    return check_name(where, name, LONGEST_VARIABLE)


def check_identifier(where: str, name: object, longest: int = LONGEST_NAME) -> str:
    """The name, if it is an identifier of C, without dots.

    Raises:
        FmuError: It is no valid identifier.
    """
    return _checked(where, name, IDENTIFIER, "letters, digits and _", longest)


def check_text(where: str, text: object, longest: int = LONGEST_TEXT) -> str:
    """The text, if it is one printable line, in any script.

    Raises:
        FmuError: It is no printable line.
    """
    if not isinstance(text, str) or len(text) > longest or not text.isprintable():
        raise FmuError(
            f"{where} = {shown(text)} is no text: write one line without control characters, "
            f"{longest} characters at most."
        )
    return text


def shown(value: object, longest: int = 80) -> str:
    """A value of a file for a message: plain ASCII on one line, truncated if long."""
    text = ascii(value[: longest + 1] if isinstance(value, str) else value)
    return text if len(text) <= longest else f"{text[:longest]}..."


def _checked(where: str, name: object, pattern: re.Pattern[str], allowed: str, longest: int) -> str:
    if not isinstance(name, str) or len(name) > longest or not pattern.fullmatch(name):
        raise FmuError(
            f"{where} = {shown(name)} is no name: write a letter or _, then {allowed}, "
            f"{longest} characters at most."
        )
    return name


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
    "rad/(m.s)": {"rad": 1, "s": -1, "m": -1},
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
}  # powers of SI base units (and rad) by unit


DISPLAY_UNITS: dict[str, tuple[str, float]] = {
    "rad": ("deg", 180 / math.pi),
    "rad/s": ("deg/s", 180 / math.pi),
    "rad/s2": ("deg/s2", 180 / math.pi),
    "T": ("uT", 1e6),
    "Pa": ("hPa", 1e-2),
}
"""Common display units: name, and its value for one SI unit."""
USUAL_SIZES = {"Pa": 1e5, "T": 1e-5, "V": 10.0, "m/s2": 10.0, "rad/s2": 10.0}
"""Typical magnitude by unit where it is far from 1, for variables without a start value."""


def usual_size(variable: Variable) -> float:
    """Nominal value: its own, the power of ten below the start value, or the typical one of the
    unit."""
    unit, start = variable.unit, variable.start
    if variable.nominal is not None:
        return variable.nominal
    if start == 0 or not math.isfinite(start):
        return USUAL_SIZES.get(unit, 1.0)
    return float(f"1e{math.floor(math.log10(abs(start)))}")


_RATE = re.compile(r"(.+)/s([0-9]?)")  # unit of a derivative


def rate_unit(unit: str) -> str:
    """Unit of the time derivative: "m/s2" for "m/s"."""
    rate = _RATE.fullmatch(unit)
    return f"{unit}/s" if rate is None else f"{rate[1]}/s{int(rate[2] or 1) + 1}"


def base_exponents(unit: str) -> dict[str, int]:
    """Exponents of kg, m, s, A, K, mol, cd, rad.

    A coefficient of a polynomial in rotor speed, "U.sK/radK", is U times s^K / rad^K.

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
        raise KeyError(f"unit {unit!r} is not in fmus/names.py")
    power = int(match[2] or 1)
    base = dict(BASE_UNITS[match[1]])
    return {**base, "s": base.get("s", 0) + power, "rad": -power}
