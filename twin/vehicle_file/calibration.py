"""The `[calibration]` section of a vehicle file: joint uncertainty of its numbers."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import tomlkit
from tomlkit import TOMLDocument
from tomlkit.items import Array as TomlArray

from ..component import unknown_name
from ..effects import EFFECTS
from ..vehicle import Array, Calibration, Vehicle

SECTION = "calibration"  # name of the section in a vehicle file
_TABLES = ("days", "constants", "records", "means", "scatter", "left")  # tables of numbers by name
_PARTS = ("flights", "numbers", "sd", "correlation", *_TABLES)
"""Keys of the section."""
_AGAIN = "Take the section out, or write it again by `uavtwin calibrate`."  # remedy in errors
_DIGITS = 12
"""Significant digits of deviations, and decimals of correlations."""
_ROUNDING = 1e-9
"""Rounding tolerance for numbers in a file, and for a correlation matrix."""


def read_calibration(section: Any, vehicle: Vehicle, mistakes: list[str]) -> Calibration | None:
    """Read the section, given as parsed TOML.

    Args:
        section: Content of the section in the file.
        vehicle: Vehicle of the file.
        mistakes: Collects the mistakes, one line each.
    """
    before = len(mistakes)
    if not isinstance(section, dict):
        mistakes.append(f"[{SECTION}] must be a table. {_AGAIN}")
        return None
    for name in (n for n in section if n not in _PARTS):
        mistakes.append(unknown_name(f"[{SECTION}]", "key", name, _PARTS))
    known = _numbers_of(vehicle)
    flights = _texts("flights", section.get("flights"), mistakes)
    numbers = _texts("numbers", section.get("numbers"), mistakes)
    for n in dict.fromkeys(n for n in numbers if numbers.count(n) > 1):
        mistakes.append(f"{SECTION}.numbers holds {n!r} twice. {_AGAIN}")
    tables = [_by_name(part, section.get(part, {}), mistakes) for part in _TABLES]
    days, constants, records, _, scatter, left = tables
    for part, names in (("numbers", numbers), ("days", days), ("records", records)):
        for name in (n for n in names if n not in known):
            mistakes.append(unknown_name(f"{SECTION}.{part}", "number", name, known))
    spreads = {"days": days, "constants": constants, "scatter": scatter, "left": left}
    for part, values in spreads.items():
        for name, sd in values.items():
            if sd < 0:
                mistakes.append(f"{SECTION}.{part}.{name} = {sd:g} must not be negative. {_AGAIN}")
    covariance = _covariance(section, len(numbers), mistakes)
    if len(mistakes) > before or covariance is None:
        return None
    return Calibration(flights, numbers, covariance, *tables)


def with_calibration(text: str, calibration: Calibration | None) -> str:
    """Text of a vehicle file with its calibration replaced.

    Args:
        text: Text of the original file.
        calibration: Calibration to write; None: the result has none.
    """
    document = tomlkit.parse(text)
    if SECTION in document:
        document.remove(SECTION)
        text = document.as_string()
    if calibration is None:
        return text
    return f"{text.rstrip()}\n\n{_section(calibration).as_string()}"


def same_calibration(a: Calibration | None, b: Calibration | None) -> bool:
    """Whether two calibrations are equal within rounding."""
    if a is None or b is None:
        return a is b
    if (a.flights, a.numbers) != (b.flights, b.numbers):
        return False
    (one, first), (two, second) = (_split(c.covariance) for c in (a, b))
    return (
        bool(np.allclose(one, two, rtol=_ROUNDING, atol=0))
        and bool(np.allclose(first, second, rtol=0, atol=_ROUNDING))
        and all(_alike(getattr(a, part), getattr(b, part)) for part in _TABLES)
    )


# -- reading ----------------------------------------------------------------------------------


def _numbers_of(vehicle: Vehicle) -> list[str]:
    """Every number of every effect, "effect.number", those of records included."""
    return [
        f"{effect.name}.{name}"
        for effect in EFFECTS.values()
        for p in (*effect.parameters, *effect.of_logs)
        for name in p.names(vehicle)
    ]


def _texts(part: str, given: Any, mistakes: list[str]) -> tuple[str, ...]:
    if not isinstance(given, list) or not all(isinstance(t, str) for t in given):
        mistakes.append(f"{SECTION}.{part} must be a list of names in quotes. {_AGAIN}")
        return ()
    return tuple(given)


def _by_name(part: str, given: Any, mistakes: list[str]) -> dict[str, float]:
    if not isinstance(given, dict):
        mistakes.append(f"{SECTION}.{part} must be a table of numbers. {_AGAIN}")
        return {}
    found = {}
    for name, value in given.items():
        if _is_number(value):
            found[name] = float(value)
        else:
            mistakes.append(f"{SECTION}.{part}.{name} = {value!r} must be a number. {_AGAIN}")
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _covariance(section: Mapping[str, Any], n: int, mistakes: list[str]) -> Array | None:
    """Covariance from `sd` and the lower triangle `correlation`; None where they are invalid."""
    sd = section.get("sd")
    if not isinstance(sd, list) or len(sd) != n or not all(map(_is_number, sd)):
        mistakes.append(f"{SECTION}.sd must hold {n} numbers, one for each of numbers. {_AGAIN}")
        return None
    wrong = [
        f"{SECTION}.sd of {name} = {value:g} must be positive. {_AGAIN}"
        for name, value in zip(section["numbers"], sd, strict=True)
        if value <= 0
    ]
    wrong += _wrong_rows(section.get("correlation"), n)
    if wrong:
        mistakes += wrong
        return None
    correlation = np.eye(n)
    for i, row in enumerate(section["correlation"]):
        correlation[i, : i + 1] = correlation[: i + 1, i] = row
    least = float(np.linalg.eigvalsh(correlation).min()) if n else 1.0
    if least < -_ROUNDING:
        mistakes.append(
            f"{SECTION}.correlation is none: its smallest eigenvalue is {least:.3g}, which must "
            f"not be negative. {_AGAIN}"
        )
        return None
    return np.asarray(correlation * np.outer(sd, sd), dtype=np.float64)


def _wrong_rows(rows: Any, n: int) -> Iterator[str]:
    """Mistakes in the rows of a lower triangle."""
    if not isinstance(rows, list) or len(rows) != n:
        yield f"{SECTION}.correlation must hold {n} rows, one for each of numbers. {_AGAIN}"
        return
    for i, row in enumerate(rows):
        where = f"{SECTION}.correlation, row {i + 1}"
        if not isinstance(row, list) or len(row) != i + 1 or not all(map(_is_number, row)):
            yield f"{where} must hold {i + 1} numbers, up to its own. {_AGAIN}"
        elif row[-1] != 1:
            yield f"{where} must end in 1, not {row[-1]:g}. {_AGAIN}"
        elif max(map(abs, row)) > 1:
            worst = max(row, key=abs)
            yield f"{where} holds {worst:g}; a correlation lies between -1 and 1. {_AGAIN}"


# -- writing ----------------------------------------------------------------------------------


def _section(calibration: Calibration) -> TOMLDocument:
    sd, correlation = _split(calibration.covariance)
    document, table = tomlkit.document(), tomlkit.table()
    table.comment("written by `uavtwin calibrate`: how well the numbers are known together")
    table["flights"] = list(calibration.flights)
    table["numbers"] = _lines(calibration.numbers)
    table["sd"] = [_rounded(v) for v in sd]
    table["correlation"] = _lines(
        [round(float(v), _DIGITS) for v in row[: i + 1]] for i, row in enumerate(correlation)
    )
    for part in _TABLES:
        values: Mapping[str, float] = getattr(calibration, part)
        if values:
            own = tomlkit.table()
            own.update({name: _rounded(value) for name, value in values.items()})
            table[part] = own
    document[SECTION] = table
    return document


def _lines(entries: Any) -> TomlArray:
    """A list with one line per entry."""
    array = tomlkit.array()
    array.extend(entries)
    return array.multiline(True)


def _split(covariance: Array) -> tuple[Array, Array]:
    """Standard deviations, shape (n,), and correlation matrix, shape (n, n)."""
    sd = np.sqrt(np.diag(covariance))
    correlation = np.clip(covariance / np.outer(sd, sd), -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    return sd, correlation


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _alike(a: Mapping[str, float], b: Mapping[str, float]) -> bool:
    return a.keys() == b.keys() and all(
        math.isclose(value, b[name], rel_tol=_ROUNDING) for name, value in a.items()
    )
