"""Which law is used: that which flies better on flights it has not seen, and does no harm."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from learning.force.candidates import Candidate
from learning.force.model import Flown
from twin.physics.residual_force import ForceLaw, weight_names

Array = NDArray[np.float64]
AHEAD_S = (0.2, 0.5, 1.0)
"""Horizons at which laws are compared."""
BETTER = 0.01
"""Share by which a law must lower the error, in the geometric mean over quantities and horizons."""
WORSE = 1.02
"""No quantity may grow by more, in the geometric mean over the horizons."""
PART = "residual_force."


def as_flown(name: str, squares: Array, fitted: Sequence[Candidate] = ()) -> Flown:
    """A law from its mean squares over those without it, shape (horizons, 4, 3)."""
    cells = np.exp(np.mean(np.log(squares), axis=0) / 2)
    return Flown(
        law=name,
        ratio=float(np.exp(np.mean(np.log(cells)))),
        worst=float(cells.max()),
        gain=float(np.mean([c.gain for c in fitted])) if fitted else 0.0,
    )


def best_law(flown: Sequence[Flown]) -> str:
    """The simplest law within `BETTER` of the best of those that help and do no harm."""
    good = [f for f in flown if f.ratio < 1 - BETTER and f.worst <= WORSE]
    if not good:
        return "none"
    least = min(f.ratio for f in good)
    return next(f.law for f in good if f.ratio <= least + BETTER)


def weight_starts(law: ForceLaw) -> dict[str, float]:
    """The weights of a law as start values of the fused FMU."""
    names = [n for table in weight_names(law) for row in table for n in row]
    values = np.concatenate([law.linear.ravel(), law.waves.ravel()]).tolist()
    return {PART + n: v for n, v in zip(names, values, strict=True)}
