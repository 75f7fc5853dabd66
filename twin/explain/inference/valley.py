"""Starting points for an effect that another one masks: along the valley between the two.

An effect whose states an observer estimates is strongly nonlinear in its size and shape parameters:
the estimates depend on the constants as well. Where the constants of two effects cancel, each alone
is rejected because of them, and no gradient leads from none to both. The valley in which the
constants stay equal has one dimension more than the shapes; it is sampled on a grid, with the exact
model.

    r0 - r(s) = B y,    x(s) = x0 + s e + s / s0 y

r: constants of the channels over their between-flight standard deviations; s e: sizes and shape
parameters of the effect; B: slopes of the constants by the numbers of the partner; y: change that
compensates r(s0) - r0. The partner is the effect that does so with the highest prior density.
"""

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from ...effects import EFFECTS
from ...residuals.channels import Array
from .evidence import LaplaceEvidence
from .fit import Problem, State
from .priors import effect_of
from .spectrum import OF_POSE, Spectrum

Start = tuple[tuple[str, ...], Array]
"""A candidate model, and its initial numbers, as `MapEstimate.x`."""
SIZES, PIVOT = np.geomspace(0.18, 1.4, 7), 0.5
"""Sizes of the effect over its prior standard deviation; and the one at which partners are
compared."""
SHAPES = np.geomspace(0.5, 1.9, 6)
"""Shape parameters over their prior means."""
PARTNERS, BALANCING, STARTS = 2, 2, 2
"""Number of partners whose valleys are sampled; steps to balance one; and best points of each from
which fits start."""
MORE = 3.0
"""Ratio of the residual in a band to that between sensor and pose, from which on there is something
for an observer to follow."""
LEAST = 1e-6
"""Prior precision of the partner's numbers that must compensate all; a solver tolerance."""


def hidden_starts(problem: Problem, laplace: LaplaceEvidence, state: State) -> Iterator[Start]:
    """Starts for each effect with an observer that the channels leave room for; `laplace`: near the
    state."""
    room = leaves_motion(laplace.spectrum)
    for cause in problem.priors.causes:
        observer = EFFECTS[effect_of(cause)].observer
        if observer is not None and any(room.get(n, False) for n in observer.channels):
            yield from _along(problem, laplace.spectrum, state, cause)


def leaves_motion(spectrum: Spectrum) -> dict[str, bool]:
    """By channel measured by both sensor and pose, whether the residual in a band exceeds their
    difference, so that it is no noise of either."""
    power, place = spectrum.power(), {n: i for i, n in enumerate(spectrum.channels)}
    mean = {k: p / n for k, (p, n) in power.items()}
    both = {n: (i, place[OF_POSE + n]) for n, i in place.items() if OF_POSE + n in place}
    return {
        name: any(
            left > MORE**2 * mean.get((of_pose, band), np.inf)
            for (c, band), left in mean.items()
            if c == own and band
        )
        for name, (own, of_pose) in both.items()
    }


def _along(problem: Problem, spectrum: Spectrum, state: State, cause: str) -> list[Start]:
    """Best points of the valleys of an effect, where they are more probable than the state, each
    with the numbers of the effect fixed and the largest day-to-day variation."""
    b = problem.priors
    own = np.array([i for i in b.of([cause]) if not b.shape[i]])
    shapes = np.array([i for i in b.of([cause]) if b.shape[i]], dtype=np.intp)
    others = [e for e in state.effects if e != cause]
    base = state.best.x.copy()
    base[b.of([cause])] = 0.0

    def at(size: float, shape: float, partner: Array) -> Array:
        """Numbers at a point of a valley."""
        x = base.copy()
        x[own] = size * b.slab[own]
        x[shapes] = np.clip(shape * b.mean[shapes], b.low[shapes], b.high[shapes]) - b.now[shapes]
        k = len(partner)
        x[:k] = np.clip(x[:k] + size / PIVOT * partner, b.low - b.now, b.high - b.now)
        return x

    def there(x: Array) -> Spectrum:
        """Residuals at some numbers, with the slopes of the state."""
        return spectrum.moved(problem.channels(x), *problem.split(x))

    def log_evidence(near: Spectrum, rest: Sequence[str], on: Sequence[str]) -> float:
        """Evidence over the numbers of `rest`, all others fixed, with the prior odds of `on`."""
        held = problem.laplace(near.only(problem.moving(rest))).best(rest, 1.0)
        return held.evidence - b.log_odds(rest) + b.log_odds(on)

    least = log_evidence(spectrum, others, state.effects)
    deviation = _deviations(problem, spectrum)
    slopes = _constants(spectrum)[1] / deviation[:, None] * b.slab
    none = np.zeros(len(b.now))
    before = _constants(there(base))[0]

    def taken_back(partner: Array) -> Array:
        """Change of the constants by the effect and its partner."""
        return (_constants(there(at(PIVOT, 1.0, partner)))[0] - before) / deviation

    found: list[tuple[float, Start]] = []
    alone = taken_back(none)
    for partner in _partners(problem, slopes, alone, cause, others):
        columns = [i for i in b.of([partner]) if not b.shape[i]]
        numbers, left = none.copy(), alone
        for _ in range(BALANCING):
            numbers[columns] += b.slab[columns] * _taking(slopes[:, columns], left, LEAST)
            left = taken_back(numbers)
        rest = tuple(sorted({*others, partner}))
        on = tuple(sorted({*rest, cause}))
        places = []
        for size, shape in product(SIZES, SHAPES if len(shapes) else (1.0,)):
            x = at(size, shape, numbers)
            evidence = log_evidence(there(x), rest, on)
            if evidence > least:
                places.append((evidence, (on, x)))
        found += sorted(places, key=lambda p: -p[0])[:STARTS]
    return [start for _, start in sorted(found, key=lambda f: -f[0])]


def _partners(
    problem: Problem, slopes: Array, alone: Array, cause: str, on: Sequence[str]
) -> list[str]:
    """Effects that compensate the constants of one effect, the most probable first."""
    b, costs = problem.priors, {}
    for other in (c for c in b.causes if effect_of(c) != effect_of(cause)):
        own = slopes[:, [i for i in b.of([other]) if not b.shape[i]]]
        y = _taking(own, alone, 1.0)
        left = alone - own @ y
        costs[other] = 0.5 * float(left @ left + y @ y) - (0.0 if other in on else b.odds[other])
    return sorted(costs, key=lambda c: costs[c])[:PARTNERS]


def _taking(slopes: Array, left: Array, precision: float) -> Array:
    """Numbers that compensate a residual, in prior standard deviations."""
    normal = slopes.T @ slopes + precision * np.eye(slopes.shape[1])
    return np.asarray(np.linalg.solve(normal, slopes.T @ left))


def _constants(spectrum: Spectrum) -> tuple[Array, Array]:
    """Constants of every channel and flight, shape (n,), and their slopes by all numbers, shape (n,
    k)."""
    values, slopes = [], []
    for r in (r for own in spectrum.rows for r in own):
        constant = r.band == 0
        values.append(float(r.residual[constant].sum()))
        row = np.zeros(len(spectrum.theta))
        row[r.active] = r.slopes[constant].sum(axis=0)
        slopes.append(row)
    return np.array(values), np.array(slopes)


def _deviations(problem: Problem, spectrum: Spectrum) -> Array:
    """Between-flight standard deviation of each constant."""
    floor = [problem.noise.bands.floor[c, 0] for c in range(len(spectrum.channels))]
    return np.asarray(np.sqrt(np.repeat(floor, len(problem.model.flights))))
