"""A hypothesis at its own best numbers: fitted again where its equations are not linear.

Gauss-Newton on the whitened residuals: the model is differentiated anew at the present numbers.
Shapes of effects (a height, a time constant of something else), in which nothing vanishes and so
nothing is linear, are searched on a grid first and then between its best neighbours.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from .evidence import Noise, Scores, blocks_of
from .model import Model
from .numbers import Number, columns_of

Array = NDArray[np.float64]
ROUNDS = 4
"""Of Gauss-Newton at most."""
SETTLED = 0.05
"""A round that moves every number by less than this share of its deviation is the last."""
GRID = 5
"""Values of a shape that are tried over its prior range."""
SEARCHES = 8
"""Values that are tried between the neighbours of the best of them."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """A hypothesis at its best.

    Attributes:
        effects: Identifiers, sorted.
        values: Numbers and shapes, "effect.number" -> value.
        numbers: Those with an interval.
        covariance: Of `numbers`, shape (k, k).
        gains: Log likelihood over that of nothing, per block, out of sample, shape (n,).
    """

    effects: tuple[str, ...]
    values: Mapping[str, float]
    numbers: tuple[Number, ...]
    covariance: Array
    gains: Array

    @property
    def gain(self) -> float:
        """Over all blocks."""
        return float(self.gains.sum())

    def sizes(self) -> dict[str, float]:
        """Of each effect the largest change of one of its numbers over the prior range."""
        changes: dict[str, float] = {}
        for n in self.numbers:
            low, high = n.about.prior
            change = abs(self.values[n.full] - n.now) / (high - low)
            changes[n.effect] = max(changes.get(n.effect, 0.0), change)
        return changes


@dataclass(frozen=True, slots=True)
class Ground:
    """What hypotheses are fitted against.

    Attributes:
        model: Flights.
        noise: Of each channel.
        powers: Of the residuals without any effect, per block.
    """

    model: Model
    noise: Sequence[Noise]
    powers: Array

    def fit(self, effects: Sequence[str]) -> Fitted:
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
        self, best: Fitted, shapes: Mapping[str, float], name: str, tries: Sequence[float]
    ) -> Fitted:
        """The best of a fit and others with another value of one shape."""
        start = best
        for value in tries:
            tried = {k: start.values[k] for k in shapes} | {name: value}
            trial = self._numbers(best.effects, tried, start.values)
            best = trial if trial.gain > best.gain else best
        return best

    def _between(
        self, best: Fitted, shapes: Mapping[str, float], name: str, grid: Sequence[float]
    ) -> Fitted:
        """The best between the neighbours of the best value of a grid."""
        at = int(np.argmin(np.abs(np.log(grid) - np.log(best.values[name]))))
        low, high = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
        trials: list[Fitted] = [best]

        def loss(log_value: float) -> float:
            """Less is better."""
            tried = {k: best.values[k] for k in shapes} | {name: float(np.exp(log_value))}
            trials.append(self._numbers(best.effects, tried, best.values))
            return -trials[-1].gain

        minimize_scalar(loss, bounds=(np.log(low), np.log(high)), method="bounded",
                        options={"maxiter": SEARCHES, "xatol": 0.01})  # fmt: skip
        return max(trials, key=lambda f: f.gain)

    def _numbers(
        self, effects: tuple[str, ...], shapes: Mapping[str, float], start: Mapping[str, float]
    ) -> Fitted:
        """Fit the numbers of some effects with their shapes given."""
        columns = columns_of(self.model.numbers, effects)
        numbers = [self.model.numbers[i] for i in columns]
        if not numbers:
            return Fitted((), {}, (), np.zeros((0, 0)), np.zeros(len(self.powers)))
        sd = np.array([n.sd for n in numbers])
        home = np.array([n.now for n in numbers])
        values = {n.full: start.get(n.full, n.now) for n in numbers} | dict(shapes)
        for _ in range(ROUNDS):
            now = np.array([values[n.full] for n in numbers])
            flights = self.model.channels(columns, values)
            scores = Scores(blocks_of(flights, self.noise), sd, now - home)
            change, covariance = scores.fit(range(len(now)))
            small = np.abs(change) < SETTLED * np.sqrt(np.diag(covariance))
            if np.all(small):
                break
            step = zip(numbers, now + change, strict=True)
            values |= {n.full: n.inside(v) for n, v in step}
            if all(values[n.full] == v for n, v in zip(numbers, now, strict=True)):
                break
        low = np.array([n.about.prior[0] for n in numbers]) - now
        high = np.array([n.about.prior[1] for n in numbers]) - now
        gains = 0.5 * (self.powers - scores.powers) + scores.gains(range(len(now)), low, high)
        covariance = covariance + scores.sandwich(range(len(now)))
        return Fitted(effects, values, tuple(numbers), covariance, gains)
