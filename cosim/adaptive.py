"""Step-size control: one step against two half steps, with rollback.

The coupling holds inputs over a step, so it is of first order: the difference between one step of
h and two of h/2 estimates the error of the latter, whose result is kept. Steps end at every output
instant and at every sample instant of a slave, and never cross one.

Source: Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, sec. II.4; for
co-simulation, Schierz, Arnold & Clauss, Co-simulation with communication step size control in an
FMI compatible master algorithm, Modelica 2012.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.errors import FmuError

from .rollback import Rollback

Array = NDArray[np.float64]
Advance = Callable[[float, float], None]
SAFETY, SHRINK, GROW = 0.9, 0.2, 5.0
SAMPLE_PERIOD = "sample_period"
"""Parameter that makes a slave a sampled one: its period, s."""
ON_GRID = 1e-6
"""A time that many periods from an instant is that instant: times carry rounding errors."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Instants origin + k * period, none of which a step crosses."""

    origin_s: float
    period_s: float

    def after(self, time_s: float) -> float:
        """First instant after a time."""
        k = np.floor((time_s - self.origin_s) / self.period_s + ON_GRID) + 1
        return float(self.origin_s + k * self.period_s)


@dataclass
class Control:
    """Chooses step lengths.

    Attributes:
        names: Signals that are compared.
        nominal: Size of a usual value of each, shape (n,).
        tolerance: Error allowed per step, relative to the larger of value and nominal value.
        shortest_s: Steps shorter than this end the run.
        step_s: Length to try next.
        steps: Steps accepted, each of two halves.
        rejected: Steps taken back.
    """

    names: Sequence[str]
    nominal: Array
    tolerance: float
    shortest_s: float
    step_s: float
    steps: int = field(default=0, init=False)
    rejected: int = field(default=0, init=False)

    def length(self, left_s: float) -> float:
        """Length of the next step, which leaves no crumb before the next instant."""
        if self.step_s >= left_s * (1 - 1e-9):
            return left_s
        return min(self.step_s, left_s / 2)

    def accepts(self, time_s: float, tried_s: float, whole: Array, halves: Array) -> bool:
        """Judge a step by its two results and choose the next length.

        Raises:
            FmuError: A step would become too short.
        """
        with np.errstate(invalid="ignore"):
            scale = np.maximum(self.nominal, np.abs(halves))
            error = np.abs(whole - halves) / scale / self.tolerance
        error[np.isnan(error)] = np.inf  # a shorter step may stay finite
        ratio = float(error.max(initial=0.0))
        better_s = tried_s * SAFETY / np.sqrt(ratio) if ratio > 0 else np.inf
        if ratio <= 1:
            # A step cut short by an instant says little against the longer one that was planned.
            longest_s = GROW * max(tried_s, self.step_s)
            self.steps += 1
        else:
            longest_s = tried_s
            self.rejected += 1
        self.step_s = float(np.clip(better_s, SHRINK * tried_s, longest_s))
        if ratio > 1 and self.step_s < self.shortest_s:
            raise FmuError(
                f"step-size control at {time_s:g} s: with a step of {tried_s:.3g} s the error of "
                f"{self.names[int(error.argmax())]} is still {ratio:.3g} times the tolerance. Does "
                f"it jump? Use the algorithm 'settled', a looser tolerance or fixed steps."
            )
        return ratio <= 1


def advance_to(
    instant_s: float,
    time_s: float,
    control: Control,
    grids: Sequence[Grid],
    advance: Advance,
    system: Rollback,
    compared: NDArray[np.intp],
) -> None:
    """Controlled steps from a time to an instant."""
    values = system.bus.values
    while time_s < instant_s:
        end_s = min([instant_s, *(g.after(time_s) for g in grids)])
        system.keep()
        while True:
            h = control.length(end_s - time_s)
            advance(time_s, h)
            whole = values[compared]
            system.back()
            advance(time_s, h / 2)
            advance(time_s + h / 2, h / 2)
            if control.accepts(time_s, h, whole, values[compared]):
                break
            system.back()
        time_s = end_s if h == end_s - time_s else time_s + h
