"""What the tests of the sensors share: motion to feed them with, and runs in Python."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twin.component import Component, Run
from twin.component.along import accumulated, mapped
from twin.component.component import normal

Array = NDArray[np.float64]


def effect_on(*names: str, **numbers: float) -> dict[str, float]:
    """Parameters that switch effects on; numbers by full name with `__` for the dot."""
    switches = {f"{name}.enabled": 1.0 for name in names}
    return switches | {k.replace("__", "."): v for k, v in numbers.items()}


def motion(component: Component, steps: int, seed: int = 0) -> Array:
    """Smooth inputs of plausible size, shape (steps, n_u): a sum of sines each."""
    rng = np.random.default_rng(seed)
    t = np.arange(steps)[:, None, None] * 1e-3
    frequency = rng.uniform(0.2, 4.0, (1, len(component.inputs), 3))
    phase = rng.uniform(0, 2 * np.pi, frequency.shape)
    u: Array = np.sin(2 * np.pi * frequency * t + phase).sum(axis=2)
    attitude = [i for i, n in enumerate(component.input_names) if n.startswith("q_")]
    if attitude:
        u[:, attitude] += [2.0, 0.0, 0.0, 0.0]
        u[:, attitude] /= np.linalg.norm(u[:, attitude], axis=1, keepdims=True)
    return u


def readings(
    component: Component, u: Array, parameters: Mapping[str, float] | None = None
) -> Array:
    """Outputs at every millisecond, the start included, shape (n + 1, n_y), inputs held."""
    run = Run(component, u[0], component.parameter_values(parameters))
    rows = [run.outputs(u[0])]
    for k, row in enumerate(u):
        run.step(k * 1e-3, 1e-3, row)
        rows.append(run.outputs(row))
    return np.array(rows)


def draws(
    component: Component, parameters: Mapping[str, float], samples: int, seed: int = 0
) -> Array:
    """Outputs at rest right after each sample instant, shape (samples, n_y)."""
    sampling = component.sampling
    assert sampling is not None
    u = component.input_values()
    p = component.parameter_values({"sample_period": 0.01, **parameters})
    x = np.asarray(component.initial(u, p)).ravel()
    still = np.asarray(sampling.signals(x, u, p)).ravel()
    w = normal(seed, sampling.stream, sampling.channels, 0, samples)
    held = [np.broadcast_to(v, (samples, len(v))) for v in (u, p, still)]
    (states,) = accumulated(sampling.update, x, *held[:2], w, held[2])
    return mapped(component.outputs, states, *held[:2])
