"""A sensor on a whole record at once: its readings with the noise left out."""

from collections.abc import Mapping

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .along import accumulated, mapped
from .component import Component

Array = NDArray[np.float64]


def noiseless_outputs(
    component: Component, u: Array, step_s: float, parameters: Mapping[str, float] | None = None
) -> Array:
    """Outputs of a sampled component on a uniform grid, every random draw zero.

    Sample instants fall on the grid points. What enters a delay line may depend on inputs and
    continuous states, not on memory: so it is in all sensors of `twin`.

    Args:
        component: A sensor.
        u: Inputs at the grid points, shape (n, n_u).
        step_s: Step of the grid.
        parameters: Parameters that differ from their start values; the sample period does not
            count.

    Returns:
        Shape (n, n_y).
    """
    sampling = component.sampling
    assert sampling is not None, component.name
    p = component.parameter_values({**(parameters or {}), sampling.period: step_s})
    start = np.asarray(component.initial(u[0], p), dtype=np.float64).ravel()
    every_p = np.broadcast_to(p, (len(u), len(p)))
    every_step = np.broadcast_to(step_s, (len(u), 1))
    (path,) = accumulated(component.step, start, u, every_p, every_step)
    states = np.vstack([start, path[:-1]])
    signals = mapped(sampling.signals, states, u, every_p).T
    delays_s = np.asarray(sampling.delays(p), dtype=np.float64).ravel()
    t = step_s * np.arange(len(u))
    late = [np.interp(t - d, t, s) for d, s in zip(delays_s, signals, strict=True)]

    x, v = ca.SX.sym("x", len(start)), ca.SX.sym("u", u.shape[1])
    d = ca.SX.sym("d", len(late))
    after = sampling.update(x, v, p, np.zeros(sampling.channels), d)
    both = ca.Function("both", [x, v, d], [component.step(after, v, p, step_s), after])
    delayed = np.reshape(late, (len(late), len(u))).T
    _, sampled = accumulated(both, start, u, delayed)
    return mapped(component.outputs, sampled, u, every_p)
