"""Terms of an equation: products of quantities, and the units of what stands before them."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from ...physics.sensors.table import BODY, sensor_of
from ..settings import DEFAULT, UnnamedSettings
from .quantities import PLAIN, Quantity, Unit, later

Array = NDArray[np.float64]
RAISED = {2: "²", 3: "³", 4: "⁴"}


@dataclass(frozen=True, slots=True)
class Term:
    """A column of the regression.

    Attributes:
        text: "|v| v_x".
        unit: Powers of base units.
        values: On the grid, shape (n,).
    """

    text: str
    unit: Unit
    values: Array


def terms(
    known: Mapping[str, Quantity],
    channel: str,
    tones_hz: tuple[float, ...],
    settings: UnnamedSettings = DEFAULT.unnamed,
) -> list[Term]:
    """Everything up to products of two, laws of drag and tones that may explain a channel.

    Args:
        known: Quantities of a flight.
        channel: See `flight_model`.
        tones_hz: Frequencies at which something may shake.
        settings: How late turning rates are where they stand for a gyroscope.
    """
    axis, sensor = channel[-1], sensor_of(channel)
    of_rates = sensor is not None and bool(sensor.rate_unit)
    own = {
        k: later(v, settings.own_noise_s) if k.startswith("omega_") and of_rates else v
        for k, v in known.items()
        if _may_explain(k, channel)
    }
    n = len(next(iter(known.values())).values)
    found = [Term("1", PLAIN, np.ones(n))]
    found += [Term(k, q.unit, q.values) for k, q in own.items()]
    plain = [k for k, q in own.items() if q.degree > 1]
    for a, b in combinations_with_replacement(plain, 2):
        if (a, b) != ("|v|", "|v|"):  # the sum of three others
            found.append(_product({a: 1, b: 1} if a != b else {a: 2}, own))
    for k in (k for k in plain if k.startswith(("v_", "omega_"))):
        size, unit = np.abs(own[k].values), own[k].unit
        found.append(Term(f"max({k}, 0)", unit, np.maximum(own[k].values, 0.0)))
        found.append(Term(f"|{k}| {k}", _times(unit, unit), size * own[k].values))
    if f"v_{axis}" in own:
        found.append(_product({"|v|": 2, f"v_{axis}": 1}, own))
    t = own["time"].values
    for hz in tones_hz:
        for name, wave in (("sin", np.sin), ("cos", np.cos)):
            found.append(Term(f"{name}(2π {hz:.4g} Hz t)", PLAIN, wave(2 * np.pi * hz * t)))
    return found


def _may_explain(symbol: str, channel: str) -> bool:
    """Directions stand for what is fixed in space: a field; a force along its own axis."""
    if symbol.partition("_")[0] not in ("north", "east", "down"):
        return True
    sensor = sensor_of(channel)
    if sensor is None or sensor.fixed_in_space:
        return sensor is not None
    return sensor.group == BODY and not sensor.rate_unit and symbol[-1] == channel[-1]


def _product(powers: Mapping[str, int], known: Mapping[str, Quantity]) -> Term:
    values, unit = np.ones(1), PLAIN
    for symbol, power in powers.items():
        values = values * known[symbol].values ** power
        for _ in range(power):
            unit = _times(unit, known[symbol].unit)
    text = " ".join(s + RAISED.get(p, "") for s, p in powers.items())
    return Term(text, unit, values)


def _times(a: Unit, b: Unit) -> Unit:
    both = Counter(dict(a))
    both.update(dict(b))
    return {k: v for k, v in both.items() if v}


def powers_of(unit: str) -> Unit:
    """Powers of a unit such as "rad/s²"."""
    raised = {mark: power for power, mark in RAISED.items()}
    above, _, below = unit.partition("/")
    found: dict[str, int] = {}
    for symbols, sign in ((above, 1), (below, -1)):
        for symbol in symbols.split():
            power = raised.get(symbol[-1], 1)
            found[symbol if power == 1 else symbol[:-1]] = sign * power
    return found


def over(channel: Unit, term: Unit) -> str:
    """Unit of what stands before a term: "1/m", "rad s", "1"."""
    powers = _times(channel, {k: -v for k, v in term.items()})
    above, below = (
        " ".join(k + RAISED.get(abs(v), "") for k, v in powers.items() if v * sign > 0)
        for sign in (1, -1)
    )
    if " " in below:
        below = f"({below})"
    return f"{above or '1'}/{below}" if below else above or "1"
