"""States that no flight measures: a rotor's speed, the warmth of a motor, a load on its rope.

They are integrated along what is measured, with the steps and sample instants of the component's
own equations, every random draw zero.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component
from ..component.along import accumulated, mapped

Array = NDArray[np.float64]


def integrate_states(
    component: Component, index: Sequence[int], x: Array, u: Array, p: Array, step_s: float
) -> Array:
    """Some states of a component along the others and the inputs.

    Where one of these is unknown its last known value counts. What enters a delay line may depend
    on inputs and measured states, not on the states that are integrated.

    Args:
        component: It says how they change.
        index: Positions of the states.
        x: All states on a uniform grid, those of `index` not used, NaN where unknown, (n, n_x).
        u: Inputs there, NaN where unknown, shape (n, n_u).
        p: Parameters.
        step_s: Step of the grid.

    Returns:
        Shape (n, len(index)), from the component's own start on; NaN where nothing is known at all.
    """
    index = list(index)
    others = np.setdiff1d(np.arange(x.shape[1]), index)
    known = np.all(np.isfinite(x[:, others]), axis=1) & np.all(np.isfinite(u), axis=1)
    if not known.any():
        return np.full((len(x), len(index)), np.nan)
    last = np.maximum.accumulate(np.where(known, np.arange(len(x)), -1))
    rows = np.where(last < 0, np.argmax(known), last)
    path, inputs = x[rows], u[rows]
    start = np.asarray(component.initial(inputs[0], p), dtype=np.float64).ravel()[index]
    z, at, v = (
        ca.SX.sym(n, k) for n, k in (("z", len(index)), ("x", x.shape[1]), ("u", u.shape[1]))
    )
    full = ca.SX(at)
    full[index] = z
    if not _sampled(component, index):
        step = ca.Function("hidden_step", [z, at, v], [component.step(full, v, p, step_s)[index]])
        (after,) = accumulated(step, start, path, inputs)
        return np.vstack([start, after[:-1]])
    return _with_samples(component, index, path, inputs, p, step_s, start)


def _sampled(component: Component, index: Sequence[int]) -> bool:
    """Whether some of the states change at sample instants."""
    if component.sampling is None:
        return False
    update = component.sampling.update
    x, u, p, w, d = update.sx_in()
    after = update(x, u, p, w, d)
    return not all(ca.is_equal(after[i], x[i], 2) for i in index)


def _with_samples(
    component: Component,
    index: Sequence[int],
    path: Array,
    inputs: Array,
    p: Array,
    step_s: float,
    start: Array,
) -> Array:
    """The same with memory, sampled as often as the component says."""
    sampling = component.sampling
    assert sampling is not None
    names = [v.name for v in component.parameters]
    period = float(p[names.index(sampling.period)])
    often, seldom = max(1, round(step_s / period)), max(1, round(period / step_s))
    signals = mapped(sampling.signals, path, inputs, np.broadcast_to(p, (len(path), len(p)))).T
    delays_s = np.asarray(sampling.delays(p), dtype=np.float64).ravel()
    t = step_s * np.arange(len(path))
    late = [np.interp(t - d, t, s) for d, s in zip(delays_s, signals, strict=True)]
    z, at, v, d, now = (
        ca.SX.sym(n, k)
        for n, k in (
            ("z", len(index)),
            ("x", path.shape[1]),
            ("u", inputs.shape[1]),
            ("d", len(late)),
            ("now", 1),
        )
    )
    quiet = np.zeros(sampling.channels)

    def sample(values: ca.SX) -> ca.SX:
        """After a sample instant."""
        full = ca.SX(at)
        full[index] = values
        return sampling.update(full, v, p, quiet, d)[index]

    def advance(values: ca.SX, h: float) -> ca.SX:
        """After a step."""
        full = ca.SX(at)
        full[index] = values
        return component.step(full, v, p, h)[index]

    here = ca.if_else(now, sample(z), z)
    then = advance(here, step_s / often)
    for _ in range(often - 1):
        then = advance(sample(then), step_s / often)
    both = ca.Function("both", [z, at, v, d, now], [then, here])
    instants = (np.arange(len(path)) % seldom == 0).astype(np.float64)
    delayed = np.reshape(late, (len(late), len(path))).T
    return accumulated(both, start, path, inputs, delayed, instants[:, None])[1]
