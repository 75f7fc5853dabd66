"""Weights of laws, refined by flying: what is trained is what runs.

What follows best from one instant to the next is not always what is least far off half a second
later. So the weights that the instants gave are given shares, from none to `MOST`, at which the
exported twin, left alone, is least far off on the flights that taught it: Gauss-Newton over replays
through the FMU, whose weights are tunable parameters. What acts, and which way, the instants say,
which tell a cause from the controller's answer to it; how much of it, the replays.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from learning.force.candidates import LAWS, WORTH, Candidate
from twin.physics.residual_force import FEATURES

from .fold import Lesson, law_starts
from .open_loop import Replay

Array = NDArray[np.float64]
REFINED = "refined"
"""Its name among the laws."""
MOST = 2.0
"""Largest share of a weight. Not chosen on flights."""
STEP = 0.05
"""Of a share, for the slopes."""
ROUNDS = 6
"""Of Gauss-Newton, at most."""
_TINY = 1e-30


def to_refine(laws: Sequence[str], fitted: Sequence[Mapping[str, Candidate]]) -> list[str]:
    """Names of the laws that are refined, per output: those in use, else linear ones for which
    flights left out speak.

    Args:
        laws: In use.
        fitted: Laws by name of each output, of all flights.
    """
    linear = LAWS[2]
    return [
        linear if law == LAWS[0] and every[linear].gain > WORTH else law
        for law, every in zip(laws, fitted, strict=True)
    ]


def refined(
    lesson: Lesson,
    names: Sequence[str],
    replays: Sequence[Replay],
    progress: Callable[[], None] = lambda: None,
) -> Lesson:
    """The lesson with one law more of each output: that with the shares that fly best.

    Args:
        lesson: Of some flights.
        names: Of the laws that are refined together, one per output.
        replays: Of these flights.
        progress: Called after each time that they are flown.
    """
    chosen = lesson.chosen(names)
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
        flown = [replay.through(lesson.fmu, starts).off for replay in replays]
        progress()
        return flown

    def errors(shares: Array) -> Array:
        """In shares of what the twin is off without laws: horizons and quantities count alike."""
        flown = off(shares)
        return np.concatenate([(o / s).ravel() for o, s in zip(flown, sizes, strict=True)])

    shares = np.ones(ends[-1])
    if len(shares):
        without = off(0 * shares)
        sizes = [np.sqrt(np.sum(o**2, axis=0) + _TINY) for o in without]
        found = least_squares(
            errors, shares, bounds=(0.0, MOST), diff_step=STEP, max_nfev=ROUNDS, xtol=STEP
        )
        shares = found.x
    fitted = [
        {**every, REFINED: c} for every, c in zip(lesson.fitted, of(shares), strict=True)
    ]
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
