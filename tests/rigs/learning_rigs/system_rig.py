"""Flights whose residual is known beforehand, and small systems that learn it in seconds."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.paper.system import Role, SystemModel, SystemPreset, fit_system
from benchmarks.paper.trainings import SYSTEMS
from learning.data.flights import ResidualFlight

PHASES = (1, 2)
LEVEL = 2.0
"""Distance of the phases' means, in spreads within each."""


def known(seed: int, n: int = 400) -> ResidualFlight:
    """Takeoff and hover, a span each; waves of two frequencies about a mean of each phase."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / 100.0
    hz, begin = np.where(np.arange(15) % 2, 2.0, 4.0), rng.uniform(0, 2 * np.pi)
    waves = np.sqrt(2) * np.sin(2 * np.pi * t[:, None] * hz + begin + np.arange(15))
    phase = np.repeat(PHASES, [n // 2, n - n // 2])
    residual = waves + np.where(phase == PHASES[0], 0.0, LEVEL)[:, None]
    return ResidualFlight(
        name=f"known_{seed}",
        rate_hz=100.0,
        t_s=t,
        virtual=np.zeros((n, 15)),
        residual=residual,
        fresh=np.ones((n, 15), dtype=np.bool_),
        commands=np.zeros((n, 0)),
        phase=phase,
        spans=((0, n // 2), (n // 2, n)),
    )


def small(
    name: str,
    role: Role,
    epochs: int,
    folder: Path,
    **preset: float,
) -> SystemModel:
    """A system of that name with 64 codes of 32 numbers, trained on four such flights.

    Args:
        name: Of the system.
        role: What it is to do.
        epochs: Passes over the flights.
        folder: For the checkpoint; made if it does not exist.
        preset: What else is other than the system's preset.
    """
    size = {"epochs": epochs, "code_size": 32, "n_codes": 64, "units": 32, "window": 50}
    changed = replace(SystemPreset(name), **(size | preset))  # type: ignore[arg-type]
    folder.mkdir(exist_ok=True)
    return fit_system(SYSTEMS[name], [known(k) for k in range(4)], changed, role, folder)
