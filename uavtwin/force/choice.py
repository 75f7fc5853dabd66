"""Which observers and laws are used: those that fly better on flights they have not seen, and do no
harm."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from learning.force.laws import LAWS, WORTH
from learning.force.model import Flown
from twin.physics.residual_force import OUTPUTS

from .fold import Fold, Lesson

Array = NDArray[np.float64]
OBSERVER = "observer"
"""Its name beside those of the laws."""
BETTER = 0.01
"""Share by which an observer or a law must lower the error, in the geometric mean over flights,
quantities and horizons."""
WORSE = 1.02
"""No quantity may grow by more, in the geometric mean over flights and horizons."""
_TINY = 1e-30


@dataclass(frozen=True, slots=True)
class Choice:
    """Which laws are used.

    Attributes:
        laws: Name of that of each output.
        tried: What each law of each output did.
    """

    laws: tuple[str, ...]
    tried: tuple[tuple[Flown, ...], ...]

    @classmethod
    def nothing(cls) -> "Choice":
        """No law, and none tried."""
        return cls((LAWS[0],) * len(OUTPUTS), ((),) * len(OUTPUTS))

    def tried_too(self, flown: Sequence[Flown]) -> "Choice":
        """The same laws, and one more tried of each output."""
        return Choice(self.laws, tuple((*t, f) for t, f in zip(self.tried, flown, strict=True)))


class Steps:
    """Progress by counted steps."""

    def __init__(self, total: int, progress: Callable[[float], None]) -> None:
        self._total, self._done, self._progress = total, 0, progress

    def one(self) -> None:
        """Another one is done."""
        self._done += 1
        self._progress(self._done / self._total)


def as_flown(law: str, gain: float, squares: Array, without: Array) -> Flown:
    """What a law or an observer does.

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


def chosen_observers(
    folds: Sequence[Fold], lesson: Lesson, progress: Callable[[float], None]
) -> tuple[list[Fold], Lesson, list[Flown]]:
    """Observer of each output, one after the other beside those of the others, no law used yet.

    It is kept where the twin is closer with it in the mean. That no quantity is farther is asked of
    laws alone: where two disturbances hid each other, the other one shows when one is taken away.

    Args:
        folds: One per flight.
        lesson: Of all flights.
        progress: Called with the share done.

    Returns:
        The same without the observers that do not fly better, and what each did.
    """
    kept, laws, found = list(folds), Choice.nothing().laws, []
    steps = Steps(len(OUTPUTS) + 1, progress)
    least = left_out(kept, laws)
    steps.one()
    for i in range(len(OUTPUTS)):
        silent = [fold.unobserved(i) for fold in kept]
        without = left_out(silent, laws)
        found.append(as_flown(OBSERVER, 0.0, least, without))
        ratio = found[-1].ratio
        if ratio is None or ratio >= 1 - BETTER:
            kept, lesson, least = silent, lesson.unobserved(i), without
        steps.one()
    return kept, lesson, found


def chosen_laws(folds: Sequence[Fold], lesson: Lesson, progress: Callable[[float], None]) -> Choice:
    """Law of each output, output after output.

    Args:
        folds: One per flight.
        lesson: Of all flights: it says which laws are worth a flight.
        progress: Called with the share done.
    """
    steps = Steps(len(OUTPUTS) * (len(LAWS) - 1) + 1, progress)
    laws, found = list(Choice.nothing().laws), []
    least = left_out(folds, laws)
    steps.one()
    for i in range(len(OUTPUTS)):
        flown, squares = [], {laws[i]: least}
        for name in LAWS[1:]:
            gain = lesson.fitted[i][name].gain
            steps.one()
            if gain <= WORTH:
                flown.append(Flown(name, gain))
                continue
            squares[name] = left_out(folds, [*laws[:i], name, *laws[i + 1 :]])
            flown.append(as_flown(name, gain, squares[name], least))
        laws[i] = best_law(flown)
        least = squares[laws[i]]
        found.append(tuple(flown))
    return Choice(tuple(laws), tuple(found))


def left_out(folds: Sequence[Fold], laws: Sequence[str]) -> Array:
    """Mean squares of what the twin with these laws is off in each flight left out, shape
    (flights, horizons, 4, 3)."""
    return np.stack([f.squares_of(laws) for f in folds])
