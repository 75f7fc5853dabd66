"""Numbers, units and names as text, identical in tables, sentences and pages."""

import math
from collections.abc import Sequence

_READ_IN = {
    "T": ("µT", 1e6),
    "Pa": ("hPa", 1e-2),
    "rad": ("°", 180 / math.pi),
    "rad/s": ("°/s", 180 / math.pi),
}
"""Display units of quantities, and their factors from SI."""
_SMALLER = {"m": 0.1, "s": 0.1, "kg": 0.1}
"""Values below which a quantity is displayed in thousandths of its unit; for others, `_TINY`."""
_TINY, _PREFIXES = 1e-3, (("m", 1e3), ("µ", 1e6), ("n", 1e9))
"""Value below which a prefix is used; prefix and factor."""


def pretty_unit(unit: str) -> str:
    """A unit in printed form: `m/s2` is m/s²."""
    return unit.replace("^", "").replace("s2", "s²").replace("m2", "m²")


def number(value: float) -> str:
    """A number with three significant figures; a dash for NaN."""
    if not math.isfinite(value):
        return "\N{EN DASH}"
    if value != 0 and (abs(value) < 1e-3 or abs(value) >= 1e5):
        text = f"{value:.2e}"
    else:
        text = f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return text.replace("-", "\N{MINUS SIGN}")


def percent(share: float) -> str:
    """A percentage, with two significant figures below 10 %; a dash for NaN."""
    if not math.isfinite(share):
        return "\N{EN DASH}"
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def readable(unit: str, *values: float) -> tuple[tuple[float, ...], str]:
    """Values of one quantity in display units: degrees, µT, hPa, and milli, micro or nano of a unit
    where all values are small.

    Args:
        unit: SI unit, as in an FMU; "1" for a plain number.
        values: Values in that unit.

    Returns:
        The values in the display unit, and the printed unit, "" for a plain number.
    """
    if unit in ("1", ""):
        return values, ""
    if unit in _READ_IN:
        name, factor = _READ_IN[unit]
        return tuple(factor * v for v in values), name
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    symbol = unit.partition("/")[0].partition(".")[0]
    if largest >= _SMALLER.get(unit, _TINY) or largest == 0 or not symbol.isalpha():
        return values, pretty_unit(unit)
    if unit == "kg":
        return tuple(1e3 * v for v in values), "g"
    prefix, factor = next((p for p in _PREFIXES if largest * p[1] >= 1), _PREFIXES[-1])
    scaled = tuple(factor * v if abs(factor * v) >= _TINY else 0.0 for v in values)
    return scaled, prefix + pretty_unit(unit)


def quantity(value: float, unit: str) -> str:
    """A value with its display unit."""
    (shown,), name = readable(unit, value)
    return f"{number(shown)}{name}" if name == "°" else f"{number(shown)} {name}".rstrip()


def joined(parts: list[str], word: str = "and") -> str:
    """Parts of a sentence joined by commas and "and"."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {word} {parts[-1]}"


def title(effect: str) -> str:
    """Name of an effect in words."""
    return effect.replace("_", " ")


def certainty(probability: float) -> str:
    """A probability in words or percent: never 0 or 100 %."""
    if probability > 0.99:
        return "99 %" if probability < 0.995 else "more than 99 %"
    return "less than 1 %" if probability < 0.01 else f"{100 * probability:.0f} %"


def interval(ci95: tuple[float, float] | None) -> str:
    """95 % interval of a number; a dash where there is none."""
    return "\N{EN DASH}" if ci95 is None else " to ".join(map(number, ci95))


def number_cells(
    value: float, unit: str, ci95: tuple[float, float] | None = None
) -> tuple[str, str, str]:
    """A number in a table: value, unit and 95 % interval, in the display unit."""
    (shown, *ends), name = readable(unit, value, *(ci95 or ()))
    return number(shown), name, interval((ends[0], ends[1]) if ends else None)


def counted(things: Sequence[object], one: str) -> str:
    """A count with its noun: "1 flight", "3 flights"."""
    return f"{len(things)} {one}{'' if len(things) == 1 else 's'}"
