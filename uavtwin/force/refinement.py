"""Weights of laws, refined by flying: what is trained is what runs.

What follows best from one instant to the next is not always what is least far off half a second
later. So the weights that the instants gave are given shares, from none to `MOST`, at which the
exported twin, left alone, is least far off on the flights that taught it: Gauss-Newton over replays
through the FMU, whose weights are tunable parameters. What acts, and which way, the instants say,
which tell a cause from the controller's answer to it; how much of it, the replays.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from learning.force.candidates import LAWS, WORTH, Candidate
from learning.force.model import Flown
from twin.physics.residual_force import FEATURES

from .choice import Choice, Steps, as_flown, best_law, left_out
from .fold import Fold, Lesson, law_starts
from .memory import Memory
from .open_loop import Replay

Array = NDArray[np.float64]
REFINED = "refined"
"""Its name among the laws."""
MOST = 2.0
"""Largest share of a weight. Not chosen on flights."""
STEP = 0.05
"""Of a share, for the slopes."""
THINNED = 4
"""Of so many windows one is flown: the longest horizon covers them all once."""
ROUNDS = 2
"""Of Gauss-Newton: what a weight does to half a second of flight is nearly linear in it."""
_TINY = 1e-30


def refine(
    folds: Sequence[Fold], lesson: Lesson, choice: Choice, progress: Callable[[float], None]
) -> tuple[list[Fold], Lesson, Choice]:
    """Refine laws together, and use them where they fly better on flights left out.

    Args:
        folds: One per flight.
        lesson: Of all flights.
        choice: Laws so far; where there is none, a linear one is refined for which flights left
            out speak.
        progress: Called with the share done.

    Returns:
        The same with one law more of each output, and the choice.
    """
    names = [_refinable(*both) for both in zip(choice.laws, lesson.fitted, strict=True)]
    chosen = lesson.chosen(names)
    if not any(c.weights.any() for c in chosen):
        return list(folds), lesson, choice.tried_too([Flown(REFINED, c.gain) for c in chosen])
    steps, taught = Steps(len(folds) + 1, progress), []
    for fold in folds:
        replays = [f.replay for f in folds if f is not fold]
        taught.append(replace(fold, lesson=refined(fold.lesson, names, replays, fold.memory)))
        steps.one()
    laws = [
        law if name == LAWS[0] else REFINED for law, name in zip(choice.laws, names, strict=True)
    ]
    whole = as_flown(REFINED, 0.0, left_out(taught, laws), left_out(folds, choice.laws))
    tried = choice.tried_too(
        [replace(whole, gain=c.gain) if c.weights.any() else Flown(REFINED, c.gain) for c in chosen]
    )
    if best_law([whole]) != REFINED:
        return list(folds), lesson, tried
    lesson = refined(lesson, names, [f.replay for f in folds], folds[0].memory)
    steps.one()
    return taught, lesson, replace(tried, laws=tuple(laws))


def _refinable(law: str, fitted: Mapping[str, Candidate]) -> str:
    """Name of the law that is refined: that in use, else the linear one if it is worth it.

    Args:
        law: In use.
        fitted: By name, of all flights.
    """
    linear = LAWS[2]
    return linear if law == LAWS[0] and fitted[linear].gain > WORTH else law


def refined(
    lesson: Lesson, names: Sequence[str], replays: Sequence[Replay], memory: Memory
) -> Lesson:
    """The lesson with one law more of each output: that with the shares that fly best.

    Args:
        lesson: Of some flights.
        names: Of the laws that are refined together, one per output.
        replays: Of these flights.
        memory: Of the steps that were taken before.
    """
    chosen = lesson.chosen(names)
    flown = [replay.thinned(THINNED) for replay in replays]
    parts = [_parts(c.weights) for c in chosen]
    ends = np.cumsum([len(p) for p in parts])

    def of(shares: Array) -> list[Candidate]:
        """The laws with shares of their weights."""
        return [
            replace(c, law=REFINED, weights=_shared(c.weights, p, own))
            for c, p, own in zip(chosen, parts, np.split(shares, ends[:-1]), strict=True)
        ]

    def off(shares: Array) -> list[Array]:
        """What the twin is off in each flight, shape (w, horizons, 4, 3)."""
        starts = law_starts(lesson.prepared, of(shares))
        return [replay.through(lesson.fmu, starts).off for replay in flown]

    def errors(shares: Array) -> Array:
        """In shares of what the twin is off without laws: horizons and quantities count alike."""
        both = zip(off(shares), sizes, strict=True)
        return np.concatenate([(o / s).ravel() for o, s in both])

    shares = np.ones(ends[-1])
    if len(shares):

        def unrefined() -> Array:
            """What the twin is off without laws, all flights, shape (flights, horizons, 4, 3)."""
            return np.stack([np.sqrt(np.sum(o**2, axis=0) + _TINY) for o in off(0 * shares)])

        def step_from(shares: Array) -> Array:
            """Shares after one step of Gauss-Newton."""
            now = errors(shares)
            slopes = np.column_stack(
                [(errors(shares + step) - now) / STEP for step in STEP * np.eye(len(shares))]
            )
            stepped = shares + lsq_linear(slopes, -now, (-shares, MOST - shares)).x
            return np.asarray(np.clip(stepped, 0.0, MOST))

        where = f"{lesson.place.stem} {' '.join(names)}"
        sizes = list(memory.array(f"unrefined {where}", unrefined))
        for _ in range(ROUNDS):
            shares = memory.array(f"refined {where}", partial(step_from, shares))
    fitted = [{**every, REFINED: c} for every, c in zip(lesson.fitted, of(shares), strict=True)]
    return replace(lesson, fitted=fitted)


def _parts(weights: Array) -> list[NDArray[np.intp]]:
    """Weights that have a share in common: each linear one has its own, the waves one."""
    n = len(FEATURES)
    waves = n + np.flatnonzero(weights[n:])
    linear = [np.array([i]) for i in np.flatnonzero(weights[:n])]
    return [*linear, *([waves] if len(waves) else [])]


def _shared(weights: Array, parts: Sequence[NDArray[np.intp]], shares: Array) -> Array:
    """Weights of which only shares are used."""
    left = weights.copy()
    for part, share in zip(parts, shares, strict=True):
        left[part] *= share
    return left
