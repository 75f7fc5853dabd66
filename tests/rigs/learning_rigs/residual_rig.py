"""What the tests of the compensator share: made-up residual flights and a tiny preset."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from learning.data.flights import ResidualFlight
from learning.model.compensator import Compensator
from learning.model.family import Progress, TrainingTask, silent
from learning.model.registry import family_named
from learning.preset import BEST, Preset, Protocol
from learning.training.train import fit_model

Array = NDArray[np.float64]
TINY = replace(
    BEST,
    name="tiny",
    clustering="kmeans",
    n_clusters=2,
    encoder_units=(6,),
    decoder_units=(6,),
    code_size=4,
    n_codes=16,
    phase_size=2,
    epochs=4,
    validate_every=2,
    batch=4,
    window=20,
    carry=2,
)
"""Trains in a fraction of a second."""
UNITS = np.repeat([0.1, 2.0, 1e-6, 0.3, 0.5], 3)
"""Size of the made-up residuals, units of the channels."""


def made_up(
    seed: int, n: int = 300, commands: int = 2, every: int = 1, gain: float = 1.0
) -> ResidualFlight:
    """Takeoff and hover, two spans with a gap; slow residuals that follow the virtual speed.

    Args:
        seed: Of everything.
        n: Samples.
        commands: Motors.
        every: Position and magnetometer are measured once in so many samples.
        gain: Of what follows the speed: a residual that the features tell.
    """
    rng = np.random.default_rng(seed)
    speed = lfilter([0.05], [1.0, -0.95], rng.normal(size=(n, 15)), axis=0)
    virtual = UNITS * (3 * speed + 0.1 * rng.normal(size=(n, 15)))
    drift = lfilter([0.3], [1.0, -0.9], rng.normal(size=(n, 15)), axis=0)
    residual = UNITS * (drift + gain * np.roll(speed, 1, axis=1) * 5 + 0.5)
    fresh = np.ones((n, 15), dtype=np.bool_)
    slow = np.arange(n) % every == 0
    fresh[:, 6:12] = slow[:, None]
    for row in range(1, n):
        residual[row] = np.where(fresh[row], residual[row], residual[row - 1])
    return ResidualFlight(
        name=f"made_up_{seed}",
        rate_hz=100.0,
        t_s=np.arange(n) / 100.0,
        virtual=virtual,
        residual=residual,
        fresh=fresh,
        commands=rng.uniform(size=(n, commands)),
        phase=np.repeat([1, 2], [n // 2, n - n // 2]),
        spans=((0, n // 3), (n // 3 + 5, n)),
    )


def tiny(**changes: object) -> Preset:
    """The tiny preset with some switches turned."""
    return replace(TINY, **changes)  # type: ignore[arg-type]


def train(
    flights: Sequence[ResidualFlight],
    preset: Preset,
    protocol: Protocol,
    horizon: int,
    seed: int,
    folder: Path,
    progress: Progress = silent,
) -> Compensator:
    """A compensator of these flights, its folder written."""
    task = TrainingTask(protocol, horizon, seed, "v", "0f")
    family = family_named("svq" if preset.network else "linear")
    model = fit_model(flights, family, preset, task, folder, progress)
    assert isinstance(model, Compensator)
    return model
