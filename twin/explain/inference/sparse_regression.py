"""Sparse regression of one channel on products of physical quantities of a flight.

*Quantities* of a flight on its grid, with units: motion from the pose, rotation from the gyroscope,
rotor load from the rotor equations; none from the accelerometer.

*Terms*: products of quantities, and the units of their coefficients.

*Regression*, whitened, scored on time blocks that were not used in it: terms are selected by
forward regression with orthogonal least squares, their number by the out-of-sample gain. Selection
is part of the fit: it is repeated for every fold.

Source: Billings et al., Int. J. Control 49 (1989); Brunton, Proctor & Kutz, PNAS 113 (2016).
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from ...frames import to_body
from ...physics.sensors.table import BODY, sensor_of
from ...residuals.channels import GRID_HZ, Array
from ...vehicle import GRAVITY_M_S2
from ...vehicle.vehicle import hover_level
from ..model.model import FlightModel
from ..settings import DEFAULT, UnnamedSettings
from .whitening import Block, Key

IntArray = NDArray[np.intp]
Unit = Mapping[str, int]
"""Exponents of base units."""
PLAIN: Unit = {}  # no unit
SPEED: Unit = {"m": 1, "s": -1}  # m/s
TURNING: Unit = {"rad": 1, "s": -1}  # rad/s


@dataclass(frozen=True, slots=True)
class Quantity:
    """One quantity of one flight on the grid, shape (n,), with exponents of its base units; one of
    degree 2 may be multiplied with others, one of degree 1 may not."""

    unit: Unit
    values: Array
    degree: int = 2


def quantities(flight: FlightModel) -> dict[str, Quantity]:
    """Quantities of a flight, by symbol; missing ones are omitted."""
    aligned, t = flight.aligned, flight.aligned.inputs.t_s
    motion = aligned.motion
    found = _of_rotors(flight)
    if motion.velocity is not None and motion.attitude is not None:
        q = list(motion.attitude.at(t).T)
        speed = np.stack(to_body(q, list(motion.velocity.at(t).T)))
        found |= {f"v_{a}": Quantity(SPEED, v) for a, v in zip("xyz", speed, strict=True)}
        found["|v|"] = Quantity(SPEED, np.sqrt((speed**2).sum(axis=0)))
    if motion.rates is not None:
        rates = motion.rates.at(t).T
        found |= {f"omega_{a}": Quantity(TURNING, r) for a, r in zip("xyz", rates, strict=True)}
    if motion.attitude is not None:
        q = list(motion.attitude.at(t).T)
        for name, way in (("north", (1, 0, 0)), ("east", (0, 1, 0)), ("down", (0, 0, 1))):
            along = to_body(q, [np.full(len(t), float(w)) for w in way])
            for a, value in zip("xyz", along, strict=True):
                found[f"{name}_{a}"] = Quantity(PLAIN, np.asarray(value), degree=1)
    if motion.position is not None:
        found["height"] = Quantity({"m": 1}, -motion.position.at(t)[:, 2])
    if "vbat_v" in aligned.airframe.input_names and flight.flight.has("vbat_v"):
        u = aligned.inputs.u[:, aligned.airframe.input_names.index("vbat_v")]
        found["voltage"] = Quantity({"V": 1}, u)
    found["time"] = Quantity({"s": 1}, t - t[0], degree=1)
    return found


def _of_rotors(flight: FlightModel) -> dict[str, Quantity]:
    """Thrust over weight, and commands over that of hover: total, and front over rear, right over
    left, clockwise over counter-clockwise."""
    aligned, vehicle = flight.aligned, flight.vehicle
    body, u = aligned.airframe, aligned.inputs.u
    rotors = vehicle.rotors
    y = body.outputs_along(aligned.states, u, {"ground.enabled": 0.0}).T
    names = [f"thrust_{i + 1}" for i in range(rotors.count)]
    weight = vehicle.mass_kg * GRAVITY_M_S2
    thrust = y[[body.output_names.index(n) for n in names]] / weight
    drives = [i for i, n in enumerate(body.input_names) if n.startswith(("cmd_", "rotor_"))]
    level = hover_level(vehicle)
    if not rotors.from_speed or body.input_names[drives[0]].startswith("rotor_"):
        command = u[:, drives].T / level
    else:
        assert rotors.speed_rad_s is not None
        grid = np.linspace(0, 1, 2001)
        reached = np.polynomial.polynomial.polyval(grid, rotors.speed_rad_s)
        command = u[:, drives].T / max(float(grid[int(np.argmin(np.abs(reached - level)))]), 1e-3)
    place = rotors.position_m / vehicle.arm_m
    found = {"thrust": Quantity(PLAIN, thrust.sum(axis=0))}
    found["command"] = Quantity(PLAIN, command.mean(0), degree=1)
    for side, sign in (("front", place[:, 0]), ("right", place[:, 1]), ("spin", rotors.direction)):
        share = sign / max(float(np.abs(sign).sum()), 1e-9)
        found[f"thrust_{side}"] = Quantity(PLAIN, rotors.count * share @ thrust)
        found[f"command_{side}"] = Quantity(PLAIN, share @ command, degree=1)
    return found


def later(quantity: Quantity, by_s: float) -> Quantity:
    """The quantity delayed by a time, s."""
    shift = round(by_s * GRID_HZ)
    values = np.concatenate([np.full(shift, quantity.values[0]), quantity.values[:-shift]])
    return Quantity(quantity.unit, values, quantity.degree)


RAISED = {2: "²", 3: "³", 4: "⁴"}  # superscripts of powers


@dataclass(frozen=True, slots=True)
class Term:
    """A column of the regression, "|v| v_x", exponents of its base units, and values on the grid,
    shape (n,)."""

    text: str
    unit: Unit
    values: Array


def terms(
    known: Mapping[str, Quantity],
    channel: str,
    tones_hz: tuple[float, ...],
    settings: UnnamedSettings = DEFAULT.unnamed,
) -> list[Term]:
    """All products of up to two quantities, drag laws and tones that may explain a channel."""
    axis, sensor = channel[-1], sensor_of(channel)
    of_rates = sensor is not None and sensor.rate is not None
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
    """Whether a quantity may explain a channel: directions represent vectors fixed in space, such
    as a field, or a force along its own axis."""
    if symbol.partition("_")[0] not in ("north", "east", "down"):
        return True
    sensor = sensor_of(channel)
    if sensor is None or sensor.fixed_in_space:
        return sensor is not None
    return sensor.group == BODY and sensor.rate is None and symbol[-1] == channel[-1]


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
    """Exponents of a unit such as "rad/s²"."""
    raised = {mark: power for power, mark in RAISED.items()}
    above, _, below = unit.partition("/")
    found: dict[str, int] = {}
    for symbols, sign in ((above, 1), (below, -1)):
        for symbol in symbols.split():
            power = raised.get(symbol[-1], 1)
            found[symbol if power == 1 else symbol[:-1]] = sign * power
    return found


def over(channel: Unit, term: Unit) -> str:
    """Unit of the coefficient of a term: "1/m", "rad s", "1"."""
    powers = _times(channel, {k: -v for k, v in term.items()})
    above, below = (
        " ".join(k + RAISED.get(abs(v), "") for k, v in powers.items() if v * sign > 0)
        for sign in (1, -1)
    )
    if " " in below:
        below = f"({below})"
    return f"{above or '1'}/{below}" if below else above or "1"


RIDGE = 1e-6
"""Ridge as a share of the power of a column, so that no combination of columns is singular."""


@dataclass(frozen=True, slots=True)
class Sparse:
    """Equation of one channel.

    Attributes:
        picked: Selected columns, in the order of the power that they explain.
        coefficients: Coefficients, shape (k,).
        by_fold: Coefficients fitted without each fold, shape (folds, p).
        gain: Out-of-sample log likelihood gain, nats.
    """

    picked: tuple[int, ...]
    coefficients: Array
    by_fold: Array
    gain: float


def fold_of(
    keys: Sequence[Key], seed: int, settings: UnnamedSettings = DEFAULT.unnamed
) -> dict[Key, int]:
    """Fold of each time block."""
    order = np.random.default_rng(seed).permutation(len(keys))
    return {keys[i]: int(n) % settings.folds for n, i in enumerate(order)}


def sparse(
    blocks: Mapping[Key, Block],
    folds: Mapping[Key, int],
    settings: UnnamedSettings = DEFAULT.unnamed,
) -> Sparse | None:
    """The best equation of up to `most_terms` terms; None where none gains anything."""
    whole, most = _sum([*blocks.values()]), settings.most_terms
    size = _size(whole)
    parts = [
        _sum([b for k, b in blocks.items() if folds[k] == f], len(size))
        for f in range(settings.folds)
    ]
    paths = []
    for part in parts:
        rest = Block(whole.gram - part.gram, whole.pull - part.pull, whole.power - part.power)
        paths.append(_path(rest, size, most))
    totals = []
    for n in range(most + 1):
        gains = [_gain(part, path[n]) for part, path in zip(parts, paths, strict=True)]
        totals.append(sum(gains) - settings.per_term * n)
    best = max(totals)
    if best <= 0:
        return None
    n = next(i for i, total in enumerate(totals) if total >= settings.most_of_it * best)
    by_fold = np.stack([path[n] for path in paths])
    final = _path(whole, size, most)[n]
    picked = np.flatnonzero(final)
    order = picked[np.argsort(-np.abs(final[picked] * size[picked]))]
    return Sparse(
        tuple(int(i) for i in order),
        final[order],
        by_fold,
        sum(_gain(b, by_fold[folds[k]]) for k, b in blocks.items()),
    )


def longest(blocks: Mapping[Key, Block], settings: UnnamedSettings = DEFAULT.unnamed) -> Array:
    """Coefficients of the equation with `most_terms` terms, fitted to all data, shape (p,)."""
    whole, most = _sum([*blocks.values()]), settings.most_terms
    return _path(whole, _size(whole), most)[most]


def _size(block: Block) -> Array:
    """Root of the power of each column."""
    return np.sqrt(np.maximum(np.diag(block.gram), 1e-300))


def _sum(blocks: Sequence[Block], p: int | None = None) -> Block:
    """Sums over some blocks, of `p` columns where there may be none."""
    p = len(blocks[0].pull) if p is None else p
    return sum(blocks, Block(np.zeros((p, p)), np.zeros(p), 0.0))


def _gain(block: Block, coefficients: Array) -> float:
    return float(block.pull @ coefficients - 0.5 * coefficients @ block.gram @ coefficients)


def forward(gram: Array, pull: Array, most: int) -> IntArray:
    """Columns in the order of the power that each explains beyond the earlier ones, shape (most,)
    or (p,).

    The remaining power and covariance of each column follow from the products alone, of columns,
    shape (p, p), and with the residual, shape (p,): selection is a Cholesky factorisation with
    pivots.
    """
    p = len(pull)
    power, left = np.diag(gram).copy(), pull.copy()
    factors, order = np.zeros((0, p)), np.zeros(0, dtype=np.intp)
    for _ in range(min(most, p)):
        explained = np.divide(left**2, power, out=np.zeros(p), where=power > 0)
        explained[order] = -1.0
        best = int(np.argmax(explained))
        factor = (gram[best] - factors.T @ factors[:, best]) / np.sqrt(power[best])
        left = left - factor * left[best] / np.sqrt(power[best])
        power = power - factor**2
        factors, order = np.vstack([factors, factor]), np.append(order, best)
    return order


def _path(block: Block, size: Array, most: int) -> list[Array]:
    """Coefficients with 0, 1, ... `most` terms, each of shape (p,)."""
    p = len(size)
    gram = block.gram / np.outer(size, size) + RIDGE * np.eye(p)
    pull = block.pull / size
    order = forward(gram, pull, most)
    path = []
    for n in range(most + 1):
        picked = np.sort(order[:n])
        coefficients = np.zeros(p)
        chosen = np.ix_(picked, picked)
        coefficients[picked] = np.linalg.solve(gram[chosen], pull[picked]) / size[picked]
        path.append(coefficients)
    return path
