"""Where the numbers of a hypothesis may lie: prior ranges, limits that nature sets, and which of
them a fit has driven a number to."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS, Limit
from ...representation import short_repr
from ...vehicle import Vehicle
from ..model.numbers import Number

Array = NDArray[np.float64]
EDGE = 1e-6
"""Share of a limit's terms that a fit at the limit may be away from it."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """Ranges and linear limits of k numbers.

    Attributes:
        low: Smallest value of each, shape (k,).
        high: Largest value of each, shape (k,).
        rows: Weights of each limit, shape (m, k).
        least: Smallest value of each weighted sum, shape (m,).
    """

    low: Array
    high: Array
    rows: Array
    least: Array

    __repr__ = short_repr

    @classmethod
    def of(cls, numbers: Sequence[Number], vehicle: Vehicle) -> "Bounds":
        """What priors and the effects' own limits leave; a model as it stands is always inside."""
        place = {n.full: i for i, n in enumerate(numbers)}
        now = np.array([n.now for n in numbers])
        rows = []
        for effect in dict.fromkeys(n.effect for n in numbers):
            for limit in EFFECTS[effect].limits(vehicle):
                row = np.zeros(len(numbers))
                row[[place[f"{effect}.{k}"] for k in limit.weights]] = [*limit.weights.values()]
                rows.append(row)
        every = np.array(rows).reshape(-1, len(numbers))
        low, high = (np.array([n.about.bounds[i] for n in numbers]) for i in (0, 1))
        return cls(low, high, every, np.minimum(0.0, every @ now))

    def around(self, values: Array) -> "Bounds":
        """Of changes from some values."""
        return Bounds(
            self.low - values, self.high - values, self.rows, self.least - self.rows @ values
        )

    def part(self, columns: Sequence[int]) -> "Bounds":
        """Of some of the numbers, while the others do not change."""
        c = np.asarray(columns, dtype=np.intp)
        reach = np.any(self.rows[:, c], axis=1)
        return replace(
            self,
            low=self.low[c],
            high=self.high[c],
            rows=self.rows[reach][:, c],
            least=self.least[reach],
        )

    def inside(self, values: Array, covariance: Array) -> Array:
        """The nearest values inside, in the metric of a fit.

        Args:
            values: Shape (..., k).
            covariance: Of the fit, shape (..., k, k).
        """
        values = np.clip(values, self.low, self.high)
        for row, least in zip(self.rows, self.least, strict=True):
            short = np.maximum(least - values @ row, 0.0)
            way = covariance @ row
            values = values + (short / (way @ row))[..., None] * way
        return np.clip(values, self.low, self.high)


def edges(
    numbers: Sequence[Number], values: Mapping[str, float], vehicle: Vehicle
) -> Iterator[tuple[str, str]]:
    """Effects at an edge, and which: a hint that another effect is meant.

    Args:
        numbers: That were fitted.
        values: Of these, "effect.number" -> value.
        vehicle: The model as it stands.
    """
    for n in numbers:
        value = values[n.full]
        at = np.isclose(value, n.about.bounds, rtol=EDGE, atol=0)
        if np.any(at) and value != n.about.neutral and not n.about.ends:
            yield (
                n.effect,
                f"{n.full} = {value:.4g} is at the edge of the range that is considered, "
                f"{n.about.bounds[0]:g} to {n.about.bounds[1]:g}: perhaps another effect is meant",
            )
    for effect in dict.fromkeys(n.effect for n in numbers):
        for limit in EFFECTS[effect].limits(vehicle):
            if _on_edge(effect, limit, values):
                yield (
                    effect,
                    f"{effect} is at the edge of what is possible: {limit.meaning}; another "
                    f"effect may be meant",
                )


def _on_edge(effect: str, limit: Limit, values: Mapping[str, float]) -> bool:
    """Whether numbers use up what a limit leaves them."""
    parts = [w * values[f"{effect}.{k}"] for k, w in limit.weights.items()]
    return sum(parts) <= EDGE * sum(map(abs, parts))
