"""Which law is used: that which flies better on flights it has not seen, and does no harm."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from learning.force.candidates import Candidate
from learning.force.instants import Instants
from learning.force.model import Flown, observer_starts
from learning.force.train import Prepared
from twin.physics.residual_force import ForceLaw, weight_names
from twin.representation import short_repr

from .open_loop import Replay

Array = NDArray[np.float64]
BETTER = 0.01
"""Share by which a law must lower the error, in the geometric mean over flights, quantities and
horizons."""
WORSE = 1.02
"""No quantity may grow by more, in the geometric mean over flights and horizons."""
PART = "residual_force."
_TINY = 1e-30


@dataclass(frozen=True, slots=True)
class Fold:
    """A flight that is left out, and what the others teach.

    Attributes:
        replay: Of the flight.
        seen: The flight.
        prepared: The others.
        fitted: Laws by name of each output, fitted to the others.
    """

    replay: Replay
    seen: Instants
    prepared: Prepared
    fitted: Sequence[Mapping[str, Candidate]]

    __repr__ = short_repr

    def law(self, names: Sequence[str]) -> tuple[ForceLaw, dict[str, float]]:
        """The law of these names, one per output, and the parameters that make a twin fly it."""
        chosen = [every[name] for every, name in zip(self.fitted, names, strict=True)]
        law = self.prepared.law(chosen)[0]
        return law, weight_starts(law) | observer_starts([c.observer for c in chosen])

    def squares(self, fmu: Path, starts: Mapping[str, float]) -> Array:
        """Mean squares of what a twin is off in the flight left out, shape (horizons, 4, 3)."""
        return np.asarray(np.mean(self.replay.through(fmu, starts).off ** 2, axis=0))


class Steps:
    """Progress by counted steps."""

    def __init__(self, total: int, progress: Callable[[float], None]) -> None:
        self._total, self._done, self._progress = total, 0, progress

    def one(self) -> None:
        """Another one is done."""
        self._done += 1
        self._progress(self._done / self._total)


def as_flown(law: str, gain: float, squares: Array, without: Array) -> Flown:
    """What a law does.

    Args:
        law: Its name.
        gain: Nats.
        squares: Mean squares with it, shape (flights, horizons, 4, 3).
        without: The same without it.
    """
    logs = np.log((squares + _TINY) / (without + _TINY)) / 2
    worst = logs.mean(axis=(0, 1)).max()
    return Flown(law, gain, float(np.exp(logs.mean())), float(np.exp(worst)))


def best_law(flown: Sequence[Flown]) -> str:
    """The simplest law within `BETTER` of the best of those that help and do no harm."""
    good = [
        (f.law, f.ratio)
        for f in flown
        if f.ratio is not None and f.worst is not None and f.ratio < 1 - BETTER and f.worst <= WORSE
    ]
    if not good:
        return "none"
    least = min(ratio for _, ratio in good)
    return next(law for law, ratio in good if ratio <= least + BETTER)


def weight_starts(law: ForceLaw) -> dict[str, float]:
    """The weights of a law as start values of the fused FMU."""
    names = [n for table in weight_names(law) for row in table for n in row]
    values = np.concatenate([law.linear.ravel(), law.waves.ravel()]).tolist()
    return {PART + n: v for n, v in zip(names, values, strict=True)}
