"""Fit of a force law through the rollout of the airframe's equations.

The purpose of a law is prediction over half a second; a law with the right acceleration at every
instant need not give it (a controller responds to disturbances, and its response is mistaken for
their cause). So the weights minimise the error at several horizons of windows that begin at the
measured motion, with the disturbance observer of the driven twin:

    x' = f(x, u, units (W features(x, u) + d))        d(0) = low-pass of (what f lacks - W features)

d decays. Sensitivities of the motion by W are integrated along the rollout (forward sensitivities,
first order in the step), so that a Levenberg-Marquardt step takes one rollout. A ridge pulls W to
zero. From zero, the errors after 2 s have other local minima; so horizons grow, each starting from
the previous law.

Source: output-error identification, Ljung, System Identification, ch. 7.3 and 10.2; sensitivities,
Maine & Iliff, NASA RP 1168, 1986; the loss, Charbonnier et al., ICIP 1994.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.frames import AXES
from twin.physics.observer import FADE_S
from twin.physics.residual_force import FEATURES, OUTPUTS
from twin.residuals.teacher_forced import GRID_S, RIGID

from .equations import STEP_S, STEPS, Equations
from .windows import HORIZONS_S, FlightWindows, apart, turn_slopes

Array = NDArray[np.float64]
ROBUST = 3.0
"""Error, relative to the rms of its quantity at its horizon, above which it counts linearly, so
that a window with a tumbling twin has limited influence."""
GROWING_S = (0.5, 1.0, 2.0)
"""Longest horizons, in turn, s. With the last two, a law of real_1 leaves of real_2 (RflySimDT,
ridge 0.1) 0.27 as with the first alone after 0.5 s, and 0.14 and 0.16 after 1 and 2 s in place of
0.34 and 0.45."""
ROUNDS, RAISES = 8, 8
"""Maximum number of Levenberg-Marquardt steps, and of increases of the damping per step."""
DAMPING, SETTLED = 1e-3, 1e-3
"""Initial damping; and relative gain below which the fit has converged."""
FARTHEST = 30.0
"""Speed, m/s, and rate, rad/s, above which a window is ignored, as the twin diverges."""
_N, _WEIGHTS = len(RIGID), len(OUTPUTS) * len(FEATURES)


def rolled(
    equations: Equations,
    flight: FlightWindows,
    weights: Array,
    slopes: bool = False,
    longest_s: float = HORIZONS_S[-1],
) -> tuple[Array, Array]:
    """Errors of windows predicted with a law.

    Args:
        equations: Equations of the airframe.
        flight: Windows of a flight.
        weights: Weights: specific force and angular acceleration per feature, shape (6, k).
        slopes: Whether slopes by the weights are computed.
        longest_s: Longest horizon that is predicted, s.

    Returns:
        Twin minus aircraft at `HORIZONS_S` up to the longest, (w, h, 12), and its slope by
        `weights`, (w, h, 12, 6 k); without slopes (w, h, 12, 0).
    """
    x, count = flight.start, len(flight.start)
    ends = [round(h / STEP_S) for h in HORIZONS_S if h <= longest_s]
    disturbance = flight.lacks - flight.knows @ weights.T
    fades = (1 - GRID_S / FADE_S) ** STEPS
    fast = [i for i, n in zip(equations.rigid, RIGID, strict=True) if n[:3] in ("vel", "ome")]
    width = _WEIGHTS if slopes else 0
    by_weight, of_disturbance = np.zeros((count, _N, width)), -_blocks(flight.knows, width)
    errors, slopes_of = [], []
    for k in range(ends[-1]):
        u, volts = flight.inputs[:, k], flight.volts[:, k]
        seen = equations.features(x, u, volts)
        a = seen @ weights.T + disturbance
        if slopes:
            step, push, of_features = equations.slopes(x, u, volts, a)
            of_law = weights @ (of_features @ by_weight) + _blocks(seen, width)
            by_weight = step @ by_weight + push @ (of_law + of_disturbance)
            of_disturbance = of_disturbance * fades
        after = equations.step(x, u, a)
        slow = np.all(np.abs(after[:, fast]) < FARTHEST, axis=1)[:, None]
        x = np.where(slow, after, x)
        by_weight = np.where(slow[..., None], by_weight, 0.0)
        disturbance = disturbance * fades
        if k + 1 in ends:
            motion = x[:, equations.rigid]
            off = apart(motion, flight.truth[:, ends.index(k + 1)])
            errors.append(off.reshape(count, -1))
            slopes_of.append(_error_slopes(motion, by_weight))
    return np.stack(errors, axis=1), np.stack(slopes_of, axis=1)


def _blocks(values: Array, width: int) -> Array:
    """Derivative of `W @ values` by W, shapes (w, k) to (w, 6, 6 k)."""
    found = np.zeros((len(values), len(OUTPUTS), len(OUTPUTS), values.shape[1]))
    for i in range(len(OUTPUTS)):
        found[:, i, i] = values
    return found.reshape(len(values), len(OUTPUTS), -1)[..., :width]


def _error_slopes(motion: Array, by_weight: Array) -> Array:
    """Slopes of `apart` for small errors, from those of `RIGID`, shape (w, 12, m)."""
    rows = {stem: [RIGID.index(f"{stem}_{a}") for a in AXES] for stem in ("pos", "vel", "omega")}
    turned = turn_slopes(motion) @ by_weight[:, [RIGID.index(f"q_{a}") for a in "wxyz"]]
    pos, vel, omega = (by_weight[:, i] for i in rows.values())
    return np.concatenate([pos, vel, turned, omega], axis=1)


def fitted(
    equations: Equations,
    flights: Sequence[FlightWindows],
    sizes: Array,
    ridge: float,
    start: Array | None = None,
    outputs: Sequence[int] = range(len(OUTPUTS)),
) -> Array:
    """Weights that minimise the error over windows, with equal weight of the flights.

    Errors are relative to those of the law from which a step begins, by flight, horizon and
    quantity: what falls is the geometric mean, by which laws are chosen. Relative to those without
    a law, what a law had reduced to a tenth would hardly count any more. Weights are relative to
    the size of the residual acceleration, features to their own.

    Args:
        equations: Equations of the airframe.
        flights: Training flights.
        sizes: Sizes of the features, shape (k,).
        ridge: Ridge parameter: penalty of a weight.
        start: Initial weights, shape (6, k); None: zero.
        outputs: Indices of the outputs in `OUTPUTS` for which there is a law.

    Returns:
        Weights: specific force, m/s2, and angular acceleration, rad/s2, per feature, shape (6, k).
    """
    weights = np.zeros(_WEIGHTS) if start is None else (start * sizes).ravel()
    free = np.flatnonzero(np.repeat(np.isin(np.arange(len(OUTPUTS)), outputs), len(sizes)))
    for longest_s in GROWING_S if start is None else GROWING_S[-1:]:
        problem = _Problem(equations, flights, sizes, ridge, longest_s, weights)
        weights = _improved(problem, weights, free)
    return weights.reshape(len(OUTPUTS), -1) / sizes


def _improved(problem: "_Problem", weights: Array, free: NDArray[np.intp]) -> Array:
    """Weights with less cost, by Levenberg-Marquardt; those that are not free stay."""
    damping, (cost, gradient, curvature) = DAMPING, problem.slopes(weights)
    for _ in range(ROUNDS):
        for _ in range(RAISES):
            damped = curvature + damping * np.diag(np.diag(curvature))
            tried = weights.copy()
            tried[free] -= np.linalg.solve(damped[np.ix_(free, free)], gradient[free])
            if (less := problem.cost(tried)) < cost:
                break
            damping *= 10
        else:
            break
        gain, weights, damping = (cost - less) / cost, tried, damping / 5
        if gain < SETTLED:
            break
        cost, gradient, curvature = problem.slopes(weights)
    return weights


class _Problem:
    """Cost of weights, each normalised by the size of its feature, shape (6 k,)."""

    def __init__(
        self,
        equations: Equations,
        flights: Sequence[FlightWindows],
        sizes: Array,
        ridge: float,
        longest_s: float,
        start: Array,
    ) -> None:
        self._equations, self._flights, self._sizes = equations, flights, sizes
        self._longest_s = longest_s
        lacks = np.sqrt(np.mean([np.mean(f.left**2, axis=0) for f in flights], axis=0))
        self._ridge = ridge / np.repeat(np.maximum(lacks, _LEAST) ** 2, len(sizes))
        per_feature = start.reshape(len(OUTPUTS), -1) / sizes
        self._units = [
            _cells(rolled(equations, f, per_feature, longest_s=longest_s)[0]) for f in flights
        ]

    def cost(self, weights: Array) -> float:
        """Cost of weights."""
        losses = [np.mean(_loss(off)) for off, _ in self._errors(weights, False)]
        return float(np.mean(losses) + weights @ (self._ridge * weights))

    def slopes(self, weights: Array) -> tuple[float, Array, Array]:
        """Cost, half of its gradient, and half of its Gauss-Newton curvature."""
        cost = float(weights @ (self._ridge * weights))
        gradient, curvature = self._ridge * weights, np.diag(self._ridge)
        for off, slope in self._errors(weights, True):
            counts = 1 / (np.sqrt(1 + (off / ROBUST) ** 2) * off.size * len(self._flights))
            cost += float(np.mean(_loss(off))) / len(self._flights)
            gradient = gradient + slope.T @ (counts * off)
            curvature = curvature + (slope * counts[:, None]).T @ slope
        return cost, gradient, curvature

    def _errors(self, weights: Array, slopes: bool) -> Sequence[tuple[Array, Array]]:
        """Normalised errors of each flight, flat, and their slopes."""
        per_feature = weights.reshape(len(OUTPUTS), -1) / self._sizes
        sizes = np.tile(self._sizes, len(OUTPUTS)) if slopes else np.zeros(0)
        found = []
        for flight, unit in zip(self._flights, self._units, strict=True):
            off, slope = rolled(self._equations, flight, per_feature, slopes, self._longest_s)
            scaled = slope / unit[..., None] / sizes
            found.append(((off / unit).ravel(), scaled.reshape(off.size, -1)))
        return found


_LEAST = 1e-9
"""Lower bound of a size used as a divisor."""


def _cells(off: Array) -> Array:
    """Rms by horizon and quantity, over the three axes; (w, h, 12) to (1, h, 12)."""
    by_axis = np.mean(off**2, axis=0).reshape(off.shape[1], -1, len(AXES))
    rms = np.sqrt(by_axis.mean(axis=-1))
    return np.repeat(np.maximum(rms, _LEAST), len(AXES), axis=1)[None]


def _loss(off: Array) -> Array:
    """Robust loss: square of small errors, linear for large ones."""
    return 2 * ROBUST**2 * (np.sqrt(1 + (off / ROBUST) ** 2) - 1)
