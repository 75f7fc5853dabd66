"""Evaluation of generated residuals: by distribution and spectrum, never sample by sample.

A generator is right when nobody can tell its signals from measured ones; a draw that agreed with
the flight sample by sample would be chance. One row is one channel of one flight in one phase
("all": the whole flight) and one seed:

| column | says |
|---|---|
| wasserstein, wasserstein_std | distance of the distributions; in units of the training spread |
| spread, spread_measured | rms about the mean |
| log_spectral_db | root mean square difference of the power spectra |
| band_db | mean absolute difference of the power in the frequency bands |
| measured B, generated B | power in frequency band B, Hz |
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..data.channels import UNITS
from ..data.flights import ResidualFlight
from ..model.corrected import Model
from . import metrics
from .scores import GROUP_OF, cells, check_finite, check_flights, residual_scale

Array = NDArray[np.float64]
SEEDS = (0, 1, 2)


def evaluate_generated(
    models: Mapping[str, Callable[[int], Model]],
    train: Sequence[ResidualFlight],
    test: Sequence[ResidualFlight],
    seeds: Sequence[int] = SEEDS,
) -> pd.DataFrame:
    """Score generators.

    Args:
        models: By name; each makes a model of a seed. A training flight played back (`recording`)
            tells how alike two real flights are.
        train: What standardised units are made from.
        test: Flights to compare with.
        seeds: Of the draws.

    Returns:
        One row per model, seed, flight, phase and channel.
    """
    check_flights(train, test)
    scale = residual_scale(train, "channel")
    rows: list[dict[str, Any]] = []
    for name, make in models.items():
        for seed in seeds:
            model = make(seed)
            for flight in test:
                corrected = model.run(flight)
                check_finite(name, flight, corrected)
                head = {"protocol": "generate", "model": name, "seed": seed, "flight": flight.name}
                rows += [head | r for r in _rows(flight, corrected.correction, scale)]
    return pd.DataFrame(rows)


def _rows(flight: ResidualFlight, generated: Array, scale: Array) -> Iterator[dict[str, Any]]:
    for phase, c, channel, here in cells(flight):
        measured, made = flight.residual[here, c], generated[here, c]
        size, t_s = scale[flight.phase[here], c], flight.t_s[here]
        powers = [metrics.band_powers(t_s, v) for v in (measured, made)]
        yield {
            "phase": phase,
            "channel": channel,
            "group": GROUP_OF[channel],
            "unit": UNITS[c],
            "n": len(made),
            "wasserstein": metrics.wasserstein(measured, made),
            "wasserstein_std": metrics.wasserstein(measured / size, made / size),
            "spread": metrics.spread_of(made),
            "spread_measured": metrics.spread_of(measured),
            "log_spectral_db": metrics.log_spectral_distance(t_s, measured, made),
            "band_db": metrics.band_distance(*powers),
            **{f"measured {b}": float(p) for b, p in zip(metrics.BANDS, powers[0], strict=True)},
            **{f"generated {b}": float(p) for b, p in zip(metrics.BANDS, powers[1], strict=True)},
        }
