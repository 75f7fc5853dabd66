"""A hypothesis at its own best numbers: fitted again where its equations are not linear.

Gauss-Newton on the whitened residuals: the model is evaluated at the present numbers, and
differentiated anew where it has turned out not to be linear.
Shapes of effects (a height, a time constant of something else), in which nothing vanishes and so
nothing is linear, are searched on a grid first and then between its best neighbours.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ...representation import short_repr
from ..model.model import Model
from ..model.numbers import Number, columns_of
from ..settings import DEFAULT, LikelihoodSettings
from .bounds import Bounds, edges
from .likelihood import Flights, Noise, Scores, Whitened, noise_of_all, whiten

Array = NDArray[np.float64]
ROUNDS = 4
"""Of Gauss-Newton at most."""
SETTLED = 0.05
"""A round that moves every number by less than this share of its deviation is the last."""
STRAIGHT = 0.01
"""Share of the power of a step that the model may deviate from a straight line on it."""
GRID = 5
"""Values of a shape that are tried over its prior range."""
SEARCHES = 8
"""Values that are tried between the neighbours of the best of them."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A hypothesis at its best.

    Attributes:
        effects: Identifiers, sorted.
        values: Numbers and shapes, "effect.number" -> value.
        numbers: Those with an interval.
        half_widths: Of the 95 % intervals of `numbers`, shape (k,).
        gains: Log likelihood over that of nothing, out of sample, shape (blocks, channels).
        told: How many numbers the flights tell, see `Scores.told`.
        left: Power that is left of each channel, white and in units of its noise, shape (c,).
        raw: The same as it is, in the square of the channel's unit.
        edges: Effects with a number at the edge of its range, and what that is.
    """

    effects: tuple[str, ...]
    values: Mapping[str, float]
    numbers: tuple[Number, ...]
    half_widths: Array
    gains: Array
    told: float
    left: Array
    raw: Array
    edges: tuple[tuple[str, str], ...] = ()

    __repr__ = short_repr

    @property
    def gain(self) -> float:
        """Over all blocks."""
        return float(self.gains.sum())

    def sizes(self) -> dict[str, float]:
        """Of each effect the largest change of one of its numbers, over one worth a name."""
        changes: dict[str, float] = {}
        for n in self.numbers:
            change = abs(self.values[n.full] - n.now) / n.about.smallest
            changes[n.effect] = max(changes.get(n.effect, 0.0), change)
        return changes


@dataclass(frozen=True, slots=True)
class Problem:
    """What hypotheses are fitted against.

    Attributes:
        model: Flights.
        noise: Of each channel.
        columns: Numbers that `rest` has slopes by.
        rest: Without any effect.
        raw: Power of each channel without any effect.
        settings: Of the noise, and how far laws are believed.
    """

    model: Model
    noise: Sequence[Noise]
    columns: tuple[int, ...]
    rest: Whitened
    raw: Array
    settings: LikelihoodSettings = DEFAULT.inference.likelihood

    __repr__ = short_repr

    @classmethod
    def of(
        cls, model: Model, settings: LikelihoodSettings = DEFAULT.inference.likelihood
    ) -> "Problem":
        """Flights with every number of their model, and the noise that it leaves."""
        columns = columns_of(model.numbers, model.effects)
        rows = model.channels(columns)
        noise = noise_of_all(rows, np.array([model.numbers[i].sd for i in columns]), settings)
        rest = whiten(rows, noise, settings)
        return cls(model, noise, tuple(columns), rest, raw_powers(rows), settings)

    def nothing(self) -> Fit:
        """The hypothesis that nothing is missing."""
        powers = self.rest.per_cell(self.rest.residual**2)
        return Fit((), {}, (), np.zeros(0), 0.0 * powers, 0.0, powers.sum(axis=0), self.raw)

    def fit(self, effects: Sequence[str]) -> Fit:
        """Fit the numbers and shapes of some effects."""
        effects = tuple(sorted(effects))
        own = [n for n in self.model.numbers if n.effect in effects]
        shapes = {n.full: n.now for n in own if n.shape}
        best = self._numbers(effects, shapes, {})
        for name in shapes:
            number = next(n for n in own if n.full == name)
            low, high = number.about.prior
            grid = np.geomspace(max(low, 1e-3 * high), high, GRID).tolist()
            best = self._better(best, shapes, name, grid)
            best = self._between(best, shapes, name, grid)
        return best

    def _better(
        self, best: Fit, shapes: Mapping[str, float], name: str, tries: Sequence[float]
    ) -> Fit:
        """The best of a fit and others with another value of one shape."""
        start = best
        for value in tries:
            tried = {k: start.values[k] for k in shapes} | {name: value}
            trial = self._numbers(best.effects, tried, start.values)
            best = trial if trial.gain > best.gain else best
        return best

    def _between(
        self, best: Fit, shapes: Mapping[str, float], name: str, grid: Sequence[float]
    ) -> Fit:
        """The best between the neighbours of the best value of a grid."""
        at = int(np.argmin(np.abs(np.log(grid) - np.log(best.values[name]))))
        low, high = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
        trials: list[Fit] = [best]

        def loss(log_value: float) -> float:
            """Less is better."""
            tried = {k: best.values[k] for k in shapes} | {name: float(np.exp(log_value))}
            trials.append(self._numbers(best.effects, tried, best.values))
            return -trials[-1].gain

        minimize_scalar(
            loss,
            bounds=(np.log(low), np.log(high)),
            method="bounded",
            options={"maxiter": SEARCHES, "xatol": 0.01},
        )
        return max(trials, key=lambda f: f.gain)

    def _numbers(
        self, effects: tuple[str, ...], shapes: Mapping[str, float], start: Mapping[str, float]
    ) -> Fit:
        """Fit the numbers of some effects with their shapes given."""
        columns = columns_of(self.model.numbers, effects)
        numbers = [self.model.numbers[i] for i in columns]
        if not numbers:
            return self.nothing()
        home, sd = (np.array([f(n) for n in numbers]) for f in (_now, _sd))
        bounds = Bounds.of(numbers, self.model.vehicle)
        now = np.array([start.get(n.full, n.now) for n in numbers])
        names = [n.full for n in numbers]
        rows, raw = self._rows(columns, dict(zip(names, now, strict=True)) | dict(shapes))
        for round_ in range(ROUNDS + 1):
            scores = Scores(rows, sd, now - home)
            change, covariance = scores.fit(range(len(now)))
            then = bounds.inside(now + change, covariance)
            settled = np.abs(then - now) <= SETTLED * np.sqrt(np.diag(covariance))
            if np.all(settled) or round_ == ROUNDS:
                break
            values = dict(zip(names, then, strict=True)) | dict(shapes)
            step = rows.slopes @ (then - now)
            flights = self.model.channels([], values)
            after, raw = self._whiten(flights).residual, raw_powers(flights)
            bend = after - (rows.residual - step)
            now = then
            rows = replace(rows, residual=after)
            if bend @ bend > max(1.0, STRAIGHT * float(step @ step)):
                rows, _ = self._rows(columns, values)
        gained = rows.per_cell(0.5 * (self.rest.residual**2 - rows.residual**2))
        gains = gained + scores.gains(range(len(now)), bounds.around(now))
        values = dict(zip(names, now.tolist(), strict=True)) | dict(shapes)
        return Fit(
            effects,
            values,
            tuple(numbers),
            scores.half_widths(range(len(now))),
            gains,
            scores.told(range(len(now)), gains.sum(axis=0), self.settings) + len(shapes),
            rows.per_cell(rows.residual**2).sum(axis=0),
            raw,
            tuple(edges(numbers, values, self.model.vehicle)),
        )

    def around(self, fitted: Fit) -> Scores:
        """Hypotheses about numbers near those of a fit, in the columns of `rest`."""
        numbers = [self.model.numbers[i] for i in self.columns]
        home, sd = (np.array([f(n) for n in numbers]) for f in (_now, _sd))
        now = np.array([fitted.values.get(n.full, n.now) for n in numbers])
        rows = self._whiten(self.model.channels(self.columns, fitted.values))
        return Scores(rows, sd, now - home)

    def _rows(self, columns: Sequence[int], values: Mapping[str, float]) -> tuple[Whitened, Array]:
        """Residuals and slopes at some values, and raw powers."""
        at_rest = {n.full: n.now for n in self.model.numbers}
        if all(at_rest[name] == value for name, value in values.items()):
            known = [self.columns.index(i) for i in columns]
            return replace(self.rest, slopes=self.rest.slopes[:, known]), self.raw
        flights = self.model.channels(columns, values)
        return self._whiten(flights), raw_powers(flights)

    def _whiten(self, flights: Flights) -> Whitened:
        return whiten(flights, self.noise, self.settings)


def raw_powers(flights: Flights) -> Array:
    """Sum of squares of each channel's residual, all flights together, shape (c,)."""
    return np.array(
        [sum(float(c.residual @ c.residual) for c in ch) for ch in zip(*flights, strict=True)]
    )


def _now(number: Number) -> float:
    return number.now


def _sd(number: Number) -> float:
    return number.sd
